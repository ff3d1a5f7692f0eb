//! Access paths: two ways to walk the states of an environment. All states of the database in the
//! order of their ids, beside which their cells lie, is fast. The environment's own, found by its
//! index, is slow, and meets no page that has nothing of it: for where there is damage that may be
//! another's.

use crate::store::StoreError;

/// How states are walked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Walk {
    /// Over all of the database.
    All,
    /// Over those of the environment alone.
    Own,
}

/// The states of the database, in order of id, as SQL.
macro_rules! all_states {
    () => {
        "states not indexed"
    };
}

/// The states of environment `?1`, as SQL: no more than it has, for looking whether there is
/// another would read on where the next one begins.
macro_rules! own_states {
    () => {
        "(select id, environment, key from states indexed by sqlite_autoindex_states_1 where environment = ?1
              limit (select states from totals where environment = ?1)) as states"
    };
}

pub(super) use {all_states, own_states};

/// Reads by a walk over all states, and where that meets damage by one over the environment's own:
/// only what that meets is the environment's.
pub(super) async fn apart<T, F>(read: impl Fn(Walk) -> F) -> Result<T, StoreError>
where
    F: Future<Output = Result<T, StoreError>>,
{
    match read(Walk::All).await {
        Err(StoreError::Damaged(_)) => read(Walk::Own).await,
        other => other,
    }
}
