//! A fitted prior (empirical Bayes), with what is computed from it once for all who ask.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use super::evidence_cache::EvidenceCache;
use crate::domain::{ActionTotals, FitId, Pair, Schema};
use crate::evidence::{self, Beliefs, Fit, Habits, Prior};
use crate::information::Alphabet;

/// A fitted prior (spike and slab) with what is computed from it.
pub struct Fitted {
    /// Its version and revision.
    pub id: FitId,
    /// The last version that was given to the pair, also to a fit that cannot be read any more:
    /// answers have named it, so it is not used again.
    pub(super) last_version: u64,
    /// When it was made; `None` where that was before the start.
    pub(super) made: Option<Instant>,
    /// The fit itself.
    pub fit: Fit,
    /// What answers are computed with.
    pub prior: Arc<Prior>,
    /// What was found about single states.
    pub evidence_cache: EvidenceCache,
    /// The last threshold asked for, and what is believed of it without counts: nearly all
    /// questions have the same.
    pub(super) unseen: Mutex<Option<(f64, Beliefs)>>,
    /// The habits that were asked for last, by the revision they are of.
    pub(super) habits: Mutex<Option<(u64, Arc<Habits>)>>,
}

/// A fitted prior with the habits of its environment by now: what evidence rests on.
#[derive(Clone)]
pub struct Informed {
    /// The fit.
    pub fitted: Arc<Fitted>,
    /// How the environment uses the actions of both agents.
    pub habits: Arc<Habits>,
    /// How many transitions the environment had when they were read.
    pub revision: u64,
}

impl std::ops::Deref for Informed {
    type Target = Fitted;

    fn deref(&self) -> &Fitted {
        &self.fitted
    }
}

impl Fitted {
    /// Returns what is believed of a state that was never seen, at a threshold in nats.
    pub fn unseen(&self, nats: f64) -> Beliefs {
        let mut last = self.unseen.lock().unwrap_or_else(PoisonError::into_inner);
        match *last {
            Some((threshold, beliefs)) if threshold == nats => beliefs,
            _ => last.insert((nats, self.prior.unseen().beliefs(nats))).1,
        }
    }

    /// Returns the habits behind the totals of an environment, of the earlier and the later agent of
    /// the pair.
    pub(super) fn habits(
        &self,
        totals: &ActionTotals,
        [earlier, later]: [usize; 2],
    ) -> Arc<Habits> {
        let mut last = self.habits.lock().unwrap_or_else(PoisonError::into_inner);
        match &*last {
            Some((revision, habits)) if *revision == totals.revision => habits.clone(),
            _ => {
                let habits = Habits::new(&totals.draws(earlier), &totals.draws(later));
                let (_, habits) = last.insert((totals.revision, Arc::new(habits)));
                habits.clone()
            }
        }
    }

    /// Returns the prior for figures that look at every pair of actions many times; `None` where
    /// there are too many pairs for them.
    pub fn in_detail(&self) -> Option<&Prior> {
        let Alphabet { rows, columns } = self.fit.alphabet;
        (rows * columns <= evidence::MOST_CELLS).then_some(&*self.prior)
    }
}

/// Returns how many actions the two have; `None` where that is too many for evidence.
pub fn alphabet(schema: &Schema, pair: &Pair) -> Option<Alphabet> {
    let alphabet = pair.alphabet(schema);
    (alphabet.rows.max(alphabet.columns) <= evidence::MOST_LETTERS).then_some(alphabet)
}
