//! `nudge env`: environments of a service.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use super::asking::asked;
use super::output::{Table, cannot_read, print, print_json, to_json};
use super::server::Server;
use super::{Failure, output};
use crate::api::{json as dto, proto};
use crate::client::{Connection, derived_of, schema_of};
use crate::domain::draft::DescriptionDraft;
use crate::domain::{
    Angle, Coordinates, DerivedFeatures, Feature, FeatureKind, Label, Name, Outcome, Pair, Schema,
    SchemaDraft, Unit, WrittenRule,
};
use crate::error::{ErrorKind, Fault, Problem};
use crate::information::Alphabet;

/// Create, list, show and delete environments
#[derive(Debug, Subcommand)]
#[command(long_about = "Create, list, show and delete environments.\n\n\
    An environment is a world with a fixed description of its state, its agents and what is observed later, and a decision rule that may change.\n\n\
    Example:\n  nudge env apply hallway.json\n  nudge env show hallway")]
pub(super) enum Env {
    /// Create an environment from a description, or confirm that it exists
    #[command(
        long_about = "Create an environment from a description in JSON, or confirm that it exists with this very one.\n\n\
        A rule in the file is set, and so are derived features; without them they stay as they are. State, agents and outcomes cannot be changed: \
        delete the environment, or take another name.\n\n\
        What `nudge env show --json` prints is a description too: it is known by its own name, unless --name makes a copy of it.\n\n\
        Example:\n  nudge env apply worlds/hallway.json --name hallway\n  \
        nudge env show hallway --json | nudge env apply - --server http://127.0.0.1:9090\n\n\
        A small description:\n  \
        {\"state\": [{\"name\": \"distance\", \"unit\": \"m\", \"continuous\": {\"edges\": [0.5, 1, 2]}}],\n   \
        \"agents\": [\n     \
        {\"name\": \"robot\", \"action\": [{\"name\": \"go\", \"integer\": {\"min\": 0, \"max\": 1}}]},\n     \
        {\"name\": \"human\", \"action\": [{\"name\": \"go\", \"integer\": {\"min\": 0, \"max\": 1}}]}]}\n\n\
        With \"lags\": [1, 2, 3] each agent's action 1 to 3 steps later is observed too; \"may_be_absent\": true lets an agent not act. \
        \"derived\": [{\"name\": \"dx\", \"difference\": [\"b.x\", \"a.x\"]}] is what follows from the state (manhattan, equal)."
    )]
    Apply(Apply),
    /// List environments
    #[command(
        long_about = "List environments in order of name.\n\nExample:\n  nudge env list --json"
    )]
    List(List),
    /// Show one environment
    #[command(
        long_about = "Show the state, what is derived from it, the agents, what is observed later and the rule of one environment.\n\nExample:\n  nudge env show counter_circuit"
    )]
    Show(Show),
    /// Delete an environment with everything that was counted in it
    #[command(
        long_about = "Delete an environment with everything that was counted in it, for ever. Streams into it end, and its name is free \
        at once; its rows go in the background.\n\n\
        Example:\n  nudge env delete counter_circuit.pos --yes"
    )]
    Delete(Delete),
}

#[derive(Debug, Args)]
pub(super) struct Apply {
    /// File with the description, in JSON; - for standard input
    file: PathBuf,
    /// Name of the environment; else the name that the description gives itself, else the file's
    /// name without its extension
    #[arg(long)]
    name: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: Server,
}

#[derive(Debug, Args)]
pub(super) struct List {
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: Server,
}

#[derive(Debug, Args)]
pub(super) struct Show {
    /// Name of the environment
    name: String,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: Server,
}

#[derive(Debug, Args)]
pub(super) struct Delete {
    /// Name of the environment
    name: String,
    /// Do it
    #[arg(long)]
    yes: bool,
    #[command(flatten)]
    server: Server,
}

impl Env {
    pub(super) async fn run(self) -> Result<(), Failure> {
        match self {
            Self::Apply(command) => command.run().await,
            Self::List(command) => command.run().await,
            Self::Show(command) => command.run().await,
            Self::Delete(command) => command.run().await,
        }
    }
}

