//! The decision rule that turns figures into a verdict, and the unit that information is told in.

use std::f64::consts::LN_2;
use std::fmt;

use super::{Estimator, Estimators, Label, RuleDraft};
use crate::error::Fault;
use crate::information::Alphabet;

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

/// Mutual information above which there is influence, as somebody wrote it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Threshold {
    /// In the rule's unit; finite and not negative.
    Information(f64),
    /// Of ln min(R, K), the most that two agents with R and K actions can have; at least 0 and
    /// below 1.
    Share(f64),
}

/// How figures become a verdict, as it was written: for every pair of an environment. The parts
/// that a kind does not use are kept, so that switching back loses nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct WrittenRule {
    /// Which rule decides.
    pub kind: RuleKind,
    /// Above which there is influence.
    pub threshold: Threshold,
    /// The unit of the threshold, and of answers unless another is asked for.
    pub unit: Unit,
    /// Visits below which the paper's rule stays undecided.
    pub min_visits: u64,
    /// Probability from which the evidence rule decides, above 0.5 and below 1.
    pub confidence: f64,
    /// What answers tell beside the plug-in, unless a question names others. They decide nothing.
    pub estimators: Estimators,
    /// Segments in which agents explored, each once and in order: what they did there weighs
    /// nothing, unless a question names a policy.
    pub exploration: Vec<Label>,
}

impl fmt::Display for WrittenRule {
    /// Tells the rule in words, for the log.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unit = self.unit.as_str();
        write!(f, "{} above ", self.kind.as_str())?;
        match self.threshold {
            Threshold::Information(information) => write!(f, "{information} {unit}")?,
            Threshold::Share(share) => write!(f, "a share of {share}, in {unit}")?,
        }

        write!(
            f,
            ", at least {} visits, confidence {}, estimators ",
            self.min_visits, self.confidence
        )?;

        let names: Vec<&str> = self.estimators.iter().map(Estimator::as_str).collect();
        f.write_str(if names.is_empty() { "none" } else { "" })?;
        f.write_str(&names.join(" "))
    }
}

/// How figures become a verdict for one pair: a share has become information.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rule {
    /// Which rule decides.
    pub kind: RuleKind,
    /// In `unit`; finite and not negative.
    pub threshold: f64,
    /// The unit of the threshold.
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
        Self {
            threshold: unit.from_nats(self.threshold_nats()),
            unit,
            ..self
        }
    }
}

impl From<Rule> for WrittenRule {
    fn from(rule: Rule) -> Self {
        let Rule {
            kind,
            threshold,
            unit,
            min_visits,
            confidence,
            estimators,
        } = rule;
        Self {
            kind,
            threshold: Threshold::Information(threshold),
            unit,
            min_visits,
            confidence,
            estimators,
            exploration: Vec::new(),
        }
    }
}

impl Default for WrittenRule {
    /// The paper's half a nat, whatever the agents.
    fn default() -> Self {
        Rule::default().into()
    }
}

impl WrittenRule {
    /// Returns this rule for two agents with so many actions. A share becomes nats, so that it is
    /// the same threshold to the last bit whatever unit is told.
    pub fn resolved(&self, alphabet: Alphabet) -> Rule {
        let Self {
            kind,
            threshold,
            unit,
            min_visits,
            confidence,
            estimators,
            ..
        } = *self;

        let (threshold, unit) = match threshold {
            Threshold::Information(threshold) => (threshold, unit),
            Threshold::Share(share) => (share * alphabet.largest_information(), Unit::Nats),
        };

        Rule {
            kind,
            threshold,
            unit,
            min_visits,
            confidence,
            estimators,
        }
    }

    /// Returns which share of the largest mutual information of two agents with so many actions the
    /// threshold is; `None` where that is 0.
    pub fn share(&self, alphabet: Alphabet) -> Option<f64> {
        let largest = alphabet.largest_information();
        (largest > 0.0).then(|| match self.threshold {
            Threshold::Share(share) => share,
            Threshold::Information(_) => self.resolved(alphabet).threshold_nats() / largest,
        })
    }

