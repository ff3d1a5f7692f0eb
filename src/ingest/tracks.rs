//! Thinning where the sender does not do it: which steps of the tracks that a stream has told count
//! as entries of their state. The rule is [`EntryRule`], the one that senders use themselves.
//!
//! Kept in memory only, for as long as a stream is open: a later stream begins its tracks anew.

use std::collections::HashMap;

use foldhash::fast::RandomState;

use crate::domain::{Agent, Entry, Schema};
use crate::tracks::EntryRule;

/// Tracks that are remembered: those that had a step last. A quarter more may be for a while, so that
/// forgetting costs little each.
const REMEMBERED: usize = 1_024;

/// Tracks at which some are forgotten.
const MOST: usize = REMEMBERED + REMEMBERED / 4;

/// The tracks of one stream into one environment. Without a track it keeps nothing and costs
/// nothing.
#[derive(Default)]
pub struct Tracks {
    followed: HashMap<u64, Followed, RandomState>,
    /// Steps of all tracks so far.
    steps: u64,
    /// What each agent does in the step at hand.
    actions: Vec<Option<u64>>,
}

struct Followed {
    rule: EntryRule<u64>,
    /// When it had a step last.
    latest: u64,
}

/// One step of a track, discretised.
pub struct Step {
    /// The track, by its sender's number.
    pub track: u64,
    /// What tells its state from the others of the track.
    pub state: u64,
    /// The joint action.
    pub joint: u64,
    /// What the sender says of it.
    pub sent: Entry,
}

impl Tracks {
    /// Takes the next step of a track; returns what its sender says, or whether it counts as an
    /// entry where that is nothing. Agents that are absent take part where they are observed later.
    pub fn entry(
        &mut self,
        schema: &Schema,
        step: &Step,
        is_observed_later: impl Fn(usize) -> bool,
    ) -> Entry {
        let mut actions = std::mem::take(&mut self.actions);
        actions.clear();
        let agents = 0..schema.agents().len();
        actions.extend(agents.map(|agent| schema.taken_action(step.joint, agent)));

        let rule = self.rule_of(schema, step.track);
        let entry = match step.sent {
            Entry::Unknown => rule.entry_of(&step.state, &actions, |agent| {
                actions[agent].is_some() || is_observed_later(agent)
            }),
            told => {
                rule.told(&step.state, &actions, told == Entry::Entered);
                told
            }
        };

        self.actions = actions;
        entry
    }

    /// Passes over a step of a track that was rejected: the next one enters its state.
    pub fn gap(&mut self, track: u64) {
        if let Some(followed) = self.followed.get_mut(&track) {
            followed.rule.gap();
        }
    }

    fn rule_of(&mut self, schema: &Schema, track: u64) -> &mut EntryRule<u64> {
        if self.followed.len() == MOST && !self.followed.contains_key(&track) {
            self.forget();
        }

        self.steps += 1;
        let begin = || Followed {
            rule: EntryRule::new(schema.agents().iter().map(Agent::actions)),
            latest: 0,
        };
        let followed = self.followed.entry(track).or_insert_with(begin);
        followed.latest = self.steps;
        &mut followed.rule
    }

    /// Forgets those that had no step for longest.
    fn forget(&mut self) {
        let mut latest: Vec<u64> = self.followed.values().map(|one| one.latest).collect();
        let (_, kept, _) = latest.select_nth_unstable(MOST - REMEMBERED);
        let first = *kept;
        self.followed.retain(|_, one| one.latest >= first);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::SchemaDraft;
    use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft};

    /// A state and two agents with two actions each, the second of which may be absent.
    fn schema() -> Schema {
        let feature = |name: &str, most| FeatureDraft {
            name: name.into(),
            unit: None,
            kinds: vec![KindDraft::Integer(0, most)],
        };
        let agent = |name: &str, may_be_absent| AgentDraft {
            name: name.into(),
            action: vec![feature("move", 1)],
            may_be_absent,
        };
        let draft = SchemaDraft {
            state: vec![feature("x", 9)],
            agents: vec![agent("a", false), agent("b", true)],
            ..SchemaDraft::default()
        };
        Schema::try_from(&draft).expect("valid")
    }

