//! Surrogate data: twins of a track in which agents do what they did, but nobody's action answers
//! anybody's. Whatever is found in a twin is what chance and habits show.
//!
//! * [`shuffled`] (permutation within strata) leaves each state its actions, and takes their order:
//!   an exact null where steps are independent draws of their state, and one that holds in both
//!   directions and at every lag.
//! * [`shifted`] (circular shift) leaves each agent its own sequence, with all that makes one of its
//!   actions like the next (autocorrelation), and takes only their common clock.
//!
//! States stay where they are in both, and so do outcomes that are nobody's action: a twin says
//! nothing about those. Lagged actions follow from the twin's own steps, by [`Track`](super::Track).

use std::collections::BTreeMap;
use std::ops::Range;

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::Step;
use super::track::action_values;
use crate::domain::{Schema, StateKey};

/// The least shift, either way round the circle: beyond the lags at which anybody answers.
pub const LEAST_SHIFT: usize = 60;

/// Returns a track with every agent's actions exchanged at random, each agent's by themselves,
/// between the steps of the same state in which it acts.
pub fn shuffled(schema: &Schema, steps: &[Step], seed: u64) -> Vec<Step> {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut twin = steps.to_vec();
    for (agent, values) in action_values(schema).into_iter().enumerate() {
        for stratum in strata(schema, steps, agent).into_values() {
            let mut from = stratum.clone();
            from.shuffle(&mut random);
            for (to, from) in stratum.into_iter().zip(from) {
                put(&mut twin[to], &steps[from], &values);
            }
        }
    }
    twin
}

/// Returns the steps of each state in which an agent acts. What is no state, or no action, is left
/// where it is.
fn strata(schema: &Schema, steps: &[Step], agent: usize) -> BTreeMap<StateKey, Vec<usize>> {
    let mut strata: BTreeMap<StateKey, Vec<usize>> = BTreeMap::new();
    for (at, step) in steps.iter().enumerate() {
        if let (true, Ok(key)) = (acts(step, agent), schema.key_of_values(&step.state)) {
            strata.entry(key).or_default().push(at);
        }
    }
    strata
}

/// Returns a track with one agent's actions taken from so many steps earlier, in a circle, drawn
/// from [`LEAST_SHIFT`] to the number of steps less that; whether it acts comes along. `None` for
/// fewer than twice [`LEAST_SHIFT`] steps: no shift of those is far enough.
pub fn shifted(schema: &Schema, steps: &[Step], agent: usize, seed: u64) -> Option<Vec<Step>> {
    let most = steps.len().checked_sub(LEAST_SHIFT)?;
    if most < LEAST_SHIFT {
        return None;
    }
    let by = Pcg64::seed_from_u64(seed).random_range(LEAST_SHIFT..=most);
    Some(shifted_by(schema, steps, agent, by))
}

/// Returns the same with a shift of so many steps.
fn shifted_by(schema: &Schema, steps: &[Step], agent: usize, by: usize) -> Vec<Step> {
    let values = &action_values(schema)[agent];
    let mut twin = steps.to_vec();
    for (at, from) in steps.iter().enumerate() {
        let to = &mut twin[(at + by) % steps.len()];
        put(to, from, values);
        if !(to.acts.is_empty() && from.acts.is_empty()) {
            to.acts.resize(schema.agents().len(), true);
            to.acts[agent] = acts(from, agent);
        }
    }
    twin
}

/// Returns whether an agent acts in a step.
fn acts(step: &Step, agent: usize) -> bool {
    step.acts.get(agent).copied().unwrap_or(true)
}

