//! Adjusted mutual information (AMI): corrected for chance agreement, as a share.

use crate::information::mutual_information::plug_in;
use crate::information::null::{entropy, expected_if_independent};
use crate::information::table::Table;

/// Where the margins leave less room than this above chance, in nats, nothing can be told from
/// chance.
const NO_ROOM: f64 = 1e-12;

/// Returns the adjusted mutual information, a share without unit: 0 is what chance gives at these
/// margins, 1 is all there can be (Vinh, Epps & Bailey 2010, "Information theoretic measures for
/// clusterings comparison").
///
/// (I - E) / ((H_r + H_c) / 2 - E), with the plug-in I, its mean E under independence
/// ([`expected_if_independent`](crate::information::expected_if_independent), which is exact to
/// N = 1,000) and the arithmetic mean of the two entropies: of their normalisations the one that
/// scikit-learn takes unless told otherwise.
///
/// In words: how much of the two agents' variety is shared, beyond chance. It compares states of
/// different variety; it is no strength to hold against a threshold in nats.
///
/// May be negative. 0 at N = 0, with one row or one column, and where the margins alone already
/// decide everything, as where no action was seen twice (scikit-learn says 1 there, and for a
/// single occupied cell).
pub fn adjusted(table: &Table) -> f64 {
    if table.is_line() {
        return 0.0;
    }

    let (expected, _) = expected_if_independent(table);
    let entropies = entropy(table.rows(), table.total()) + entropy(table.columns(), table.total());
    let room = entropies / 2.0 - expected;

    if room > NO_ROOM {
        (plug_in(table) - expected) / room
    } else {
        0.0
    }
}
