//! Policies: whose habits weigh the ego's actions in a question.

use super::Label;
use super::draft::PolicyDraft;
use crate::error::Fault;

/// Whose habits weigh the ego's actions.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub enum Policy {
    /// Those that were seen in what is asked about.
    #[default]
    Observed,
    /// Nobody's: every action in use alike.
    Uniform,
    /// Those seen in these segments, each once and in order; responses are from all visits.
    Segments(Vec<Label>),
    /// Those seen outside of these segments, where a rule says that agents explored in them: what
    /// they tried there was no habit of theirs.
    Outside(Vec<Label>),
}

impl Policy {
    /// Returns the policy that a draft means, or every fault by its pointer, `/policy/segments/1`.
    pub fn checked(draft: &PolicyDraft) -> Result<Self, Vec<Fault>> {
        match draft {
            PolicyDraft::Word(word) => match word.as_str() {
                "observed" => Ok(Self::Observed),
                "uniform" => Ok(Self::Uniform),
                _ => {
                    let detail = format!(
                        "got {word:?}, expected observed, uniform or an object of segments"
                    );
                    Err(vec![Fault::new("/policy", detail)])
                }
            },
            PolicyDraft::Segments(named) => Self::of_segments(named),
        }
    }

    fn of_segments(named: &[String]) -> Result<Self, Vec<Fault>> {
        let (mut segments, mut faults) = (Vec::<Label>::new(), Vec::new());
        for (at, text) in named.iter().enumerate() {
            match text.parse() {
                Ok(label) => segments.push(label),
                Err(detail) => {
                    faults.push(Fault::new(format!("/policy/segments/{at}"), detail));
                }
            }
        }
        if named.is_empty() {
            faults.push(Fault::new(
                "/policy/segments",
                "got none, expected one or more",
            ));
        }
        segments.sort_unstable();
        segments.dedup();
        match faults.is_empty() {
            true => Ok(Self::Segments(segments)),
            false => Err(faults),
        }
    }

    /// Returns the policy of questions that name none, where agents explored in these segments.
    pub fn unless_exploring(exploration: &[Label]) -> Self {
        match exploration {
            [] => Self::Observed,
            explored => Self::Outside(explored.to_vec()),
        }
    }
}
