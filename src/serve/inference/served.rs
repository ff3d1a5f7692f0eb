//! What the protocol asks of this service, without its wire: which network a model's name and
//! version mean, what it takes, and what it predicts.

use std::sync::Arc;
use std::time::Instant;

use crate::api::inference::{Answer, Figure, Metadata, Output, Request};
use crate::app::App;
use crate::domain::{Environment, Model, Pair};
use crate::error::{ErrorKind, Fault, Problem};
use crate::model::{Network, Prediction};
use crate::telemetry;
use crate::work::{Gate, Stop};

/// Requests of fewer values are sooner answered than handed to another thread; some hundreds of
/// rows, and at a lag as many fewer as there are strata.
const MOST_INLINE_VALUES: usize = 2_048;

/// Versions that are told where one is of another model: the last ones.
const TOLD: usize = 8;

/// States that are predicted for from one look to the next whether somebody still waits.
const TOGETHER: usize = 4_096;

/// A model as a caller names it. An empty version means the one that is active.
#[derive(Debug, Clone, Copy)]
pub struct ModelName<'a> {
    /// `{environment}~{ego}~{other}`, `{environment}~{ego}~{other}@{lag}` for the other's action so
    /// many steps later, or `{environment}` for its first two agents.
    pub model: &'a str,
    /// A number, or nothing.
    pub version: &'a str,
}

/// A network that was found by its model's name.
pub struct Served {
    model: Arc<str>,
    environment: Arc<Environment>,
    network: Arc<Network>,
}

/// Predicts for the states of a request.
pub async fn infer(app: &App, name: ModelName<'_>, request: Request) -> Result<Answer, Problem> {
    let started = Instant::now();
    let answer = async {
        Served::find(app, name)
            .await?
            .infer(&app.work.questions, request)
            .await
    }
    .await;

    let states = answer.as_ref().map_or(0, |answer| {
        answer
            .outputs
            .first()
            .map_or(0, |output| output.values.len())
    });

    let code = answer
        .as_ref()
        .map_or_else(|problem| problem.reason, |_| "OK");
    telemetry::inferred(started.elapsed(), code, states as u64);
    answer
}

/// Tells whether a name and a version mean a network that can answer.
pub async fn is_known(app: &App, name: ModelName<'_>) -> Result<bool, Problem> {
    match Served::find(app, name).await {
        Ok(_) => Ok(true),
        Err(problem) if problem.kind == ErrorKind::NotFound => Ok(false),
        Err(problem) => Err(problem),
    }
}

impl Served {
    /// Finds the network that a name and a version mean.
    pub async fn find(app: &App, name: ModelName<'_>) -> Result<Self, Problem> {
        let ModelName { model, version } = name;
        let (environment, pair) = pair(app, model)?;
        let network = match number(version)? {
            Some(version) => app.networks.network(&environment, version).await?,
            None => app
                .networks
                .served(&environment, &pair)
                .await?
                .ok_or_else(|| none_active(model))?,
        };

        let found = Self {
            model: model.into(),
            environment,
            network,
        };

        if found.network.pair != pair {
            let known = found.versions(app, &pair).await?;
            let known: Vec<String> = known
                .iter()
                .rev()
                .take(TOLD)
                .rev()
                .map(u64::to_string)
                .collect();
            let known = if known.is_empty() {
                "there is none".to_owned()
            } else {
                format!("known: {}", known.join(", "))
            };
            return Err(not_found(format!(
                "version {version} is not one of model `{model}`; {known}"
            )));
        }

        Ok(found)
    }

    /// Returns what it takes and answers, and which other versions there are.
    pub async fn metadata(&self, app: &App) -> Result<Metadata, Problem> {
        Ok(Metadata {
            model: self.model.clone(),
            versions: self.versions(app, &self.network.pair).await?,
            features: self.environment.schema.state().len(),
            figures: Figure::of_kind(self.network.kind),
        })
    }

