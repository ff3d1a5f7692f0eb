//! Ways to treat segments (stratified or pooled evidence): tables cut by segment in, what is
//! believed of each state out.

use rayon::prelude::*;

use crate::domain::{Dependence, Rule};
use crate::evidence::{Believed, Counted, Fitter, Posterior, Prior, Uses, dependence};
use crate::information::{Alphabet, Table};
use crate::simulation::planted::segments::pooled;

/// The estimate of a state: its dependence and interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Said {
    /// P(dependent), within segments or not, as the way goes.
    pub dependent: f64,
    /// The 90 % interval of mutual information, in nats.
    pub interval: [f64; 2],
    /// Whether there is dependence at all.
    pub dependence: Dependence,
}

impl Said {
    /// Tells a posterior, beside that of a state never seen, by the tables that it was made of.
    pub fn new(posterior: &Posterior, unseen: &Posterior, tables: &[Table]) -> Self {
        let threshold = Rule::default().threshold_nats();
        let believed = Believed::new(
            posterior.beliefs(threshold),
            unseen.beliefs(threshold),
            tables,
        );
        Self {
            dependent: posterior.dependent(),
            interval: posterior.interval(),
            dependence: dependence(&believed),
        }
    }
}

/// Evidence that is given tables cut by segment: fitted to all states, then asked about each.
pub trait Engine: Sync + Sized {
    /// Fits the states of an environment, each by its tables of one segment each.
    fn fit(alphabet: Alphabet, states: &[Vec<Table>]) -> Self;

    /// Returns what is believed of a state, by its tables of one segment each.
    fn posterior(&self, segments: &[Table]) -> Said;
}

/// A way to treat segments, in the words of a question.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Within {
    /// Segments are added up.
    Pooled,
    /// The evidence is given the parts, too.
    Auto,
}

impl Within {
    /// Every way, the one that is held to the targets last.
    pub const ALL: [Self; 2] = [Self::Pooled, Self::Auto];

    /// The way that is held to the targets.
    pub const JUDGED: Self = Self::ALL[Self::ALL.len() - 1];

    /// Returns its name.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Pooled => "pooled",
            Self::Auto => "auto",
        }
    }

    /// Fits the states and asks about each.
    pub fn ask(self, alphabet: Alphabet, states: &[Vec<Table>]) -> Vec<Said> {
        match self {
            Self::Pooled => asked::<Pooled>(alphabet, states),
            Self::Auto => asked::<Auto>(alphabet, states),
        }
    }
}

fn asked<E: Engine>(alphabet: Alphabet, states: &[Vec<Table>]) -> Vec<Said> {
    let engine = E::fit(alphabet, states);
    states
        .par_iter()
        .map(|segments| engine.posterior(segments))
        .collect()
}

/// Evidence that does not know about segments.
pub struct Pooled(Prior);

impl Engine for Pooled {
    fn fit(alphabet: Alphabet, states: &[Vec<Table>]) -> Self {
        let tables: Vec<[Table; 1]> = states.iter().map(|segments| [pooled(segments)]).collect();
        let mut uses = Uses::new(alphabet);
        tables.iter().for_each(|table| uses.add(table));
        let mut fitter = Fitter::new(alphabet, &uses);
        tables.iter().for_each(|table| fitter.add(table));
        Self(Prior::new(&fitter.fit()))
    }

    fn posterior(&self, segments: &[Table]) -> Said {
        let Self(prior) = self;
        let table = [pooled(segments)];
        Said::new(
            &prior.posterior(prior.habits(), &table),
            prior.unseen(),
            &table,
        )
    }
}

/// Evidence that knows about segments.
pub struct Auto(Prior);

impl Engine for Auto {
    fn fit(alphabet: Alphabet, states: &[Vec<Table>]) -> Self {
        let wholes: Vec<[Table; 1]> = states.iter().map(|segments| [pooled(segments)]).collect();
        let counted = || {
            wholes
                .iter()
                .zip(states)
                .map(|(whole, segments)| counted(whole, segments))
        };

        let mut uses = Uses::new(alphabet);
        counted().for_each(|state| uses.add(state));
        let mut fitter = Fitter::new(alphabet, &uses);
        counted().for_each(|state| fitter.add(state));
        Self(Prior::new(&fitter.fit()))
    }

    fn posterior(&self, segments: &[Table]) -> Said {
        let Self(prior) = self;
        let whole = [pooled(segments)];
        Said::new(
            &prior.posterior(prior.habits(), counted(&whole, segments)),
            prior.unseen(),
            &whole,
        )
    }
}

fn counted<'a>(whole: &'a [Table; 1], segments: &'a [Table]) -> Counted<'a> {
    Counted {
        slices: whole,
        parts: if segments.len() > 1 { segments } else { &[] },
    }
}
