//! One seed of a world: counted by a service, learned from, and asked about; and once more with
//! shuffled actions, everything from scratch.

use super::Method;
use super::method::Said;
use super::scene::{Actions, Scene};
use crate::domain::draft::{QuestionDraft, TrainingDraft};
use crate::domain::{ModelKind, View};
use crate::error::{ErrorKind, Problem};
use crate::experiments::service::Service;
use crate::model::BackOff;

/// The ground truth of an unseen state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Truth {
    /// Its time steps in the test games.
    pub steps: usize,
    /// Whether its mutual information is above the threshold.
    pub is_strong: bool,
}

/// The ground truth of the unseen states, and what each method says of them.
pub struct Trial {
    /// A truth a state.
    pub truths: Vec<Truth>,
    /// In the same order.
    pub said: Vec<(Method, Vec<Said>)>,
}

/// Runs a seed of a world.
pub async fn trial(scene: &Scene, seed: u64, epochs: u32) -> Result<Trial, Problem> {
    let drawn = scene.draw(seed);
    let truth = |(state, steps): &(usize, usize)| Truth {
        steps: *steps,
        is_strong: scene.states[*state].is_strong(),
    };
    let mut said = learned(scene, &drawn, seed, epochs).await?;
    said.extend([
        (
            Method::AllPositive,
            vec![Said::certainly(true); scene.unseen.len()],
        ),
        (
            Method::Shuffled,
            shuffled(scene, &drawn, seed, epochs).await?,
        ),
        (
            Method::Oracle,
            scene
                .unseen
                .iter()
                .map(|(at, _)| Said::certainly(scene.states[*at].is_answered))
                .collect(),
        ),
    ]);

    Ok(Trial {
        truths: scene.unseen.iter().map(truth).collect(),
        said,
    })
}

/// Counts the steps, and asks before there is a network, then each of the networks, then the
/// coarser tables.
async fn learned(
    scene: &Scene,
    drawn: &[Actions],
    seed: u64,
    epochs: u32,
) -> Result<Vec<(Method, Vec<Said>)>, Problem> {
    let service = counted(scene, drawn).await?;
    let look_up = asked(&service, scene).await?;
    let joint = train_and_ask(&service, scene, ModelKind::Joint, seed, epochs).await?;
    let direct = train_and_ask(&service, scene, ModelKind::Direct, seed, epochs).await?;
    let back_off = backed_off(&service, scene).await?;
    service.close().await?;

    Ok(vec![
        (Method::Joint, joint),
        (Method::Direct, direct),
        (Method::LookUp, look_up),
        (Method::BackOff, back_off),
    ])
}

async fn shuffled(
    scene: &Scene,
    drawn: &[Actions],
    seed: u64,
    epochs: u32,
) -> Result<Vec<Said>, Problem> {
    let service = counted(scene, &scene.shuffled(drawn, seed)).await?;
    let said = train_and_ask(&service, scene, ModelKind::Joint, seed, epochs).await?;
    service.close().await?;
    Ok(said)
}

async fn counted(scene: &Scene, actions: &[Actions]) -> Result<Service, Problem> {
    let mut service = Service::open(&scene.schema).await?;
    service.count(None, &scene.records(actions)).await?;
    service.fit().await?;
    Ok(service)
}

/// Trains a network, makes it active whatever it says of itself, and asks it.
async fn train_and_ask(
    service: &Service,
    scene: &Scene,
    kind: ModelKind,
    seed: u64,
    epochs: u32,
) -> Result<Vec<Said>, Problem> {
    let draft = TrainingDraft {
        kind: Some(kind.as_str().into()),
        epochs: Some(epochs.into()),
        seed: Some(seed),
        activate: true,
        ..TrainingDraft::default()
    };
    service.train(&draft).await?;
    asked(service, scene).await
}

async fn asked(service: &Service, scene: &Scene) -> Result<Vec<Said>, Problem> {
    let question = QuestionDraft {
        view: Some(View::Figures.as_str().into()),
        ..QuestionDraft::default()
    };
    let answers = service.ask(&scene.asked(), &question).await?;
    let said: Option<Vec<Said>> = answers.iter().map(Said::of_answer).collect();

    said.ok_or_else(|| {
        Problem::new(
            ErrorKind::Internal,
            "INTERNAL",
            "an answer has no probability",
        )
    })
}

async fn backed_off(service: &Service, scene: &Scene) -> Result<Vec<Said>, Problem> {
    let dataset = service.dataset().await?;
    let every: Vec<usize> = (0..dataset.examples.len()).collect();
    let back_off = BackOff::new(&dataset, &every);
    let said = |state: &Vec<f32>| {
        let table = back_off
            .table(&service.key(state)?)
            .cloned()
            .unwrap_or_default();
        Ok(Said::by(dataset.above(&table)))
    };

    scene.asked().iter().map(said).collect()
}
