//! States of several agents with a known causal graph: who looks at whom before it acts. For
//! measuring what is drawn of it.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::joint::dirichlet;

/// How evenly an agent that looks at nobody acts, and how a response is drawn, to a parent alone
/// and to one of two: the smaller, the more of its own. Responses to one parent are not too clear:
/// where two agents do exactly the same, neither can be held fixed and tell anything of the other.
const POLICY: f64 = 3.0;
const RESPONSES: [f64; 2] = [0.25, 0.1];

/// How often the sum of both parents' actions is told in [`Structure::Xor`]; else any action is as
/// likely as any other.
const TOLD: f64 = 0.85;

/// A directed acyclic graph of three or four agents.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Structure {
    /// 0 -> 1 -> 2.
    Chain,
    /// 0 <- 1 -> 2.
    Fork,
    /// 0 -> 2 <- 1, by a noisy or: either parent may be the one that is answered.
    Collider,
    /// 0 -> 1, 0 -> 2, 1 -> 3, 2 -> 3, the last by a noisy or.
    Diamond,
    /// 0 -> 2 <- 1, by the sum of both actions, which are drawn evenly: no two of the three depend,
    /// all three together do.
    Xor,
    /// Nobody looks at anybody.
    Independent,
}

/// What to draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Who looks at whom, in the states that have any dependence.
    pub structure: Structure,
    /// Actions of each agent.
    pub letters: usize,
    /// How many states.
    pub states: usize,
    /// The share of states that have the structure; in the others nobody looks at anybody.
    pub structured: f64,
    /// How often each state is seen.
    pub visits: usize,
    /// The same seed gives the same states.
    pub seed: u64,
}

/// One state.
#[derive(Debug, Clone, PartialEq)]
pub struct Played {
    /// Whether it has the structure.
    pub structured: bool,
    /// What was seen: one action an agent.
    pub visits: Vec<Vec<u64>>,
}

impl Structure {
    /// Every structure.
    pub const ALL: [Self; 6] = [
        Self::Chain,
        Self::Fork,
        Self::Collider,
        Self::Diamond,
        Self::Xor,
        Self::Independent,
    ];

    /// Returns its name.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Chain => "chain",
            Self::Fork => "fork",
            Self::Collider => "collider",
            Self::Diamond => "diamond",
            Self::Xor => "xor",
            Self::Independent => "independent",
        }
    }

    /// Returns whom each agent looks at.
    pub fn parents(self) -> &'static [&'static [usize]] {
        match self {
            Self::Chain => &[&[], &[0], &[1]],
            Self::Fork => &[&[1], &[], &[1]],
            Self::Collider | Self::Xor => &[&[], &[], &[0, 1]],
            Self::Diamond => &[&[], &[0], &[0], &[1, 2]],
            Self::Independent => &[&[], &[], &[]],
        }
    }

    /// Returns how many agents there are.
    pub fn agents(self) -> usize {
        self.parents().len()
    }

    /// Returns its skeleton: the pairs of which one looks at the other, the earlier first, in
    /// order.
    pub fn skeleton(self) -> Vec<(usize, usize)> {
        let of = |(child, parents): (usize, &&[usize])| {
            parents
                .iter()
                .map(move |parent| (child.min(*parent), child.max(*parent)))
                .collect::<Vec<_>>()
        };
        let mut edges: Vec<_> = self.parents().iter().enumerate().flat_map(of).collect();
        edges.sort_unstable();
        edges
    }
}

/// How the agents of one state act.
struct Agents {
    /// Whom each of them looks at.
    parents: &'static [&'static [usize]],
    /// Its response to each action of each parent, or its policy where it has none.
    responses: Vec<Vec<Vec<Vec<f64>>>>,
    /// Whether it answers the sum of its parents' actions.
    sums: bool,
}

/// Draws states, each with tables of its own.
pub fn played(options: &Options) -> Vec<Played> {
    let mut rng = Pcg64::seed_from_u64(options.seed);
    (0..options.states)
        .map(|_| random_state(options, &mut rng))
        .collect()
}

fn random_state(options: &Options, rng: &mut Pcg64) -> Played {
    let structured = rng.random_bool(options.structured);
    let agents = Agents::new(options, structured, rng);
    let visits = (0..options.visits)
        .map(|_| agents.act(options.letters, rng))
        .collect();
    Played {
        structured: structured && options.structure != Structure::Independent,
        visits,
    }
}

