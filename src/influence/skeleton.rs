//! The skeleton of a causal graph, as the PC algorithm finds it (Spirtes, Glymour & Scheines 2000,
//! "Causation, Prediction, and Search"): an edge stays only where no set of few other agents'
//! actions, held fixed, explains it. Sets are tried smallest first, all edges by the neighbours of
//! the level before, so that the order of the agents changes nothing (PC-stable; Colombo & Maathuis
//! 2014).
//!
//! What one test says comes from outside: here is only which tests are made, and what follows.

use rayon::prelude::*;

use crate::domain::{Dependence, EdgeKind};
use crate::evidence::{self, Believed};

/// The most agents whose actions are held fixed together.
const MOST_FIXED: usize = 3;

/// The most neighbours of an agent that are held fixed, those that depend on it most: all of them
/// up to eight agents. Among more agents there would be millions of sets; who opens what is closed
/// is then also looked for among so many, but for those who do it alone.
const MOST_NEIGHBOURS: usize = 6;

/// Independent pairs that are opened by chance, at most, of those that are looked at with sets of
/// one size.
const LEVEL: f64 = 0.05;

/// Conditional independence tests: what is asked of a pair, by its position, while some other
/// agents' actions are held fixed.
pub trait IndependenceTests: Sync {
    /// Returns what is believed of it by its prior; `None` where that cannot be asked.
    fn believed(&self, pair: usize, fixed: &[usize]) -> Option<Believed>;

    /// Returns the p-value of the test of independence by so many permutations within each joint
    /// action of those held fixed.
    fn p_value(&self, pair: usize, fixed: &[usize], permutations: u64) -> f64;
}

/// What was found of one pair.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EdgeFinding {
    pub kind: EdgeKind,
    /// The agents whose actions, held fixed, leave no dependence.
    pub explained_by: Vec<usize>,
    /// The agents whose actions, held fixed, show dependence that is not seen without.
    pub opened_by: Vec<usize>,
}

/// A pair of agents, the earlier first; at a lag the ego.
pub type Ends = [usize; 2];

/// What is known of a pair by itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Margin {
    pub ends: Ends,
    /// Whether there is any dependence.
    pub dependence: Dependence,
    /// How strong it is, in any unit.
    pub strength: f64,
    /// The probability that habits differ by segment, where that is told.
    pub differ: Option<f64>,
}

/// Finds what each pair is, given what the evidence says of it by itself.
pub fn skeleton(
    agents: usize,
    pairs: &[Margin],
    tests: &impl IndependenceTests,
) -> Vec<EdgeFinding> {
    let found = pairs
        .iter()
        .map(|pair| at_margin(pair.dependence))
        .collect();
    let mut search = Search {
        agents,
        pairs,
        found,
        tests,
    };
    (1..=MOST_FIXED).for_each(|size| search.explain(size));
    (1..=MOST_FIXED).for_each(|size| search.open(size));
    search.found
}

fn at_margin(margin: Dependence) -> EdgeFinding {
    let kind = match margin {
        Dependence::Established => EdgeKind::Direct,
        Dependence::Open => EdgeKind::Open,
        Dependence::Excluded => EdgeKind::Absent,
    };
    EdgeFinding {
        kind,
        explained_by: Vec::new(),
        opened_by: Vec::new(),
    }
}

struct Search<'a, T> {
    agents: usize,
    pairs: &'a [Margin],
    found: Vec<EdgeFinding>,
    tests: &'a T,
}

