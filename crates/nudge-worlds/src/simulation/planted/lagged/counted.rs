//! Counts of tracks at any lag, on the entries that count as draws.

use nudge_core::domain::Entry;
use nudge_core::information::Table;
use nudge_core::tracks::EntryRule;

use super::{Options, Step};

/// Who is asked about whom, and how much later.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Asked {
    /// The ego, 0 for the leader; the other is the other one.
    pub ego: usize,
    /// How many steps later the other is observed.
    pub lag: usize,
}

/// Which steps are draws of their state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Draws {
    /// Every step that entered it.
    Entered,
    /// Those of them that the [`EntryRule`] counts.
    Renewed,
}

/// What was counted of the states of a world: for each draw both agents' actions from then on.
#[derive(Debug, Clone)]
pub struct Counted {
    letters: u64,
    /// How many steps each draw goes on.
    lags: usize,
    draws: Draws,
    /// Draws of a state from which no more are taken.
    enough: usize,
    states: Vec<Vec<Vec<[u64; 2]>>>,
}

impl Counted {
    /// Counts so many draws of each state, at lags up to the greatest.
    pub fn of_tracks(
        tracks: impl Iterator<Item = Vec<Step>>,
        options: &Options,
        draws: Draws,
        [enough, lags]: [usize; 2],
    ) -> Self {
        let mut counted = Self {
            letters: options.letters as u64,
            lags,
            draws,
            enough,
            states: vec![Vec::new(); options.states],
        };
        for track in tracks {
            counted.add(&track);
            if counted.states.iter().all(|draws| draws.len() == enough) {
                break;
            }
        }
        counted
    }

    fn add(&mut self, track: &[Step]) {
        let mut rule = EntryRule::new([self.letters; 2]);
        let mut last = None;
        for (at, step) in track.iter().enumerate() {
            let renewed = rule.entry(&step.state, &step.actions.map(Some)) == Entry::Entered;
            let is_draw = match self.draws {
                Draws::Entered => last.replace(step.state) != Some(step.state),
                Draws::Renewed => renewed,
            };
            // What is not observed to its greatest lag is left out at every lag, so that all lags
            // are asked of the same draws.
            if is_draw && let Some(rest) = track.get(at..=at + self.lags) {
                let state = &mut self.states[step.state];
                if state.len() < self.enough {
                    state.push(rest.iter().map(|step| step.actions).collect());
                }
            }
        }
    }

    /// Returns the tables of a state, one for each action that the other took the step before it is
    /// observed; at lag 0, one.
    pub fn tables(&self, state: usize, Asked { ego, lag }: Asked) -> Vec<Table> {
        let other = 1 - ego;
        let given = |draw: &[[u64; 2]]| lag.checked_sub(1).map_or(0, |before| draw[before][other]);
        let of = |letter: u64| {
            let draws = self.states[state].iter();
            let draws = draws.filter(|draw| given(draw) == letter);
            Table::from_counts(draws.map(|draw| (draw[0][ego], draw[lag][other], 1)))
        };
        (0..if lag == 0 { 1 } else { self.letters })
            .map(of)
            .collect()
    }
}
