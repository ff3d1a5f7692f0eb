//! Requests of every face as anybody could make them: raw headers, raw messages.

use http::{HeaderMap, HeaderValue};
use http_body_util::{BodyExt, Full};
use nudge::api::proto;
use prost::Message;
use prost_types::field_descriptor_proto::Type;
use prost_types::{DescriptorProto, FileDescriptorSet};
use serde_json::Value;
use tonic::Code;
use tonic::transport::{Channel, Endpoint};
use tonic_types::StatusExt;
use tower::{Service, ServiceExt};

use crate::support::TestApp;

/// How requests travel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Face {
    Rest,
    Grpc,
    GrpcWeb,
}

/// One endpoint of a face: a route of REST, or a method of gRPC.
#[derive(Debug, Clone)]
pub struct Asked {
    pub face: Face,
    /// `GET /v1/environments/{environment}`, or `/nudge.v1.IngestService/Write`.
    pub name: String,
}

/// What came back, the same for every face.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// The HTTP status of REST; for gRPC the one that stands beside its code.
    pub status: u16,
    pub reason: String,
    pub text: String,
    pub headers: HeaderMap,
}

/// Returns the endpoints that are documented: the OpenAPI document, the descriptors of gRPC, and
/// what neither has.
pub async fn endpoints(app: &TestApp) -> Vec<Asked> {
    const UNDOCUMENTED: [&str; 19] = [
        "GET /",
        "GET /docs/",
        "GET /docs/swagger-ui-bundle.js",
        "GET /docs/swagger-initializer.js",
        "GET /openapi.json",
        "GET /livez",
        "GET /readyz",
        "GET /readyz?verbose",
        "GET /metrics",
        "GET /v2",
        "GET /v2/",
        "GET /v2/health/live",
        "GET /v2/health/ready",
        "GET /v2/models/{environment}",
        "GET /v2/models/{environment}/ready",
        "POST /v2/models/{environment}/infer",
        "GET /v2/models/{environment}/versions/{version}",
        "GET /v2/models/{environment}/versions/{version}/ready",
        "POST /v2/models/{environment}/versions/{version}/infer",
    ];
    let document = app.get("/openapi.json").await;
    let paths = document["paths"].as_object().expect("paths");
    let documented = paths.iter().flat_map(|(path, operations)| {
        let methods = operations.as_object().expect("operations").keys();
        methods.map(move |method| format!("{} {path}", method.to_uppercase()))
    });
    let rest = documented
        .chain(UNDOCUMENTED.map(str::to_owned))
        .map(|name| Asked {
            face: Face::Rest,
            name,
        });
    let methods = [Face::Grpc, Face::GrpcWeb].into_iter().flat_map(|face| {
        nudge::api::grpc_methods()
            .into_iter()
            .map(move |name| Asked { face, name })
    });
    let health = ["/grpc.health.v1.Health/Check"].map(|name| Asked {
        face: Face::Grpc,
        name: name.into(),
    });
    let all: Vec<Asked> = rest.chain(methods).chain(health).collect();
    assert!(all.len() > 23 + 19 + 50, "{}", all.len());
    all
}

/// A way to every face of a service.
pub struct Wire<'a> {
    app: &'a TestApp,
    http: reqwest::Client,
}

impl<'a> Wire<'a> {
    pub fn new(app: &'a TestApp) -> Self {
        Self {
            app,
            http: reqwest::Client::new(),
        }
    }

    /// Asks an endpoint about an environment, with these headers.
    pub async fn ask(
        &self,
        endpoint: &Asked,
        environment: &str,
        headers: &[(&str, &[u8])],
    ) -> Answer {
        match endpoint.face {
            Face::Rest => self.rest(&endpoint.name, environment, headers).await,
            Face::Grpc => {
                self.grpc(&endpoint.name, environment, headers, "application/grpc")
                    .await
            }
            Face::GrpcWeb => self.web(&endpoint.name, environment, headers).await,
        }
    }