impl Agents {
    fn new(options: &Options, structured: bool, rng: &mut Pcg64) -> Self {
        const ALONE: [&[usize]; 4] = [&[]; 4];
        let Options {
            structure, letters, ..
        } = *options;
        let parents = if structured {
            structure.parents()
        } else {
            &ALONE[..structure.agents()]
        };
        let sums = structure == Structure::Xor;

        // Where the sum is answered, anything but even policies would show each parent by itself.
        let policy = if sums { 1e6 } else { POLICY };
        let mut responses = |parents: &&[usize]| match parents.len() {
            0 => vec![vec![dirichlet(policy, letters, rng)]],
            several => {
                let mut to_one = || {
                    (0..letters)
                        .map(|_| dirichlet(RESPONSES[several - 1], letters, rng))
                        .collect()
                };
                (0..several).map(|_| to_one()).collect()
            }
        };
        Self {
            responses: parents.iter().map(&mut responses).collect(),
            parents,
            sums,
        }
    }

    /// Lets everybody act, in an order in which each acts after those it looks at.
    fn act(&self, letters: usize, rng: &mut Pcg64) -> Vec<u64> {
        let mut actions = vec![None; self.parents.len()];
        while actions.iter().any(Option::is_none) {
            for (agent, parents) in self.parents.iter().enumerate() {
                let seen: Option<Vec<usize>> =
                    parents.iter().map(|parent| actions[*parent]).collect();
                if let (None, Some(seen)) = (actions[agent], seen) {
                    actions[agent] = Some(self.action(agent, &seen, letters, rng));
                }
            }
        }
        actions
            .into_iter()
            .flatten()
            .map(|action| action as u64)
            .collect()
    }

    fn action(&self, agent: usize, seen: &[usize], letters: usize, rng: &mut Pcg64) -> usize {
        if self.sums && seen.len() > 1 {
            let told = seen.iter().sum::<usize>() % letters;
            return if rng.random_bool(TOLD) {
                told
            } else {
                rng.random_range(0..letters)
            };
        }

        let to = if seen.len() > 1 {
            rng.random_range(0..seen.len())
        } else {
            0
        };
        drawn(
            &self.responses[agent][to][seen.get(to).copied().unwrap_or(0)],
            rng,
        )
    }
}

fn drawn(shares: &[f64], rng: &mut Pcg64) -> usize {
    let mut point = rng.random::<f64>();
    for (letter, share) in shares.iter().enumerate() {
        point -= share;
        if point < 0.0 {
            return letter;
        }
    }
    // What rounding left.
    shares.len() - 1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(structure: Structure) -> Options {
        Options {
            structure,
            letters: 4,
            states: 20,
            structured: 0.5,
            visits: 400,
            seed: 1,
        }
    }

    /// Returns the plug-in mutual information of two agents in a state, in nats.
    fn plug_in(state: &Played, [a, b]: [usize; 2], fixed: Option<(usize, u64)>) -> f64 {
        let visits = state
            .visits
            .iter()
            .filter(|actions| fixed.is_none_or(|(agent, action)| actions[agent] == action));
        nudge_core::information::plug_in(&nudge_core::information::Table::from_counts(
            visits.map(|actions| (actions[a], actions[b], 1)),
        ))
    }

    #[test]
    fn the_same_seed_gives_the_same_states() {
        for structure in Structure::ALL {
            let states = played(&options(structure));
            assert_eq!(states, played(&options(structure)));
            assert_ne!(
                states,
                played(&Options {
                    seed: 2,
                    ..options(structure)
                })
            );
            assert!(states.iter().all(|state| {
                state.visits.len() == 400
                    && state
                        .visits
                        .iter()
                        .all(|actions| actions.len() == structure.agents())
            }));
            assert_eq!(
                states.iter().any(|state| state.structured),
                structure != Structure::Independent
            );
        }
    }

    #[test]
    fn neighbours_depend_and_others_do_not() {
        for structure in [
            Structure::Chain,
            Structure::Fork,
            Structure::Collider,
            Structure::Diamond,
        ] {
            for state in played(&Options {
                visits: 4_000,
                ..options(structure)
            }) {
                for (a, b) in structure.skeleton() {
                    assert_eq!(
                        plug_in(&state, [a, b], None) > 0.02,
                        state.structured,
                        "{structure:?} {a}, {b}"
                    );
                }
            }
        }
    }

    #[test]
    fn sums_show_only_where_a_third_is_held_fixed() {
        for state in played(&Options {
            visits: 4_000,
            ..options(Structure::Xor)
        }) {
            for [a, b, c] in [[0, 1, 2], [0, 2, 1], [1, 2, 0]] {
                assert!(plug_in(&state, [a, b], None) < 0.01);
                assert_eq!(
                    plug_in(&state, [a, b], Some((c, 0))) > 0.2,
                    state.structured,
                    "{a}, {b}"
                );
            }
        }
    }

    #[test]
    fn skeletons_are_those_of_the_graphs() {
        let skeletons = Structure::ALL.map(|structure| structure.skeleton().len());
        assert_eq!(skeletons, [2, 2, 2, 4, 2, 0]);
        assert_eq!(Structure::Fork.skeleton(), [(0, 1), (1, 2)]);
        assert_eq!(
            Structure::Diamond.skeleton(),
            [(0, 1), (0, 2), (1, 3), (2, 3)]
        );
    }
}
