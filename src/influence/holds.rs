//! Mean holds: for how many steps the agents of a pair go on with an action. Where the ego holds its
//! actions, what is true of one lag is true of those beside it.

use crate::domain::{Counts, Family, Holds, Pair, Schema, SegmentId};

/// Returns the mean holds of both agents of a pair in a state; `None` in the same tick.
///
/// A hold is estimated as 1/(1 - p), where p is the share of steps after which an agent does what it
/// did before: the mean length of holds, a geometric distribution's and any other's whose holds are
/// seen whole. The ego's is from what it does one step later, the other's from what it did one step
/// before that which is asked about. What biases it:
///
/// * An action that is chosen again is held: who draws one of R at random has R/(R - 1), not 1.
/// * It is of visits, and of this state: where a state is left, a hold may go on elsewhere.
/// * Where few changes were seen it is too high on average, as a ratio of counts is.
pub fn holds(
    schema: &Schema,
    pair: &Pair,
    counts: &Counts,
    segments: Option<&[SegmentId]>,
) -> Option<Holds> {
    let later = pair.later?;
    let hold = |outcome| hold(schema, outcome, counts, segments);
    Some(Holds {
        ego: schema.action_at(pair.ego, 1).and_then(hold),
        other: hold(later),
    })
}

/// Returns the mean hold of the agent whose later action an outcome is; `None` where that is counted
/// beside no action one step before it, and where no change was seen.
fn hold(
    schema: &Schema,
    outcome: usize,
    counts: &Counts,
    segments: Option<&[SegmentId]>,
) -> Option<f64> {
    let agent = schema.outcomes()[outcome].agent?;
    if schema.own_lag(outcome)? + 1 != schema.outcomes()[outcome].lag {
        return None;
    }

    let (mut steps, mut changes) = (0, 0);
    let family = Family::of_outcome(outcome);
    for cell in counts.of_family_and_segments(family, segments) {
        let (joint, action) = schema.split(family, cell.joint);
        if let Some(before) = schema.taken_action(joint, agent) {
            steps += cell.tally.n;
            changes += if before == action { 0 } else { cell.tally.n };
        }
    }
    (changes > 0).then(|| steps as f64 / changes as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft, OutcomeDraft};
    use crate::domain::{Cell, SchemaDraft, Tally};

    const PUSH: SegmentId = SegmentId(1);
    const PULL: SegmentId = SegmentId(2);

    /// Two agents of three actions, the second of which may be absent, and a pot.
    fn schema(outcomes: &[(&str, i64)]) -> Schema {
        let feature = |name: &str| FeatureDraft {
            name: name.into(),
            unit: None,
            kinds: vec![KindDraft::Integer(0, 2)],
        };
        let agent = |name: &str, may_be_absent| AgentDraft {
            name: name.into(),
            action: vec![feature("act")],
            may_be_absent,
        };
        let later = |(agent, lag): &(&str, i64)| OutcomeDraft {
            agent: Some((*agent).into()),
            lag: Some(*lag),
            ..OutcomeDraft::default()
        };
        let pot = OutcomeDraft {
            name: "pot".into(),
            lag: Some(1),
            value: vec![feature("holds")],
            ..OutcomeDraft::default()
        };
        Schema::try_from(&SchemaDraft {
            state: vec![feature("place")],
            agents: vec![agent("ego", false), agent("other", true)],
            outcomes: outcomes.iter().map(later).chain([pot]).collect(),
            lags: Vec::new(),
        })
        .expect("valid")
    }

    fn asked(schema: &Schema, name: &str) -> Pair {
        let later = schema.outcome(name).expect("declared");
        let value = schema.agents().len() + later;
        Pair {
            later: Some(later),
            ..Pair::new(
                0,
                schema.outcomes()[later].agent.unwrap_or(value),
                Vec::new(),
            )
        }
    }

    /// Adds to a state what both did, then what was observed later, so many times.
    fn add(
        counts: &mut Counts,
        schema: &Schema,
        (name, segment): (&str, SegmentId),
        (joint, later, n): ([u64; 2], u64, u64),
    ) {
        let family = Family::of_outcome(schema.outcome(name).expect("declared"));
        let cell = Cell {
            joint: (joint[0] * 4 + joint[1]) * 3 + later,
            segment,
            tally: Tally {
                n,
                entries: Some(0),
            },
        };
        counts.add(family, cell);
    }

    #[test]
    fn a_hold_is_the_steps_for_each_change() {
        let schema = schema(&[("ego", 1), ("other", 1), ("other", 2)]);
        let mut counts = Counts::default();
        for (told, cell) in [
            (("ego@1", PUSH), ([1, 0], 1, 6)),
            (("ego@1", PUSH), ([1, 2], 0, 2)),
            (("ego@1", PULL), ([2, 0], 1, 2)),
            (("other@2", PUSH), ([0, 2], 2, 3)),
            (("other@2", PUSH), ([1, 1], 2, 2)),
            // It did not act one step before.
            (("other@2", PUSH), ([1, 3], 2, 99)),
            (("other@1", PUSH), ([1, 1], 1, 4)),
        ] {
            add(&mut counts, &schema, told, cell);
        }

        let of = |name, segments| holds(&schema, &asked(&schema, name), &counts, segments);
        let told = |ego, other| Some(Holds { ego, other });
        assert_eq!(of("other@2", None), told(Some(2.5), Some(2.5)));
        assert_eq!(of("other@2", Some(&[PUSH])), told(Some(4.0), Some(2.5)));
        assert_eq!(of("other@2", Some(&[PULL])), told(Some(1.0), None));
        assert_eq!(
            of("other@1", None),
            told(Some(2.5), None),
            "no change was seen"
        );
        assert_eq!(
            of("pot", None),
            told(Some(2.5), None),
            "a value holds nothing"
        );
        assert_eq!(
            holds(&schema, &Pair::new(0, 1, Vec::new()), &counts, None),
            None
        );
        let nothing = Counts::default();
        let pair = asked(&schema, "other@2");
        assert_eq!(holds(&schema, &pair, &nothing, None), told(None, None));
    }

    #[test]
    fn holds_take_the_step_before() {
        // Lag 3 is counted beside what the other does now, and the ego is not observed later.
        let schema = schema(&[("other", 1), ("other", 3)]);
        let mut counts = Counts::default();
        add(&mut counts, &schema, ("other@3", PUSH), ([0, 1], 2, 5));
        add(&mut counts, &schema, ("other@1", PUSH), ([0, 1], 2, 5));
        let of = |name| holds(&schema, &asked(&schema, name), &counts, None);
        let told = |ego, other| Some(Holds { ego, other });
        assert_eq!(of("other@3"), told(None, None));
        assert_eq!(of("other@1"), told(None, Some(1.0)));
    }
}