    /// Says so where two agents with so many actions cannot have more mutual information than the
    /// threshold. Agents of which one has a single action have none at all, and no threshold is
    /// wrong for them.
    pub fn within_reach(&self, alphabet: Alphabet) -> Result<(), Fault> {
        /// What the rounding of a unit may add.
        const ROUNDING: f64 = 1e-12;
        let (rule, largest) = (self.resolved(alphabet), alphabet.largest_information());
        if largest == 0.0 || rule.threshold_nats() < largest * (1.0 - ROUNDING) {
            return Ok(());
        }
        Err(Fault::new("/threshold", beyond_reach(rule, alphabet)))
    }

    /// Returns this rule with the parts of `draft` that were given; a unit given alone converts the
    /// threshold. Lists every fault.
    pub fn merged(&self, draft: &RuleDraft) -> Result<Self, Vec<Fault>> {
        let mut faults = Vec::new();
        let kind = parsed(&draft.kind, "/kind", &mut faults).unwrap_or(self.kind);
        let base = parsed(&draft.unit, "/unit", &mut faults);
        let base = base.map_or_else(|| self.clone(), |unit| self.in_unit(unit));
        let threshold = threshold(draft, &mut faults).unwrap_or(base.threshold);

        let min_visits = draft.min_visits.unwrap_or(base.min_visits);
        if i64::try_from(min_visits).is_err() {
            faults.push(Fault::new(
                "/min_visits",
                format!("got {min_visits}, expected 0 to 2^63 - 1"),
            ));
        }

        let confidence = draft.confidence.unwrap_or(base.confidence);
        if !(confidence > 0.5 && confidence < 1.0) {
            faults.push(Fault::new(
                "/confidence",
                format!("got {confidence}, expected a number above 0.5 and below 1"),
            ));
        }
        let estimators = estimators(draft, &mut faults).unwrap_or(self.estimators);
        let exploration =
            exploration(draft, &mut faults).unwrap_or_else(|| self.exploration.clone());

        let rule = Self {
            kind,
            threshold,
            unit: base.unit,
            min_visits,
            confidence,
            estimators,
            exploration,
        };

        if faults.is_empty() {
            Ok(rule)
        } else {
            Err(faults)
        }
    }

    fn in_unit(&self, unit: Unit) -> Self {
        let threshold = match self.threshold {
            Threshold::Information(threshold) if unit != self.unit => {
                Threshold::Information(unit.from_nats(threshold * self.unit.in_nats()))
            }
            same => same,
        };

        Self {
            threshold,
            unit,
            ..self.clone()
        }
    }
}

/// Tells the most that two agents can have, in the unit of the threshold that is beyond it.
fn beyond_reach(rule: Rule, alphabet: Alphabet) -> String {
    let Rule {
        threshold, unit, ..
    } = rule;
    let Alphabet { rows, columns } = alphabet;

    let largest = (unit.from_nats(alphabet.largest_information()) * 1e6).round() / 1e6;
    let logarithm = if unit == Unit::Nats { "ln" } else { "log2" };
    let (unit, fewer) = (unit.as_str(), rows.min(columns));
    format!(
        "got {threshold} {unit}, expected less than {largest} {unit} = {logarithm} {fewer}, the most two agents with {rows} and {columns} actions \
         can have"
    )
}

/// Returns the threshold that is given, in one way or the other.
fn threshold(draft: &RuleDraft, faults: &mut Vec<Fault>) -> Option<Threshold> {
    if draft.threshold.is_some() && draft.share.is_some() {
        faults.push(Fault::new(
            "/threshold",
            "got a share too, expected one of them",
        ));
        faults.push(Fault::new(
            "/share",
            "got a threshold too, expected one of them",
        ));
        return None;
    }

    // A negative zero would be told as "-0".
    if let Some(threshold) = draft.threshold {
        if !(threshold.is_finite() && threshold >= 0.0) {
            faults.push(Fault::new(
                "/threshold",
                format!("got {threshold}, expected a finite number, at least 0"),
            ));
        }
        return Some(Threshold::Information(threshold + 0.0));
    }

    let share = draft.share?;
    if !(0.0..1.0).contains(&share) {
        faults.push(Fault::new(
            "/share",
            format!("got {share}, expected a number, at least 0 and below 1"),
        ));
    }
    Some(Threshold::Share(share + 0.0))
}

