//! `nudge query`: the question itself.

use std::collections::HashSet;

use clap::{Args, ValueEnum};

use super::asking::asked;
use super::output::{print, print_json, to_json};
use super::profile::{self, ProfileArguments};
use super::region::{self, Regions};
use super::server::Server;
use super::{Failure, answers, graph};
use crate::api::{json as dto, proto};
use crate::client::{Connection, schema_of};
use crate::domain::Schema;
use crate::domain::draft::{NamedValues, ValueDraft};
use crate::error::{Fault, Problem};

/// Ask whether one agent's action influences another's in some states
#[derive(Debug, Args)]
#[command(
    long_about = "Ask whether one agent's action influences another's in some states, how strongly, and from how many visits.\n\n\
    A state is given by the values of its features, or by its key. Several --state or --key ask about several states; where a feature is named \
    again, the next state begins. Plug-in mutual information stands beside what it would be on average if nothing depended on anything: at few \
    visits the two are close, and the figure is mostly bias. The posterior mean, its interval and the probabilities are what the counts support. A --region asks about all its states \
    as one: what a state has too few visits to tell, all of them together may.\n\n\
    Example:\n  nudge query hallway --state distance=1.2 lane=3 --ego robot --other human\n  \
    nudge query hallway --key 3.0 --key 3.1 --segments trial-3 --unit bits\n  \
    nudge query hallway --key 3.0 --lag 3\n  \
    nudge query kitchen --key 3.0 --ego cook --other pot\n  \
    nudge query kitchen --region distance=2 held=onion,dish --lag 4\n  \
    nudge query kitchen --profile --region distance=1..2 --svg profile.svg\n  \
    nudge query kitchen --profile --both --svg both.svg\n  \
    nudge query hallway --key 3.0 --rule-kind paper --rule-threshold 0.2 --json"
)]
pub(super) struct Query {
    /// Name of the environment
    environment: String,
    /// A state by the values of its features: numbers or labels; a number is a label's index only
    /// where no label reads as a number
    #[arg(long, num_args = 1.., value_name = "FEATURE=VALUE", value_parser = assignment)]
    state: Vec<(String, String)>,
    /// A state by its key, such as 3.0.7
    #[arg(long, num_args = 1.., conflicts_with = "state")]
    key: Vec<String>,
    #[command(flatten)]
    regions: Regions,
    /// Grain of the regions: features of their states, or derived ones, that are kept; all unless
    /// given
    #[arg(long, num_args = 1.., value_delimiter = ',', value_name = "FEATURE", requires = "region")]
    features: Vec<String>,
    /// Agent whose influence is asked about; the first one unless given
    #[arg(long, value_name = "AGENT")]
    ego: Option<String>,
    /// Agent that may be influenced, or outcome with values; the second agent unless given
    #[arg(long, value_name = "AGENT")]
    other: Option<String>,
    /// Steps after which the other's action is observed, as the environment declares them; 0, the
    /// same tick, unless given. An outcome with values has its own
    #[arg(
        long,
        value_name = "STEPS",
        allow_negative_numbers = true,
        default_value_t = 0,
        hide_default_value = true
    )]
    lag: i32,
    /// Agents whose actions are held fixed
    #[arg(long, num_args = 1.., value_name = "AGENT")]
    given: Vec<String>,
    /// Segments to count; all unless given
    #[arg(long, num_args = 1.., value_name = "SEGMENT")]
    segments: Vec<String>,
    /// What is compared within each segment alone; auto unless given
    #[arg(long, value_enum)]
    within: Option<Within>,
    /// Whose habits weigh the ego's actions: observed, or uniform for every action in use alike;
    /// observed unless given
    #[arg(long, value_name = "POLICY", conflicts_with = "policy_segments")]
    policy: Option<String>,
    /// Segments whose habits weigh the ego's actions; responses are by all visits
    #[arg(long, num_args = 1.., value_name = "SEGMENT")]
    policy_segments: Vec<String>,
    /// Further estimators of mutual information, such as nsb, dirichlet or uniform_policy
    #[arg(long, num_args = 1.., value_delimiter = ',', value_name = "NAME")]
    estimators: Vec<String>,
    /// Test independence by permuting all transitions of a state, or those of a segment only
    #[arg(long, value_enum)]
    significance: Option<Significance>,
    /// Say how many more visits a verdict would take
    #[arg(long)]
    visits_to_decide: bool,
    /// Unit of the figures, nats or bits; the rule's unless given
    #[arg(long)]
    unit: Option<String>,
    /// How much is told; full for one state and figures for several unless given
    #[arg(long, value_enum)]
    view: Option<View>,
    /// Draw the causal graph of one state: what every pair of agents is, beside all others
    #[arg(long, conflicts_with_all = ["ego", "other", "given", "region", "policy", "policy_segments", "estimators", "significance", "visits_to_decide", "view"])]
    graph: bool,
    #[command(flatten)]
    profile: ProfileArguments,
    #[command(flatten)]
    rule: Rule,
    /// Print JSON, as REST answers it
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: Server,
}

