//! Fits on request: empirical Bayes, a prior for each pair, by the counts as they are now.

use std::sync::Arc;

use tracing::instrument;

use super::Influence;
use crate::domain::draft::PairDraft;
use crate::domain::{Environment, FittedPrior, Pair, Scope};
use crate::error::Problem;
use crate::work::Progress;

impl Influence {
    /// Fits the prior of a pair, or of every pair, to the counts as they are now. Whoever could not
    /// wait for it is told of it when it asks again.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn fit(
        &self,
        environment: &Arc<Environment>,
        pair: Option<&PairDraft>,
    ) -> Result<Vec<FittedPrior>, Problem> {
        let pair = pair
            .map(|pair| Scope::new(environment, pair))
            .transpose()?
            .map(|scope| scope.pair.undirected());

        let fits = |progress: Progress| {
            let (this, environment, pair) = (self.clone(), environment.clone(), pair.clone());
            async move {
                let pairs =
                    pair.map_or_else(|| Pair::every(&environment.schema), |pair| vec![pair]);
                let mut fitted = Vec::with_capacity(pairs.len());
                for pair in pairs {
                    fitted.extend(this.fitted(&progress, &environment, &pair).await?);
                }
                Ok(fitted)
            }
        };

        self.fitting.ask((environment.id, pair.clone()), fits).await
    }

    /// Fits one prior; `None` where the alphabets are too large for evidence.
    async fn fitted(
        &self,
        progress: &Progress,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<FittedPrior>, Problem> {
        let Some(found) = self.fits.fit_telling(progress, environment, pair).await? else {
            return Ok(None);
        };

        let name = |agent: usize| environment.schema.agents()[agent].name.to_string();
        Ok(Some(FittedPrior {
            earlier: name(pair.ego),
            later: pair.name_of_other(&environment.schema).to_owned(),
            lag: pair.lag(&environment.schema),
            given: pair.given.iter().map(|agent| name(*agent)).collect(),
            fit: found.id,
            states: found.fit.states,
            dependent_share: found.fit.parameters.dependent,
        }))
    }
}
