//! Receipts, and how far a producer is.

use serde::Serialize;
use utoipa::ToSchema;

use super::words;
use crate::proto;

/// What became of a batch. It is on stable storage when this is sent.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Receipt {
    /// The batch.
    pub sequence: u64,
    /// `applied` (counted now), `rejected` (every record was: nothing is counted, the number is
    /// used), `duplicate` (counted before; this is the first receipt) or `unverified` (its number
    /// was used so long ago that neither content nor receipt is kept: counted before if the
    /// producer numbers as it should, and lost if it began again at 1; such a producer takes a new
    /// id).
    #[schema(example = "applied", value_type = words::BatchStatus)]
    pub status: &'static str,
    /// Records that were counted.
    pub accepted: u64,
    /// Records that were not.
    pub rejected_count: u64,
    /// The first 100 of those.
    #[schema(max_items = 100)]
    pub rejected: Vec<Rejection>,
    /// True where the figures above are not known, and 0: for `unverified` always, for `duplicate`
    /// where the first receipt cannot be read. Else absent.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    #[schema(required = false)]
    pub unverified: bool,
}

/// A record that was not counted.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Rejection {
    /// Its position in the batch, from 0.
    pub index: u32,
    /// The first field at fault, as a JSON pointer into the record.
    #[schema(example = "/state/distance")]
    pub field: String,
    /// The value that was found and what was expected.
    pub reason: String,
}

/// How far a producer is.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Producer {
    /// The last committed sequence, 0 if there is none. Send what follows it.
    pub committed_sequence: u64,
    /// The environment's uid.
    pub environment_uid: String,
}

impl From<proto::Receipt> for Receipt {
    fn from(receipt: proto::Receipt) -> Self {
        Self {
            sequence: receipt.sequence,
            status: words::batch_status(receipt.status()),
            accepted: receipt.accepted,
            rejected_count: receipt.rejected_count,
            rejected: receipt.rejected.into_iter().map(Into::into).collect(),
            unverified: receipt.unverified,
        }
    }
}

impl From<proto::Rejection> for Rejection {
    fn from(rejection: proto::Rejection) -> Self {
        let proto::Rejection {
            index,
            field,
            reason,
        } = rejection;
        Self {
            index,
            field,
            reason,
        }
    }
}

impl From<proto::GetProducerResponse> for Producer {
    fn from(response: proto::GetProducerResponse) -> Self {
        let proto::GetProducerResponse {
            committed_sequence,
            environment_uid,
        } = response;
        Self {
            committed_sequence,
            environment_uid,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn unverified_is_told_only_when_so() {
        let receipt = proto::Receipt {
            sequence: 3,
            status: proto::BatchStatus::Applied.into(),
            ..Default::default()
        };
        let mut told = Receipt::from(receipt);
        let expected = json!({"sequence": 3, "status": "applied", "accepted": 0, "rejected_count": 0, "rejected": []});
        assert_eq!(serde_json::to_value(&told).expect("JSON"), expected);
        told.unverified = true;
        assert_eq!(
            serde_json::to_value(&told).expect("JSON")["unverified"],
            true
        );
    }
}
