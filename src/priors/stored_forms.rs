//! The stored form of a fitted prior: versioned JSON whose numbers read back to the same bits.

use serde::{Deserialize, Serialize};

use crate::domain::Pair;
use crate::evidence::{Base, Fit, Parameters, SideParameters};
use crate::information::Alphabet;
use crate::store::FitRecord;
use crate::store::form::{self, Unreadable};

/// The version of the form that is written. The first one read tables in one way only: nothing of
/// it says what the other way would. The second one weighed other slabs, and those on a state's own
/// marginal by less evidence than there is.
const FORM: u32 = 3;

#[derive(Serialize, Deserialize)]
struct StoredFit {
    bases: [Vec<u64>; 2],
    dependent: f64,
    sides: [StoredSide; 2],
    families: [f64; 3],
    states: u64,
}

#[derive(Serialize, Deserialize)]
struct StoredSide {
    nulls: Vec<f64>,
    slabs: Vec<f64>,
    habit: Option<f64>,
    habit_in_segments: Option<f64>,
    segments: Vec<f64>,
}

impl From<SideParameters> for StoredSide {
    fn from(side: SideParameters) -> Self {
        let SideParameters {
            nulls,
            slabs,
            habit,
            habit_in_segments,
            segments,
        } = side;
        Self {
            nulls,
            slabs,
            habit,
            habit_in_segments,
            segments,
        }
    }
}

impl From<StoredSide> for SideParameters {
    fn from(side: StoredSide) -> Self {
        let StoredSide {
            nulls,
            slabs,
            habit,
            habit_in_segments,
            segments,
        } = side;
        Self {
            nulls,
            slabs,
            habit,
            habit_in_segments,
            segments,
        }
    }
}

/// Writes a pair as the store knows it: the positions of its variables, then those held fixed, then
/// that of the outcome that is asked about: `0,2|1@5`.
pub fn write_pair(pair: &Pair) -> String {
    let given: Vec<String> = pair.given.iter().map(ToString::to_string).collect();
    let fixed = if given.is_empty() {
        String::new()
    } else {
        format!("|{}", given.join(","))
    };
    let later = pair.later.map(|at| format!("@{at}")).unwrap_or_default();
    format!("{},{}{fixed}{later}", pair.ego, pair.other)
}

/// Reads a pair back; `None` where nothing is called so.
pub fn read_pair(text: &str) -> Option<Pair> {
    let positions = |text: &str| {
        text.split(',')
            .map(|position| position.parse().ok())
            .collect::<Option<Vec<usize>>>()
    };
    let (text, later) = match text.split_once('@') {
        Some((text, later)) => (text, Some(later.parse().ok()?)),
        None => (text, None),
    };
    let (agents, given) = match text.split_once('|') {
        Some((agents, given)) => (agents, positions(given)?),
        None => (text, Vec::new()),
    };
    match positions(agents)?[..] {
        [ego, other] => Some(Pair {
            later,
            ..Pair::new(ego, other, given)
        }),
        _ => None,
    }
}

/// Writes a fit.
pub fn write_fit(fit: &Fit) -> String {
    let Parameters {
        dependent,
        sides,
        families,
    } = fit.parameters.clone();

    let bases = fit.bases.clone().map(|base| base.counts().to_vec());
    form::write(
        FORM,
        &StoredFit {
            bases,
            dependent,
            sides: sides.map(StoredSide::from),
            families,
            states: fit.states,
        },
    )
}

/// Reads a fit of these alphabets as it is kept.
pub fn read_record(record: &FitRecord, alphabet: Alphabet) -> Result<Fit, Unreadable> {
    match record.is_sound {
        true => read_fit(&record.body, alphabet),
        false => Err(Unreadable::spoiled("its checksum is another")),
    }
}

