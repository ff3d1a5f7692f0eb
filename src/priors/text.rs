//! How a fit is kept: JSON of our own, whose numbers read back to the same bits.

use serde::{Deserialize, Serialize};

use crate::domain::Pair;
use crate::evidence::{Base, Fit, Parameters};
use crate::information::Alphabet;
use crate::store::form::{self, Unreadable};

/// The version of the form that is written.
const FORM: u32 = 1;

#[derive(Serialize, Deserialize)]
struct FitText {
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

/// Reads a pair back; `None` where nothing is called so.
pub fn pair(text: &str) -> Option<Pair> {
    let positions = |text: &str| text.split(',').map(|position| position.parse().ok()).collect::<Option<Vec<usize>>>();
    let (agents, given) = match text.split_once('|') {
        Some((agents, given)) => (agents, positions(given)?),
        None => (text, Vec::new()),
    };
    match positions(agents)?[..] {
        [ego, other] => Some(Pair { ego, other, given }),
        _ => None,
    }
}

/// Writes a fit.
pub fn of_fit(fit: &Fit) -> String {
    let Parameters { dependent, nulls, slabs } = fit.parameters.clone();
    form::write(FORM, &FitText { base: fit.base.counts().to_vec(), dependent, nulls, slabs, states: fit.states })
}

/// Reads a fit of these alphabets back. One that cannot be read is made again; a version whose content says too little for that is
/// [`Unreadable::Older`].
pub fn fit(text: &str, alphabet: Alphabet) -> Result<Fit, Unreadable> {
    match form::version(text)? {
        1 => first(form::read(text)?, alphabet),
        found => Err(Unreadable::Newer { found, newest: FORM }),
    }
}

fn first(text: FitText, alphabet: Alphabet) -> Result<Fit, Unreadable> {
    let FitText { base, dependent, nulls, slabs, states } = text;
    let cold = Parameters::cold();
    let found = [base.len(), nulls.len(), slabs.len()];
    let expected = [alphabet.columns as usize, cold.nulls.len(), cold.slabs.len()];
    if found != expected {
        let why = format!("it has {found:?} actions, nulls and slabs, expected {expected:?}");
        return Err(Unreadable::Spoiled(why));
    }
    if !is_inside(dependent) {
        return Err(Unreadable::spoiled(format!("dependent {dependent}, expected above 0 and below 1")));
    }
    for (name, weights) in [("nulls", &nulls), ("slabs", &slabs)] {
        if !are_weights(weights) {
            return Err(Unreadable::spoiled(format!("{name} {weights:?}, expected above 0 and summing to 1")));
        }
    }
    Ok(Fit { alphabet, base: Base::new(&base), parameters: Parameters { dependent, nulls, slabs }, states })
}

/// What a fit never says with certainty.
fn is_inside(share: f64) -> bool {
    share > 0.0 && share < 1.0
}

fn are_weights(weights: &[f64]) -> bool {
    /// What rounding may leave of a sum.
    const ROUNDING: f64 = 1e-9;
    weights.iter().all(|weight| is_inside(*weight)) && (weights.iter().sum::<f64>() - 1.0).abs() <= ROUNDING
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALPHABET: Alphabet = Alphabet { rows: 2, columns: 3 };

    fn made() -> Fit {
        let parameters = Parameters { dependent: 0.1 + 0.2, ..Parameters::cold() };
        Fit { alphabet: ALPHABET, base: Base::new(&[3, 0, u64::from(u32::MAX)]), parameters, states: 7 }
    }

    #[test]
    fn pairs_read_back() {
        for (ego, other, given) in [(0, 1, vec![]), (2, 0, vec![1]), (0, 7, vec![1, 12])] {
            let written = Pair { ego, other, given };
            assert_eq!(pair(&of_pair(&written)), Some(written));
        }
        for wrong in ["", "0", "0,1,2", "0,1|", "a,b", "0,-1"] {
            assert_eq!(pair(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn a_fit_reads_back_to_the_same_bits_with_a_version_and_without() {
        let text = of_fit(&made());
        assert!(text.starts_with(r#"{"form":1,"base":[3,0,4294967295],"dependent":0.30000000000000004,"#), "{text}");
        let before_versions = text.replacen("\"form\":1,", "", 1);
        for text in [text, before_versions] {
            let read = fit(&text, ALPHABET).expect("a fit");
            assert_eq!((read.parameters, read.states), (made().parameters, 7));
            assert_eq!(read.base.counts(), made().base.counts());
        }
    }

    #[test]
    fn what_was_fitted_to_something_else_says_so() {
        let why = |text: &str, columns| fit(text, Alphabet { rows: 2, columns }).expect_err("not its fit").to_string();
        let text = of_fit(&made());
        assert!(why(&text, 4).starts_with("it is not as it was written: it has [3, "), "{}", why(&text, 4));
        assert!(why("{}", 3).contains("missing field `base`"));
        assert!(why(&text.replacen("1", "2", 1), 3).contains("form 2 of a newer build"));
    }
    #[test]
    fn shares_and_weights_that_no_fit_has_are_spoiled() {
        let why = |change: &dyn Fn(&mut Parameters)| {
            let mut wrong = made();
            change(&mut wrong.parameters);
            fit(&of_fit(&wrong), ALPHABET).expect_err("no fit").to_string()
        };
        for wrong in [-0.1, 0.0, 1.0, 1.5, f64::MAX] {
            let told = why(&|parameters| parameters.dependent = wrong);
            assert!(told.starts_with("it is not as it was written: dependent "), "{wrong}: {told}");
            let told = why(&|parameters| parameters.nulls[0] = wrong);
            assert!(told.starts_with("it is not as it was written: nulls ["), "{wrong}: {told}");
            let told = why(&|parameters| parameters.slabs[1] = wrong);
            assert!(told.starts_with("it is not as it was written: slabs ["), "{wrong}: {told}");
        }
        for wrong in [f64::NAN, f64::INFINITY] {
            let told = why(&|parameters| parameters.dependent = wrong);
            assert!(told.contains("invalid type: null"), "what JSON has for it: {told}");
        }
        let told = why(&|parameters| parameters.slabs[0] *= 2.0);
        assert!(told.contains("slabs ["), "they sum to more than 1: {told}");
    }
}
