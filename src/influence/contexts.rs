//! The context of each query: its scope with the segments that it names, the prior that was fitted
//! last and the network that is active.

use std::sync::Arc;

use super::Influence;
use super::policy_segments::PolicySegments;
use super::query_context::QueryContext;
use super::store_errors::logged;
use crate::domain::{Environment, Label, Policy, Scope, SegmentId, hint};
use crate::error::{Fault, Problem};
use crate::evidence;
use crate::information::Alphabet;

impl Influence {
    /// Finds out what questions of that scope rest on: the numbers of their segments and the fit.
    pub(super) async fn query_context(
        &self,
        environment: &Arc<Environment>,
        scope: Scope,
    ) -> Result<QueryContext, Problem> {
        let segments = self
            .segments(environment, scope.segments.as_deref())
            .await?;
        let policy = self.policy(environment, &scope).await?;
        let informed = self
            .fits
            .informed(environment, &scope.pair)
            .await
            .map_err(logged)?;

        let network = self.networks.active(environment, &scope.pair).await?;

        Ok(QueryContext {
            environment: environment.clone(),
            scope,
            segments,
            policy,
            informed,
            network,
        })
    }

    /// Returns the policy of a scope by the numbers of its segments.
    async fn policy(
        &self,
        environment: &Environment,
        scope: &Scope,
    ) -> Result<PolicySegments, Problem> {
        let Alphabet { rows, columns } = scope.pair.alphabet(&environment.schema);
        let is_weighable = rows * columns <= evidence::MOST_CELLS;
        match &scope.policy {
            Policy::Observed => Ok(PolicySegments::Observed),
            Policy::Outside(explored) => {
                let known = self.store.segments(environment.id).await.map_err(logged)?;
                let explored = known.into_iter().filter(|(_, label)| {
                    let label = label.as_ref();
                    label.is_some_and(|label| explored.contains(label))
                });
                let explored: Vec<SegmentId> = explored.map(|(id, _)| id).collect();
                Ok(match explored.is_empty() || !is_weighable {
                    true => PolicySegments::Observed,
                    false => PolicySegments::Outside(explored),
                })
            }
            _ if !is_weighable => {
                let detail = format!(
                    "expected none for agents with {rows} x {columns} actions: a policy that was \
                     not seen weighs at most {} pairs",
                    evidence::MOST_CELLS
                );
                let fault = Fault::new("/policy", detail);
                Err(Problem::invalid("question", vec![fault]))
            }
            Policy::Uniform => Ok(PolicySegments::Uniform),
            Policy::Segments(named) => {
                let at = "/policy/segments";
                let ids = self.segments_at(at, environment, Some(named)).await?;
                Ok(PolicySegments::Within(ids.unwrap_or_default()))
            }
        }
    }

    /// Returns the numbers of the segments named, or every unknown one as a fault.
    pub(super) async fn segments(
        &self,
        environment: &Environment,
        named: Option<&[Label]>,
    ) -> Result<Option<Vec<SegmentId>>, Problem> {
        self.segments_at("/segments", environment, named).await
    }

    async fn segments_at(
        &self,
        pointer: &str,
        environment: &Environment,
        named: Option<&[Label]>,
    ) -> Result<Option<Vec<SegmentId>>, Problem> {
        let Some(named) = named else { return Ok(None) };
        let known = self.store.segments(environment.id).await.map_err(logged)?;

        let mut faults = Vec::new();
        let mut ids = Vec::with_capacity(named.len());
        for label in named {
            match known
                .iter()
                .find(|(_, known)| known.as_ref() == Some(label))
            {
                Some((id, _)) => ids.push(*id),
                None => {
                    let known = known
                        .iter()
                        .filter_map(|(_, label)| Some(label.as_ref()?.as_str()));
                    let hint = hint(label.as_str(), known);
                    faults.push(Fault::new(
                        pointer,
                        format!("unknown segment {:?}{hint}", label.as_str()),
                    ));
                }
            }
        }

        if faults.is_empty() {
            Ok(Some(ids))
        } else {
            Err(Problem::invalid("question", faults))
        }
    }
}
