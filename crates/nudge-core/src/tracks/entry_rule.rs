//! Thinning of autocorrelated steps: which of them count as independent draws of their state.

use std::collections::VecDeque;

use crate::domain::Entry;

/// Counted entries that are remembered while an agent holds its action. Beyond them no state counts
/// until that agent has changed it: whoever did nothing else for so many entries tells nothing by
/// the next.
const REMEMBERED: usize = 256;

/// Decides which steps of one track count as draws of their state: those that entered it, where
/// every agent has changed its action since the last entry of that state that counted.
///
/// Steps of one stay are not independent draws, for agents hold their actions (autocorrelation).
/// Nor is an entry where the state was left and entered again while they still hold them: of
/// independent agents that keep an action nine times in ten, all states seemed dependent at .05
/// where every entry counted.
///
/// An agent that is absent, or that has no choice, takes no part. Keys of states are whatever tells
/// them apart. Memory is bounded by 256 keys, and in play by the few states that are
/// entered while the slowest agent holds one action.
#[derive(Debug, Clone)]
pub struct EntryRule<K> {
    /// The state of the step before.
    last: Option<K>,
    agents: Vec<Agent>,
    /// The state of each entry that counted, and its step, in order; no state twice.
    counted: VecDeque<(K, u64)>,
    /// The latest entry that was forgotten while it still mattered.
    forgotten: Option<u64>,
    step: u64,
}

#[derive(Debug, Clone)]
struct Agent {
    /// Whether it has two actions or more.
    chooses: bool,
    /// Its latest action, which it may have taken before it was absent.
    action: Option<u64>,
    /// The step at which it took another action than before.
    changed: u64,
}

impl<K: Clone + Eq> EntryRule<K> {
    /// Begins a track of agents with so many actions each.
    pub fn new(actions: impl IntoIterator<Item = u64>) -> Self {
        let agent = |actions| Agent {
            chooses: actions > 1,
            action: None,
            changed: 0,
        };
        Self {
            last: None,
            agents: actions.into_iter().map(agent).collect(),
            counted: VecDeque::new(),
            forgotten: None,
            step: 0,
        }
    }

    /// Returns whether the next step counts as an entry of its state, where each agent acts so, or
    /// is absent.
    pub fn entry(&mut self, state: &K, actions: &[Option<u64>]) -> Entry {
        let acts = |agent: usize| actions[agent].is_some();
        self.entry_of(state, actions, acts)
    }

    /// Returns the same where absent agents take part as well, as far as `takes_part` says so: one
    /// that is observed a few steps later, say, since what it does then is counted with this step.
    pub fn entry_of(
        &mut self,
        state: &K,
        actions: &[Option<u64>],
        takes_part: impl Fn(usize) -> bool,
    ) -> Entry {
        self.act(actions);
        let entered = self.last.as_ref() != Some(state);
        let counts = entered && self.is_renewed(state, takes_part);
        self.pass(state, counts);

        if counts {
            Entry::Entered
        } else {
            Entry::Stayed
        }
    }

    /// Takes the next step where it is known whether it counts as an entry, because whoever sent it
    /// said so: those that follow are decided as if this rule had said the same.
    pub fn told(&mut self, state: &K, actions: &[Option<u64>], counts: bool) {
        self.act(actions);
        self.pass(state, counts);
    }

    /// Passes over steps that were not observed: the next one enters its state. That an agent holds
    /// an action is not forgotten, for it may well have held it all the while.
    pub fn gap(&mut self) {
        self.last = None;
    }

    fn act(&mut self, actions: &[Option<u64>]) {
        debug_assert_eq!(actions.len(), self.agents.len());
        for (agent, action) in self.agents.iter_mut().zip(actions) {
            if action.is_some() && *action != agent.action {
                (agent.action, agent.changed) = (*action, self.step);
            }
        }
    }

    /// Passes to the step after this one.
    fn pass(&mut self, state: &K, counts: bool) {
        if counts {
            self.count(state);
        }
        self.last = Some(state.clone());
        self.step += 1;
    }

    /// Returns whether those that take part have all changed their action since the state's last
    /// entry that counted.
    fn is_renewed(&self, state: &K, takes_part: impl Fn(usize) -> bool) -> bool {
        let Some(last) = self.last_counted(state) else {
            return true;
        };
        self.agents
            .iter()
            .enumerate()
            .filter(|(at, agent)| agent.chooses && takes_part(*at))
            .all(|(_, agent)| agent.changed > last)
    }

    /// Returns when an entry of a state counted last. One that was forgotten counted with the
    /// latest of these at the latest.
    fn last_counted(&self, state: &K) -> Option<u64> {
        let mut newest_first = self.counted.iter().rev();
        newest_first
            .find(|(counted, _)| counted == state)
            .map(|(_, step)| *step)
            .or(self.forgotten)
    }

    fn count(&mut self, state: &K) {
        let before = self
            .counted
            .iter()
            .position(|(counted, _)| counted == state);
        before.map(|at| self.counted.remove(at));
        self.forget();
        self.counted.push_back((state.clone(), self.step));
    }

    /// Forgets entries since which every agent has changed its action, which keep nothing from
    /// counting again; and the oldest of too many.
    fn forget(&mut self) {
        let choosing = self.agents.iter().filter(|agent| agent.chooses);
        let held_since = choosing
            .map(|agent| agent.changed)
            .min()
            .unwrap_or(self.step);
        while self
            .counted
            .front()
            .is_some_and(|(_, step)| *step < held_since)
        {
            self.counted.pop_front();
        }
        if self.counted.len() == REMEMBERED {
            self.forgotten = self.counted.pop_front().map(|(_, step)| step);
        }
    }
}

#[cfg(test)]
mod tests;
