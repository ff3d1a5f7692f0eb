//! A world whose truth is known, 50,000 transitions of which are counted: 1,000 states to learn
//! from, 250 that nobody sees.
//!
//! Each agent's habits are a sum over the features of a state, so that an unseen state can be told
//! from others. Where the first feature says so, the other mostly does what the ego does.

use std::sync::Arc;
use std::time::{Duration, Instant};

use nudge::domain::draft::{AgentDraft, FeatureDraft, KindDraft, SchemaDraft, TrainingDraft};
use nudge::domain::{
    Acknowledged, Batch, Environment, Job, JobState, ProducerId, Record, Records, Sequence,
    StateKey, Widths,
};
use nudge::model::Network;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::support::Service;

pub const ACTIONS: usize = 6;
pub const BINS: [u32; 4] = [5, 5, 8, 10];
pub const ENVIRONMENT: &str = "play";
const LEARNED: usize = 1_000;
const HELD_OUT: usize = 250;
const TRANSITIONS: usize = 50_000;
const SEED: u64 = 1;
/// Labels of the first feature below this are those where the other answers the ego.
const ANSWERED: u32 = 2;
/// How often it then does what the ego does, whatever its habits.
const COPIED: f64 = 0.7;

/// Probabilities of the pairs of actions in a state: `[ego][other]`.
pub type Joint = [[f64; ACTIONS]; ACTIONS];

/// The bins of a state.
pub type State = [u32; BINS.len()];

/// The world, counted by a service of its own.
pub struct Play {
    pub service: Service,
    pub environment: Arc<Environment>,
    pub learned: Vec<State>,
    /// What was counted: a state and the actions of both.
    pub transitions: Vec<(State, [usize; 2])>,
    /// States that were never seen, with the truth about them.
    pub held_out: Vec<(State, Joint)>,
}

/// A network and how long it took from asking to having it: reading the counts, fitting the prior,
/// its members, their shuffled twins, and judging.
pub struct Trained {
    pub network: Arc<Network>,
    pub took: Duration,
}

/// How far from the truth somebody is on states that were not seen, in nats.
pub struct Quality {
    /// What a transition costs: -sum p ln q of the actions of both, the mean.
    pub joint: f64,
    /// What the ego's part of it costs.
    pub ego: f64,
    /// Root mean square error of mutual information.
    pub information: f64,
}

impl Play {
    pub async fn start() -> Self {
        let mut random = Pcg64::seed_from_u64(SEED);
        let habits = Habits::drawn(&mut random);
        let mut states = all_states();
        states.shuffle(&mut random);
        let learned = states[..LEARNED].to_vec();
        let held_out = states[LEARNED..][..HELD_OUT]
            .iter()
            .map(|state| (*state, habits.joint(state)))
            .collect();
        let transition = |_| {
            let state = learned[random.random_range(0..LEARNED)];
            (state, drawn(&habits.joint(&state), random.random()))
        };
        let transitions: Vec<_> = (0..TRANSITIONS).map(transition).collect();
        let service = Service::start().await;
        let (environment, _) = service
            .app
            .environments
            .apply(ENVIRONMENT, schema().into())
            .await
            .expect("valid");
        let play = Self {
            service,
            environment,
            learned,
            transitions,
            held_out,
        };
        play.count().await;
        play
    }

    async fn count(&self) {
        const BATCH: usize = 10_000;
        let producer: ProducerId = "bench".parse().expect("a producer id");
        let record = |(state, actions): &(State, [usize; 2])| {
            let state = state.iter().map(|bin| *bin as f32).collect();
            let actions = actions.iter().map(|action| *action as f32).collect();
            Ok(Record::new(state, actions))
        };
        for (number, transitions) in (1..).zip(self.transitions.chunks(BATCH)) {
            let records = Records::collect(
                Widths::of_schema(&self.environment.schema),
                transitions.iter().map(record),
            );
            let batch = Batch {
                sequence: Sequence::new(number).expect("a number"),
                segment: None,
                records,
            };
            let told = self
                .service
                .app
                .ingest
                .write(&self.environment, producer.clone(), batch)
                .await;
            assert!(
                matches!(&told, Ok(Acknowledged::Applied(receipt)) if receipt.rejected_count == 0),
                "{told:?}"
            );
        }
    }

    /// Trains a network as usual, or with at most so many epochs, and makes it the one that
    /// answers.
    pub async fn train(&self, epochs: Option<u64>) -> Trained {
        let started = Instant::now();
        let job = self.ask(epochs).await;
        let job = self
            .service
            .app
            .networks
            .finished(&self.environment, job.id)
            .await
            .expect("known");
        let took = started.elapsed();
        assert_eq!(job.state, JobState::Done, "{}", job.message);
        let version = job.version.expect("a version came out");
        let network = self
            .service
            .app
            .networks
            .network(&self.environment, version)
            .await
            .expect("kept");
        Trained { network, took }
    }

