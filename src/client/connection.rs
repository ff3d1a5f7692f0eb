//! A connection to one service: where it is, whether it is a Nudge, and a typed stub for each of its services.

use std::error::Error;
use std::time::Duration;

use tokio::time::Instant;
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Request, Response, Status};
use tonic_types::StatusExt;

use super::error::{is_transient, said};
use super::trouble::Trouble;
use super::{ClientError, Producer, ProducerBuilder};
use crate::api::proto;
use crate::api::proto::environment_service_client::EnvironmentServiceClient;
use crate::api::proto::influence_service_client::InfluenceServiceClient;
use crate::api::proto::ingest_service_client::IngestServiceClient;
use crate::api::proto::model_service_client::ModelServiceClient;
use crate::domain::{Schema, SchemaDraft};

const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
const PROBE_TIMEOUT: Duration = Duration::from_secs(5);

/// How long a question is asked again while nobody answers it.
const PATIENCE: Duration = Duration::from_secs(60);

/// How long a silent connection is trusted before it is asked for a sign of life, and how long the answer may take: a half-open connection is
/// noticed within their sum.
const KEEP_ALIVE: (Duration, Duration) = (Duration::from_secs(20), Duration::from_secs(10));

/// The largest acknowledgement that is read: a hundred rejections with their reasons for each batch of a wide window.
const MOST_ACKNOWLEDGEMENT_BYTES: usize = 64 << 20;

/// A connection to one service. Cloning is cheap and shares it; it reconnects by itself when it is used again.
#[derive(Debug, Clone)]
pub struct Connection {
    address: String,
    channel: Channel,
}

impl Connection {
    /// Connects to `http://127.0.0.1:8080` or `127.0.0.1:8080`, and makes sure that a Nudge answers there.
    pub async fn open(address: &str) -> Result<Self, ClientError> {
        let connection = Self::dial(&with_scheme(address)?).await?;
        connection.probe().await?;
        Ok(connection)
    }

    /// Returns the address with its scheme.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Returns a stub of the service that keeps environments.
    pub fn environments(&self) -> EnvironmentServiceClient<Channel> {
        EnvironmentServiceClient::new(self.channel.clone())
    }

    /// Returns a stub of the service that answers questions.
    pub fn influence(&self) -> InfluenceServiceClient<Channel> {
        InfluenceServiceClient::new(self.channel.clone())
    }

    /// Returns a stub of the service that trains networks.
    pub fn models(&self) -> ModelServiceClient<Channel> {
        ModelServiceClient::new(self.channel.clone())
    }

    /// Returns a stub of the service that takes batches; [`Producer`] speaks to it well.
    pub fn ingest(&self) -> IngestServiceClient<Channel> {
        IngestServiceClient::new(self.channel.clone()).max_decoding_message_size(MOST_ACKNOWLEDGEMENT_BYTES)
    }

    /// Prepares a producer of that id into that environment.
    pub fn producer(&self, environment: &str, id: &str) -> ProducerBuilder {
        Producer::builder(self, environment, id)
    }

    /// Returns an environment by name.
    pub async fn environment(&self, name: &str) -> Result<proto::Environment, ClientError> {
        let ask = || {
            let (mut client, request) = (self.environments(), proto::GetEnvironmentRequest { name: name.into() });
            async move { client.get_environment(request).await }
        };
        let response: proto::GetEnvironmentResponse = patiently(ask).await?;
        response.environment.ok_or_else(|| ClientError::Disagreement("the service answered without environment".into()))
    }

    /// Makes an environment, or confirms that it exists with this very description; its rule stays as it is.
    pub async fn apply(&self, name: &str, schema: &SchemaDraft) -> Result<(), ClientError> {
        let request =
            proto::ApplyEnvironmentRequest { name: name.into(), schema: Some(schema.clone().into()), rule: None };
        let ask = || {
            let (mut client, request) = (self.environments(), request.clone());
            async move { client.apply_environment(request).await }
        };
        patiently(ask).await.map(drop)
    }

