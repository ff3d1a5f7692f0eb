//! Admission control of connections: a bounded number, and who makes room for whom when there are
//! as many.
//!
//! A new connection takes the place of one that waited longest without a request. Where all have
//! requests it is a guest, of whom there are few: operators are answered even then, and everybody
//! else is told that there are too many.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::limits::Limits;
use super::vitals::Vitals;
use crate::telemetry;

/// One of so many makes room at a time.
const EVICTED_OF: usize = 64;

/// Those who are here.
pub struct Crowd {
    residents: Arc<Semaphore>,
    guests: Arc<Semaphore>,
    present: Mutex<HashMap<u64, Present>>,
    numbered: AtomicU64,
}

struct Present {
    vitals: Arc<Vitals>,
    standing: Standing,
}

/// What a connection may do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// Everything.
    Resident,
    /// Ask once what operators ask.
    Guest,
}

/// A place for one connection, given back when it is dropped.
pub struct Place {
    crowd: Arc<Crowd>,
    number: u64,
    standing: Standing,
    _permit: OwnedSemaphorePermit,
}

impl Crowd {
    /// Makes room for as many as the limits say.
    pub fn new(limits: &Limits) -> Arc<Self> {
        Arc::new(Self {
            residents: Arc::new(Semaphore::new(limits.connections)),
            guests: Arc::new(Semaphore::new(limits.guests)),
            present: Mutex::default(),
            numbered: AtomicU64::new(0),
        })
    }

    /// Finds a place for a new connection, if there is one.
    pub async fn admit(self: &Arc<Self>) -> Option<Place> {
        for standing in [Standing::Resident, Standing::Guest] {
            let places = self.places(standing).clone();
            let permit = match places.clone().try_acquire_owned() {
                Ok(permit) => Some(permit),
                // Whoever was evicted goes as soon as its task runs.
                Err(_) if self.evict(standing) => places.acquire_owned().await.ok(),
                Err(_) => None,
            };
            if let Some(permit) = permit {
                let number = self.numbered.fetch_add(1, Ordering::Relaxed);
                return Some(Place {
                    crowd: self.clone(),
                    number,
                    standing,
                    _permit: permit,
                });
            }
        }
        None
    }

    /// Ends the connections of that standing that waited longest without a request, a few at a
    /// time; tells whether there were any.
    pub fn evict(&self, standing: Standing) -> bool {
        let present = self.lock();
        let peers = present
            .values()
            .filter(|present| present.standing == standing);
        let mut waiting: Vec<_> = peers
            .filter_map(|peer| Some((peer.vitals.waits_since()?, peer.vitals.as_ref())))
            .collect();
        waiting.sort_unstable_by_key(|(since, _)| *since);

        // To look at everybody for each new connection would be a lever in a stranger's hand.
        let several = 1 + present.len() / EVICTED_OF;
        let evicted = waiting
            .iter()
            .take(several)
            .filter(|(_, vitals)| vitals.evict())
            .count();
        (0..evicted).for_each(|_| telemetry::connection_ended("evicted"));
        evicted > 0
    }

    fn places(&self, standing: Standing) -> &Arc<Semaphore> {
        match standing {
            Standing::Resident => &self.residents,
            Standing::Guest => &self.guests,
        }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<u64, Present>> {
        self.present.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Place {
    /// Returns the number of the connection, which is never used again.
    pub fn number(&self) -> u64 {
        self.number
    }

    /// Returns what the connection may do.
    pub fn standing(&self) -> Standing {
        self.standing
    }

    /// Lets the connection be seen, so that it can make room for others.
    pub fn take(&self, vitals: Arc<Vitals>) {
        let mut present = self.crowd.lock();
        present.insert(
            self.number,
            Present {
                vitals,
                standing: self.standing,
            },
        );
        telemetry::connections(present.len());
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut present = self.crowd.lock();
        present.remove(&self.number);
        telemetry::connections(present.len());
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use http::Version;
    use tokio::time::advance;
    use tokio_util::sync::CancellationToken;

    use super::*;

    fn crowd() -> (Arc<Limits>, Arc<Crowd>) {
        let limits = Arc::new(Limits {
            connections: 2,
            guests: 1,
            ..Limits::default()
        });
        (limits.clone(), Crowd::new(&limits))
    }

    fn enter(place: &Place, limits: &Arc<Limits>) -> Arc<Vitals> {
        let vitals = Vitals::new(
            limits.clone(),
            None,
            CancellationToken::new(),
            CancellationToken::new(),
        );
        place.take(vitals.clone());
        vitals
    }

    #[tokio::test(start_paused = true)]
    async fn who_waited_longest_makes_room() {
        let (limits, crowd) = crowd();
        let first = crowd.admit().await.expect("free");
        let old = enter(&first, &limits);
        advance(Duration::from_secs(1)).await;
        let second = crowd.admit().await.expect("free");
        let young = enter(&second, &limits);
        let mut third = Box::pin(crowd.admit());
        assert!(
            futures::poll!(&mut third).is_pending(),
            "the evicted one is not gone yet"
        );
        assert!(old.over.is_cancelled() && !young.over.is_cancelled());
        drop(first);
        assert_eq!(
            third.await.expect("its place").standing(),
            Standing::Resident
        );
    }

    #[tokio::test(start_paused = true)]
    async fn where_everybody_is_busy_there_are_guests() {
        let (limits, crowd) = crowd();
        let places = [
            crowd.admit().await.expect("free"),
            crowd.admit().await.expect("free"),
        ];
        let _requests = places
            .each_ref()
            .map(|place| enter(place, &limits).begin(Version::HTTP_2));
        let guest = crowd.admit().await.expect("a guest");
        assert_eq!(guest.standing(), Standing::Guest);
        let _busy = enter(&guest, &limits).begin(Version::HTTP_11);
        assert!(crowd.admit().await.is_none(), "not even a guest");
        drop(guest);
        assert!(crowd.admit().await.is_some());
    }
}
