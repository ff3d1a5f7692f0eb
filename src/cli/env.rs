//! `nudge env`: environments of a service.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use super::output::{Table, cannot_read, print, print_json, to_json};
use super::server::Server;
use super::{Failure, output};
use crate::api::{json as dto, proto};
use crate::client::{Connection, schema_of};
use crate::domain::{Feature, Schema};
use crate::error::Problem;

/// Create, list, show and delete environments
#[derive(Debug, Subcommand)]
#[command(long_about = "Create, list, show and delete environments.\n\n\
    An environment is a world with a fixed description of its state and its agents, and a decision rule that may change.\n\n\
    Example:\n  nudge env apply hallway.json\n  nudge env show hallway")]
pub(super) enum Env {
    /// Create an environment from a description, or confirm that it exists
    #[command(
        long_about = "Create an environment from a description in JSON, or confirm that it exists with this very one.\n\n\
        A rule in the file is set; without one the rule stays as it is. State and agents cannot be changed: delete the environment, or take \
        another name.\n\n\
        Example:\n  nudge env apply worlds/hallway.json --name hallway\n\n\
        A small description:\n  \
        {\"state\": [{\"name\": \"distance\", \"unit\": \"m\", \"continuous\": {\"edges\": [0.5, 1, 2]}}],\n   \
        \"agents\": [\n     \
        {\"name\": \"robot\", \"action\": [{\"name\": \"go\", \"integer\": {\"min\": 0, \"max\": 1}}]},\n     \
        {\"name\": \"human\", \"action\": [{\"name\": \"go\", \"integer\": {\"min\": 0, \"max\": 1}}]}]}"
    )]
    Apply(Apply),
    /// List environments
    #[command(long_about = "List environments in order of name.\n\nExample:\n  nudge env list --json")]
    List(List),
    /// Show one environment
    #[command(
        long_about = "Show the state, the agents and the rule of one environment.\n\nExample:\n  nudge env show counter_circuit"
    )]
    Show(Show),
    /// Delete an environment with everything that was counted in it
    #[command(
        long_about = "Delete an environment with everything that was counted in it, for ever. Streams into it end.\n\n\
        Example:\n  nudge env delete counter_circuit.pos --yes"
    )]
    Delete(Delete),
}

#[derive(Debug, Args)]
pub(super) struct Apply {
    /// File with the description, in JSON
    file: PathBuf,
    /// Name of the environment; the file's name without its extension unless given
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
        let (schema, rule) = dto::description_of_text(&text_of(&self.file)?)?;
        // The wire has room for one kind a feature and for fewer numbers than JSON: what does not fit must be told, not trimmed.
        Schema::try_from(&schema).map_err(|faults| Problem::invalid("environment", faults))?;
        let name = self.name.unwrap_or_else(|| stem(&self.file));
        let connection = self.server.connect().await?;
        let request = proto::ApplyEnvironmentRequest { name, schema: Some(schema.into()), rule: rule.map(Into::into) };
        let response = connection.environments().apply_environment(request).await?.into_inner();
        let environment = response.environment.unwrap_or_default();
        if self.json {
            return print_json(&to_json(dto::Environment::from(environment)));
        }
        let done = if response.created { "created" } else { "exists with this description" };
        print(&format!("environment `{}` {done}", environment.name))
    }
}

impl List {
    async fn run(self) -> Result<(), Failure> {
        let page = all(&self.server.connect().await?).await?;
        if self.json {
            let mut told = to_json(dto::EnvironmentPage::from(page));
            // It is all of them.
            told.as_object_mut().map(|page| page.remove("next_page_token"));
            return print_json(&told);
        }
        let proto::ListEnvironmentsResponse { environments, unreadable, .. } = page;
        if environments.is_empty() && unreadable.is_empty() {
            return print("no environments yet: `nudge env apply FILE` makes one");
        }
        let mut table = Table::new(&["name", "state", "agents", "rule", "uid"]);
        for environment in &environments {
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
        print(&described(&environment, &schema_of(&environment)?))
    }
}

impl Delete {
    async fn run(self) -> Result<(), Failure> {
        let Self { name, yes, server } = self;
        if !yes {
            let message = format!("this deletes `{name}` and everything counted in it, for ever: add --yes to do it");
            return Err(Failure::usage(message));
        }
        let request = proto::DeleteEnvironmentRequest { name: name.clone() };
        server.connect().await?.environments().delete_environment(request).await?;
        print(&format!("environment `{name}` deleted"))
    }
}

/// Returns every environment, as one page.
async fn all(connection: &Connection) -> Result<proto::ListEnvironmentsResponse, Failure> {
    let mut all = proto::ListEnvironmentsResponse::default();
    loop {
        let page_token = std::mem::take(&mut all.next_page_token);
        let request = proto::ListEnvironmentsRequest { page_size: 1_000, page_token };
        let page = connection.environments().list_environments(request).await?.into_inner();
        all.environments.extend(page.environments);
        all.unreadable.extend(page.unreadable);
        all.next_page_token = page.next_page_token;
        if all.next_page_token.is_empty() {
            return Ok(all);
        }
    }
}

fn cannot_be_read(environment: &proto::UnreadableEnvironment) -> String {
    let proto::UnreadableEnvironment { name, uid, unreadable } = environment;
    format!("{name}  CANNOT BE READ ({uid}): {unreadable}; `nudge env delete {name} --yes` deletes it\n")
}

fn text_of(file: &Path) -> Result<String, Failure> {
    std::fs::read_to_string(file).map_err(|error| cannot_read(file, &error))
}

fn stem(file: &Path) -> String {
    file.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default()
}

fn described(environment: &proto::Environment, schema: &Schema) -> String {
    let mut table = Table::new(&["of", "feature", "unit", "bins", "values"]);
    let mut row = |of: &str, feature: &Feature| {
        let unit = feature.unit.as_ref().map(ToString::to_string).unwrap_or_default();
        let bins = output::count(u64::from(feature.kind.bins()));
        table.row([of.to_owned(), feature.name.to_string(), unit, bins, feature.kind.expected()]);
    };
    schema.state().iter().for_each(|feature| row("state", feature));
    schema.action_features().for_each(|(agent, feature)| row(agent.name.as_str(), feature));
    let (name, uid, hash) = (&environment.name, &environment.uid, schema.hash());
    format!("{name}\nuid     {uid}\nschema  {hash}\nrule    {}\n\n{}", rule(environment), table.render(""))
}

fn agents(schema: &Schema) -> String {
    schema.agents().iter().map(|agent| agent.name.as_str()).collect::<Vec<_>>().join(", ")
}

fn rule(environment: &proto::Environment) -> String {
    let rule = environment.rule.clone().unwrap_or_default();
    let kind = rule.kind.unwrap_or_default();
    let (threshold, unit) = (rule.threshold.unwrap_or_default(), rule.unit.unwrap_or_default());
    match kind.as_str() {
        "paper" => format!("paper, above {threshold} {unit} from {} visits", rule.min_visits.unwrap_or_default()),
        _ => format!("{kind}, above {threshold} {unit} at {}", rule.confidence.unwrap_or_default()),
    }
}
