//! The question itself: in this state, does the ego's action influence the other's, how strongly,
//! and which of its actions do it?
//!
//! Reads counts from the store, makes contingency tables of them, lets `information` measure and
//! `evidence` decide.
//!
//! # The map
//!
//! | what is asked | file | by |
//! |---|---|---|
//! | states that are named | `questions` | `answer`, `actions`, `stratified`: tests, figures |
//! | regions, each as one | `questions` | `region_answers`, `region_warnings` |
//! | the causal graph of a state | `graph` | `skeleton`: the PC algorithm |
//! | a page of all states | `pages` | `listing`, `order` |
//! | all states in sum, what to try next | `overviews` | `summary`, `explore` |
//! | all states of a region as one, by lag | `overviews` | `profile` |
//! | the regions in which influence lives | `overviews` | `region_search` |
//! | a fit | `fits` | [`crate::priors`] |
//!
//! Each begins with its `query_context`, which `contexts` finds, its policy by `policy_segments`. An `assessor` says of one state's
//! counts what they are worth: `rows` keep that for all states, `state_ranking` and `count_ranking`
//! order them, and `discoveries` tests many at once. `passes` gets those from a `pass_cache`, made
//! once for all who ask. `labels` names what has numbers, and `size` refuses what no message holds.
//!
//! # Deliberately absent
//!
//! Nothing here counts, and nothing here knows a wire format but for the size that an answer may
//! have; what is fitted to all counts of an environment is kept in the store beside them.

use std::sync::Arc;
use std::time::Duration;

mod actions;
mod answer;
mod assessor;
mod contexts;
mod count_ranking;
mod discoveries;
mod explore;
mod fits;
mod graph;
mod holds;
mod keyed;
mod labels;
mod listing;
mod order;
mod overviews;
mod pages;
mod pass_cache;
mod passes;
mod policy_segments;
mod profile;
mod query_context;
mod questions;
mod region_answers;
mod region_search;
mod region_warnings;
mod row;
mod rows;
mod size;
mod skeleton;
mod state_ranking;
mod store_errors;
mod stratified;
mod summary;

use count_ranking::CountRanking;
use discoveries::DiscoverySearch;
use explore::Explored;
use pass_cache::PassCache;
use profile::{Points, ProfileKey};
use query_context::{CountRankingKey, RankingKey};
use region_answers::{Made, RegionKey};
use region_search::{Candidates, RegionSearchKey};
use state_ranking::StateRanking;

use crate::domain::{DiscoveryMethod, EnvironmentId, FittedPrior, Pair};
use crate::model::Networks;
use crate::priors::PriorRegistry;
use crate::store::Store;
use crate::work::{Jobs, Work};

/// For how long fits that nobody was told are kept for whoever asked for them.
const FITTED: Duration = Duration::from_secs(120);

/// Which discoveries: the ranking they are looked for in, the bits of the rate, and the method.
type SearchKey = (RankingKey, u64, DiscoveryMethod);

/// Which priors: of one pair, or of all.
type FitKey = (EnvironmentId, Option<Pair>);

/// The service that answers questions of influence. Cloning is cheap: every request does.
#[derive(Clone)]
pub struct Influence(Arc<Handles>);

/// What all clones share.
pub struct Handles {
    store: Arc<dyn Store>,
    fits: PriorRegistry,
    networks: Networks,
    work: Work,
    count_rankings: PassCache<CountRankingKey, CountRanking>,
    rankings: PassCache<RankingKey, StateRanking>,
    searched: PassCache<SearchKey, DiscoverySearch>,
    explored: PassCache<(RankingKey, u64), Explored>,
    profiles: PassCache<ProfileKey, Points>,
    regions: PassCache<RegionKey, Made>,
    region_searches: PassCache<RegionSearchKey, Candidates>,
    fitting: Jobs<FitKey, Vec<FittedPrior>>,
}

impl std::ops::Deref for Influence {
    type Target = Handles;

    fn deref(&self) -> &Handles {
        &self.0
    }
}

impl Influence {
    /// Makes a handle on the answers from a store, the priors fitted to it and the networks that
    /// are asked where counts do not decide.
    pub fn new(store: Arc<dyn Store>, fits: PriorRegistry, networks: Networks, work: Work) -> Self {
        let stopping = || work.stopping.clone();
        Self(Arc::new(Handles {
            count_rankings: PassCache::new("the ranking", stopping()),
            rankings: PassCache::new("the ranking", stopping()),
            searched: PassCache::new("the list of discoveries", stopping()),
            explored: PassCache::new("the exploration", stopping()),
            profiles: PassCache::new("the profile", stopping()),
            regions: PassCache::new("the answer", stopping()),
            region_searches: PassCache::new("the search for regions", stopping()),
            fitting: Jobs::new("the fit", FITTED, stopping()),
            store,
            fits,
            networks,
            work,
        }))
    }
}