    /// Returns every version of a pair that can answer.
    async fn versions(&self, app: &App, pair: &Pair) -> Result<Vec<u64>, Problem> {
        let schema = &self.environment.schema;
        let models = app.networks.list(&self.environment).await?.models;
        let is_served =
            |model: &&Model| model.card.is_ok() && model.pair(schema).as_ref() == Some(pair);

        Ok(models
            .iter()
            .filter(is_served)
            .map(|model| model.version)
            .collect())
    }

    /// Predicts for the states of a request.
    async fn infer(self, gate: &Gate, request: Request) -> Result<Answer, Problem> {
        let (id, figures) = (request.id.clone(), request.figures(self.network.kind)?);
        let predictions = self.predictions(gate, request).await?;
        let output = |figure| output(figure, self.network.threshold, &predictions);
        Ok(Answer {
            outputs: figures.into_iter().map(output).collect::<Result<_, _>>()?,
            model: self.model,
            version: self.network.version,
            id,
        })
    }

    /// Few states are read and predicted here, many when it is their turn.
    async fn predictions(&self, gate: &Gate, request: Request) -> Result<Vec<Prediction>, Problem> {
        let (schema, network) = (self.environment.schema.clone(), self.network.clone());
        if request.values().saturating_mul(network.strata()) <= MOST_INLINE_VALUES {
            return Ok(network.predict(&request.states(&schema)?, network.threshold));
        }

        let predict = move |stop: &Stop| {
            let states = match request.states(&schema) {
                Ok(states) => states,
                Err(problem) => return Ok(Err(problem)),
            };
            let mut predictions = Vec::with_capacity(states.len());
            for states in states.chunks(TOGETHER) {
                stop.check()?;
                predictions.extend(network.predict(states, network.threshold));
            }
            Ok(Ok(predictions))
        };

        gate.run(predict).await?
    }
}

/// Returns one figure of every state.
fn output(figure: Figure, threshold: f64, predictions: &[Prediction]) -> Result<Output, Problem> {
    let value = |prediction: &Prediction| match figure {
        Figure::InfluenceProbability => prediction.probability,
        Figure::MutualInformation => prediction.mutual_information,
    };
    let values: Option<Vec<f32>> = predictions
        .iter()
        .map(|one| value(one).map(|value| value as f32))
        .collect();
    let (threshold, unit) = match figure {
        Figure::InfluenceProbability => (Some(threshold), None),
        Figure::MutualInformation => (None, Some("nats")),
    };

    // A network tells every figure of its kind at its own threshold.
    let values =
        values.ok_or_else(|| internal(format!("the network does not tell {}", figure.as_str())))?;

    Ok(Output {
        figure,
        threshold,
        unit,
        values,
    })
}

/// Returns the environment and the agents that a model's name means.
fn pair(app: &App, model: &str) -> Result<(Arc<Environment>, Pair), Problem> {
    let unknown = |why: &str| not_found(format!("unknown model `{model}`: {why}"));
    let (environment, agents) = parts(model).ok_or_else(|| {
        unknown("expected {environment}~{ego}~{other}, with @ and the lag behind the other where it is observed later, or {environment} for its first two agents")
    })?;
    let environment = app.environments.find(environment)?;
    let [ego, other] = agents.map_or([None, None], |agents| agents.map(Some));
    let (other, lag) = match other.map(|other| at_lag(other).ok_or(other)) {
        None => (None, 0),
        Some(Ok((other, lag))) => (Some(other), lag),
        Some(Err(wrong)) => {
            return Err(unknown(&format!(
                "got {wrong:?}, expected a whole number above 0 behind the @"
            )));
        }
    };
    let [ego, other] = [ego, other].map(|name| name.map(str::to_owned));
    let pair = Pair::of_network(&environment.schema, ego, other, lag).map_err(|faults| {
        unknown(
            &faults
                .into_iter()
                .map(|fault| fault.detail)
                .collect::<Vec<_>>()
                .join("; "),
        )
    })?;

    Ok((environment, pair))
}