    async fn dial(address: &str) -> Result<Self, ClientError> {
        let unusable = |why: String| ClientError::Address { address: address.into(), why };
        let endpoint = Endpoint::from_shared(address.to_owned()).map_err(|error| unusable(innermost(&error)))?;
        let (interval, timeout) = KEEP_ALIVE;
        let endpoint =
            endpoint.connect_timeout(CONNECT_TIMEOUT).http2_keep_alive_interval(interval).keep_alive_timeout(timeout);
        let channel = endpoint.connect().await.map_err(|error| unreachable(address, innermost(&error)))?;
        Ok(Self { address: address.into(), channel })
    }

    /// Asks something small that only a Nudge can answer: a connection alone proves nothing.
    async fn probe(&self) -> Result<(), ClientError> {
        let mut request = Request::new(proto::ListEnvironmentsRequest { page_size: 1, page_token: String::new() });
        request.set_timeout(PROBE_TIMEOUT);
        match self.environments().list_environments(request).await {
            Ok(_) => Ok(()),
            Err(status) => Err(self.not_answered(status)),
        }
    }

    fn not_answered(&self, status: Status) -> ClientError {
        let is_signed = status.get_details_error_info().is_some();
        match status.code() {
            _ if is_signed => status.into(),
            Code::Unavailable => unreachable(&self.address, said(&status)),
            Code::Unimplemented => {
                let why = "it does not know nudge.v1.EnvironmentService".into();
                ClientError::NotNudge { address: self.address.clone(), why }
            }
            _ => ClientError::NotNudge { address: self.address.clone(), why: said(&status) },
        }
    }
}

/// Asks until the service answers, which may be away for a moment: as patiently as a producer that sends. Where it is still making the answer, it is
/// asked for as long as that takes.
pub async fn patiently<T, F>(mut ask: impl FnMut() -> F) -> Result<T, ClientError>
where
    F: Future<Output = Result<Response<T>, Status>>,
{
    let mut trouble = Trouble::begin(Instant::now());
    loop {
        match ask().await {
            Ok(response) => return Ok(response.into_inner()),
            Err(status) if is_still_working(&status) => {
                trouble = Trouble::begin(Instant::now());
                tokio::time::sleep(trouble.failed(said(&status))).await;
            }
            Err(status) if is_transient(&status) && trouble.lasted(Instant::now()) < PATIENCE => {
                tokio::time::sleep(trouble.failed(said(&status))).await;
            }
            Err(status) => return Err(status.into()),
        }
    }
}

/// Returns whether the service goes on making what was asked for.
fn is_still_working(status: &Status) -> bool {
    status.get_details_error_info().is_some_and(|info| info.reason == "STILL_WORKING")
}

/// Checks the description that the service keeps of an environment.
pub fn schema_of(environment: &proto::Environment) -> Result<Schema, ClientError> {
    let draft = SchemaDraft::from(environment.schema.clone().unwrap_or_default());
    Schema::try_from(&draft).map_err(|_| {
        let name = &environment.name;
        ClientError::Disagreement(format!("the service describes `{name}` in a way that this client does not know"))
    })
}

fn with_scheme(address: &str) -> Result<String, ClientError> {
    let unusable = |why: &str| Err(ClientError::Address { address: address.into(), why: why.into() });
    match address.split_once("://") {
        None if address.is_empty() => unusable("it is empty, expected something like http://127.0.0.1:8080"),
        None => Ok(format!("http://{address}")),
        Some(("http", _)) => Ok(address.into()),
        Some((scheme, _)) => unusable(&format!("{scheme} is not spoken, expected http://HOST:PORT")),
    }
}

fn unreachable(address: &str, why: String) -> ClientError {
    ClientError::Unreachable { address: address.into(), why }
}

/// Returns what the last cause says: the outer ones only say "transport error".
fn innermost(error: &dyn Error) -> String {
    let mut cause = error;
    while let Some(deeper) = cause.source() {
        cause = deeper;
    }
    cause.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_may_come_without_its_scheme() {
        assert_eq!(with_scheme("127.0.0.1:8080"), Ok("http://127.0.0.1:8080".into()));
        assert_eq!(with_scheme("http://[::1]:8080"), Ok("http://[::1]:8080".into()));
        for bad in ["", "https://example.org", "unix:///tmp/nudge"] {
            assert!(with_scheme(bad).is_err(), "{bad}");
        }
    }
}
