//! A connection to one service: where it is, whether it is a Nudge, and a typed stub for each of
//! its services.

use std::error::Error;
use std::time::Duration;

use bytes::Bytes;
use http_body_util::{BodyExt, Limited};
use nudge_core::domain::draft::{DerivedDraft, DescriptionDraft};
use nudge_core::domain::{DerivedFeatures, Schema, SchemaDraft};
use nudge_wire::proto;
use nudge_wire::proto::environment_service_client::EnvironmentServiceClient;
use nudge_wire::proto::influence_service_client::InfluenceServiceClient;
use nudge_wire::proto::ingest_service_client::IngestServiceClient;
use nudge_wire::proto::model_service_client::ModelServiceClient;
use tokio::time::Instant;
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Request, Status};
use tonic_types::StatusExt;
use tower::ServiceExt;

use crate::ClientError;
use crate::error::words_of;
use crate::handshake::{Heard, PLAIN, failed_handshake};
use crate::options::{Bearer, Options, Wire};
use crate::retry::{PATIENCE, advised, patiently};

const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
const PROBE_TIMEOUT: Duration = Duration::from_secs(5);

/// How long a silent connection is trusted before it is asked for a sign of life, and how long the
/// answer may take: a half-open connection is noticed within their sum.
const KEEP_ALIVE: (Duration, Duration) = (Duration::from_secs(20), Duration::from_secs(10));

/// The largest acknowledgement that is read: a hundred rejections with their reasons for each batch
/// of a wide window.
const MOST_ACKNOWLEDGEMENT_BYTES: usize = 64 << 20;

/// The most that is read of what a service says about its readiness.
const MOST_READINESS_BYTES: usize = 64 << 10;

/// A connection to one service. Cloning is cheap and shares it; it reconnects by itself when it is
/// used again.
#[derive(Debug, Clone)]
pub struct Connection {
    address: String,
    channel: Channel,
    bearer: Bearer,
    heard: Heard,
}

impl Connection {
    /// Connects to `http://127.0.0.1:8080` or `127.0.0.1:8080`, and makes sure that a Nudge answers
    /// there.
    pub async fn open(address: &str) -> Result<Self, ClientError> {
        Self::open_with(address, &Options::default()).await
    }

    /// Connects as [`Connection::open`] does, with a key or by what is said about TLS.
    pub async fn open_with(address: &str, options: &Options) -> Result<Self, ClientError> {
        let connection = Self::dial(&with_scheme(address)?, options).await?;
        connection.probe().await?;
        Ok(connection)
    }

    /// Returns the address with its scheme.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Returns a stub of the service that keeps environments.
    pub fn environments(&self) -> EnvironmentServiceClient<Wire> {
        EnvironmentServiceClient::with_interceptor(self.channel.clone(), self.bearer.clone())
    }

    /// Returns a stub of the service that answers questions.
    pub fn influence(&self) -> InfluenceServiceClient<Wire> {
        InfluenceServiceClient::with_interceptor(self.channel.clone(), self.bearer.clone())
    }

    /// Returns a stub of the service that trains networks.
    pub fn models(&self) -> ModelServiceClient<Wire> {
        ModelServiceClient::with_interceptor(self.channel.clone(), self.bearer.clone())
    }

    /// Returns a stub of the service that takes batches; [`Producer`](super::Producer) speaks to it
    /// well.
    pub fn ingest(&self) -> IngestServiceClient<Wire> {
        IngestServiceClient::with_interceptor(self.channel.clone(), self.bearer.clone())
            .max_decoding_message_size(MOST_ACKNOWLEDGEMENT_BYTES)
    }

    /// Returns an environment by name.
    pub async fn environment(&self, name: &str) -> Result<proto::Environment, ClientError> {
        let ask = || {
            let (mut client, request) = (
                self.environments(),
                proto::GetEnvironmentRequest { name: name.into() },
            );
            async move { client.get_environment(request).await }
        };
        let response: proto::GetEnvironmentResponse = patiently(ask).await?;
        response.environment.ok_or_else(|| {
            ClientError::Disagreement("the service answered without environment".into())
        })
    }