impl Apply {
    async fn run(self) -> Result<(), Failure> {
        let description: dto::Description =
            dto::decode("environment", text_of(&self.file)?.as_bytes())?;
        let name = self
            .name
            .or_else(|| description.name.clone())
            .or_else(|| stem(&self.file))
            .ok_or_else(unnamed)?;

        let draft = DescriptionDraft::from(description);
        // The wire has room for one kind a feature and for fewer numbers than JSON, and none for a
        // hash: what does not fit must be told, not trimmed.
        let schema = checked(&draft).map_err(|faults| Problem::invalid("environment", faults))?;
        let connection = self.server.connect().await?;
        let draft = DescriptionDraft { schema, ..draft };
        let request = proto::ApplyEnvironmentRequest::of_description(name, draft);
        let response = connection
            .environments()
            .apply_environment(request)
            .await?
            .into_inner();
        let environment = response.environment.unwrap_or_default();
        if self.json {
            return print_json(&to_json(dto::Environment::from(environment)));
        }

        let done = if response.created {
            "created"
        } else {
            "exists with this description"
        };

        let schema = schema_of(&environment)?;
        let told = [thresholds(&environment, &schema), notes(&schema)].concat();

        print(&format!(
            "environment `{}` {done}\n{}",
            environment.name,
            told.join("\n")
        ))
    }
}

/// Returns the description as the wire takes it. What only the service can tell, whether it was
/// made before units of angles were read, is left to it.
fn checked(draft: &DescriptionDraft) -> Result<SchemaDraft, Vec<Fault>> {
    let said = draft.schema_hash.is_some();
    let schema = match said {
        true => Schema::described(draft, None)?,
        false => Schema::try_from(&draft.schema.in_radians())?,
    };
    DerivedFeatures::checked(draft.derived.as_deref().unwrap_or_default(), &schema)?;

    Ok(match said {
        true => schema.draft(),
        false => draft.schema.clone(),
    })
}

fn unnamed() -> Failure {
    Failure::usage("a description from standard input has no name of its own: add --name NAME")
}

impl List {
    async fn run(self) -> Result<(), Failure> {
        let page = all(&self.server.connect().await?).await?;
        if self.json {
            let mut told = to_json(dto::EnvironmentPage::from(page));
            // It is all of them.
            told.as_object_mut()
                .map(|page| page.remove("next_page_token"));
            return print_json(&told);
        }

        let proto::ListEnvironmentsResponse {
            environments,
            unreadable,
            ..
        } = page;

        if environments.is_empty() && unreadable.is_empty() {
            return print("no environments yet: `nudge env apply FILE` makes one");
        }

        let mut table = Table::new(&["name", "state", "agents", "rule", "uid"]);
        for environment in &environments {
            if environment.schema.is_none() {
                let large = "its description is larger than a message: REST tells it";
                table.row([
                    environment.name.clone(),
                    large.into(),
                    "".into(),
                    rule(environment),
                    environment.uid.clone(),
                ]);
                continue;
            }
            let schema = schema_of(environment)?;
            let features = format!("{} features", schema.state().len());
            table.row([
                environment.name.clone(),
                features,
                agents(&schema),
                rule(environment),
                environment.uid.clone(),
            ]);
        }

        let lines = unreadable.iter().map(cannot_be_read).collect::<String>();
        match environments.is_empty() {
            true => print(lines.trim_end()),
            false => print(&format!("{}{lines}", table.render(""))),
        }
    }
}

impl Show {
    async fn run(self) -> Result<(), Failure> {
        let environment = self.server.connect().await?.environment(&self.name).await?;
        if self.json {
            return print_json(&to_json(dto::Environment::from(environment)));
        }
        let schema = schema_of(&environment)?;
        let derived = derived_of(&environment, &schema)?;
        print(&described(&environment, &schema, &derived))
    }
}

impl Delete {
    async fn run(self) -> Result<(), Failure> {
        let Self { name, yes, server } = self;
        let connection = server.connect().await?;
        if !yes {
            return Err(unsure(&connection, &name).await);
        }

        let request = proto::DeleteEnvironmentRequest { name: name.clone() };
        connection
            .environments()
            .delete_environment(request)
            .await?;
        print(&format!("environment `{name}` deleted"))
    }
}

/// Says what would be deleted, if there is anything: one that cannot be read can be deleted too.
async fn unsure(connection: &Connection, name: &str) -> Failure {
    match connection.environment(name).await {
        Err(error) if error.kind() == ErrorKind::NotFound => error.into(),
        _ => Failure::usage(format!(
            "this deletes `{name}` and everything counted in it, for ever: add --yes to do it"
        )),
    }
}