    fn unsaid(track: u64, state: u64, joint: u64) -> Step {
        Step {
            track,
            state,
            joint,
            sent: Entry::Unknown,
        }
    }

    fn entries(tracks: &mut Tracks, steps: &[Step]) -> Vec<bool> {
        let schema = schema();
        let entry = |step| tracks.entry(&schema, step, |_| false) == Entry::Entered;
        steps.iter().map(entry).collect()
    }

    // Joint actions of the schema: the first agent's action times three, and the second's, of which
    // 2 is its absence.
    const BOTH_0: u64 = 0;
    const BOTH_1: u64 = 4;
    const ONLY_0: u64 = 2;
    const ONLY_1: u64 = 5;

    #[test]
    fn tracks_are_followed_each_on_its_own() {
        let steps = [
            unsaid(7, 1, BOTH_0),
            unsaid(u64::MAX, 1, BOTH_0),
            unsaid(7, 1, BOTH_1),
            unsaid(u64::MAX, 2, BOTH_0),
            unsaid(7, 2, BOTH_1),
            unsaid(u64::MAX, 1, BOTH_0),
            unsaid(7, 1, BOTH_1),
        ];
        let expected = [true, true, false, true, true, false, true];
        assert_eq!(entries(&mut Tracks::default(), &steps), expected);
    }

    #[test]
    fn who_is_absent_takes_part_where_it_is_observed_later() {
        let schema = schema();
        let steps = [
            unsaid(0, 1, ONLY_0),
            unsaid(0, 2, ONLY_1),
            unsaid(0, 1, ONLY_1),
        ];
        for (is_observed, expected) in [(false, Entry::Entered), (true, Entry::Stayed)] {
            let mut tracks = Tracks::default();
            let entry = |step| tracks.entry(&schema, step, |agent| is_observed && agent == 1);
            assert_eq!(steps.iter().map(entry).last(), Some(expected));
        }
    }

    #[test]
    fn a_flag_that_is_sent_stands_and_what_follows_goes_by_it() {
        let told = |state, joint, sent| Step {
            sent,
            ..unsaid(0, state, joint)
        };
        let steps = [
            told(1, BOTH_0, Entry::Stayed),
            unsaid(0, 2, BOTH_0),
            // Nothing of this state has counted yet.
            unsaid(0, 1, BOTH_0),
            told(2, BOTH_0, Entry::Entered),
            told(1, BOTH_1, Entry::Stayed),
            unsaid(0, 2, BOTH_1),
            unsaid(0, 1, BOTH_1),
        ];
        let expected = [false, true, true, true, false, true, true];
        assert_eq!(entries(&mut Tracks::default(), &steps), expected);
    }

    #[test]
    fn the_next_step_after_a_gap_enters_and_a_gap_begins_no_track() {
        let mut tracks = Tracks::default();
        let mut after = |joint| {
            tracks.gap(0);
            tracks.gap(1);
            entries(&mut tracks, &[unsaid(0, 1, joint)])
        };
        assert_eq!(
            [BOTH_0, BOTH_0, BOTH_1].map(&mut after),
            [[true], [false], [true]]
        );
        assert_eq!(tracks.followed.len(), 1);
    }

    #[test]
    fn tracks_without_a_step_for_longest_are_forgotten_first() {
        let mut tracks = Tracks::default();
        let many = 5 * REMEMBERED as u64;
        let step = |track| unsaid(track, 1, BOTH_0);
        for track in 1..=many {
            assert_eq!(entries(&mut tracks, &[step(track)]), [true]);
            // This one goes on between all others.
            assert_eq!(entries(&mut tracks, &[step(0)]), [track == 1]);
            assert!(tracks.followed.len() <= MOST);
        }

        let latest = many - REMEMBERED as u64 + 2;
        for track in latest..=many {
            assert_eq!(entries(&mut tracks, &[step(track)]), [false], "{track}");
        }
        assert_eq!(entries(&mut tracks, &[step(1)]), [true], "it begins anew");
    }
}
