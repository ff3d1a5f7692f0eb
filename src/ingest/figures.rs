//! Counters for operators: what became of the batches of each environment since the start. An
//! environment that is gone takes its figures along.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::SystemTime;

use crate::domain::{Acknowledged, EnvironmentId, Receipt};
use crate::telemetry::PARTS;

/// Counters of what became of the batches of one environment.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Figures {
    /// Records counted.
    pub accepted: u64,
    /// Records rejected, by the part at fault.
    pub rejected: [u64; PARTS.len()],
    /// Batches that had been counted before.
    pub duplicates: u64,
    /// Batches under numbers used so long ago that nobody can tell whether they were counted.
    pub unverified: u64,
    /// When a batch was last acknowledged.
    pub last: Option<SystemTime>,
}

/// The counters of every environment that had a batch. Cloning shares them.
#[derive(Clone, Default)]
pub struct BatchTotals(Arc<Mutex<HashMap<EnvironmentId, Figures>>>);

impl BatchTotals {
    /// Notes that a batch was acknowledged.
    pub fn note(&self, environment: EnvironmentId, acknowledged: &Acknowledged, now: SystemTime) {
        let mut all = self.lock();
        let figures = all.entry(environment).or_default();
        figures.last = Some(now);
        match acknowledged {
            Acknowledged::Applied(receipt) | Acknowledged::Rejected(receipt) => {
                figures.add(receipt)
            }
            Acknowledged::Duplicate(_) | Acknowledged::Untold => figures.duplicates += 1,
            Acknowledged::Unverified => figures.unverified += 1,
        }
    }

    /// Returns the figures of these environments, and forgets those of all others: they are gone.
    pub fn figures_of(&self, environments: &[EnvironmentId]) -> Vec<Figures> {
        let mut all = self.lock();
        all.retain(|id, _| environments.contains(id));
        environments
            .iter()
            .map(|id| all.get(id).cloned().unwrap_or_default())
            .collect()
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<EnvironmentId, Figures>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Figures {
    fn add(&mut self, receipt: &Receipt) {
        self.accepted += receipt.accepted;
        for rejection in &receipt.rejected {
            self.rejected[part_at_fault(&rejection.field)] += 1;
        }
        self.rejected[position("untold")] += receipt.rejected_count - receipt.rejected.len() as u64;
    }
}

/// Returns which of the parts of a record a pointer leads into, whatever a client sends.
fn part_at_fault(pointer: &str) -> usize {
    position(pointer.split('/').nth(1).unwrap_or_default())
}

fn position(part: &str) -> usize {
    let other = || {
        PARTS
            .iter()
            .position(|known| *known == "other")
            .expect("it is one of them")
    };
    PARTS
        .iter()
        .position(|known| *known == part)
        .unwrap_or_else(other)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::Rejection;

    #[test]
    fn figures_are_of_environments_that_exist() {
        let (counted, now) = (BatchTotals::default(), SystemTime::UNIX_EPOCH);
        let rejected = |field: &str| Rejection {
            index: 0,
            field: field.into(),
            reason: "no".into(),
        };
        let rejected = vec![rejected("/state/x"), rejected("/invented"), rejected("")];
        let told = Acknowledged::Applied(Receipt {
            accepted: 5,
            rejected_count: 7,
            rejected,
        });
        counted.note(EnvironmentId(1), &told, now);
        counted.note(EnvironmentId(2), &Acknowledged::Untold, now);
        counted.note(EnvironmentId(2), &Acknowledged::Unverified, now);

        let [first, second, third] = [1, 2, 3].map(EnvironmentId);
        let all = counted.figures_of(&[first, second, third]);
        assert_eq!((all[0].accepted, all[0].rejected), (5, [1, 0, 0, 0, 2, 4]));
        assert_eq!(
            (all[1].duplicates, all[1].unverified, all[1].last),
            (1, 1, Some(now))
        );
        assert_eq!(all[2], Figures::default());

        counted.figures_of(&[second]);
        assert_eq!(
            counted.figures_of(&[first, second])[0],
            Figures::default(),
            "it was gone"
        );
    }
}
