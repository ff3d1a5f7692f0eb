//! Inference: the network that is ready to predict for a pair of agents.

use std::sync::Arc;

use super::Networks;
use super::network::Network;
use crate::domain::{Environment, Pair};
use crate::error::Problem;

impl Networks {
    /// Returns the network that answers for a pair; none where other agents are held fixed.
    pub async fn active(
        &self,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<Arc<Network>>, Problem> {
        let is_of_agents = pair.other_agent(&environment.schema).is_some();
        if pair.given.is_empty() && is_of_agents {
            self.registry.active(environment, pair).await
        } else {
            Ok(None)
        }
    }

    /// Returns the active network of a pair, for callers who want it and nothing else: an error
    /// where it cannot be read.
    pub async fn served(
        &self,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<Arc<Network>>, Problem> {
        self.registry.served(environment, pair).await
    }

    /// Returns a version ready to answer, active or not.
    pub async fn network(
        &self,
        environment: &Environment,
        version: u64,
    ) -> Result<Arc<Network>, Problem> {
        self.registry.network(environment, version).await
    }
}