    /// Asks for a training.
    pub async fn ask(&self, epochs: Option<u64>) -> Job {
        let draft = TrainingDraft {
            epochs,
            activate: true,
            ..TrainingDraft::default()
        };
        self.service
            .app
            .networks
            .train(&self.environment, &draft)
            .await
            .expect("a valid training")
    }

    /// Returns what a network says of the unseen states.
    pub fn predictions(&self, network: &Network) -> Vec<Joint> {
        let told = |(state, _): &(State, Joint)| {
            let actions = network.by_action(&self.environment, &StateKey::new(state));
            std::array::from_fn(|i| {
                std::array::from_fn(|j| actions[i].probability * actions[i].response[j])
            })
        };
        self.held_out.iter().map(told).collect()
    }

    /// Returns how far from the truth what somebody says of the unseen states is.
    pub fn quality(&self, told: &[Joint]) -> Quality {
        let mean = |figure: &dyn Fn(&Joint, &Joint) -> f64| {
            let each = self
                .held_out
                .iter()
                .zip(told)
                .map(|((_, truth), told)| figure(truth, told));
            each.sum::<f64>() / HELD_OUT as f64
        };
        Quality {
            joint: mean(&|truth, told| cross_entropy(truth.as_flattened(), told.as_flattened())),
            ego: mean(&|truth, told| cross_entropy(&policy(truth), &policy(told))),
            information: mean(&|truth, told| (information(truth) - information(told)).powi(2))
                .sqrt(),
        }
    }

    pub async fn stop(self) {
        self.service.stop().await;
    }
}

/// ln weights that each label of each feature gives to the actions of both.
struct Habits(Vec<Vec<[[f64; ACTIONS]; 2]>>);

impl Habits {
    fn drawn(random: &mut Pcg64) -> Self {
        let mut weights =
            || [(); 2].map(|()| [(); ACTIONS].map(|()| random.random_range(-1.0..1.0)));
        Self(
            BINS.iter()
                .map(|labels| (0..*labels).map(|_| weights()).collect())
                .collect(),
        )
    }

    fn policy(&self, state: &State, agent: usize) -> [f64; ACTIONS] {
        let weights = |action: usize| {
            let each = self
                .0
                .iter()
                .zip(state)
                .map(|(feature, label)| feature[*label as usize][agent][action]);
            each.sum::<f64>().exp()
        };
        let weights: [f64; ACTIONS] = std::array::from_fn(weights);
        weights.map(|weight| weight / weights.iter().sum::<f64>())
    }

    fn joint(&self, state: &State) -> Joint {
        let [ego, other] = [0, 1].map(|agent| self.policy(state, agent));
        let copied = if state[0] < ANSWERED { COPIED } else { 0.0 };
        let response =
            |i: usize, j: usize| (1.0 - copied) * other[j] + if i == j { copied } else { 0.0 };
        std::array::from_fn(|i| std::array::from_fn(|j| ego[i] * response(i, j)))
    }
}

fn policy(joint: &Joint) -> [f64; ACTIONS] {
    joint.map(|row| row.iter().sum())
}

/// Returns -sum p ln q.
fn cross_entropy(p: &[f64], q: &[f64]) -> f64 {
    p.iter().zip(q).map(|(p, q)| -p * q.ln()).sum()
}

/// Returns sum p_ij ln [p_ij / (p_i p_j)].
fn information(joint: &Joint) -> f64 {
    let other: [f64; ACTIONS] = std::array::from_fn(|j| joint.iter().map(|row| row[j]).sum());
    let cell = |(row, of_ego): (&[f64; ACTIONS], f64)| {
        row.iter()
            .zip(&other)
            .map(|(p, of_other)| p * (p / (of_ego * of_other)).ln())
            .sum::<f64>()
    };
    joint.iter().zip(policy(joint)).map(cell).sum()
}

fn all_states() -> Vec<State> {
    let [a, b, c, d] = BINS;
    (0..a * b * c * d)
        .map(|n| [n % a, n / a % b, n / a / b % c, n / a / b / c])
        .collect()
}

/// Returns the pair of actions at a place in the unit interval.
fn drawn(joint: &Joint, mut place: f64) -> [usize; 2] {
    for (i, row) in joint.iter().enumerate() {
        for (j, p) in row.iter().enumerate() {
            place -= p;
            if place < 0.0 {
                return [i, j];
            }
        }
    }
    [ACTIONS - 1; 2]
}

fn schema() -> SchemaDraft {
    let labels = |n: u32| KindDraft::Categorical((0..n).map(|label| format!("l{label}")).collect());
    let feature = |name: String, n| FeatureDraft {
        name,
        unit: None,
        kinds: vec![labels(n)],
    };
    let agent = |name: &str| AgentDraft {
        name: name.into(),
        action: vec![feature("move".into(), ACTIONS as u32)],
        ..AgentDraft::default()
    };
    SchemaDraft {
        state: (0..)
            .zip(BINS)
            .map(|(at, n): (u32, u32)| feature(format!("f{at}"), n))
            .collect(),
        agents: vec![agent("ego"), agent("other")],
        ..SchemaDraft::default()
    }
}
