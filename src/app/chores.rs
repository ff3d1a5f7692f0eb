//! Background tasks, as operators are told of them: what the service does behind its answers.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::store::Leftovers;

/// What is being done now. Cloning is cheap.
#[derive(Clone, Default)]
pub struct Chores(Arc<Mutex<Vec<&'static str>>>);

/// Ends a chore when it is dropped.
pub struct Chore {
    chores: Chores,
    what: &'static str,
}

impl Chores {
    /// Says that something begins: "comparing totals with cells".
    pub fn begin(&self, what: &'static str) -> Chore {
        self.lock().push(what);
        Chore {
            chores: self.clone(),
            what,
        }
    }

    /// Tells everything that is being done, with what deleted environments have left; `idle` where
    /// nothing is.
    pub fn describe(&self, left: Leftovers) -> String {
        let removing = (left.environments > 0).then(|| removing(left));
        let chores = self
            .lock()
            .iter()
            .map(|what| (*what).to_owned())
            .collect::<Vec<_>>();
        let all: Vec<String> = removing.into_iter().chain(chores).collect();
        if all.is_empty() {
            "idle".to_owned()
        } else {
            all.join("; ")
        }
    }

    fn lock(&self) -> MutexGuard<'_, Vec<&'static str>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Chore {
    fn drop(&mut self) {
        let mut chores = self.chores.lock();
        if let Some(at) = chores.iter().position(|what| *what == self.what) {
            chores.remove(at);
        }
    }
}

fn removing(
    Leftovers {
        environments,
        states,
    }: Leftovers,
) -> String {
    let plural = |number| if number == 1 { "" } else { "s" };
    let (of_environments, of_states) = (plural(environments), plural(states));
    format!(
        "removing {environments} environment{of_environments}, {} state{of_states} left",
        in_thousands(states)
    )
}

fn in_thousands(number: u64) -> String {
    let digits = number.to_string();
    let groups = digits.as_bytes().rchunks(3).rev();
    groups
        .map(|group| String::from_utf8_lossy(group).into_owned())
        .collect::<Vec<_>>()
        .join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chores_are_told_while_they_go_on() {
        let chores = Chores::default();
        assert_eq!(chores.describe(Leftovers::default()), "idle");
        let audit = chores.begin("comparing totals with cells");
        let looking = chores.begin("looking at fits and networks");
        let left = Leftovers {
            environments: 2,
            states: 1_234_567,
        };
        let removing = "removing 2 environments, 1,234,567 states left";
        assert_eq!(
            chores.describe(left),
            format!("{removing}; comparing totals with cells; looking at fits and networks")
        );
        drop(audit);
        drop(looking);
        assert_eq!(chores.describe(left), removing);
    }

    #[test]
    fn numbers_are_grouped() {
        let told = [0, 7, 999, 1_000, 12_345, 1_000_000].map(in_thousands);
        assert_eq!(told, ["0", "7", "999", "1,000", "12,345", "1,000,000"]);
    }
}