/// Takes a model's name apart. No name of an environment or an agent holds a `~`.
fn parts(model: &str) -> Option<(&str, Option<[&str; 2]>)> {
    let parts: Vec<&str> = model.split('~').collect();
    match parts[..] {
        [environment] => Some((environment, None)),
        [environment, ego, other] => Some((environment, Some([ego, other]))),
        _ => None,
    }
}

/// Takes the name of the other apart: the agent's, and the lag behind an `@`, which no name of an
/// agent holds; 0 without one. `None` where no lag is written so.
fn at_lag(other: &str) -> Option<(&str, i64)> {
    let Some((agent, text)) = other.split_once('@') else {
        return Some((other, 0));
    };
    let lag = text.parse().ok();
    lag.filter(|lag: &i64| *lag > 0 && lag.to_string() == text)
        .map(|lag| (agent, lag))
}

/// Returns the number that a version is written as.
fn number(version: &str) -> Result<Option<u64>, Problem> {
    if version.is_empty() {
        return Ok(None);
    }

    let number = version
        .parse()
        .ok()
        .filter(|number: &u64| number.to_string() == version);
    let fault = || {
        Fault::new(
            "/version",
            format!("got {version:?}, expected a number, or nothing for the active one"),
        )
    };

    number
        .map(Some)
        .ok_or_else(|| Problem::invalid("model version", vec![fault()]))
}

fn none_active(model: &str) -> Problem {
    not_found(format!(
        "no version of model `{model}` is active: train one, or make one active, or ask for one by its number"
    ))
}

fn not_found(message: String) -> Problem {
    Problem::new(ErrorKind::NotFound, "MODEL_NOT_FOUND", message)
}

fn internal(cause: String) -> Problem {
    Problem::new(ErrorKind::Internal, "INTERNAL", cause)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_an_environment_or_an_environment_and_two_agents() {
        assert_eq!(parts("hallway"), Some(("hallway", None)));
        assert_eq!(
            parts("a.b-c~robot~human"),
            Some(("a.b-c", Some(["robot", "human"])))
        );
        for wrong in ["a~b", "a~b~c~d", "~", "~~~"] {
            assert_eq!(parts(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn a_lag_stands_behind_the_other() {
        assert_eq!(at_lag("human"), Some(("human", 0)));
        assert_eq!(at_lag("human@12"), Some(("human", 12)));
        for wrong in [
            "human@", "human@0", "human@03", "human@-3", "human@+3", "a@b@3",
        ] {
            assert_eq!(at_lag(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn a_version_is_a_number_or_absent() {
        assert_eq!(number(""), Ok(None));
        assert_eq!(number("12"), Ok(Some(12)));
        for wrong in ["012", "+1", "-1", "1.0", "latest", "18446744073709551616"] {
            assert_eq!(number(wrong).expect_err(wrong).reason, "INVALID_INPUT");
        }
    }

    #[test]
    fn figures_say_their_unit_or_their_threshold() {
        let prediction = Prediction {
            probability: Some(0.25),
            mutual_information: Some(0.5),
            agrees: true,
            in_range: true,
        };
        let probability = output(Figure::InfluenceProbability, 0.1, &[prediction]).expect("told");
        assert_eq!(
            (probability.values, probability.threshold, probability.unit),
            (vec![0.25], Some(0.1), None)
        );
        let information = output(Figure::MutualInformation, 0.1, &[prediction]).expect("told");
        assert_eq!(
            (information.values, information.threshold, information.unit),
            (vec![0.5], None, Some("nats"))
        );
        let direct = Prediction {
            mutual_information: None,
            ..prediction
        };
        assert!(output(Figure::MutualInformation, 0.1, &[direct]).is_err());
    }
}
