//! The life cycle of environments: idempotent creation, changes of what may change, removal. The store
//! keeps them; what is decided here is what a repeated or changed description means.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tracing::{Instrument, instrument};

use crate::api::{self, proto};
use crate::domain::draft::{ChangeDraft, DerivedDraft, DescriptionDraft, RuleDraft};
use crate::domain::{
    Asker, Change, DerivedFeatures, Environment, EnvironmentId, EnvironmentPage, Name, Pair,
    Principal, Schema, UnreadableEnvironment, WrittenRule, hint, page_size,
};
use crate::error::{ErrorKind, Fault, Problem};
use crate::ingest::Ingest;
use crate::model::Networks;
use crate::store::{ENVIRONMENT_NOT_FOUND, Leftovers, Store, StoreError};
use crate::telemetry;
use crate::work::beside;

/// The longest rest between two steps of a removal.
const REST: Duration = Duration::from_millis(50);

/// How long it is waited after a step failed, and how long at most after many did.
const BACK_OFF: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(60)];

/// A handle on the environments. Cloning is cheap.
#[derive(Clone)]
pub struct Environments {
    store: Arc<dyn Store>,
    ingest: Ingest,
    networks: Networks,
    asker: Asker,
}

impl Environments {
    /// Makes a handle.
    pub fn new(store: Arc<dyn Store>, ingest: Ingest, networks: Networks) -> Self {
        Self {
            store,
            ingest,
            networks,
            asker: Asker::always(Principal::anonymous()),
        }
    }

    /// Returns a handle for whoever asks, to whom other environments than theirs are forbidden,
    /// whether there are such or not. Which are theirs is looked at each time.
    pub fn asked_by(&self, asker: Asker) -> Self {
        Self {
            asker,
            ..self.clone()
        }
    }

    fn admit(&self, name: &str) -> Result<(), Problem> {
        self.asker
            .admit_to(name)
            .inspect_err(|_| telemetry::denied("environment"))
    }

    /// Returns the environment of that name.
    pub fn find(&self, name: &str) -> Result<Arc<Environment>, Problem> {
        self.admit(name)?;
        self.store
            .environment(name)
            .ok_or_else(|| match self.find_unreadable(name) {
                Some(environment) => cannot_be_read(&environment),
                None => self.unknown(name),
            })
    }

    fn unknown(&self, name: &str) -> Problem {
        let (known, principal) = (self.store.environments(), self.asker.now());
        let theirs = known
            .iter()
            .map(|environment| environment.name.as_str())
            .filter(|name| principal.may_see(name));
        let hint = hint(name, theirs);
        Problem::new(
            ErrorKind::NotFound,
            ENVIRONMENT_NOT_FOUND,
            format!("unknown environment `{name}`{hint}"),
        )
    }

    /// Returns the environment of that name, unless it is another one than the caller knows under
    /// its uid; an empty uid takes it as it is.
    pub fn find_known(&self, name: &str, uid: &str) -> Result<Arc<Environment>, Problem> {
        let environment = self.find(name)?;
        is_known_as(&environment, uid).map(|()| environment)
    }

    fn find_unreadable(&self, name: &str) -> Option<Arc<UnreadableEnvironment>> {
        self.store
            .unreadable()
            .into_iter()
            .find(|environment| environment.name == name)
    }

    /// Returns a page of environments; a size of 0 takes the default.
    pub fn list(&self, asked: u64, page_token: Option<&str>) -> Result<EnvironmentPage, Problem> {
        let size = page_size(asked)?;
        let place = page_token.map(place).transpose()?;
        let after = |environment: &Arc<Environment>| {
            place.is_none_or(|name| environment.name.as_str() > name)
        };
        let principal = self.asker.now();
        let mut unreadable = if page_token.is_none() {
            self.store.unreadable()
        } else {
            Vec::new()
        };
        unreadable.retain(|environment| principal.may_see(&environment.name));
        let spent = unreadable
            .iter()
            .map(|one| api::bytes(&proto::UnreadableEnvironment::from(&**one)))
            .sum();

        let is_theirs =
            |environment: &Arc<Environment>| principal.may_see(environment.name.as_str());
        let environments = self
            .store
            .environments()
            .into_iter()
            .filter(after)
            .filter(is_theirs);
        let page = api::page(environments, size, spent, |environment| {
            proto::Environment::from(&**environment)
        });
        let last = page
            .items
            .last()
            .filter(|_| page.has_more)
            .map(|environment| token(environment.name.as_str()));
        Ok(EnvironmentPage {
            environments: page.items,
            unreadable,
            next_page_token: last,
        })
    }