    async fn rest(&self, route: &str, environment: &str, headers: &[(&str, &[u8])]) -> Answer {
        let (method, path) = route.split_once(' ').expect("a route");
        let path = path
            .replace("{environment}", environment)
            .replace("{producer}", "p");
        let path = path
            .replace("{key}", "0.0")
            .replace("{model}", "1")
            .replace("{version}", "1");
        let request = self
            .http
            .request(method.parse().expect("a method"), self.app.url(&path));
        let request = match method {
            "GET" => request,
            _ if path.ends_with("/import") => request
                .header("content-type", "application/octet-stream")
                .body("x"),
            "PATCH" => request
                .header("content-type", "application/json")
                .body(r#"{"rule": {}}"#),
            _ if path.ends_with("/infer") => request.body(INFER),
            _ => request
                .header("content-type", "application/json")
                .body("{}"),
        };
        match with(request, headers).send().await {
            Ok(response) => Answer::of_rest(response).await,
            Err(error) => Answer::broken(&error.to_string()),
        }
    }

    async fn web(&self, method: &str, environment: &str, headers: &[(&str, &[u8])]) -> Answer {
        let request = self
            .http
            .post(self.app.url(method))
            .header("content-type", "application/grpc-web+proto");
        let response = with(request, headers)
            .body(framed(message(method, environment)))
            .send()
            .await;
        let response = match response {
            Ok(response) => response,
            Err(error) => return Answer::broken(&error.to_string()),
        };
        let (status, mut headers) = (response.status(), response.headers().clone());
        // A call that goes on is let in; a trailer is a frame of its own.
        let body =
            tokio::time::timeout(std::time::Duration::from_millis(300), response.bytes()).await;
        let body = body
            .map(|body| body.unwrap_or_default())
            .unwrap_or_default();
        let text = String::from_utf8_lossy(&body).into_owned();
        for line in text
            .split("\r\n")
            .flat_map(|line| line.rsplit('\0'))
            .filter(|line| line.contains("grpc-"))
        {
            if let Some((name, value)) = line[line.find("grpc-").expect("there")..].split_once(':')
            {
                let name: http::HeaderName = name.parse().expect("a name");
                headers.insert(name, HeaderValue::from_str(value.trim()).expect("a value"));
            }
        }
        Answer::of_grpc(status.as_u16(), headers, text)
    }

    /// Calls a method over HTTP/2 with a content type, whatever that says.
    pub async fn grpc(
        &self,
        method: &str,
        environment: &str,
        headers: &[(&str, &[u8])],
        media: &'static str,
    ) -> Answer {
        let mut endpoint = Endpoint::from_shared(self.app.url("")).expect("an address");
        if let Some((_, host)) = headers.iter().find(|(name, _)| *name == "host") {
            let origin = format!("http://{}", String::from_utf8_lossy(host));
            endpoint = endpoint.origin(origin.parse().expect("an origin"));
        }
        let mut channel: Channel = endpoint.connect().await.expect("the service listens");
        let mut request = http::Request::post(format!("http://x{method}"))
            .header("content-type", media)
            .header("te", "trailers");
        for (name, value) in headers.iter().filter(|(name, _)| *name != "host") {
            request = request.header(*name, HeaderValue::from_bytes(value).expect("a value"));
        }
        let body = tonic::body::Body::new(Full::new(framed(message(method, environment)).into()));
        let request = request.body(body).expect("a request");
        let response = match channel
            .ready()
            .await
            .expect("connected")
            .call(request)
            .await
        {
            Ok(response) => response,
            Err(error) => return Answer::broken(&format!("{error:?}")),
        };
        let (parts, body) = response.into_parts();
        let mut headers = parts.headers;
        let body =
            tokio::time::timeout(std::time::Duration::from_millis(300), body.collect()).await;
        let mut text = String::new();
        if let Ok(Ok(body)) = body {
            headers.extend(body.trailers().cloned().unwrap_or_default());
            text = String::from_utf8_lossy(&body.to_bytes()).into_owned();
        }
        Answer::of_grpc(parts.status.as_u16(), headers, text)
    }
}

/// A request of the inference protocol that is right but for its model.
const INFER: &str = r#"{"inputs":[{"name":"state","datatype":"FP32","shape":[1,2],"data":[1,0]}]}"#;

impl Answer {
    /// Reads what came back over REST or gRPC.
    pub fn from_parts(is_grpc: bool, status: u16, headers: HeaderMap, text: String) -> Self {
        if is_grpc {
            Self::of_grpc(status, headers, text)
        } else {
            Self::of_text(status, headers, text)
        }
    }

    async fn of_rest(response: reqwest::Response) -> Self {
        let (status, headers) = (response.status().as_u16(), response.headers().clone());
        Self::of_text(status, headers, response.text().await.unwrap_or_default())
    }