/// Reads a fit of these alphabets back. One that cannot be read is made again; a version whose
/// content says too little for that is [`Unreadable::Older`].
fn read_fit(text: &str, alphabet: Alphabet) -> Result<Fit, Unreadable> {
    match form::version(text)? {
        older @ 1..FORM => Err(Unreadable::Older(older)),
        FORM => read_newest(form::read_content(text)?, alphabet),
        found => Err(Unreadable::Newer {
            found,
            newest: FORM,
        }),
    }
}

fn read_newest(text: StoredFit, alphabet: Alphabet) -> Result<Fit, Unreadable> {
    let StoredFit {
        bases,
        dependent,
        sides,
        families,
        states,
    } = text;

    let found = bases.each_ref().map(|base| base.len() as u64);
    if found != [alphabet.rows, alphabet.columns] {
        return Err(Unreadable::spoiled(format!(
            "it has {found:?} actions, expected {}, {}",
            alphabet.rows, alphabet.columns
        )));
    }

    if !is_inside(dependent) {
        return Err(Unreadable::spoiled(format!(
            "dependent {dependent}, expected above 0 and below 1"
        )));
    }

    check(&sides)?;
    if !are_weights(&families) {
        return Err(Unreadable::spoiled(format!(
            "families {families:?}, expected above 0 and summing to 1"
        )));
    }

    let parameters = Parameters {
        dependent,
        sides: sides.map(SideParameters::from),
        families,
    };
    Ok(Fit {
        alphabet,
        bases: bases.map(|counts| Base::new(&counts)),
        parameters,
        states,
    })
}

fn check(sides: &[StoredSide; 2]) -> Result<(), Unreadable> {
    let cold = &Parameters::cold().sides[0];
    for StoredSide {
        nulls,
        slabs,
        habit,
        habit_in_segments,
        segments,
    } in sides
    {
        let found = [nulls.len(), slabs.len(), segments.len()];
        let expected = [cold.nulls.len(), cold.slabs.len(), cold.segments.len()];
        if found != expected {
            let what = "nulls, slabs and kinds of habits";
            return Err(Unreadable::spoiled(format!(
                "it has {found:?} {what}, expected {expected:?}"
            )));
        }

        if !are_weights(segments) {
            return Err(Unreadable::spoiled(format!(
                "segments {segments:?}, expected above 0 and summing to 1"
            )));
        }

        if !are_weights(nulls) {
            return Err(Unreadable::spoiled(format!(
                "nulls {nulls:?}, expected above 0 and summing to 1"
            )));
        }

        for (name, habit) in [("habit", habit), ("habit_in_segments", habit_in_segments)] {
            if habit.is_some_and(|habit| habit <= 0.0) {
                return Err(Unreadable::spoiled(format!(
                    "{name} {habit:?}, expected above 0"
                )));
            }
        }
    }

    let slabs: Vec<f64> = sides.iter().flat_map(|side| side.slabs.clone()).collect();
    if !are_weights(&slabs) {
        return Err(Unreadable::spoiled(format!(
            "slabs {slabs:?}, expected above 0 and summing to 1"
        )));
    }
    Ok(())
}

/// What a fit never says with certainty.
fn is_inside(share: f64) -> bool {
    share > 0.0 && share < 1.0
}