/// Returns every environment, as one page.
async fn all(connection: &Connection) -> Result<proto::ListEnvironmentsResponse, Failure> {
    let mut all = proto::ListEnvironmentsResponse::default();
    loop {
        let page_token = std::mem::take(&mut all.next_page_token);
        let request = proto::ListEnvironmentsRequest {
            page_size: 1_000,
            page_token,
        };
        let ask = || {
            let (mut client, request) = (connection.environments(), request.clone());
            async move { client.list_environments(request).await }
        };
        let page = asked(ask).await?;
        all.environments.extend(page.environments);
        all.unreadable.extend(page.unreadable);
        all.next_page_token = page.next_page_token;
        if all.next_page_token.is_empty() {
            return Ok(all);
        }
    }
}

fn cannot_be_read(environment: &proto::UnreadableEnvironment) -> String {
    let proto::UnreadableEnvironment {
        name,
        uid,
        unreadable,
    } = environment;
    format!(
        "{name}  CANNOT BE READ ({uid}): {unreadable}; `nudge env delete {name} --yes` deletes it\n"
    )
}

fn text_of(file: &Path) -> Result<String, Failure> {
    let text = if is_standard_input(file) {
        io::read_to_string(io::stdin())
    } else {
        std::fs::read_to_string(file)
    };
    text.map_err(|error| cannot_read(file, &error))
}

fn is_standard_input(file: &Path) -> bool {
    file == Path::new("-")
}

fn stem(file: &Path) -> Option<String> {
    file.file_stem()
        .filter(|_| !is_standard_input(file))
        .map(|stem| stem.to_string_lossy().into_owned())
}

fn described(
    environment: &proto::Environment,
    schema: &Schema,
    derived: &DerivedFeatures,
) -> String {
    let (name, uid, hash) = (&environment.name, &environment.uid, schema.hash());
    let told: String = thresholds(environment, schema)
        .iter()
        .map(|line| format!("        {line}\n"))
        .collect();
    let notes: String = notes(schema)
        .iter()
        .map(|line| format!("note    {line}\n"))
        .collect();
    let rule = rule(environment);
    let (later, formulas) = (later(schema), formulas(schema, derived));
    let table = features(schema, derived).render("");

    format!(
        "{name}\nuid     {uid}\nschema  {hash}\nrule    {rule}\n{told}{later}{formulas}{notes}\n{table}"
    )
}

/// Returns the features of the state, of what follows from it, of actions and of outcomes.
fn features(schema: &Schema, derived: &DerivedFeatures) -> Table {
    let mut table = Table::new(&["of", "feature", "unit", "bins", "values"]);
    let mut row = |of: &str, name: &Name, unit: Option<&Label>, kind: &FeatureKind| {
        let unit = unit.map(ToString::to_string).unwrap_or_default();
        let bins = output::count(u64::from(kind.bins()));
        table.row([of.to_owned(), name.to_string(), unit, bins, kind.expected()]);
    };

    for coordinate in Coordinates::new(schema, derived).all() {
        let of = match coordinate.is_derived() {
            true => "derived",
            false => "state",
        };
        row(of, coordinate.name(), coordinate.unit(), coordinate.kind());
    }
    let mut part = |of: &str, feature: &Feature| {
        row(of, &feature.name, feature.unit.as_ref(), &feature.kind);
    };
    schema
        .action_features()
        .for_each(|(agent, feature)| part(agent.name.as_str(), feature));
    // An agent's later action has the features of its action.
    schema
        .outcome_features()
        .filter(|(outcome, _)| outcome.agent.is_none())
        .for_each(|(outcome, feature)| part(&outcome.name, feature));
    table
}

/// Tells what follows from the state, a line each.
fn formulas(schema: &Schema, derived: &DerivedFeatures) -> String {
    derived
        .iter()
        .map(|feature| format!("derived {} is {}\n", feature.name, feature.formula(schema)))
        .collect()
}

