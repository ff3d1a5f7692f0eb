//! One state's counts, judged: its tables, what the evidence says of them, and the verdict.

use super::fits::Fitted;
use super::tables::Tables;
use crate::domain::{Cell, Evidence, Independence, Probability, RuleKind, Schema, Scope, Verdict, View};
use crate::evidence::{self, Belief, Posterior};
use crate::information::plug_in;

/// Who judges: a schema, a question's scope and the fit that the evidence rests on.
#[derive(Clone, Copy)]
pub struct Judge<'a> {
    pub schema: &'a Schema,
    pub scope: &'a Scope,
    pub fitted: Option<&'a Fitted>,
    /// Whether figures are wanted: a verdict by the paper's rule needs no evidence.
    pub view: View,
}

/// What was found about one state, in nats.
pub struct Judged {
    /// Its tables.
    pub tables: Tables,
    /// What the evidence counts as independent draws.
    pub independence: Independence,
    /// Plug-in mutual information.
    pub plug_in: f64,
    /// What its counts let one believe; `None` where nobody asks, or the alphabets are too large.
    pub posterior: Option<Posterior>,
    /// What is believed of MI > threshold.
    pub above: Option<Belief>,
    /// The verdict.
    pub verdict: Verdict,
}

impl Judge<'_> {
    /// Judges a state by its cells.
    pub fn judge<'c, C: Iterator<Item = &'c Cell> + Clone>(&self, cells: C) -> Judged {
        let Scope { pair, rule, .. } = self.scope;
        let tables = Tables::new(self.schema, pair, cells.clone());
        let plug_in = tables.figure(plug_in);
        let wanted = self.fitted.filter(|_| self.view != View::Verdict || rule.kind == RuleKind::Evidence);
        let (independence, slices) = tables.draws(self.schema, pair, cells);
        let posterior = wanted.map(|fitted| fitted.prior.posterior(&slices));
        drop(slices);
        let nats = rule.threshold_nats();
        let above = posterior
            .as_ref()
            .zip(wanted)
            .map(|(posterior, fitted)| Belief { now: posterior.above(nats), unseen: fitted.unseen_above(nats) });
        let verdict = evidence::decide(rule, tables.whole.total(), plug_in, above);
        Judged { tables, independence, plug_in, posterior, above, verdict }
    }

    /// Returns what the evidence on a state says, in nats.
    pub fn evidence(&self, judged: &Judged) -> Option<Evidence> {
        let posterior = judged.posterior.as_ref()?;
        let dependent = Belief { now: posterior.dependent(), unseen: self.fitted?.prior.unseen().dependent() };
        Some(Evidence {
            dependence: evidence::dependence(dependent),
            probability: Probability { dependent: dependent.now, above_threshold: judged.above?.now },
            // A negative zero would be told as "-0".
            posterior_mean: posterior.mean() + 0.0,
            interval: posterior.interval(),
        })
    }
}
