//! The forward pass that is served beside the training library's own on the same weights and the
//! same states, encoding included.

use std::collections::HashMap;
use std::hint::black_box;
use std::time::Instant;

use candle_core::{D, Device, Module, Result, Tensor};
use candle_nn::Linear;
use candle_nn::ops::{log_softmax, softmax};
use nudge::domain::StateKey;
use nudge::model::Network;

use super::ROUNDS;
use super::play::{ACTIONS, BINS, Play, State};
use super::support::{self, median};

/// Rows that are predicted in one measurement, in as many calls as that takes.
const ROWS: usize = 1_024;
const PRECISION: f64 = 1e-5;

/// Mutual information of one row and of many.
pub async fn report(play: &Play, network: &Network) {
    let library = Library::of(play, network).await;
    let states: Vec<State> = play.learned.iter().cycle().take(ROWS).copied().collect();
    let keys: Vec<StateKey> = states.iter().map(|state| StateKey::new(state)).collect();
    agree(
        network,
        &keys,
        &library.predict(&states).expect("predicted"),
    );
    let alone = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .expect("a pool");
    for size in [1, ROWS] {
        let predict = |keys: &[StateKey]| {
            drop(black_box(
                network.predict_once(black_box(keys), network.threshold),
            ))
        };
        let own = rows_per_second(&keys, size, predict);
        let again = |keys: &[StateKey]| {
            drop(black_box(
                network.predict(black_box(keys), network.threshold),
            ))
        };
        let again = rows_per_second(&keys, size, again);
        let ask = |states: &[State]| {
            drop(black_box(
                library.predict(black_box(states)).expect("predicted"),
            ))
        };
        let beside = [
            (
                "candle, one thread",
                alone.install(|| rows_per_second(&states, size, ask)),
            ),
            (
                "candle, its own threads",
                rows_per_second(&states, size, ask),
            ),
        ];
        for (yardstick, beside) in beside {
            let what = format!("predicting {size} at once");
            support::report(&what, own, yardstick, beside, "rows/s", "");
        }
        let what = format!("telling {size} at once that were asked before");
        support::report(&what, again, "predicting them", own, "rows/s", "");
    }
}

fn agree(network: &Network, keys: &[StateKey], library: &[f32]) {
    for (own, other) in network.predict(keys, network.threshold).iter().zip(library) {
        let own = own.mutual_information.expect("a joint network's");
        assert!((own - f64::from(*other)).abs() < PRECISION, "{own} {other}");
    }
}

fn rows_per_second<T>(rows: &[T], at_once: usize, predict: impl Fn(&[T])) -> f64 {
    let time = |_| {
        let started = Instant::now();
        rows.chunks(at_once).for_each(&predict);
        rows.len() as f64 / started.elapsed().as_secs_f64()
    };
    median((0..ROUNDS).map(time).collect())
}

/// The same network in the training library.
pub struct Library {
    members: Vec<Member>,
}

struct Member {
    trunk: Linear,
    ego: Linear,
    other: Linear,
    interaction: Linear,
}

impl Library {
    pub async fn of(play: &Play, network: &Network) -> Self {
        let exported = play
            .service
            .app
            .networks
            .export(&play.environment, network.version)
            .await
            .expect("kept");
        Self::load(&exported).expect("its own format")
    }

    fn load(file: &[u8]) -> Result<Self> {
        let tensors = candle_core::safetensors::load_buffer(file, &Device::Cpu)?;
        let exists = |at: &usize| tensors.contains_key(&format!("members.{at}.trunk.weight"));
        let members = (0..)
            .take_while(exists)
            .map(|at| Member::load(&tensors, at));
        Ok(Self {
            members: members.collect::<Result<_>>()?,
        })
    }

    /// Returns mutual information of states in nats, the mean of the members.
    pub fn predict(&self, states: &[State]) -> Result<Vec<f32>> {
        let inputs = encoded(states)?;
        let each = self
            .members
            .iter()
            .map(|member| member.information(&inputs))
            .collect::<Result<Vec<Tensor>>>()?;
        Tensor::stack(&each, 0)?.mean(0)?.to_vec1()
    }
}

impl Member {
    fn load(tensors: &HashMap<String, Tensor>, at: usize) -> Result<Self> {
        let tensor = |name: String| {
            tensors
                .get(&name)
                .cloned()
                .ok_or_else(|| candle_core::Error::CannotFindTensor { path: name }.bt())
        };
        let layer = |name: &str| {
            let part = |part: &str| tensor(format!("members.{at}.{name}.{part}"));
            Ok::<_, candle_core::Error>(Linear::new(part("weight")?, Some(part("bias")?)))
        };
        Ok(Self {
            trunk: layer("trunk")?,
            ego: layer("ego")?,
            other: layer("other")?,
            interaction: layer("interaction")?,
        })
    }

    fn information(&self, inputs: &Tensor) -> Result<Tensor> {
        let hidden = self.trunk.forward(inputs)?.relu()?;
        let ego = softmax(&self.ego.forward(&hidden)?, D::Minus1)?;
        let interaction = self
            .interaction
            .forward(&hidden)?
            .reshape(((), ACTIONS, ACTIONS))?;
        let ln_response = log_softmax(
            &interaction.broadcast_add(&self.other.forward(&hidden)?.unsqueeze(1)?)?,
            D::Minus1,
        )?;
        let response = ln_response.exp()?;
        let marginal = response.broadcast_mul(&ego.unsqueeze(2)?)?.sum_keepdim(1)?;
        let divergence = (response * ln_response.broadcast_sub(&marginal.log()?)?)?.sum(2)?;
        (ego * divergence)?.sum(1)
    }
}

/// One a label: every feature of the world is categorical.
fn encoded(states: &[State]) -> Result<Tensor> {
    let width: u32 = BINS.iter().sum();
    let mut inputs = vec![0.0_f32; states.len() * width as usize];
    for (row, state) in inputs.chunks_exact_mut(width as usize).zip(states) {
        let mut from = 0;
        for (label, labels) in state.iter().zip(BINS) {
            row[(from + label) as usize] = 1.0;
            from += labels;
        }
    }
    Tensor::from_vec(inputs, (states.len(), width as usize), &Device::Cpu)
}