/// The parts of the rule that differ from the environment's.
#[derive(Debug, Clone, Default, Args)]
struct Rule {
    /// Rule that decides: evidence or paper
    #[arg(long, value_name = "KIND")]
    rule_kind: Option<String>,
    /// Mutual information above which there is influence
    #[arg(long, value_name = "NUMBER")]
    rule_threshold: Option<f64>,
    /// The same as a share of the most that the two agents can have, from 0 to below 1
    #[arg(long, value_name = "SHARE")]
    rule_share: Option<f64>,
    /// Unit of the threshold, nats or bits
    #[arg(long, value_name = "UNIT")]
    rule_unit: Option<String>,
    /// Visits below which the paper's rule stays undecided
    #[arg(long, value_name = "VISITS")]
    rule_min_visits: Option<u64>,
    /// Probability from which the evidence rule decides
    #[arg(long, value_name = "PROBABILITY")]
    rule_confidence: Option<f64>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum View {
    /// State, visits, verdict and basis
    Verdict,
    /// All but the figures of each ego action
    Figures,
    /// Everything
    Full,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
pub(super) enum Within {
    /// Tests of independence
    Auto,
    /// Tests of independence, the plug-in and its mean under independence
    Segments,
    /// Nothing: segments are added up first
    Pooled,
}

impl From<Within> for proto::Within {
    fn from(within: Within) -> Self {
        match within {
            Within::Auto => Self::Auto,
            Within::Segments => Self::Segments,
            Within::Pooled => Self::Pooled,
        }
    }
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Significance {
    /// Permute as --within says
    Auto,
    /// Permute all transitions of the state
    Pooled,
    /// Permute within each segment only
    WithinSegments,
}

impl From<Significance> for proto::Permutations {
    fn from(significance: Significance) -> Self {
        match significance {
            Significance::Auto => Self::Auto,
            Significance::Pooled => Self::Pooled,
            Significance::WithinSegments => Self::WithinSegments,
        }
    }
}

impl Query {
    pub(super) async fn run(self) -> Result<(), Failure> {
        if self.profile.profile {
            return self.run_profile().await;
        }
        let is_about_states = !self.state.is_empty() || !self.key.is_empty();
        if is_about_states != self.regions.is_empty() {
            return Err(Failure::usage(match is_about_states {
                true => "got states and regions, expected one of them",
                false => {
                    "no state: add --state FEATURE=VALUE ... or --key KEY (`nudge env show` lists the features), or --region for many states as one, or --profile for all of them by lag"
                }
            }));
        }

        let connection = self.server.connect().await?;
        let schema = schema_of(&connection.environment(&self.environment).await?)?;
        if self.graph {
            let request = self.graph_request(&schema)?;
            let ask = || {
                let (mut client, request) = (connection.influence(), request.clone());
                async move { client.get_graph(request).await }
            };
            let response = asked(ask).await?;
            return match self.json {
                true => print_json(&to_json(dto::Graph::from(response))),
                false => print(&graph::render(&self.environment, &response)),
            };
        }

        let request = self.request(&schema)?;
        let ask = || {
            let (mut client, request) = (connection.influence(), request.clone());
            async move { client.batch_get_influence(request).await }
        };
        let response = asked(ask).await?;

        if self.json {
            print_json(&to_json(dto::Answers::from(response)))
        } else if self.regions.is_empty() {
            print(&answers::render(&self.environment, &response))
        } else {
            print(&region::render(&self.environment, &response))
        }
    }

    async fn run_profile(self) -> Result<(), Failure> {
        let request = self.profile.request(self.scope(), self.regions.joined()?);
        let connection = self.server.connect().await?;
        let mut profiles = vec![asked_profile(&connection, &request).await?];
        if self.profile.both {
            let [ego, other] = profile::pair(&profiles[0]);
            let scope = proto::Scope {
                ego: other,
                other: ego,
                ..self.scope()
            };
            let back = self.profile.request(scope, self.regions.joined()?);
            profiles.push(asked_profile(&connection, &back).await?);
        }

        self.profile.draw(&self.environment, &profiles)?;
        if self.json {
            let first = profiles.swap_remove(0);
            return print_json(&to_json(dto::Profile::from(first)));
        }
        let told = profiles
            .iter()
            .map(|one| profile::render(&self.environment, one));
        print(&told.collect::<Vec<_>>().join("\n"))
    }

    /// Returns the question as the service takes it.
    fn request(&self, schema: &Schema) -> Result<proto::BatchGetInfluenceRequest, Problem> {
        let states = values(schema, grouped(&self.state))?;
        let asked = states.len() + self.key.len() + self.regions.len();
        Ok(proto::BatchGetInfluenceRequest {
            scope: Some(self.scope()),
            states,
            keys: self.key.clone(),
            regions: self.regions.messages()?,
            features: self.features.clone(),
            view: self.view(asked).into(),
            estimators: self.estimators.clone(),
            significance: self
                .significance
                .map_or(proto::Permutations::Unspecified, Into::into)
                .into(),
            visits_to_decide: self.visits_to_decide,
        })
    }

    /// Returns the question for the graph of one state as the service takes it.
    fn graph_request(&self, schema: &Schema) -> Result<proto::GetGraphRequest, Failure> {
        use proto::get_graph_request::State;

        let mut states: Vec<State> = values(schema, grouped(&self.state))?
            .into_iter()
            .map(State::Values)
            .collect();
        states.extend(self.key.iter().cloned().map(State::Key));
        if states.len() > 1 {
            return Err(Failure::usage(format!(
                "got {} states, expected one: a graph is of a single state",
                states.len()
            )));
        }

        Ok(proto::GetGraphRequest {
            environment: self.environment.clone(),
            state: states.pop(),
            segments: self.segments.clone(),
            rule: Some(self.rule.clone().into()),
            unit: self.unit.clone().unwrap_or_default(),
            within: self
                .within
                .map_or(proto::Within::Unspecified, Into::into)
                .into(),
            lag: self.lag,
        })
    }

    fn scope(&self) -> proto::Scope {
        proto::Scope {
            environment: self.environment.clone(),
            ego: self.ego.clone().unwrap_or_default(),
            other: self.other.clone().unwrap_or_default(),
            given: self.given.clone(),
            segments: self.segments.clone(),
            rule: Some(self.rule.clone().into()),
            unit: self.unit.clone().unwrap_or_default(),
            within: self
                .within
                .map_or(proto::Within::Unspecified, Into::into)
                .into(),
            lag: self.lag,
            policy: self.policy(),
        }
    }

    fn policy(&self) -> Option<proto::Policy> {
        use proto::policy::Habits;
        let segments = (!self.policy_segments.is_empty()).then(|| {
            Habits::Segments(proto::PolicySegments {
                segments: self.policy_segments.clone(),
            })
        });
        let habits = self.policy.clone().map(Habits::Named).or(segments)?;
        Some(proto::Policy {
            habits: Some(habits),
        })
    }

    fn view(&self, asked: usize) -> proto::View {
        match self.view {
            Some(View::Verdict) => proto::View::Verdict,
            Some(View::Figures) => proto::View::Figures,
            Some(View::Full) => proto::View::Full,
            None if asked == 1 => proto::View::Full,
            None => proto::View::Figures,
        }
    }
}

async fn asked_profile(
    connection: &Connection,
    request: &proto::GetProfileRequest,
) -> Result<proto::GetProfileResponse, Failure> {
    let ask = || {
        let (mut client, request) = (connection.influence(), request.clone());
        async move { client.get_profile(request).await }
    };
    asked(ask).await
}

impl From<Rule> for proto::Rule {
    fn from(rule: Rule) -> Self {
        Self {
            kind: rule.rule_kind,
            threshold: rule.rule_threshold,
            share: rule.rule_share,
            unit: rule.rule_unit,
            min_visits: rule.rule_min_visits,
            confidence: rule.rule_confidence,
            estimators: None,
            exploration: None,
        }
    }
}

fn assignment(text: &str) -> Result<(String, String), String> {
    let (feature, value) = text.split_once('=').ok_or("expected FEATURE=VALUE")?;
    Ok((feature.into(), value.into()))
}

/// Begins another state where a feature is named again: `--state x=1 y=2 --state x=3 y=4` is two,
/// `--state x=1 --state y=2` is one.
fn grouped(assignments: &[(String, String)]) -> Vec<NamedValues> {
    let mut states: Vec<NamedValues> = Vec::new();
    let mut named = HashSet::new();
    for (feature, value) in assignments {
        if states.is_empty() || !named.insert(feature.as_str()) {
            named = HashSet::from([feature.as_str()]);
            states.push(NamedValues::new());
        }
        if let Some(state) = states.last_mut() {
            state.push((feature.clone(), ValueDraft::Text(value.clone())));
        }
    }

    states
}

fn values(schema: &Schema, states: Vec<NamedValues>) -> Result<Vec<proto::StateValues>, Problem> {
    let mut faults: Vec<Fault> = Vec::new();
    let mut all = Vec::new();
    for (i, named) in states.iter().enumerate() {
        match schema.state_values(named) {
            Ok(values) => all.push(proto::StateValues { values }),
            Err(found) => faults.extend(
                found
                    .into_iter()
                    .map(|fault| fault.under(&format!("/states/{i}"))),
            ),
        }
    }

    if faults.is_empty() {
        Ok(all)
    } else {
        Err(Problem::invalid("question", faults))
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::recordings::overcooked::{Abstraction, Kitchen, World};

    #[derive(Parser)]
    struct Only {
        #[command(flatten)]
        query: Query,
    }

    fn request(arguments: &[&str]) -> Result<proto::BatchGetInfluenceRequest, Problem> {
        let world = World::new(
            Kitchen::named("cramped_room").expect("known"),
            Abstraction::Pos,
        );
        let schema = Schema::try_from(&world.description()).expect("valid");
        let arguments = ["nudge", "cramped_room.pos"].iter().chain(arguments);
        Only::try_parse_from(arguments)
            .expect("well formed")
            .query
            .request(&schema)
    }

    #[test]
    fn labels_and_indices_become_values_in_the_order_of_the_description() {
        let request =
            request(&["--state", "player_1.position=3", "player_0.position=2,1"]).expect("valid");
        assert_eq!(
            request.states,
            [proto::StateValues {
                values: vec![1.0, 3.0]
            }]
        );
        assert_eq!(request.view(), proto::View::Full);
    }

    #[test]
    fn a_state_begins_where_a_feature_is_named_again() {
        let (a, b) = ("player_0.position=0", "player_1.position=1");
        assert_eq!(
            request(&["--state", a, "--state", b])
                .expect("one")
                .states
                .len(),
            1
        );
        let two = request(&["--state", a, b, "--state", b, a]).expect("two");
        assert_eq!((two.states.len(), two.view()), (2, proto::View::Figures));
    }

    #[test]
    fn every_fault_is_told_with_its_state() {
        let faults = request(&["--state", "player_0.position=9,9", "size=2"])
            .expect_err("wrong")
            .faults;
        let pointers: Vec<&str> = faults.iter().map(|fault| fault.pointer.as_str()).collect();
        assert_eq!(
            pointers,
            [
                "/states/0/size",
                "/states/0/player_0.position",
                "/states/0/player_1.position"
            ]
        );
    }

    #[test]
    fn the_rule_and_the_pair_are_passed_on_as_given() {
        let pair = [
            "--key", "0.1", "--ego", "player_1", "--unit", "bits", "--within", "segments",
        ];
        let request = request(&[&pair[..], &["--rule-threshold", "0.2"]].concat());
        let scope = request.expect("valid").scope.expect("always there");
        assert_eq!(
            (
                scope.ego.as_str(),
                scope.other.as_str(),
                scope.unit.as_str()
            ),
            ("player_1", "", "bits")
        );
        assert_eq!(scope.within(), proto::Within::Segments);
        assert_eq!(
            scope.rule,
            Some(proto::Rule {
                threshold: Some(0.2),
                ..proto::Rule::default()
            })
        );
    }
}