fn are_weights(weights: &[f64]) -> bool {
    /// What rounding may leave of a sum.
    const ROUNDING: f64 = 1e-9;
    weights.iter().all(|weight| is_inside(*weight))
        && (weights.iter().sum::<f64>() - 1.0).abs() <= ROUNDING
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALPHABET: Alphabet = Alphabet {
        rows: 2,
        columns: 3,
    };

    fn made() -> Fit {
        let mut parameters = Parameters {
            dependent: 0.1 + 0.2,
            ..Parameters::cold()
        };
        parameters.sides[1].habit = Some(2.0 / 3.0);
        let bases = [Base::new(&[5, 6]), Base::new(&[3, 0, u64::from(u32::MAX)])];
        Fit {
            alphabet: ALPHABET,
            bases,
            parameters,
            states: 7,
        }
    }

    #[test]
    fn pairs_read_back() {
        for (ego, other, given) in [(0, 1, vec![]), (2, 0, vec![1]), (0, 7, vec![1, 12])] {
            for later in [None, Some(0), Some(511)] {
                let written = Pair {
                    later,
                    ..Pair::new(ego, other, given.clone())
                };
                assert_eq!(read_pair(&write_pair(&written)), Some(written));
            }
        }
        assert_eq!(write_pair(&Pair::new(0, 2, vec![1])), "0,2|1", "as ever");
        for wrong in [
            "", "0", "0,1,2", "0,1|", "a,b", "0,-1", "0,1@", "0,1@-1", "0,1@a", "@1",
        ] {
            assert_eq!(read_pair(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn a_fit_reads_back_to_the_same_bits() {
        let text = write_fit(&made());
        assert!(
            text.starts_with(
                r#"{"form":3,"bases":[[5,6],[3,0,4294967295]],"dependent":0.30000000000000004,"#
            ),
            "{text}"
        );
        assert_eq!(read_fit(&text, ALPHABET).expect("a fit"), made());
    }

    #[test]
    fn what_was_fitted_to_something_else_says_so() {
        let why = |text: &str, columns| {
            read_fit(text, Alphabet { rows: 2, columns })
                .expect_err("not its fit")
                .to_string()
        };
        let text = write_fit(&made());
        assert!(
            why(&text, 4).starts_with("it is not as it was written: it has [2, 3] actions"),
            "{}",
            why(&text, 4)
        );
        assert!(why(r#"{"form":3}"#, 3).contains("missing field `bases`"));
        assert!(why(&text.replacen("3", "4", 1), 3).contains("form 4 of a newer build"));
        assert_eq!(
            read_fit(&text.replacen("3", "2", 1), ALPHABET),
            Err(Unreadable::Older(2))
        );
        // As builds before this one wrote it, with a version and without.
        for first in [
            r#"{"form":1,"base":[3,0,9]}"#,
            r#"{"base":[3,0,9],"dependent":0.3,"nulls":[1.0],"slabs":[1.0],"states":1}"#,
        ] {
            assert_eq!(read_fit(first, ALPHABET), Err(Unreadable::Older(1)));
        }
    }

    #[test]
    fn shares_and_weights_that_no_fit_has_are_spoiled() {
        let why = |change: &dyn Fn(&mut Parameters)| {
            let mut wrong = made();
            change(&mut wrong.parameters);
            read_fit(&write_fit(&wrong), ALPHABET)
                .expect_err("no fit")
                .to_string()
        };
        for wrong in [-0.1, 0.0, 1.0, 1.5, f64::MAX] {
            let told = why(&|parameters| parameters.dependent = wrong);
            assert!(
                told.starts_with("it is not as it was written: dependent "),
                "{wrong}: {told}"
            );
            let told = why(&|parameters| parameters.sides[0].nulls[0] = wrong);
            assert!(
                told.starts_with("it is not as it was written: nulls ["),
                "{wrong}: {told}"
            );
            let told = why(&|parameters| parameters.sides[1].slabs[1] = wrong);
            assert!(
                told.starts_with("it is not as it was written: slabs ["),
                "{wrong}: {told}"
            );
        }
        let told = why(&|parameters| parameters.sides[0].habit = Some(-1.0));
        assert!(told.contains("habit Some(-1.0)"), "{told}");
        for wrong in [f64::NAN, f64::INFINITY] {
            let told = why(&|parameters| parameters.dependent = wrong);
            assert!(
                told.contains("invalid type: null"),
                "what JSON has for it: {told}"
            );
        }
        let told = why(&|parameters| parameters.sides[0].slabs[0] *= 2.0);
        assert!(told.contains("slabs ["), "they sum to more than 1: {told}");
    }
}
