//! Discretisation of many records at once: the ranks of their states and their joint actions, as
//! numbers in mixed radix, the first feature most significant.
//!
//! Feature after feature and not record after record, so that the same few instructions run over
//! all of them (SIMD, as the compiler finds it).

use super::feature::MISFIT;
use super::{Agent, Feature, FeatureKind, Increment, Presence, Schema, Values};

/// One number a record; none where a value of it has no bin.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Numbers([u64; Numbers::LANES]);

/// No rank, no joint action and no cell: those are below 2^62.
const NONE: u64 = Increment::MISSING;

/// No value, beside [`NONE`] where a value has no bin.
const MISSING: u64 = NONE - 1;

impl Numbers {
    /// How many records are discretised together.
    pub const LANES: usize = 64;

    /// Returns the number of a record.
    #[inline]
    pub fn get(&self, lane: usize) -> Option<u64> {
        Some(self.0[lane]).filter(|number| *number != NONE)
    }

    /// Returns the number of a record, or [`Increment::MISSING`].
    #[inline]
    pub fn get_or_missing(&self, lane: usize) -> u64 {
        self.0[lane]
    }

    /// Discretises the records from one on, as many as there are. All their numbers together must
    /// be below 2^63.
    fn of<'k>(
        kinds: impl ExactSizeIterator<Item = &'k FeatureKind>,
        values: &Values,
        first: usize,
    ) -> Self {
        let width = kinds.len();
        Self::of_slot(kinds, values, first, Slot { at: 0, width })
    }

    /// Discretises the same of some features of a record alone, which has more.
    fn of_slot<'k>(
        kinds: impl ExactSizeIterator<Item = &'k FeatureKind>,
        values: &Values,
        first: usize,
        Slot { at, width }: Slot,
    ) -> Self {
        let rest = values.len().saturating_sub(first * width);
        let lanes = Self::LANES.min(rest.checked_div(width).unwrap_or(0));

        let (mut numbers, mut fits) = ([0u64; Self::LANES], [true; Self::LANES]);
        for (feature, kind) in kinds.enumerate() {
            let mut column = [0.0; Self::LANES];
            let found = values.column(first * width + at + feature, width, lanes);
            for (slot, value) in column.iter_mut().zip(found) {
                *slot = value;
            }

            let (radix, bins) = (u64::from(kind.bins()), kind.bins_of(&column));
            for lane in 0..Self::LANES {
                fits[lane] &= bins[lane] != MISFIT;
                // A misfit may pass 2^64; it has no number anyway.
                numbers[lane] = numbers[lane]
                    .wrapping_mul(radix)
                    .wrapping_add(u64::from(bins[lane]));
            }
        }

        for lane in 0..Self::LANES {
            numbers[lane] = if fits[lane] { numbers[lane] } else { NONE };
        }
        Self(numbers)
    }
}

/// Where some features of a record are among all of them.
#[derive(Debug, Clone, Copy)]
struct Slot {
    at: usize,
    width: usize,
}

/// Numbers of several slots that a record has; one beyond all where it has none.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SlotNumbers(Vec<Numbers>);

impl SlotNumbers {
    /// Returns the number of a slot of a record, where it has a value.
    #[inline]
    pub fn get(&self, lane: usize, slot: usize) -> SlotNumber {
        match self.0[slot].0[lane] {
            MISSING => SlotNumber::Missing,
            NONE => SlotNumber::Misfit,
            number => SlotNumber::Of(number),
        }
    }

    /// Returns of each record whether any of its values has no bin.
    pub fn misfits(&self) -> [bool; Numbers::LANES] {
        let mut misfits = [false; Numbers::LANES];
        for Numbers(numbers) in &self.0 {
            (0..Numbers::LANES).for_each(|lane| misfits[lane] |= numbers[lane] == NONE);
        }
        misfits
    }
}

/// What a slot of a record has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SlotNumber {
    /// No value.
    Missing,
    /// A value that has no bin.
    Misfit,
    /// A value with this number.
    Of(u64),
}

impl Schema {
    /// Returns the ranks of the states of [`Numbers::LANES`] records from one on. Only where the
    /// schema [is ranked](Schema::is_ranked).
    pub fn ranks_at(&self, states: &Values, first: usize) -> Numbers {
        Numbers::of(
            self.state().iter().map(|feature| &feature.kind),
            states,
            first,
        )
    }

