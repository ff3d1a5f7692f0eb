//! Strata: the parts of a question within which alone actions are compared.

use crate::information::table::Table;

/// One table, within which alone actions are compared, and where it belongs.
#[derive(Debug, Clone, Copy)]
pub struct Stratum<'a> {
    /// Which state it is of, by any numbering of the pool's states: the first cluster.
    pub state: u64,
    /// Which segment it is of, likewise: the second cluster. The same number for all of them where
    /// segments are pooled.
    pub segment: u64,
    /// Its counts, which should be independent draws (entries), in labels below the alphabet's
    /// sizes.
    pub table: &'a Table,
}