/// Tells which agents may be absent, and what is observed how many steps later, a line each.
fn later(schema: &Schema) -> String {
    let mut lines = String::new();
    let absent = schema.agents().iter().filter(|agent| agent.may_be_absent);
    let absent: Vec<&str> = absent.map(|agent| agent.name.as_str()).collect();
    if !absent.is_empty() {
        lines += &format!("absent  {} may be\n", absent.join(", "));
    }

    let named = |outcome: &Outcome| match outcome.agent {
        Some(_) => outcome.name.clone(),
        None => format!("{} after {}", outcome.name, steps(outcome.lag)),
    };
    let outcomes: Vec<String> = schema.outcomes().iter().map(named).collect();
    if !outcomes.is_empty() {
        lines += &format!("later   {}\n", outcomes.join(", "));
    }
    lines
}

fn steps(lag: u32) -> String {
    match lag {
        1 => "1 step".into(),
        lag => format!("{lag} steps"),
    }
}

/// Tells the threshold in every way, a line for pairs that can have as much as each other.
fn thresholds(environment: &proto::Environment, schema: &Schema) -> Vec<String> {
    let draft = environment.rule.clone().unwrap_or_default().into();
    let Ok(rule) = WrittenRule::default().merged(&draft) else {
        return Vec::new();
    };

    let mut by_reach: BTreeMap<u64, Vec<Pair>> = BTreeMap::new();
    for pair in Pair::every(schema) {
        let Alphabet { rows, columns } = pair.alphabet(schema);
        by_reach.entry(rows.min(columns)).or_default().push(pair);
    }

    by_reach
        .into_values()
        .map(|pairs| threshold(&rule, schema, &pairs))
        .collect()
}

/// Tells the threshold for pairs of which each can have as much as the others.
fn threshold(rule: &WrittenRule, schema: &Schema, pairs: &[Pair]) -> String {
    const NAMED: usize = 3;

    let name = |agent: usize| schema.agents()[agent].name.as_str();
    let mut named: Vec<String> = pairs
        .iter()
        .take(NAMED)
        .map(|pair| format!("{} and {}", name(pair.ego), name(pair.other)))
        .collect();

    if pairs.len() > NAMED {
        named.push(format!("{} other pairs", pairs.len() - NAMED));
    }
    let (named, alphabet) = (named.join(", "), pairs[0].alphabet(schema));
    let Some(share) = rule.share(alphabet) else {
        return format!("always undecided between {named}: one of the two has a single action");
    };

    let nats = rule.resolved(alphabet).threshold_nats();
    let [nats, bits] =
        [nats, Unit::Bits.from_nats(nats)].map(|number| output::significant(number, 3));
    let beyond = if rule.within_reach(alphabet).is_err() {
        ": out of reach"
    } else {
        ""
    };

    format!(
        "influence above {nats} nats ({bits} bits; {} of the most {named} can have{beyond})",
        output::percent(share)
    )
}

/// Says where values are not measured in what their unit says.
fn notes(schema: &Schema) -> Vec<String> {
    let actions = schema
        .action_features()
        .map(|(agent, feature)| (format!("{}.{}", agent.name, feature.name), feature));
    let state = schema
        .state()
        .iter()
        .map(|feature| (feature.name.to_string(), feature));

    let features = state.chain(actions);
    features
        .filter_map(|(name, feature)| note(&name, feature))
        .collect()
}

fn note(name: &str, feature: &Feature) -> Option<String> {
    let unit = feature.unit.as_ref()?.as_str();
    let FeatureKind::Circular(_, angle) = feature.kind else {
        return None;
    };

    (Angle::of_unit(Some(unit)) != Some(angle)).then(|| {
        let values = angle.as_str();
        format!("{name}: values are {values} although the unit is {unit}, as in environments made before units of angles were read")
    })
}

fn agents(schema: &Schema) -> String {
    schema
        .agents()
        .iter()
        .map(|agent| agent.name.as_str())
        .collect::<Vec<_>>()
        .join(", ")
}

fn rule(environment: &proto::Environment) -> String {
    let rule = environment.rule.clone().unwrap_or_default();
    let (kind, unit) = (rule.kind.unwrap_or_default(), rule.unit.unwrap_or_default());
    let above = match rule.share {
        Some(share) => format!("{} of what two agents can have", output::percent(share)),
        None => format!("{} {unit}", rule.threshold.unwrap_or_default()),
    };

    match kind.as_str() {
        "paper" => format!(
            "paper, above {above} from {} visits",
            rule.min_visits.unwrap_or_default()
        ),
        _ => format!(
            "{kind}, above {above} at {}",
            rule.confidence.unwrap_or_default()
        ),
    }
}