    /// Returns the joint actions of [`Numbers::LANES`] records from one on; none where an agent is
    /// absent that may not be.
    pub fn joint_actions_at(&self, actions: &Values, present: &Presence, first: usize) -> Numbers {
        if !self.may_lack_actions() && present.is_all() {
            return Numbers::of(self.action_kinds().iter(), actions, first);
        }

        let slots = self.agents().iter().map(|agent| &*agent.action);
        let letters = slots_at(slots, actions, present, first);
        let joint = |lane: usize| {
            self.agents()
                .iter()
                .enumerate()
                .try_fold(0, |joint, (at, agent)| {
                    Some(joint * agent.letters() + letter(agent, letters.get(lane, at))?)
                })
        };
        Numbers(std::array::from_fn(|lane| {
            match first + lane < len(self, actions) {
                true => joint(lane).unwrap_or(NONE),
                false => NONE,
            }
        }))
    }

    /// Returns the values of all outcomes of [`Numbers::LANES`] records from one on; nothing where
    /// none has a value.
    pub fn outcomes_at(&self, outcomes: &Values, present: &Presence, first: usize) -> SlotNumbers {
        if outcomes.is_empty() {
            return SlotNumbers::default();
        }
        let slots = self.outcomes().iter().map(|outcome| &*outcome.value);
        slots_at(slots, outcomes, present, first)
    }
}

/// Returns how many records have these actions.
fn len(schema: &Schema, actions: &Values) -> usize {
    actions.len() / schema.action_width()
}

fn slots_at<'s>(
    slots: impl ExactSizeIterator<Item = &'s [Feature]> + Clone,
    values: &Values,
    present: &Presence,
    first: usize,
) -> SlotNumbers {
    let width: usize = slots.clone().map(<[Feature]>::len).sum();
    let records = values.len().checked_div(width).unwrap_or(0);
    let (mut at, many) = (0, slots.len());
    let numbers = slots.enumerate().map(|(number, slot)| {
        let kinds = slot.iter().map(|feature| &feature.kind);
        let mut numbers = Numbers::of_slot(kinds, values, first, Slot { at, width });
        at += slot.len();

        // Fewer records than lanes are in the last block.
        let lanes = numbers.0.iter_mut().enumerate();
        let is_missing = |record| record >= records || !present.has(record * many + number);
        lanes
            .filter(|(lane, _)| is_missing(first + lane))
            .for_each(|(_, slot)| *slot = MISSING);
        numbers
    });
    SlotNumbers(numbers.collect())
}

/// Returns the letter that an agent has in a joint action.
fn letter(agent: &Agent, action: SlotNumber) -> Option<u64> {
    match action {
        SlotNumber::Of(action) => Some(action),
        SlotNumber::Missing => agent.may_be_absent.then(|| agent.absence()),
        SlotNumber::Misfit => None,
    }
}

impl Schema {
    /// Returns the cells of every outcome's family that records with these joint actions count in;
    /// none for a record where the outcome is missing, or what it is counted beside is. An agent that
    /// may be absent and has no action one step before was absent then.
    pub fn outcome_cells(&self, joints: &Numbers, observed: &SlotNumbers) -> Vec<Numbers> {
        // What is divided is divided once for all lags of an agent.
        let without: Vec<Numbers> = (0..self.agents().len())
            .map(|agent| self.without(joints, agent))
            .collect();
        let cells = |outcome| self.cells_beside(outcome, joints, &without, observed);
        (0..observed.0.len()).map(cells).collect()
    }

    /// Returns joint actions with the first letter in the place of an agent's own; nothing where the
    /// agent's later actions are counted beside none but these.
    fn without(&self, joints: &Numbers, agent: usize) -> Numbers {
        let of_agent = |at: &usize| self.outcomes()[*at].agent == Some(agent);
        let mut outcomes = (0..self.outcomes().len()).filter(of_agent);
        if !outcomes.any(|at| self.own_before(at).is_some()) {
            return Numbers([NONE; Numbers::LANES]);
        }
        Numbers(joints.0.map(|joint| match joint {
            NONE => NONE,
            joint => self.with_letter(joint, agent, 0),
        }))
    }