    /// Makes an environment, or confirms that it exists with this very description. Its rule and
    /// its derived features stay as they are where the description says nothing of them.
    pub async fn apply(
        &self,
        name: &str,
        description: impl Into<DescriptionDraft>,
    ) -> Result<(), ClientError> {
        let description: DescriptionDraft = description.into();
        let schema = description.schema.clone();
        let request = proto::ApplyEnvironmentRequest::of_description(name.into(), description);

        let ask = || {
            let (mut client, request) = (self.environments(), request.clone());
            async move { client.apply_environment(request).await }
        };
        match patiently(ask).await {
            Err(ClientError::Refused(refusal)) if refusal.reason == "SCOPE_MISSING" => {
                // A key that may only send finds what another made.
                match self.has_schema(name, &schema).await {
                    true => Ok(()),
                    false => Err(ClientError::Refused(refusal)),
                }
            }
            done => done.map(drop),
        }
    }

    /// Tells whether there is an environment of that name and of this very description.
    async fn has_schema(&self, name: &str, expected: &SchemaDraft) -> bool {
        let found = self.environment(name).await.ok();
        let found = found.and_then(|found| schema_of(&found).ok());
        let expected = Schema::try_from(expected).ok();

        found
            .zip(expected)
            .is_some_and(|(found, expected)| found.hash() == expected.hash())
    }

    async fn dial(address: &str, options: &Options) -> Result<Self, ClientError> {
        let unusable = |why: String| ClientError::Address {
            address: address.into(),
            why,
        };
        if address.starts_with(PLAIN) && options.tls.is_set() {
            return Err(unusable(
                "TLS is asked for (--ca, --cert), expected https://HOST:PORT".into(),
            ));
        }

        let endpoint = Endpoint::from_shared(address.to_owned())
            .map_err(|error| unusable(innermost(&error)))?;
        let (interval, timeout) = KEEP_ALIVE;
        let endpoint = endpoint
            .connect_timeout(CONNECT_TIMEOUT)
            .http2_keep_alive_interval(interval)
            .keep_alive_timeout(timeout);

        let heard = Heard::default();
        let connected = endpoint
            .connect_with_connector(options.tls.connector(address, heard.clone())?)
            .await;
        let channel = connected.map_err(|error| not_connected(address, &error))?;

        Ok(Self {
            address: address.into(),
            channel,
            bearer: options.bearer(),
            heard,
        })
    }

    /// Asks something small that only a Nudge can answer: a connection alone proves nothing.
    async fn probe(&self) -> Result<(), ClientError> {
        let asking = Instant::now();
        loop {
            let mut request = Request::new(proto::ListEnvironmentsRequest {
                page_size: 1,
                page_token: String::new(),
            });
            request.set_timeout(PROBE_TIMEOUT);
            let status = match self.environments().list_environments(request).await {
                Ok(_) => return Ok(()),
                Err(status) => status,
            };

            // Whoever has used up the rate of its key has found a Nudge, and waits.
            let wait = advised(&status).filter(|_| status.code() == Code::ResourceExhausted);
            match wait.filter(|_| asking.elapsed() < PATIENCE) {
                Some(wait) => tokio::time::sleep(wait).await,
                None => return Err(self.not_answered(status)),
            }
        }
    }

    fn not_answered(&self, status: Status) -> ClientError {
        let is_signed = status.get_details_error_info().is_some();
        if let Some(why) = failed_handshake(&status)
            .or_else(|| self.heard.last_words())
            .filter(|_| !is_signed)
        {
            return ClientError::Untrusted {
                address: self.address.clone(),
                why,
            };
        }

        match status.code() {
            _ if is_signed => status.into(),
            Code::Unavailable => unreachable(&self.address, words_of(&status)),
            Code::Unimplemented => {
                let why = "it does not know nudge.v1.EnvironmentService".into();
                ClientError::NotNudge {
                    address: self.address.clone(),
                    why,
                }
            }
            _ => ClientError::NotNudge {
                address: self.address.clone(),
                why: words_of(&status),
            },
        }
    }
}

