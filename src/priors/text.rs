//! How a fit is kept: JSON of our own, whose numbers read back to the same bits.

use serde::{Deserialize, Serialize};

use crate::domain::Pair;
use crate::evidence::{Base, Fit, Parameters};
use crate::information::Alphabet;

#[derive(Serialize, Deserialize)]
struct Text {
    base: Vec<u64>,
    dependent: f64,
    nulls: Vec<f64>,
    slabs: Vec<f64>,
    states: u64,
}

/// Returns what a pair is called: the positions of its agents, then those held fixed: `0,2|1`.
pub fn of_pair(pair: &Pair) -> String {
    let given: Vec<String> = pair.given.iter().map(ToString::to_string).collect();
    let fixed = if given.is_empty() { String::new() } else { format!("|{}", given.join(",")) };
    format!("{},{}{fixed}", pair.ego, pair.other)
}

/// Writes a fit.
pub fn of_fit(fit: &Fit) -> String {
    let Parameters { dependent, nulls, slabs } = fit.parameters.clone();
    let text = Text { base: fit.base.counts().to_vec(), dependent, nulls, slabs, states: fit.states };
    serde_json::to_string(&text).expect("numbers of a fit are finite")
}

/// Reads a fit back; `None` where it was written for something else.
pub fn fit(text: &str, alphabet: Alphabet) -> Option<Fit> {
    let Text { base, dependent, nulls, slabs, states } = serde_json::from_str(text).ok()?;
    let cold = Parameters::cold();
    let fits =
        base.len() as u64 == alphabet.columns && nulls.len() == cold.nulls.len() && slabs.len() == cold.slabs.len();
    let parameters = Parameters { dependent, nulls, slabs };
    fits.then(|| Fit { alphabet, base: Base::new(&base), parameters, states })
}