impl<T: IndependenceTests> Search<'_, T> {
    /// Looks for what explains each edge that is left: sets of so many agents that may be next to
    /// one of its ends.
    fn explain(&mut self, size: usize) {
        let neighbours =
            self.neighbours(|found| matches!(found.kind, EdgeKind::Direct | EdgeKind::Open));
        let sets = |[a, b]: Ends| {
            let mut sets = combinations(&strongest(&neighbours[a], [a, b], MOST_NEIGHBOURS), size);
            sets.extend(combinations(
                &strongest(&neighbours[b], [a, b], MOST_NEIGHBOURS),
                size,
            ));
            sets.sort_unstable();
            sets.dedup();
            sets
        };

        let is_wanted = |found: &EdgeFinding| found.kind == EdgeKind::Direct;
        let beliefs = self.conditional_beliefs(is_wanted, sets);

        for (found, beliefs) in self.found.iter_mut().zip(beliefs) {
            let explaining = beliefs
                .into_iter()
                .filter(|(_, believed)| evidence::is_explained(believed));
            if let Some((set, _)) =
                explaining.min_by(|(_, a), (_, b)| a.now.dependent.total_cmp(&b.now.dependent))
            {
                (found.kind, found.explained_by) = (EdgeKind::Explained, set);
            }
        }
    }

    /// Looks for what opens each pair that shows no dependence by itself: a common effect, or
    /// somebody with whom the two act together (the parity of their actions, say), who need not be
    /// next to either.
    fn open(&mut self, size: usize) {
        let neighbours = self.neighbours(|found| found.kind != EdgeKind::Absent);
        let agents = self.agents;
        let sets = |[a, b]: Ends| {
            let is_anybody = size == 1 || agents <= MOST_NEIGHBOURS + 2;
            let others: Vec<Neighbour> = match is_anybody {
                true => (0..agents).map(|agent| (1.0, agent)).collect(),
                false => [neighbours[a].as_slice(), &neighbours[b]].concat(),
            };
            let most = if size == 1 { agents } else { MOST_NEIGHBOURS };
            combinations(&strongest(&others, [a, b], most), size)
        };

        let is_wanted = |found: &EdgeFinding| {
            found.opened_by.is_empty() && matches!(found.kind, EdgeKind::Open | EdgeKind::Absent)
        };
        let beliefs = self.conditional_beliefs(is_wanted, sets);

        let opening: Vec<_> = beliefs
            .into_par_iter()
            .enumerate()
            .map(|(at, beliefs)| self.opening(at, beliefs))
            .collect();
        for (found, set) in self.found.iter_mut().zip(opening) {
            if let Some(set) = set {
                (found.kind, found.opened_by) = (EdgeKind::Open, set);
            }
        }
    }

    /// Returns the set that opens a pair most, if one does. It must be confirmed by a test that
    /// needs no prior: what the evidence of dozens of small strata is off by adds up, and in
    /// independent states of four agents whose pairs mostly depend, one in three was opened
    /// without.
    fn opening(&self, at: usize, beliefs: Vec<(Vec<usize>, Believed)>) -> Option<Vec<usize>> {
        let sets = beliefs.len() as u64;
        let opening = beliefs
            .into_iter()
            .filter(|(_, believed)| evidence::is_opened(believed, sets));
        let (set, _) =
            opening.max_by(|(_, a), (_, b)| a.now.dependent.total_cmp(&b.now.dependent))?;

        // Twice as many as the smallest p-value that passes takes.
        let level = LEVEL / sets as f64;
        let permutations = (2.0 / level).ceil() as u64;
        (self.tests.p_value(at, &set, permutations) <= level).then_some(set)
    }

    /// Tests every pair that is wanted with each of its sets, by several threads, and returns what
    /// is believed with each.
    fn conditional_beliefs(
        &self,
        is_wanted: impl Fn(&EdgeFinding) -> bool + Sync,
        sets: impl Fn(Ends) -> Vec<Vec<usize>> + Sync,
    ) -> Vec<Vec<(Vec<usize>, Believed)>> {
        let beliefs = |(at, found): (usize, &EdgeFinding)| {
            let sets = if is_wanted(found) {
                sets(self.pairs[at].ends)
            } else {
                Vec::new()
            };
            sets.into_par_iter()
                .filter_map(|set| {
                    self.tests
                        .believed(at, &set)
                        .map(|believed| (set, believed))
                })
                .collect()
        };
        self.found.par_iter().enumerate().map(beliefs).collect()
    }

    /// Returns, for each agent, those to whom it is joined by such a pair.
    fn neighbours(&self, is_joined: impl Fn(&EdgeFinding) -> bool) -> Vec<Vec<Neighbour>> {
        let mut neighbours = vec![Vec::new(); self.agents];
        for (
            Margin {
                ends: [a, b],
                strength,
                ..
            },
            _,
        ) in self
            .pairs
            .iter()
            .zip(&self.found)
            .filter(|(_, found)| is_joined(found))
        {
            neighbours[*a].push((*strength, *b));
            neighbours[*b].push((*strength, *a));
        }
        neighbours
    }
}

/// An agent beside another, and how strongly they depend on each other.
type Neighbour = (f64, usize);

/// Returns at most so many of these agents, the strongest and none twice, in order. The ends
/// themselves are left out.
fn strongest(agents: &[Neighbour], ends: Ends, most: usize) -> Vec<usize> {
    let mut agents: Vec<Neighbour> = agents
        .iter()
        .copied()
        .filter(|(_, agent)| !ends.contains(agent))
        .collect();
    agents.sort_unstable_by(|(s, a), (t, b)| t.total_cmp(s).then(a.cmp(b)));

    let mut strongest: Vec<usize> = Vec::new();
    for (_, agent) in agents {
        if strongest.len() < most && !strongest.contains(&agent) {
            strongest.push(agent);
        }
    }
    strongest.sort_unstable();
    strongest
}