    fn cells_beside(
        &self,
        outcome: usize,
        joints: &Numbers,
        without: &[Numbers],
        observed: &SlotNumbers,
    ) -> Numbers {
        let beside = match (self.outcomes()[outcome].agent, self.own_before(outcome)) {
            (Some(agent), Some(before)) => {
                &self.with_letters_before(agent, before, &without[agent], observed)
            }
            _ => joints,
        };

        let values = self.outcomes()[outcome].values();
        Numbers(std::array::from_fn(|lane| {
            match (observed.get(lane, outcome), beside.0[lane]) {
                (SlotNumber::Of(value), joint) if joint != NONE => joint * values + value,
                _ => NONE,
            }
        }))
    }

    /// Returns joint actions with what an agent did one step before an outcome.
    fn with_letters_before(
        &self,
        agent: usize,
        before: usize,
        without: &Numbers,
        observed: &SlotNumbers,
    ) -> Numbers {
        let (stride, actor) = (self.stride(agent), &self.agents()[agent]);
        Numbers(std::array::from_fn(|lane| {
            let own = letter(actor, observed.get(lane, before));
            match (own, without.0[lane]) {
                (Some(own), joint) if joint != NONE => joint + own * stride,
                _ => NONE,
            }
        }))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::domain::SchemaDraft;
    use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft};

    fn kinds() -> Vec<KindDraft> {
        let edges = |count: i32| (0..count).map(|edge| f64::from(edge) - 2.5).collect();
        vec![
            KindDraft::Continuous(edges(3)),
            KindDraft::Continuous(edges(16)),
            KindDraft::Continuous(edges(17)),
            KindDraft::Continuous(vec![0.5]),
            KindDraft::Circular(8, None),
            KindDraft::Integer(-3, 4),
            KindDraft::Integer(2, 2),
            KindDraft::Categorical(["a", "b", "c"].map(String::from).to_vec()),
        ]
    }

    fn schema() -> Schema {
        let features = || {
            let feature = |(at, kind)| FeatureDraft {
                name: format!("f{at}"),
                unit: None,
                kinds: vec![kind],
            };
            kinds().into_iter().enumerate().map(feature)
        };
        let agent = |name: &str, features: Vec<FeatureDraft>| AgentDraft {
            name: name.into(),
            action: features,
            ..AgentDraft::default()
        };
        let draft = SchemaDraft {
            state: features().collect(),
            agents: vec![
                agent("one", features().take(4).collect()),
                agent("two", features().skip(4).collect()),
            ],
            ..SchemaDraft::default()
        };
        Schema::try_from(&draft).expect("valid")
    }

    /// Values that mostly fit, those beside an edge, and those that never do.
    fn value() -> impl Strategy<Value = f32> {
        prop_oneof![
            12 => (-3i8..5).prop_map(f32::from),
            4 => (-6i8..12).prop_map(|half| f32::from(half) / 2.0),
            1 => any::<f32>(),
            1 => Just(f32::NAN),
            1 => Just(f32::INFINITY),
            1 => Just(-0.0),
        ]
    }

    proptest! {
        #[test]
        fn many_records_are_discretised_as_one_is(values in proptest::collection::vec(value(), 0..200 * 8)) {
            let schema = schema();
            let width = schema.state().len();
            let records = values.len() / width;
            let column = Values::from(values[..records * width].to_vec());

            for index in 0..records {
                let (first, lane) = (index - index % Numbers::LANES, index % Numbers::LANES);
                let record: Vec<f32> = column.at(index * width, width).collect();
                let rank = schema.key_of_values(&record).ok().map(|key| schema.rank(&key));
                prop_assert_eq!(schema.ranks_at(&column, first).get(lane), rank);
                let joint = schema.joint_action(&record);
                prop_assert_eq!(schema.joint_actions_at(&column, &Presence::default(), first).get(lane), joint);
            }
        }

        #[test]
        fn whole_numbers_of_a_wide_range_keep_every_digit(numbers in proptest::collection::vec(-(1i32 << 24)..=1 << 24, 1..70)) {
            let kind = FeatureKind::Integer(-(1 << 24), 1 << 24);
            let values = Values::from(numbers.iter().map(|number| *number as f32).collect::<Vec<_>>());
            for first in (0..numbers.len()).step_by(Numbers::LANES) {
                let found = Numbers::of([&kind].into_iter(), &values, first);
                for (lane, number) in numbers[first..].iter().take(Numbers::LANES).enumerate() {
                    prop_assert_eq!(found.get(lane), Some((number + (1 << 24)) as u64));
                }
            }
        }
    }
}
