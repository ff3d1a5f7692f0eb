//! An environment of many states: what is asked of all of them is slow, and so is its deletion.

use std::net::SocketAddr;

use serde_json::{Value, json};

/// Enough that they go in many transactions.
pub const STATES: usize = 3_000;

/// Makes the environment, and returns its uid.
pub async fn make(address: SocketAddr) -> String {
    let integer = |name: &str, max: usize| json!({"name": name, "integer": {"min": 0, "max": max}});
    let agent = |name: &str, max: usize| json!({"name": name, "action": [integer("move", max)]});
    let description =
        json!({"state": [integer("place", STATES - 1)], "agents": [agent("a", 1), agent("b", 2)]});
    let url = format!("http://{address}/v1/environments/wide");
    let response = reqwest::Client::new()
        .put(url)
        .json(&description)
        .send()
        .await
        .expect("answered");
    assert!(response.status().is_success(), "{}", response.status());
    let made: Value = response.json().await.expect("JSON");
    made["uid"].as_str().expect("a uid").to_owned()
}

/// Sends a transition of each state.
pub async fn fill(address: SocketAddr) {
    let transition = |place: usize| json!({"state": {"place": place}, "actions": {"a": place % 2, "b": place % 3}});
    let transitions: Vec<Value> = (0..STATES).map(transition).collect();
    let batch = json!({"producer": "p", "sequence": 1, "transitions": transitions});
    let url = format!("http://{address}/v1/environments/wide/transitions");
    let response = reqwest::Client::new()
        .post(url)
        .json(&batch)
        .send()
        .await
        .expect("answered");
    assert_eq!(response.status().as_u16(), 200);
}