/// Returns every choice of so many items, in order.
fn combinations(items: &[usize], size: usize) -> Vec<Vec<usize>> {
    if size == 0 {
        return vec![Vec::new()];
    }
    let mut all = Vec::new();
    for (at, first) in items.iter().enumerate() {
        let rests = combinations(&items[at + 1..], size - 1);
        all.extend(
            rests
                .into_iter()
                .map(|rest| [&[*first], rest.as_slice()].concat()),
        );
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::information::Table;

    /// Where all states of the environment are taken together, so many depend.
    const UNSEEN: f64 = 0.3;

    /// What every test is to say: how probable dependence is, and how improbable what was seen is
    /// without.
    struct Said<F> {
        given: F,
        p_value: f64,
    }

    impl<F: Fn(usize, &[usize]) -> Option<f64> + Sync> IndependenceTests for Said<F> {
        fn believed(&self, pair: usize, fixed: &[usize]) -> Option<Believed> {
            let stratum = Table::from_counts([(0, 0, 50), (0, 1, 50), (1, 0, 50), (1, 1, 50)]);
            Some(Believed::of_dependence(
                (self.given)(pair, fixed)?,
                UNSEEN,
                &[stratum],
            ))
        }

        fn p_value(&self, _: usize, _: &[usize], _: u64) -> f64 {
            self.p_value
        }
    }

    /// Finds the skeleton of agents whose pairs are dependent by themselves where `margin` says so,
    /// and given others where `given` does.
    fn found(
        agents: usize,
        margin: impl Fn(Ends) -> Dependence,
        given: impl Fn(Ends, &[usize]) -> f64 + Sync,
    ) -> Vec<EdgeFinding> {
        let ends = (0..agents).flat_map(|a| (a + 1..agents).map(move |b| [a, b]));
        let pairs: Vec<Margin> = ends.map(|ends| by_itself(ends, margin(ends))).collect();
        skeleton(
            agents,
            &pairs,
            &Said {
                given: |at: usize, fixed: &[usize]| Some(given(pairs[at].ends, fixed)),
                p_value: 0.0,
            },
        )
    }

    fn by_itself(ends: Ends, dependence: Dependence) -> Margin {
        Margin {
            ends,
            dependence,
            strength: 1.0,
            differ: None,
        }
    }

    fn kind(kind: EdgeKind) -> EdgeFinding {
        EdgeFinding {
            kind,
            explained_by: Vec::new(),
            opened_by: Vec::new(),
        }
    }

    fn explained(by: &[usize]) -> EdgeFinding {
        EdgeFinding {
            explained_by: by.to_vec(),
            ..kind(EdgeKind::Explained)
        }
    }

    fn opened(by: &[usize]) -> EdgeFinding {
        EdgeFinding {
            opened_by: by.to_vec(),
            ..kind(EdgeKind::Open)
        }
    }

    #[test]
    fn go_betweens_explain() {
        let chain = |ends: Ends, fixed: &[usize]| {
            if ends == [0, 2] && fixed == [1] {
                0.01
            } else {
                0.999
            }
        };
        let told = found(3, |_| Dependence::Established, chain);
        assert_eq!(
            told,
            [
                kind(EdgeKind::Direct),
                explained(&[1]),
                kind(EdgeKind::Direct)
            ]
        );
    }

    #[test]
    fn two_explain_where_neither_does() {
        let diamond = |ends: Ends, fixed: &[usize]| match (ends, fixed) {
            ([1, 2], [0]) | ([0, 3], [1, 2]) => 0.01,
            _ => 0.999,
        };
        let [direct, by_one, by_two] =
            [kind(EdgeKind::Direct), explained(&[0]), explained(&[1, 2])];
        let told = found(4, |_| Dependence::Established, diamond);
        assert_eq!(
            told,
            [
                direct.clone(),
                direct.clone(),
                by_two,
                by_one,
                direct.clone(),
                direct
            ]
        );
    }

    #[test]
    fn only_those_who_may_be_next_to_an_end_explain() {
        // The fourth agent has nothing to do with the others, whatever a test that happens to be
        // wrong says.
        let margin = |[_, b]: Ends| {
            if b == 3 {
                Dependence::Excluded
            } else {
                Dependence::Established
            }
        };
        let told = found(
            4,
            margin,
            |_, fixed| if fixed.contains(&3) { 0.001 } else { 0.999 },
        );
        let direct = told
            .iter()
            .filter(|found| found.kind == EdgeKind::Direct)
            .count();
        assert_eq!(direct, 3, "{told:?}");
    }

    #[test]
    fn what_tells_little_does_not_explain() {
        // A third of the odds of 0.3 before anything is 1/7: a probability of 1/8.
        for (given, expected) in [
            (0.3, EdgeKind::Direct),
            (0.13, EdgeKind::Direct),
            (0.12, EdgeKind::Explained),
        ] {
            let told = found(
                3,
                |_| Dependence::Established,
                |ends, _| if ends == [0, 2] { given } else { 0.999 },
            );
            assert_eq!(told[1].kind, expected, "{given}");
        }
    }

    #[test]
    fn what_acts_only_together_is_opened_and_never_dropped() {
        let told = found(
            3,
            |_| Dependence::Excluded,
            |_, fixed| if fixed.is_empty() { 0.01 } else { 0.999_99 },
        );
        assert_eq!(told, [opened(&[2]), opened(&[1]), opened(&[0])]);

        // The parity of three agents is the fourth's action: two must be held fixed.
        let parity = |_: Ends, fixed: &[usize]| if fixed.len() == 2 { 0.999_99 } else { 0.01 };
        let told = found(4, |_| Dependence::Open, parity);
        let expected =
            [[2, 3], [1, 3], [1, 2], [0, 3], [0, 2], [0, 1]].map(|others| opened(&others));
        assert_eq!(told, expected);
    }

    #[test]
    fn a_common_effect_opens() {
        let margin = |ends: Ends| {
            if ends == [0, 1] {
                Dependence::Excluded
            } else {
                Dependence::Established
            }
        };
        let told = found(3, margin, |_, _| 0.999_99);
        assert_eq!(
            told,
            [opened(&[2]), kind(EdgeKind::Direct), kind(EdgeKind::Direct)]
        );
    }

    #[test]
    fn the_more_sets_are_looked_at_the_more_one_must_stand_out() {
        // Odds of 19 establish with one other agent, not with six.
        let one = |agents| {
            found(
                agents,
                |_| Dependence::Excluded,
                |_, fixed| if fixed == [2] { 0.955 } else { 0.1 },
            )
        };
        assert_eq!(
            (one(3)[0].clone(), one(8)[0].clone()),
            (opened(&[2]), kind(EdgeKind::Absent))
        );
    }

    #[test]
    fn what_a_test_without_a_prior_denies_is_not_opened() {
        let pairs = [[0, 1], [0, 2], [1, 2]].map(|ends| by_itself(ends, Dependence::Excluded));
        let told = |p_value| {
            skeleton(
                3,
                &pairs,
                &Said {
                    given: |_: usize, _: &[usize]| Some(0.999),
                    p_value,
                },
            )
        };
        assert_eq!(
            (told(0.05)[0].clone(), told(0.06)[0].clone()),
            (opened(&[2]), kind(EdgeKind::Absent))
        );
    }

    #[test]
    fn nothing_to_ask_leaves_what_is_known_by_itself() {
        for (margin, expected) in [
            (Dependence::Established, EdgeKind::Direct),
            (Dependence::Open, EdgeKind::Open),
            (Dependence::Excluded, EdgeKind::Absent),
        ] {
            let pairs = [[0, 1], [0, 2], [1, 2]].map(|ends| by_itself(ends, margin));
            let nothing = Said {
                given: |_: usize, _: &[usize]| None,
                p_value: 0.0,
            };
            assert_eq!(
                skeleton(3, &pairs, &nothing),
                [0; 3].map(|_| kind(expected))
            );
        }
        let pairs = [by_itself([0, 1], Dependence::Established)];
        let nobody = Said {
            given: |_: usize, _: &[usize]| panic!("there is nobody to hold fixed"),
            p_value: 0.0,
        };
        assert_eq!(skeleton(2, &pairs, &nobody), [kind(EdgeKind::Direct)]);
    }

    #[test]
    fn among_many_agents_the_strongest_neighbours_are_held_fixed() {
        let ends = (0..30).flat_map(|a| (a + 1..30).map(move |b| [a, b]));
        let strength = |[a, b]: Ends| if a == 7 || b == 7 { 2.0 } else { 1.0 };
        let pairs: Vec<Margin> = ends
            .map(|ends| Margin {
                strength: strength(ends),
                ..by_itself(ends, Dependence::Established)
            })
            .collect();
        let asked = std::sync::atomic::AtomicUsize::new(0);
        let given = |_: usize, fixed: &[usize]| {
            asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            Some(if fixed == [7] { 0.01 } else { 0.999 })
        };
        let told = skeleton(
            30,
            &pairs,
            &Said {
                given,
                p_value: 0.0,
            },
        );
        let star = pairs
            .iter()
            .zip(&told)
            .all(|(pair, found)| match pair.ends.contains(&7) {
                true => found.kind == EdgeKind::Direct,
                false => *found == explained(&[7]),
            });
        let asked = asked.into_inner();
        assert!(star && asked < 10_000, "{asked}: {told:?}");
    }

    #[test]
    fn choices_are_complete_and_in_order() {
        assert_eq!(combinations(&[1, 4, 6], 2), [[1, 4], [1, 6], [4, 6]]);
        assert_eq!(combinations(&[1, 4], 3), Vec::<Vec<usize>>::new());
        assert_eq!(combinations(&(0..6).collect::<Vec<_>>(), 3).len(), 20);
    }
}
