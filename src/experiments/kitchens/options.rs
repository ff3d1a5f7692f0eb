//! Parameters of the experiment: which kinds of worlds, for which seeds, and how large.

use super::{Layout, ResponseModel};
use crate::domain::Training;
use crate::experiments::seeds::Seeds;

/// A kind of world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct World {
    /// Where its states come from.
    pub layout: Layout,
    /// How the other answers.
    pub response_model: ResponseModel,
}

/// Parameters of the experiment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Options {
    /// Which seeds.
    pub seeds: Seeds,
    /// Which layouts.
    pub layouts: Vec<Layout>,
    /// In which ways the other answers.
    pub response_models: Vec<ResponseModel>,
    /// The most passes of a network over the states.
    pub epochs: u32,
    /// The most steps of the training games that are counted, from the first; all of them if
    /// absent.
    pub steps: Option<usize>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            seeds: Seeds {
                number: 5,
                first: 1,
            },
            layouts: Layout::ALL.to_vec(),
            response_models: ResponseModel::ALL.to_vec(),
            epochs: Training::default().epochs as u32,
            steps: None,
        }
    }
}

impl Options {
    /// Returns the worlds that are drawn, for every seed: layout after layout.
    pub fn worlds(&self) -> Vec<World> {
        let of = |layout: Layout| {
            self.response_models
                .iter()
                .map(move |response_model| World {
                    layout,
                    response_model: *response_model,
                })
        };
        self.layouts.iter().copied().flat_map(of).collect()
    }
}
