//! Results as plain data, JSON and CSV.

use serde_json::{Value, json};

use super::scene::Scene;
use super::targets::{self, Findings, Target};
use super::{Figure, Layout, Method, Options, ResponseModel, World};
use crate::experiments::findings::{self, Cells, Row};

/// How large a world is, and how much of it has influence: the same for every seed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Facts {
    /// Steps of the training games: what is counted.
    pub counted: usize,
    /// States that only the test games have.
    pub unseen: usize,
    /// Steps of the test games in them.
    pub steps: usize,
    /// How many of these steps are in states with mutual information above the threshold.
    pub strong: usize,
}

impl Facts {
    pub(super) fn of_scene(scene: &Scene) -> Self {
        let steps = |only_strong: bool| {
            let wanted = scene
                .unseen
                .iter()
                .filter(|(state, _)| !only_strong || scene.states[*state].is_strong());
            wanted.map(|(_, steps)| steps).sum()
        };
        Self {
            counted: scene.train.len(),
            unseen: scene.unseen.len(),
            steps: steps(false),
            strong: steps(true),
        }
    }

    /// Returns the share of time steps in states with influence.
    pub fn strong_share(&self) -> f64 {
        self.strong as f64 / self.steps.max(1) as f64
    }
}

/// The outcome of the experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// What was run.
    pub options: Options,
    /// The worlds.
    pub worlds: Vec<(World, Facts)>,
    /// What was found.
    pub findings: Findings,
}

impl Report {
    /// Returns every target beside what was measured.
    pub fn targets(&self) -> Vec<Target> {
        targets::targets(self.worlds.iter().map(|(world, _)| *world), &self.findings)
    }

    /// Returns everything as JSON.
    pub fn json(&self) -> Value {
        let Options {
            seeds,
            layouts,
            response_models,
            epochs,
            steps,
        } = &self.options;

        let layouts: Vec<&str> = layouts.iter().copied().map(Layout::as_str).collect();
        let response_models: Vec<&str> = response_models
            .iter()
            .copied()
            .map(ResponseModel::as_str)
            .collect();

        json!({
            "experiment": "planted-kitchens",
            "revision": findings::REVISION,
            "parameters": {
                "seeds": seeds.number, "first_seed": seeds.first,
                "layouts": layouts, "manners": response_models, "epochs": epochs, "steps": steps,
            },
            "worlds": findings::objects(&self.worlds),
            "targets": findings::objects(&self.targets()),
            "findings": findings::objects(&self.findings.0),
        })
    }
}

impl Cells for World {
    fn cells(&self) -> Row {
        let Self {
            layout,
            response_model,
        } = self;
        vec![
            ("layout", layout.as_str().into()),
            ("abstraction", layout.abstraction().as_str().into()),
            ("manner", response_model.as_str().into()),
        ]
    }
}

impl Cells for (World, Facts) {
    fn cells(&self) -> Row {
        let (
            world,
            Facts {
                counted,
                unseen,
                steps,
                strong,
            },
        ) = self;
        let facts = [
            ("counted", counted),
            ("unseen_states", unseen),
            ("test_steps", steps),
            ("steps_with_influence", strong),
        ];
        [
            world.cells(),
            facts
                .map(|(name, number)| (name, (*number).into()))
                .to_vec(),
        ]
        .concat()
    }
}

findings::named!(Method as "decision", Figure as "figure");
