//! The entry rule by examples, and against its definition.

use std::collections::HashMap;

use proptest::prelude::*;

use super::*;

/// One step of two agents, of which some may be absent: a state and an action each.
type Step = (u8, [Option<u64>; 2]);

fn entries(actions: [u64; 2], steps: &[Step]) -> Vec<bool> {
    let mut rule = EntryRule::new(actions);
    steps
        .iter()
        .map(|(state, actions)| rule.entry(state, actions) == Entry::Entered)
        .collect()
}

fn acting(steps: &[(u8, [u64; 2])]) -> Vec<Step> {
    steps
        .iter()
        .map(|(state, actions)| (*state, actions.map(Some)))
        .collect()
}

#[test]
fn an_entry_counts_once_all_have_changed_their_action() {
    let steps = acting(&[
        (1, [0, 0]),
        (1, [1, 1]),
        (2, [1, 1]),
        (1, [1, 1]),
        (2, [1, 1]),
        (1, [0, 1]),
        (2, [0, 2]),
        (1, [0, 2]),
    ]);
    // State 1 counts again at once, since both changed within the stay; state 2 waits for both.
    let expected = [true, false, true, true, false, false, true, true];
    assert_eq!(entries([3, 3], &steps), expected);
}

#[test]
fn who_has_no_choice_takes_no_part() {
    let steps = acting(&[(1, [0, 0]), (2, [1, 0]), (1, [0, 0]), (2, [0, 0])]);
    assert_eq!(entries([2, 1], &steps), [true, true, true, true]);
    assert_eq!(entries([2, 2], &steps), [true, true, false, false]);
    assert_eq!(entries([1, 1], &steps), [true; 4]);
}

#[test]
fn who_is_absent_takes_no_part_and_is_remembered() {
    let steps = [
        (1, [Some(0), Some(0)]),
        (2, [Some(1), None]),
        (1, [Some(1), None]),
        (2, [Some(0), None]),
        (1, [Some(0), Some(0)]),
        (2, [Some(1), Some(1)]),
        (1, [Some(1), Some(1)]),
    ];
    // At the fifth step the second agent is back with the action that it had.
    let expected = [true, true, true, true, false, true, true];
    assert_eq!(entries([2, 2], &steps), expected);
}

#[test]
fn after_a_gap_the_next_step_enters_and_holding_goes_on() {
    let mut rule = EntryRule::new([2, 2]);
    let entered = |rule: &mut EntryRule<u8>, actions: [u64; 2]| {
        rule.entry(&1, &actions.map(Some)) == Entry::Entered
    };
    assert!(entered(&mut rule, [0, 0]));
    rule.gap();
    assert!(!entered(&mut rule, [0, 0]));
    rule.gap();
    assert!(entered(&mut rule, [1, 1]));
}

#[test]
fn memory_is_bounded_and_nothing_counts_twice() {
    let mut rule = EntryRule::new([2, 2]);
    let entered = |rule: &mut EntryRule<u64>, state, action| rule.entry(&state, &[Some(action); 2]);
    let remembered = REMEMBERED as u64;
    for state in 0..remembered {
        assert_eq!(entered(&mut rule, state, 0), Entry::Entered);
    }
    // One more and the first is forgotten; while nobody changes, nothing that is not known counts.
    assert_eq!(entered(&mut rule, remembered, 0), Entry::Entered);
    assert_eq!(rule.counted.len(), REMEMBERED);
    for state in [0, 1, remembered, remembered + 1] {
        assert_eq!(entered(&mut rule, state, 0), Entry::Stayed);
    }
    assert_eq!(rule.counted.len(), REMEMBERED);
    for state in [0, 1, remembered + 1] {
        assert_eq!(entered(&mut rule, state, 1), Entry::Entered);
    }
    assert_eq!(
        rule.counted.len(),
        3,
        "what all have changed since is forgotten"
    );
}

/// The definition, with all that ever was in memory.
fn by_definition(actions: [u64; 2], steps: &[Step]) -> Vec<bool> {
    let mut counted: HashMap<u8, usize> = HashMap::new();
    let changed = |agent: usize, since: usize, to: usize| {
        let taken = |steps: &[Step]| steps.iter().filter_map(|step| step.1[agent]).next_back();
        (since + 1..=to).any(|at| {
            let action = steps[at].1[agent];
            action.is_some() && action != taken(&steps[..at])
        })
    };
    let mut entered = |at: usize| {
        let state = steps[at].0;
        let enters = at == 0 || steps[at - 1].0 != state;
        let part = |agent: &usize| actions[*agent] > 1 && steps[at].1[*agent].is_some();
        let renewed = counted
            .get(&state)
            .is_none_or(|since| (0..2).filter(part).all(|agent| changed(agent, *since, at)));
        if enters && renewed {
            counted.insert(state, at);
        }
        enters && renewed
    };
    (0..steps.len()).map(&mut entered).collect()
}

proptest! {
    #[test]
    fn the_rule_is_its_definition(
        actions in prop::array::uniform2(1u64..4),
        steps in prop::collection::vec(
            (0u8..4, prop::array::uniform2(prop::option::weighted(0.8, 0u64..3))),
            0..80,
        ),
    ) {
        prop_assert_eq!(entries(actions, &steps), by_definition(actions, &steps));
    }

    #[test]
    fn steps_that_are_told_as_the_rule_has_it_change_nothing(
        actions in prop::array::uniform2(1u64..4),
        steps in prop::collection::vec(
            (
                (0u8..4, prop::array::uniform2(prop::option::weighted(0.8, 0u64..3))),
                any::<bool>(),
            ),
            0..80,
        ),
    ) {
        let (played, told): (Vec<Step>, Vec<bool>) = steps.into_iter().unzip();
        let expected = entries(actions, &played);
        let mut rule = EntryRule::new(actions);
        for (at, (state, acts)) in played.iter().enumerate() {
            if told[at] {
                rule.told(state, acts, expected[at]);
            } else {
                prop_assert_eq!(rule.entry(state, acts) == Entry::Entered, expected[at]);
            }
        }
    }
}