/// Returns the segments of exploration that are named, if a list is given.
fn exploration(draft: &RuleDraft, faults: &mut Vec<Fault>) -> Option<Vec<Label>> {
    let named = draft.exploration.as_ref()?;
    let mut segments: Vec<Label> = Vec::new();
    for (at, text) in named.iter().enumerate() {
        match text.parse() {
            Ok(label) => segments.push(label),
            Err(detail) => faults.push(Fault::new(format!("/exploration/{at}"), detail)),
        }
    }
    segments.sort_unstable();
    segments.dedup();
    Some(segments)
}

/// Returns the estimators that are named, if a list is given.
fn estimators(draft: &RuleDraft, faults: &mut Vec<Fault>) -> Option<Estimators> {
    let names = draft.estimators.as_ref()?.iter().enumerate();
    Some(
        names
            .filter_map(|(i, name)| {
                kept(
                    name.parse::<Estimator>(),
                    &format!("/estimators/{i}"),
                    faults,
                )
            })
            .collect(),
    )
}

fn parsed<T: std::str::FromStr<Err = String>>(
    text: &Option<String>,
    pointer: &str,
    faults: &mut Vec<Fault>,
) -> Option<T> {
    kept(text.as_deref()?.parse(), pointer, faults)
}

fn kept<T>(parsed: Result<T, String>, pointer: &str, faults: &mut Vec<Fault>) -> Option<T> {
    parsed
        .map_err(|detail| faults.push(Fault::new(pointer, detail)))
        .ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAIRS: [(u64, u64); 4] = [(2, 2), (3, 25), (256, 256), (1, 6)];

    fn alphabet((rows, columns): (u64, u64)) -> Alphabet {
        Alphabet { rows, columns }
    }

    fn merged(base: &WrittenRule, draft: RuleDraft) -> WrittenRule {
        base.merged(&draft).expect("valid")
    }

    fn share(share: f64) -> RuleDraft {
        RuleDraft {
            share: Some(share),
            ..RuleDraft::default()
        }
    }

    fn threshold(threshold: f64, unit: Option<&str>) -> RuleDraft {
        RuleDraft {
            threshold: Some(threshold),
            unit: unit.map(Into::into),
            ..RuleDraft::default()
        }
    }

    #[test]
    fn a_rule_is_told_in_words() {
        let rule = WrittenRule {
            estimators: Estimators::default(),
            ..WrittenRule::default()
        };
        assert_eq!(
            rule.to_string(),
            "evidence above 0.5 nats, at least 8 visits, confidence 0.8, estimators none"
        );
        let estimators = [Estimator::Nsb].into_iter().collect();
        let rule = WrittenRule {
            threshold: Threshold::Share(0.25),
            unit: Unit::Bits,
            estimators,
            ..rule
        };
        let expected = "evidence above a share of 0.25, in bits, at least 8 visits, confidence 0.8, estimators nsb";
        assert_eq!(rule.to_string(), expected);
    }

    #[test]
    fn a_unit_alone_converts_the_threshold() {
        let draft = RuleDraft {
            unit: Some("bits".into()),
            ..RuleDraft::default()
        };
        let rule = merged(&WrittenRule::default(), draft.clone()).resolved(alphabet((2, 2)));
        assert!((rule.threshold - 0.5 / LN_2).abs() < 1e-15);
        assert!((rule.threshold_nats() - 0.5).abs() < 1e-15);
        let rule = merged(&merged(&WrittenRule::default(), share(0.25)), draft);
        assert_eq!(
            (rule.threshold, rule.unit),
            (Threshold::Share(0.25), Unit::Bits)
        );
    }

    #[test]
    fn a_threshold_is_in_the_unit_given_with_it() {
        let rule = merged(&WrittenRule::default(), threshold(1.0, Some("bits")));
        assert_eq!(
            (rule.threshold, rule.unit),
            (Threshold::Information(1.0), Unit::Bits)
        );
    }

    #[test]
    fn a_share_is_another_figure_for_each_pair() {
        let rule = merged(&WrittenRule::default(), share(0.5));
        for (pair, most) in PAIRS.iter().zip([2.0_f64, 3.0, 256.0, 1.0]) {
            assert!(
                (rule.resolved(alphabet(*pair)).threshold_nats() - 0.5 * most.ln()).abs() < 1e-15
            );
        }
        let bits = merged(
            &rule,
            RuleDraft {
                unit: Some("bits".into()),
                ..share(0.5)
            },
        );
        assert!(
            (bits
                .resolved(alphabet((256, 256)))
                .in_unit(Unit::Bits)
                .threshold
                - 4.0)
                .abs()
                < 1e-15
        );
        for pair in PAIRS {
            assert_eq!(
                bits.resolved(alphabet(pair)),
                rule.resolved(alphabet(pair)),
                "a unit moves no threshold"
            );
        }
        assert_eq!(
            PAIRS.map(|pair| rule.share(alphabet(pair))),
            [Some(0.5), Some(0.5), Some(0.5), None]
        );
        let half_a_nat = WrittenRule::default()
            .share(alphabet((2, 2)))
            .expect("two actions each");
        assert!((half_a_nat - 0.5 / LN_2).abs() < 1e-15);
    }

    #[test]
    fn of_threshold_and_share_the_later_one_counts() {
        let by_share = merged(&WrittenRule::default(), share(0.5));
        assert_eq!(by_share.threshold, Threshold::Share(0.5));
        assert_eq!(
            merged(&by_share, threshold(0.1, None)).threshold,
            Threshold::Information(0.1)
        );
        assert_eq!(merged(&by_share, RuleDraft::default()), by_share);
        let both = RuleDraft {
            share: Some(0.5),
            ..threshold(0.1, None)
        };
        assert_eq!(pointers(&both), ["/threshold", "/share"]);
        for wrong in [-0.1, 1.0, 1.5, f64::NAN, f64::INFINITY] {
            assert_eq!(pointers(&share(wrong)), ["/share"], "{wrong}");
        }
    }

    #[test]
    fn what_no_pair_can_have_is_beyond_reach() {
        let reach = |draft: RuleDraft, pair| {
            merged(&WrittenRule::default(), draft).within_reach(alphabet(pair))
        };
        let fault = reach(threshold(0.8, None), (2, 2)).expect_err("ln 2 is less");
        assert_eq!(fault.pointer, "/threshold");
        assert_eq!(
            fault.detail,
            "got 0.8 nats, expected less than 0.693147 nats = ln 2, the most two agents with 2 and 2 actions can have"
        );
        let fault =
            reach(threshold(1.0, Some("bits")), (2, 25)).expect_err("not more than one bit");
        assert!(
            fault
                .detail
                .contains("less than 1 bits = log2 2, the most two agents with 2 and 25 actions"),
            "{fault:?}"
        );
        assert_eq!(reach(threshold(0.999, Some("bits")), (2, 25)), Ok(()));
        assert_eq!(reach(threshold(1.58, Some("bits")), (3, 25)), Ok(()));
        assert!(reach(threshold(3.0_f64.log2(), Some("bits")), (3, 25)).is_err());
        assert!(reach(threshold(8.0, Some("bits")), (256, 256)).is_err());
        assert_eq!(
            reach(threshold(1e300, None), (1, 6)),
            Ok(()),
            "no threshold is wrong where nothing can be decided"
        );
        assert_eq!(
            PAIRS.map(|pair| reach(share(0.999), pair)),
            [Ok(()), Ok(()), Ok(()), Ok(())]
        );
    }

    fn pointers(draft: &RuleDraft) -> Vec<String> {
        WrittenRule::default()
            .merged(draft)
            .expect_err("wrong")
            .into_iter()
            .map(|fault| fault.pointer)
            .collect()
    }

    #[test]
    fn every_fault_is_listed() {
        let draft = RuleDraft {
            kind: Some("papper".into()),
            threshold: Some(f64::NAN),
            share: None,
            unit: Some("hartleys".into()),
            min_visits: Some(u64::MAX),
            confidence: Some(0.5),
            estimators: Some(vec!["nsb".into(), "bayes".into()]),
            exploration: Some(vec!["tried".into(), String::new()]),
        };
        assert_eq!(
            pointers(&draft),
            [
                "/kind",
                "/unit",
                "/threshold",
                "/min_visits",
                "/confidence",
                "/estimators/1",
                "/exploration/1"
            ]
        );
    }
}
