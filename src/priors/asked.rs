//! Recency of use: which priors were asked for lately, since only those are kept up in the
//! background. Nothing here looks at a clock.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::domain::{EnvironmentId, Pair};

/// For how long a prior is kept up after it was asked for.
pub const LATELY: Duration = Duration::from_secs(60 * 60);

/// When each prior was last used; those of more than an hour ago are forgotten.
#[derive(Default)]
pub struct Asked(Mutex<HashMap<(EnvironmentId, Pair), Instant>>);

impl Asked {
    /// Remembers that a prior was asked for.
    pub fn note(&self, key: (EnvironmentId, Pair), now: Instant) {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .insert(key, now);
    }

    /// Returns the pairs of an environment that were asked for within the last hour, plain ones
    /// first, in order.
    pub fn lately(&self, environment: EnvironmentId, now: Instant) -> Vec<Pair> {
        let mut asked = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        asked.retain(|_, at| now.saturating_duration_since(*at) <= LATELY);
        let of_it = asked.keys().filter(|(id, _)| *id == environment);
        let mut pairs: Vec<Pair> = of_it.map(|(_, pair)| pair.clone()).collect();
        drop(asked);

        pairs.sort_unstable_by(|a, b| order(a).cmp(&order(b)));
        pairs
    }
}

fn order(pair: &Pair) -> (usize, &[usize], usize, usize, Option<usize>) {
    let Pair {
        ego,
        other,
        given,
        later,
    } = pair;
    (given.len(), given, *ego, *other, *later)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: EnvironmentId = EnvironmentId(1);
    const THERE: EnvironmentId = EnvironmentId(2);

    fn pair(ego: usize, other: usize, given: &[usize]) -> Pair {
        Pair::new(ego, other, given.to_vec())
    }

    #[test]
    fn what_was_asked_for_is_forgotten_after_an_hour() {
        let (asked, start) = (Asked::default(), Instant::now());
        asked.note((HERE, pair(0, 1, &[2])), start);
        asked.note((HERE, pair(0, 1, &[])), start + Duration::from_secs(1));
        asked.note((THERE, pair(1, 2, &[])), start);
        assert_eq!(
            asked.lately(HERE, start + LATELY),
            [pair(0, 1, &[]), pair(0, 1, &[2])]
        );
        assert_eq!(
            asked.lately(HERE, start + LATELY + Duration::from_secs(1)),
            [pair(0, 1, &[])]
        );
        assert_eq!(
            asked.lately(HERE, start + LATELY + Duration::from_secs(2)),
            []
        );
        assert!(
            asked.lately(THERE, start).is_empty(),
            "it was forgotten with the others"
        );
    }

    #[test]
    fn asking_again_begins_another_hour() {
        let (asked, start) = (Asked::default(), Instant::now());
        asked.note((HERE, pair(0, 1, &[])), start);
        asked.note((HERE, pair(0, 1, &[])), start + LATELY);
        assert_eq!(
            asked.lately(HERE, start + LATELY + LATELY),
            [pair(0, 1, &[])]
        );
    }
}