    fn of_text(status: u16, headers: HeaderMap, text: String) -> Self {
        let told: Value = serde_json::from_str(&text).unwrap_or_default();
        let reason = told["reason"].as_str().unwrap_or_default().to_owned();
        Self {
            status,
            reason,
            text,
            headers,
        }
    }

    fn of_grpc(status: u16, headers: HeaderMap, text: String) -> Self {
        let Some(told) = tonic::Status::from_header_map(&headers) else {
            // No code: REST has answered, or the call goes on.
            let told: Value = serde_json::from_str(&text).unwrap_or_default();
            let reason = told["reason"].as_str().unwrap_or_default().to_owned();
            return Self {
                status,
                reason,
                text,
                headers,
            };
        };
        let status = match told.code() {
            Code::Unauthenticated => 401,
            Code::PermissionDenied => 403,
            Code::ResourceExhausted => 429,
            Code::NotFound => 404,
            _ => status,
        };
        let reason = told
            .get_details_error_info()
            .map(|info| info.reason)
            .unwrap_or_default();
        Self {
            status,
            reason,
            text: format!("{} {text}", told.message()),
            headers,
        }
    }

    fn broken(why: &str) -> Self {
        Self {
            status: 0,
            reason: String::new(),
            text: why.into(),
            headers: HeaderMap::new(),
        }
    }

    /// Returns whether it was let in, whatever became of it then.
    pub fn is_let_in(&self) -> bool {
        ![0, 401, 403, 415, 429].contains(&self.status)
    }
}

fn with(request: reqwest::RequestBuilder, headers: &[(&str, &[u8])]) -> reqwest::RequestBuilder {
    // Each is added, so that there may be several of a name.
    headers.iter().fold(request, |request, (name, value)| {
        request.header(*name, HeaderValue::from_bytes(value).expect("a value"))
    })
}

/// Returns the least message of a method that names an environment: in every one of ours that is
/// the first field, or the first of the first.
pub fn message(method: &str, environment: &str) -> Vec<u8> {
    if method.ends_with("/ModelInfer") {
        return infer(environment);
    }
    let described: FileDescriptorSet = Message::decode(proto::DESCRIPTORS).expect("descriptors");
    let (service, name) = method[1..].split_once('/').expect("a method");
    let file = described.file.iter().find(|file| {
        service.starts_with(file.package())
            && file.service.iter().any(|one| service.ends_with(one.name()))
    });
    let Some(file) = file else { return Vec::new() };
    let method = file
        .service
        .iter()
        .flat_map(|service| &service.method)
        .find(|method| method.name() == name);
    let Some(method) = method else {
        return Vec::new();
    };
    let kind = |path: &str| -> DescriptorProto {
        let name = path.rsplit('.').next().expect("a name");
        let messages = described.file.iter().flat_map(|file| &file.message_type);
        messages
            .clone()
            .find(|message| message.name() == name)
            .expect("described")
            .clone()
    };
    let request = kind(method.input_type());
    let Some(first) = request.field.iter().find(|field| field.number() == 1) else {
        return Vec::new();
    };
    match first.r#type() {
        Type::String => delimited(environment.as_bytes()),
        Type::Message => delimited(&delimited(environment.as_bytes())),
        _ => Vec::new(),
    }
}

fn delimited(bytes: &[u8]) -> Vec<u8> {
    [&[0x0a, bytes.len() as u8], bytes].concat()
}

fn infer(model: &str) -> Vec<u8> {
    use nudge::api::inference_proto::model_infer_request::InferInputTensor;
    use nudge::api::inference_proto::{InferTensorContents, ModelInferRequest};
    let contents = Some(InferTensorContents {
        fp32_contents: vec![1.0, 0.0],
        ..Default::default()
    });
    let (name, datatype) = ("state".into(), "FP32".into());
    let input = InferInputTensor {
        name,
        datatype,
        shape: vec![1, 2],
        contents,
        ..Default::default()
    };
    ModelInferRequest {
        model_name: model.into(),
        inputs: vec![input],
        ..Default::default()
    }
    .encode_to_vec()
}

pub fn framed(message: Vec<u8>) -> Vec<u8> {
    [&[0][..], &(message.len() as u32).to_be_bytes(), &message].concat()
}
