//! Searches for the regions in which influence lives (subgroup discovery): the question, and what
//! of the rules that were found is told.

use super::draft::RegionSearchDraft;
use super::{
    Coordinates, Environment, FeatureKind, Halves, Label, Labels, Name, Pair, Region, Scope, Unit,
    Within,
};
use crate::error::{Fault, Problem};
use crate::information::pooled::Pooled;
use crate::information::q_values;
use crate::information::search::{Axis, FoundRule, MOST_RULES, Searched, Sum};

/// The false discovery rate of a search that names none.
const USUAL_FDR: f64 = 0.05;

/// A question for the regions in which a pair depends.
#[derive(Debug, Clone, PartialEq)]
pub struct RegionSearchQuestion {
    /// Whose influence on whom.
    pub pair: Pair,
    /// The segments to count, each once and in order; all if `None`.
    pub segments: Option<Vec<Label>>,
    /// Whether segments are strata, and are dealt into halves.
    pub within: Within,
    /// The states that are searched.
    pub region: Region,
    /// The most regions that are tested.
    pub most: usize,
    /// The share of false ones among those told that is accepted on average.
    pub fdr: f64,
    /// The unit of the answer's figures.
    pub unit: Unit,
}

/// The regions in which a pair depends, as far as they could be told.
#[derive(Debug, Clone, PartialEq)]
pub struct RegionSearch {
    /// Whose influence on whom, by names alone.
    pub labels: Labels,
    /// How many steps the other is observed after the ego.
    pub lag: u32,
    /// The states that were searched.
    pub region: Region,
    /// The unit of the figures.
    pub unit: Unit,
    /// The rate at which regions are told.
    pub fdr: f64,
    /// How the counts were dealt.
    pub halves: Halves,
    /// What passed, in the order in which it was found.
    pub regions: Vec<FoundRegion>,
    /// How many regions were tested.
    pub tested: usize,
    /// How many rules the first of them was chosen from.
    pub looked_at: u64,
    /// Coordinates that the largest rules were not looked for with.
    pub left_out: Vec<Name>,
    /// The revision this was made from.
    pub as_of: u64,
}

/// A region that was found in one half of the counts and tested on the other. The states of those
/// found before it are left out of all figures.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundRegion {
    /// Its states.
    pub region: Region,
    /// What the half that was searched says, in nats.
    pub searched: Sum,
    /// What the other half says; figures in the answer's unit.
    pub tested: Pooled,
    /// The smallest false discovery rate at which it passes.
    pub q_value: f64,
}

impl RegionSearchQuestion {
    /// Checks a question and lists every fault.
    pub fn new(environment: &Environment, draft: &RegionSearchDraft) -> Result<Self, Problem> {
        let mut faults = Vec::new();
        if draft.pair.policy.is_some() {
            let detail = "a search is by the habits that were observed: expected none";
            faults.push(Fault::new("/policy", detail));
        }
        let scope = Scope::check(environment, &draft.pair).map_err(|found| faults.extend(found));
        let region = Region::checked(&draft.region, &environment.coordinates());
        let below = |found: Vec<Fault>| found.into_iter().map(|fault| fault.under("/region"));
        let region = region.map_err(|found| faults.extend(below(found)));
        let fdr = checked_fdr(draft.fdr).map_err(|found| faults.push(found));
        let most = checked_most(draft.most).map_err(|found| faults.push(found));

        match (scope, region, fdr, most) {
            (Ok(scope), Ok(region), Ok(fdr), Ok(most)) if faults.is_empty() => Ok(Self {
                pair: scope.pair,
                segments: scope.segments,
                within: scope.within,
                region,
                most,
                fdr,
                unit: scope.unit,
            }),
            _ => Err(Problem::invalid("question", faults)),
        }
    }
}

fn checked_fdr(fdr: Option<f64>) -> Result<f64, Fault> {
    match fdr {
        None => Ok(USUAL_FDR),
        Some(fdr) if fdr > 0.0 && fdr < 1.0 => Ok(fdr),
        Some(fdr) => {
            let detail = format!("got {fdr}, expected a number above 0 and below 1");
            Err(Fault::new("/fdr", detail))
        }
    }
}

fn checked_most(most: u64) -> Result<usize, Fault> {
    match most {
        0 => Ok(MOST_RULES),
        most if most <= MOST_RULES as u64 => Ok(most as usize),
        most => {
            let detail = format!("got {most}, expected 1 to {MOST_RULES}");
            Err(Fault::new("/most", detail))
        }
    }
}

impl Coordinates {
    /// Returns each of them as a search takes it.
    pub fn axes(&self) -> Vec<Axis> {
        let axis = |kind: &FeatureKind| match kind {
            FeatureKind::Continuous(_) | FeatureKind::Integer(..) => Axis::Ordered(kind.bins()),
            FeatureKind::Circular(..) | FeatureKind::Categorical(_) => Axis::Unordered,
        };
        self.all().iter().map(|one| axis(one.kind())).collect()
    }
}

impl Region {
    /// Returns those of its states that meet a rule over all coordinates.
    pub fn ruled(&self, coordinates: &Coordinates, rule: &FoundRule) -> Self {
        let conditions = rule.conditions.iter();
        let named = conditions.map(|one| (&coordinates.all()[one.axis], one.bins.clone()));
        self.narrowed(named)
    }
}

impl FoundRegion {
    /// Returns the regions whose tests pass at a false discovery rate (Benjamini & Hochberg 1995),
    /// each with what either half says.
    pub fn passing(found: Vec<(Region, Sum, Pooled)>, fdr: f64) -> Vec<Self> {
        let p_values: Vec<f64> = found.iter().map(|(_, _, pooled)| pooled.p_value).collect();
        let with_q = found.into_iter().zip(q_values(&p_values));
        let passing = with_q.filter(|(_, q)| *q <= fdr);
        let told = |((region, searched, tested), q_value)| Self {
            region,
            searched,
            tested,
            q_value,
        };
        passing.map(told).collect()
    }

    /// Returns the same with figures, which are in nats, in a unit.
    pub fn in_unit(self, unit: Unit) -> Self {
        Self {
            tested: self.tested.in_unit(|nats| unit.from_nats(nats)),
            ..self
        }
    }
}

/// Returns the names of the coordinates that a search left out of its largest rules.
pub fn left_out(searched: &Searched, coordinates: &Coordinates) -> Vec<Name> {
    let name = |axis: &usize| coordinates.all()[*axis].name().clone();
    searched.left_out.iter().map(name).collect()
}
