//! The rule that turns figures into a verdict, and the unit that information is told in.

use std::f64::consts::LN_2;

use super::{Estimator, Estimators, RuleDraft};
use crate::error::Fault;

/// The unit of every information figure of an answer. Inside, everything is in nats.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Unit {
    /// Natural logarithms.
    #[default]
    Nats,
    /// Logarithms to base 2.
    Bits,
}

impl Unit {
    /// Returns how many nats one of this unit is.
    pub fn in_nats(self) -> f64 {
        match self {
            Self::Nats => 1.0,
            Self::Bits => LN_2,
        }
    }

    /// Returns a figure in nats told in this unit.
    pub fn from_nats(self, nats: f64) -> f64 {
        match self {
            Self::Nats => nats,
            Self::Bits => nats / LN_2,
        }
    }

    /// Returns the word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Nats => "nats",
            Self::Bits => "bits",
        }
    }
}

impl std::str::FromStr for Unit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "nats" => Ok(Self::Nats),
            "bits" => Ok(Self::Bits),
            _ => Err(format!("got {text:?}, expected nats or bits")),
        }
    }
}

/// Which rule decides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum RuleKind {
    /// By the posterior probability that mutual information exceeds the threshold.
    Evidence,
    /// The paper's: plug-in mutual information above the threshold, where visits suffice.
    Paper,
}

impl RuleKind {
    /// Returns the word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Evidence => "evidence",
            Self::Paper => "paper",
        }
    }
}

impl std::str::FromStr for RuleKind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "evidence" => Ok(Self::Evidence),
            "paper" => Ok(Self::Paper),
            _ => Err(format!("got {text:?}, expected evidence or paper")),
        }
    }
}

/// How figures become a verdict. The parts that a kind does not use are kept, so that switching back loses nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rule {
    /// Which rule decides.
    pub kind: RuleKind,
    /// In `unit`; finite and not negative.
    pub threshold: f64,
    /// The unit of the threshold, and of answers unless another is asked for.
    pub unit: Unit,
    /// Visits below which the paper's rule stays undecided.
    pub min_visits: u64,
    /// Probability from which the evidence rule decides, above 0.5 and below 1.
    pub confidence: f64,
    /// What answers tell beside the plug-in, unless a question names others. They decide nothing.
    pub estimators: Estimators,
}

impl Default for Rule {
    /// By the evidence: influence above half a nat, at a confidence of 0.8.
    fn default() -> Self {
        Self {
            kind: RuleKind::Evidence,
            threshold: 0.5,
            unit: Unit::Nats,
            min_visits: 8,
            confidence: 0.8,
            estimators: Estimators::default(),
        }
    }
}

impl Rule {
    /// Returns the threshold in nats.
    pub fn threshold_nats(&self) -> f64 {
        self.threshold * self.unit.in_nats()
    }

    /// Returns the same rule told in another unit.
    pub fn in_unit(self, unit: Unit) -> Self {
        if unit == self.unit {
            return self;
        }
        Self { threshold: unit.from_nats(self.threshold_nats()), unit, ..self }
    }

    /// Returns this rule with the parts of `draft` that were given; a unit given alone converts the threshold. Lists every fault.
    pub fn merged(self, draft: &RuleDraft) -> Result<Self, Vec<Fault>> {
        let mut faults = Vec::new();
        let kind = parsed(&draft.kind, "/kind", &mut faults).unwrap_or(self.kind);
        let base = parsed(&draft.unit, "/unit", &mut faults).map_or(self, |unit| self.in_unit(unit));
        let threshold = draft.threshold.unwrap_or(base.threshold);
        if !(threshold.is_finite() && threshold >= 0.0) {
            faults.push(Fault::new("/threshold", format!("got {threshold}, expected a finite number, at least 0")));
        }
        let min_visits = draft.min_visits.unwrap_or(base.min_visits);
        if i64::try_from(min_visits).is_err() {
            faults.push(Fault::new("/min_visits", format!("got {min_visits}, expected 0 to 2^63 - 1")));
        }
        let confidence = draft.confidence.unwrap_or(base.confidence);
        if !(confidence > 0.5 && confidence < 1.0) {
            faults
                .push(Fault::new("/confidence", format!("got {confidence}, expected a number above 0.5 and below 1")));
        }
        let estimators = estimators(draft, &mut faults).unwrap_or(self.estimators);
        // A negative zero would be told as "-0".
        let rule = Self { kind, threshold: threshold + 0.0, unit: base.unit, min_visits, confidence, estimators };
        if faults.is_empty() { Ok(rule) } else { Err(faults) }
    }
}

/// Returns the estimators that are named, if a list is given.
fn estimators(draft: &RuleDraft, faults: &mut Vec<Fault>) -> Option<Estimators> {
    let names = draft.estimators.as_ref()?.iter().enumerate();
    Some(names.filter_map(|(i, name)| kept(name.parse::<Estimator>(), &format!("/estimators/{i}"), faults)).collect())
}

fn parsed<T: std::str::FromStr<Err = String>>(
    text: &Option<String>,
    pointer: &str,
    faults: &mut Vec<Fault>,
) -> Option<T> {
    kept(text.as_deref()?.parse(), pointer, faults)
}

fn kept<T>(parsed: Result<T, String>, pointer: &str, faults: &mut Vec<Fault>) -> Option<T> {
    parsed.map_err(|detail| faults.push(Fault::new(pointer, detail))).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_alone_converts_the_threshold() {
        let draft = RuleDraft { unit: Some("bits".into()), ..RuleDraft::default() };
        let rule = Rule::default().merged(&draft).expect("valid");
        assert!((rule.threshold - 0.5 / LN_2).abs() < 1e-15);
        assert!((rule.threshold_nats() - 0.5).abs() < 1e-15);
    }

    #[test]
    fn a_threshold_is_in_the_unit_given_with_it() {
        let draft = RuleDraft { unit: Some("bits".into()), threshold: Some(1.0), ..RuleDraft::default() };
        let rule = Rule::default().merged(&draft).expect("valid");
        assert_eq!((rule.threshold, rule.unit), (1.0, Unit::Bits));
    }

    #[test]
    fn every_fault_is_listed() {
        let draft = RuleDraft {
            kind: Some("papper".into()),
            threshold: Some(f64::NAN),
            unit: Some("hartleys".into()),
            min_visits: Some(u64::MAX),
            confidence: Some(0.5),
            estimators: Some(vec!["nsb".into(), "bayes".into()]),
        };
        let pointers: Vec<String> =
            Rule::default().merged(&draft).expect_err("all wrong").into_iter().map(|f| f.pointer).collect();
        assert_eq!(pointers, ["/kind", "/unit", "/threshold", "/min_visits", "/confidence", "/estimators/1"]);
    }
}
