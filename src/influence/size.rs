//! Whether the figures of every ego action can fit into a message, asked before they are made. The rest of an answer is measured when it is encoded.

use crate::api::MOST_MESSAGE_BYTES;
use crate::domain::{Question, Schema, View};
use crate::error::Problem;

/// Bytes of an ego action's figures beside its response.
const ACTION: u64 = 40;

/// Refuses a question for more figures of ego actions than a message holds.
pub fn check(schema: &Schema, question: &Question) -> Result<(), Problem> {
    if question.view != View::Full {
        return Ok(());
    }
    let [ego, other] = [question.scope.pair.ego, question.scope.pair.other].map(|agent| &schema.agents()[agent]);
    let action = other.actions().saturating_mul(8).saturating_add(ACTION);
    let bytes = action.saturating_mul(ego.actions()).saturating_mul(question.states.len() as u64);
    if bytes <= MOST_MESSAGE_BYTES as u64 { Ok(()) } else { Err(crate::api::too_large(question.view)) }
}