/// Gives a step these action values of another, as far as both have them.
fn put(to: &mut Step, from: &Step, values: &Range<usize>) {
    let places = to.actions.get_mut(values.clone());
    if let (Some(places), Some(found)) = (places, from.actions.get(values.clone())) {
        places.copy_from_slice(found);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::SchemaDraft;
    use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft};

    /// Two agents of four actions in a world of three states.
    fn schema() -> Schema {
        let within = |name: &str, most| FeatureDraft {
            name: name.into(),
            unit: None,
            kinds: vec![KindDraft::Integer(0, most)],
        };
        let agent = |name: &str| AgentDraft {
            name: name.into(),
            action: vec![within("act", 3)],
            may_be_absent: true,
        };
        let draft = SchemaDraft {
            state: vec![within("place", 2)],
            agents: vec![agent("one"), agent("two")],
            ..SchemaDraft::default()
        };
        Schema::try_from(&draft).expect("valid")
    }

    fn steps(count: usize) -> Vec<Step> {
        let step = |at: usize| {
            let digit = |by: usize, of: usize| (at / by % of) as f32;
            Step::new(vec![digit(5, 3)], vec![digit(3, 4), digit(7, 4)])
        };
        (0..count).map(step).collect()
    }

    fn column(steps: &[Step], agent: usize) -> Vec<f32> {
        steps.iter().map(|step| step.actions[agent]).collect()
    }

    #[test]
    fn each_state_keeps_its_actions_when_they_are_shuffled() {
        let (schema, steps) = (schema(), steps(300));
        let twin = shuffled(&schema, &steps, 1);
        assert_eq!(twin, shuffled(&schema, &steps, 1));
        assert_ne!(twin, shuffled(&schema, &steps, 2));
        for agent in [0, 1] {
            assert_ne!(column(&twin, agent), column(&steps, agent));
            let sorted = |steps: &[Step], place: f32| {
                let there = steps.iter().filter(|step| step.state == [place]);
                let mut found: Vec<f32> = there.map(|step| step.actions[agent]).collect();
                found.sort_by(f32::total_cmp);
                found
            };
            for place in [0.0, 1.0, 2.0] {
                assert_eq!(sorted(&twin, place), sorted(&steps, place));
            }
        }
        assert!(twin.iter().zip(&steps).all(|(a, b)| a.state == b.state));
    }

    #[test]
    fn who_is_absent_stays_so_when_actions_are_shuffled() {
        let mut steps = steps(90);
        for step in steps.iter_mut().step_by(2) {
            step.acts = vec![true, false];
            step.actions[1] = 0.0;
        }
        let twin = shuffled(&schema(), &steps, 1);
        let acts = |steps: &[Step]| -> Vec<Vec<bool>> {
            steps.iter().map(|step| step.acts.clone()).collect()
        };
        assert_eq!(acts(&twin), acts(&steps));
        assert!(twin.iter().step_by(2).all(|step| step.actions[1] == 0.0));
    }

    #[test]
    fn one_agent_alone_is_shifted_in_a_circle() {
        let (schema, mut steps) = (schema(), steps(130));
        steps[3].acts = vec![true, false];
        let twin = shifted(&schema, &steps, 1, 9).expect("long enough");
        let rotations = LEAST_SHIFT..=steps.len() - LEAST_SHIFT;
        let mut turned = column(&steps, 1);
        let found = rotations.filter(|by| {
            turned = column(&steps, 1);
            turned.rotate_right(*by);
            turned == column(&twin, 1)
        });
        let found: Vec<usize> = found.collect();
        assert!(!found.is_empty(), "one of the shifts");
        assert_eq!(column(&twin, 0), column(&steps, 0));
        assert!(twin.iter().zip(&steps).all(|(a, b)| a.state == b.state));
        let absent: Vec<usize> = (0..130).filter(|at| !acts(&twin[*at], 1)).collect();
        assert!(found.iter().any(|by| absent == [(3 + by) % 130]));
    }

    #[test]
    fn shifts_reach_from_the_least_to_the_most_and_short_tracks_have_none() {
        let schema = schema();
        let drawn = |count| {
            let mut steps = steps(count);
            steps[0].acts = vec![true, false];
            let twin = |seed| shifted(&schema, &steps, 1, seed);
            let by = move |twin: Vec<Step>| twin.iter().position(|step| !acts(step, 1));
            let found: Vec<Option<usize>> = (0..200).map(|seed| twin(seed).and_then(by)).collect();
            (found.iter().min().copied(), found.iter().max().copied())
        };
        let [some, none] = [|by| Some(Some(by)), |_| Some(None)];
        assert_eq!(drawn(119), (none(0), none(0)));
        assert_eq!(drawn(120), (some(60), some(60)));
        assert_eq!(drawn(130), (some(60), some(70)));
    }
}