/// What a service says about itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Readiness {
    /// It is ready.
    Ready,
    /// It answers, and says why it is not ready.
    NotReady(String),
}

/// Asks a service once whether it is ready, as `GET /readyz` does.
pub async fn readiness(address: &str, options: &Options) -> Result<Readiness, ClientError> {
    let Connection {
        address,
        channel,
        heard,
        ..
    } = Connection::dial(&with_scheme(address)?, options).await?;
    let request = http::Request::get("/readyz")
        .body(tonic::body::Body::empty())
        .expect("a path");

    let answer = channel
        .oneshot(request)
        .await
        .map_err(|error| match heard.last_words() {
            Some(why) => ClientError::Untrusted {
                address: address.clone(),
                why,
            },
            None => not_connected(&address, &error),
        })?;

    let status = answer.status();
    let body = Limited::new(answer.into_body(), MOST_READINESS_BYTES)
        .collect()
        .await;
    let words = body.map_or_else(|_| Bytes::new(), |body| body.to_bytes());

    match status.as_u16() {
        200 => Ok(Readiness::Ready),
        503 => Ok(Readiness::NotReady(
            String::from_utf8_lossy(&words).trim().to_owned(),
        )),
        _ => Err(ClientError::NotNudge {
            address,
            why: format!("/readyz answers {status}"),
        }),
    }
}

/// Checks the description that the service keeps of an environment.
pub fn schema_of(environment: &proto::Environment) -> Result<Schema, ClientError> {
    let draft = SchemaDraft::from(environment.schema.clone().unwrap_or_default());
    Schema::try_from(&draft).map_err(|_| unknown_description(environment))
}

/// Checks the derived features that the service keeps of an environment of that schema.
pub fn derived_of(
    environment: &proto::Environment,
    schema: &Schema,
) -> Result<DerivedFeatures, ClientError> {
    let drafts: Vec<DerivedDraft> = environment
        .derived
        .iter()
        .cloned()
        .map(Into::into)
        .collect();
    DerivedFeatures::checked(&drafts, schema).map_err(|_| unknown_description(environment))
}

fn unknown_description(environment: &proto::Environment) -> ClientError {
    let name = &environment.name;
    ClientError::Disagreement(format!(
        "the service describes `{name}` in a way that this client does not know"
    ))
}

fn with_scheme(address: &str) -> Result<String, ClientError> {
    let unusable = |why: &str| {
        Err(ClientError::Address {
            address: address.into(),
            why: why.into(),
        })
    };
    match address.split_once("://") {
        None if address.is_empty() => {
            unusable("it is empty, expected something like http://127.0.0.1:8080")
        }
        None => Ok(format!("http://{address}")),
        Some(("http" | "https", _)) => Ok(address.into()),
        Some((scheme, _)) => unusable(&format!(
            "{scheme} is not spoken, expected http://HOST:PORT or https://HOST:PORT"
        )),
    }
}

fn not_connected(address: &str, error: &tonic::transport::Error) -> ClientError {
    match failed_handshake(error) {
        Some(why) => ClientError::Untrusted {
            address: address.into(),
            why,
        },
        None => unreachable(address, innermost(error)),
    }
}

fn unreachable(address: &str, why: String) -> ClientError {
    ClientError::Unreachable {
        address: address.into(),
        why,
    }
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
        assert_eq!(
            with_scheme("127.0.0.1:8080"),
            Ok("http://127.0.0.1:8080".into())
        );
        assert_eq!(
            with_scheme("http://[::1]:8080"),
            Ok("http://[::1]:8080".into())
        );
        assert_eq!(
            with_scheme("https://nudge:8443"),
            Ok("https://nudge:8443".into())
        );
        for bad in ["", "ftp://example.org", "unix:///tmp/nudge"] {
            assert!(with_scheme(bad).is_err(), "{bad}");
        }
    }
}