    /// Makes an environment, or confirms that it exists with this schema; derived features and a
    /// rule that are given are set. Returns whether it was made now.
    #[instrument(level = "debug", skip_all)]
    pub async fn apply(
        &self,
        name: &str,
        description: DescriptionDraft,
    ) -> Result<(Arc<Environment>, bool), Problem> {
        self.admit(name)?;
        let existing = self.store.environment(name);
        // Before it is looked at, which takes long where it is large. One that exists stays,
        // whatever its size, and comes back in.
        if existing
            .as_ref()
            .is_none_or(|existing| description.schema.bytes() > existing.schema.draft().bytes())
        {
            description.schema.within_bytes()?;
        }

        let (named, kept) = (name.to_owned(), existing.clone());
        // A description may have a million labels.
        let (name, schema, change) =
            beside(move || checked(&named, &description, kept.as_deref())).await??;

        if let Some(existing) = existing {
            return self.confirm(existing, &schema, change).await;
        }
        match self.store.create(&name, &schema, &change).await {
            Ok(made) => {
                tracing::info!(environment = %made.name, uid = %made.uid, "an environment was made");
                Ok((made, true))
            }
            Err(StoreError::AlreadyExists(_)) => {
                self.confirm(self.find(name.as_str())?, &schema, change)
                    .await
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Changes the parts of the rule, and the derived features, that are given: all or nothing.
    #[instrument(level = "debug", skip_all)]
    pub async fn update(
        &self,
        name: &str,
        draft: &ChangeDraft,
    ) -> Result<Arc<Environment>, Problem> {
        let environment = self.find(name)?;
        let change = changed(&environment, draft)
            .map_err(|faults| Problem::invalid("environment", faults))?;
        self.change(&environment, change).await
    }

    /// Removes an environment with its counts and watermarks, and ends its streams and trainings.
    /// It need not be readable. What it leaves in the database goes in the background.
    #[instrument(level = "debug", skip_all)]
    pub async fn delete(&self, name: &str) -> Result<(), Problem> {
        self.admit(name)?;
        let (id, uid) = match self.find_unreadable(name) {
            Some(environment) => (environment.id, environment.uid.clone()),
            None => self
                .find(name)
                .map(|environment| (environment.id, environment.uid.clone()))?,
        };
        // A caller who leaves meanwhile must not keep streams from ending.
        tokio::spawn(self.clone().remove(id).in_current_span())
            .await
            .map_err(|error| unexpected(&error))??;
        tracing::info!(environment = name, %uid, "an environment was deleted");
        Ok(())
    }

    /// Changes what is not as it should be already.
    async fn change(
        &self,
        environment: &Arc<Environment>,
        change: Change,
    ) -> Result<Arc<Environment>, Problem> {
        if environment.with(&change) == **environment {
            return Ok(Arc::clone(environment));
        }
        let changed = self.store.change(environment.id, &change).await?;
        tell_change(environment, &changed);
        Ok(changed)
    }

    async fn remove(self, id: EnvironmentId) -> Result<(), StoreError> {
        self.store.delete(id).await?;
        self.ingest.end_streams(id);
        self.networks.end_of(id);
        Ok(())
    }

    /// Removes what deleted environments have left, for ever. Whoever wants to write comes first:
    /// after each step it rests for as long.
    pub async fn sweep(self) {
        let mut pace = Pace::new(REST);
        loop {
            let started = Instant::now();
            let done = self.store.sweep().await;
            tokio::time::sleep(pace.rest(started, done)).await;
        }
    }

    /// Puts the journal of counts, and what earlier builds counted, into rows, for ever.
    pub async fn compact(self) {
        let mut pace = Pace::new(Duration::ZERO);
        loop {
            let started = Instant::now();
            let done = self.store.compact().await;
            tokio::time::sleep(pace.rest(started, done)).await;
        }
    }

    /// Returns what deleted environments have left in the database.
    pub fn leftovers(&self) -> Leftovers {
        self.store.leftovers()
    }

    async fn confirm(
        &self,
        existing: Arc<Environment>,
        schema: &Schema,
        change: Change,
    ) -> Result<(Arc<Environment>, bool), Problem> {
        if existing.schema.hash() != schema.hash() {
            let message = format!(
                "environment `{}` exists with another schema; delete it or take another name",
                existing.name
            );
            return Err(
                Problem::new(ErrorKind::AlreadyExists, "SCHEMA_CONFLICT", message)
                    .with("schema_hash", existing.schema.hash()),
            );
        }

        Ok((self.change(&existing, change).await?, false))
    }
}

fn tell_change(before: &Environment, now: &Environment) {
    let environment = now.name.as_str();
    if before.rule != now.rule {
        tracing::info!(environment, rule = %now.rule, before = %before.rule, "a rule was changed");
    }
    if before.derived != now.derived {
        let names = now.derived.iter().map(|feature| feature.name.as_str());
        let derived = names.collect::<Vec<_>>().join(", ");
        tracing::info!(environment, derived, "derived features were changed");
    }
}

/// Returns the token of a page that ends with an environment of that name, which may be gone when
/// the next is asked for. Any text can be a name, so the token carries a mark of ours.
fn token(name: &str) -> String {
    format!("{name}~{}", &blake3::hash(name.as_bytes()).to_hex()[..8])
}

/// Reads a page's token: the name that it comes after.
fn place(text: &str) -> Result<&str, Problem> {
    let name = text
        .rsplit_once('~')
        .map(|(name, _)| name)
        .filter(|name| token(name) == text);
    let fault = || {
        Fault::new(
            "/page_token",
            format!("got {text:?}, expected the `next_page_token` of a page"),
        )
    };
    name.ok_or_else(|| Problem::invalid("page", vec![fault()]))
}

/// Refuses a caller who knows an environment under another uid: it was deleted and made again
/// since. An empty uid takes it as it is.
pub fn is_known_as(environment: &Environment, uid: &str) -> Result<(), Problem> {
    if uid.is_empty() || environment.uid.0 == uid {
        return Ok(());
    }
    let message = format!(
        "environment `{}` was deleted and made again: its uid is not `{uid}`",
        environment.name
    );
    Err(
        Problem::new(ErrorKind::Conflict, "ENVIRONMENT_REPLACED", message)
            .with("environment_uid", &environment.uid),
    )
}

fn unexpected(error: &dyn std::fmt::Display) -> Problem {
    tracing::error!(%error, "a removal ended unexpectedly");
    Problem::new(
        ErrorKind::Internal,
        "INTERNAL",
        "the removal ended unexpectedly; the cause is in the service's log",
    )
}

fn cannot_be_read(environment: &UnreadableEnvironment) -> Problem {
    let UnreadableEnvironment { name, why, .. } = environment;
    let message = format!(
        "environment `{name}` cannot be read: {why}; use the build that wrote it, or delete it"
    );
    Problem::new(ErrorKind::Conflict, "ENVIRONMENT_UNREADABLE", message)
}

type Checked = (Name, Schema, Change);

/// Checks a description, beside what exists under its name.
fn checked(
    name: &str,
    description: &DescriptionDraft,
    existing: Option<&Environment>,
) -> Result<Checked, Problem> {
    let mut faults = Vec::new();
    let name = name
        .parse::<Name>()
        .map_err(|detail| faults.push(Fault::new("/name", detail)));

    let kept = existing.map(|environment| environment.schema.hash());
    let schema = Schema::described(description, kept)
        .map_err(|found| faults.extend(found))
        .ok();

    let derived = derived(description.derived.as_deref(), schema.as_ref())
        .map_err(|found| faults.extend(found));

    let kept = existing.map(|environment| &environment.rule);
    let given = |draft: &RuleDraft| match (WrittenRule::default().merged(draft), &schema) {
        (Ok(rule), Some(schema)) => within_reach(rule, draft, schema, kept),
        (merged, _) => merged,
    };
    let rule = description.rule.as_ref().map(given).transpose();
    let rule = rule.map_err(|found| faults.extend(under_rule(found)));

    match (name, schema, derived, rule) {
        (Ok(name), Some(schema), Ok(derived), Ok(rule)) => {
            let alike = if existing.is_none() {
                schema.labels_alike()
            } else {
                Vec::new()
            };
            if alike.is_empty() {
                Ok((name, schema, Change { derived, rule }))
            } else {
                Err(Problem::invalid("environment", alike))
            }
        }
        _ => Err(Problem::invalid("environment", faults)),
    }
}

/// Checks derived features that are given. Of a state that is at fault nobody can say what follows.
fn derived(
    drafts: Option<&[DerivedDraft]>,
    schema: Option<&Schema>,
) -> Result<Option<DerivedFeatures>, Vec<Fault>> {
    let given = drafts.zip(schema);
    given
        .map(|(drafts, schema)| DerivedFeatures::checked(drafts, schema))
        .transpose()
}

/// Checks a change of an environment.
fn changed(environment: &Environment, draft: &ChangeDraft) -> Result<Change, Vec<Fault>> {
    let mut faults = Vec::new();
    let schema = &environment.schema;
    let derived = derived(draft.derived.as_deref(), Some(schema))
        .map_err(|found| faults.extend(found))
        .ok();

    let merged = |draft: &RuleDraft| {
        let rule = environment.rule.merged(draft)?;
        within_reach(rule, draft, schema, Some(&environment.rule))
    };
    let rule = draft.rule.as_ref().map(merged).transpose();
    let rule = rule.map_err(|found| faults.extend(under_rule(found))).ok();

    match (derived, rule) {
        (Some(derived), Some(rule)) => Ok(Change { derived, rule }),
        _ => Err(faults),
    }
}

/// How long it is waited between the steps of what goes on for ever.
struct Pace {
    longest_rest: Duration,
    back_off: Duration,
}

impl Pace {
    fn new(longest_rest: Duration) -> Self {
        let [back_off, _] = BACK_OFF;
        Self {
            longest_rest,
            back_off,
        }
    }

    /// Returns a rest that is as long as the step took, or as it may be. Where a step fails it is
    /// tried again, less and less often; the store has said in the log why.
    fn rest(&mut self, started: Instant, step: Result<(), StoreError>) -> Duration {
        let [first, longest] = BACK_OFF;
        if step.is_ok() {
            self.back_off = first;
            return started.elapsed().min(self.longest_rest);
        }

        let next = (self.back_off * 2).min(longest);
        std::mem::replace(&mut self.back_off, next)
    }
}

/// Refuses a threshold that is given now and that no pair of the environment can reach. What is
/// kept already is no fault: it is how a description comes back in.
fn within_reach(
    rule: WrittenRule,
    draft: &RuleDraft,
    schema: &Schema,
    kept: Option<&WrittenRule>,
) -> Result<WrittenRule, Vec<Fault>> {
    let is_kept =
        kept.is_some_and(|kept| (kept.threshold, kept.unit) == (rule.threshold, rule.unit));
    if draft.threshold.is_some() && !is_kept {
        let widest = Pair::widest(schema).alphabet(schema);
        rule.within_reach(widest).map_err(|fault| vec![fault])?;
    }
    Ok(rule)
}

/// A rule stands under `rule` in every request, so its faults lie there.
fn under_rule(faults: Vec<Fault>) -> Vec<Fault> {
    faults
        .into_iter()
        .map(|fault| fault.under("/rule"))
        .collect()
}
