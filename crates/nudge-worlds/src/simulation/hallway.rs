//! The hallway of the paper (section 4.1): pedestrians in counter-flow, or one who crosses a flow,
//! trial after trial.
//!
//! ```text
//! Protocol -> check -> Hallway -> trial(7) -> Trial -> Observations -> transitions
//! ```
//!
//! A trial depends on the protocol's seed and its own number alone, so trial 7 is the same
//! whichever trials ran before it and on however many threads.

mod protocol;
mod start;
#[cfg(test)]
mod tests;
mod trial;

use std::sync::Arc;

pub use protocol::{Protocol, Scenario};
pub use trial::{Trial, walls};

use nudge_core::error::Fault;

/// A hallway whose protocol can be carried out. Cloning is cheap.
#[derive(Debug, Clone, PartialEq)]
pub struct Hallway(Arc<Protocol>);

impl Hallway {
    /// Returns its protocol.
    pub fn protocol(&self) -> &Protocol {
        &self.0
    }

    /// Begins the trial of that number. Fails where the draw leaves no place for somebody, which
    /// [`Hallway::try_from`] has ruled out for trial 1 and which is rare for the others: only
    /// hallways that are nearly too full for it come near.
    pub fn trial(&self, number: u32) -> Result<Trial, Fault> {
        Trial::begin(self.0.clone(), number)
    }
}

impl TryFrom<Protocol> for Hallway {
    type Error = Vec<Fault>;

    /// Checks a protocol and lists every fault by field; that everybody finds a place is tried out.
    fn try_from(protocol: Protocol) -> Result<Self, Vec<Fault>> {
        let faults = protocol.check();
        if !faults.is_empty() {
            return Err(faults);
        }
        let hallway = Self(Arc::new(protocol));
        hallway.trial(1).map_err(|fault| vec![fault])?;
        Ok(hallway)
    }
}
