//! Lag profiles (cross-dependence as a function of the lag): one question about many states
//! together, at several lags.

use super::draft::{PairDraft, ProfileDraft};
use super::pair::at_written_lag;
use super::{Environment, Label, Labels, Pair, Region, Schema, Scope, Tally, Unit, Within};
use crate::error::{Fault, Problem};
use crate::information::pooled::Pooled;

/// The level at which a lag may be the peak, divided by the number of lags (Bonferroni).
const LEVEL: f64 = 0.05;

/// A question for the profile of a pair in a region.
#[derive(Debug, Clone, PartialEq)]
pub struct ProfileQuestion {
    /// The pair of each lag, lags rising.
    pub pairs: Vec<Pair>,
    /// The segments to count, each once and in order; all if `None`.
    pub segments: Option<Vec<Label>>,
    /// Whether segments are strata.
    pub within: Within,
    /// The states that are asked about.
    pub region: Region,
    /// The unit of the answer's figures.
    pub unit: Unit,
}

/// What is dependent at which lag, over all states of a region together.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Whose influence on whom, by names alone.
    pub labels: Labels,
    /// The region.
    pub region: Region,
    /// The unit of the figures.
    pub unit: Unit,
    /// A point a lag, lags rising.
    pub points: Vec<ProfilePoint>,
    /// The revision this was made from.
    pub as_of: u64,
}

/// What the states of a region say together of one lag.
#[derive(Debug, Clone, PartialEq)]
pub struct ProfilePoint {
    /// How many steps the other is observed after the ego.
    pub lag: u32,
    /// The visits that tell of the pair, and their entries.
    pub tally: Tally,
    /// What they say; figures in the profile's unit.
    pub pooled: Pooled,
}

impl ProfileQuestion {
    /// Checks a question and lists every fault.
    pub fn new(environment: &Environment, draft: &ProfileDraft) -> Result<Self, Problem> {
        let mut faults = Vec::new();
        if draft.pair.lag != 0 {
            let detail = format!(
                "got {}, expected none beside a profile's lags",
                draft.pair.lag
            );
            faults.push(Fault::new("/lag", detail));
        }
        if draft.pair.policy.is_some() {
            let detail = "expected none: a profile is of the habits that were seen";
            faults.push(Fault::new("/policy", detail));
        }
        let without_lag = PairDraft {
            lag: 0,
            policy: None,
            ..draft.pair.clone()
        };

        let scope = Scope::check(environment, &without_lag).map_err(|found| faults.extend(found));
        let region = Region::checked(&draft.region, &environment.coordinates());
        let below = |found: Vec<Fault>| found.into_iter().map(|fault| fault.under("/region"));
        let region = region.map_err(|found| faults.extend(below(found)));

        let Ok(scope) = scope else {
            return Err(Problem::invalid("question", faults));
        };
        let pairs = pairs(&environment.schema, &scope.pair, &draft.lags);
        let pairs = pairs.map_err(|found| faults.extend(found));
        match (pairs, region) {
            (Ok(pairs), Ok(region)) if faults.is_empty() => Ok(Self {
                pairs,
                segments: scope.segments,
                within: scope.within,
                region,
                unit: scope.unit,
            }),
            _ => Err(Problem::invalid("question", faults)),
        }
    }
}

/// Returns the pairs of a profile: those of the lags, each once, or of all that there are.
fn pairs(schema: &Schema, pair: &Pair, lags: &[i64]) -> Result<Vec<Pair>, Vec<Fault>> {
    if pair.other_agent(schema).is_none() {
        let own = i64::from(pair.lag(schema));
        return match lags.iter().position(|lag| *lag != own) {
            None => Ok(vec![pair.clone()]),
            Some(at) => {
                let name = pair.name_of_other(schema);
                let detail = format!(
                    "got {}, expected {own}, at which {name} is observed",
                    lags[at]
                );
                Err(vec![Fault::new(format!("/lags/{at}"), detail)])
            }
        };
    }

    let (mut pairs, mut faults) = (Vec::new(), Vec::new());
    let all = usual_lags(schema, pair.other);
    let lags = if lags.is_empty() { &all } else { lags };
    for (at, lag) in lags.iter().enumerate() {
        match at_written_lag(schema, pair, *lag) {
            Ok(pair) => pairs.push(pair),
            Err(fault) => faults.push(Fault::new(format!("/lags/{at}"), fault.detail)),
        }
    }
    pairs.sort_by_key(|pair| pair.lag(schema));
    pairs.dedup();
    if faults.is_empty() {
        Ok(pairs)
    } else {
        Err(faults)
    }
}

/// Returns 0, and every lag that is declared for an agent, rising.
fn usual_lags(schema: &Schema, agent: usize) -> Vec<i64> {
    let later = schema
        .outcomes()
        .iter()
        .filter(|outcome| outcome.agent == Some(agent));
    let mut lags: Vec<i64> = later.map(|outcome| outcome.lag.into()).chain([0]).collect();
    lags.sort_unstable();
    lags
}

impl Profile {
    /// Returns the lag of the largest excess, of those whose test of any dependence passes at 5 %
    /// over all lags of the profile (Bonferroni); `None` where none does.
    pub fn peak(&self) -> Option<u32> {
        let level = LEVEL / self.points.len() as f64;
        let passes = |pooled: &Pooled| pooled.p_value <= level && pooled.excess > 0.0;
        let passing = self.points.iter().filter(|point| passes(&point.pooled));
        let largest = passing.max_by(|a, b| a.pooled.excess.total_cmp(&b.pooled.excess));
        largest.map(|point| point.lag)
    }
}

impl ProfilePoint {
    /// Returns the same with figures, which are in nats, in a unit.
    pub fn in_unit(self, unit: Unit) -> Self {
        Self {
            pooled: self.pooled.in_unit(|nats| unit.from_nats(nats)),
            ..self
        }
    }
}
