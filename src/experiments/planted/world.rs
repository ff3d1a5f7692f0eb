//! From a drawn world to cases: what is true of each state beside what the service answered.

use super::case::Case;
use super::method::Method;
use crate::domain::draft::{
    AgentDraft, FeatureDraft, KindDraft, PairDraft, QuestionDraft, RuleDraft, SchemaDraft,
};
use crate::domain::{Answer, Entry, Estimator, Label, Record, RuleKind, View};
use crate::error::Problem;
use crate::experiments::service::Service;
use crate::information::Table;
use crate::simulation::planted::{Arm, Generator, Options, Planted, planted};

/// A kind of world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct World {
    /// How its states come about.
    pub generator: Generator,
    /// What is done to them.
    pub arm: Arm,
    /// How many there are.
    pub states: usize,
    /// The percentage of them with influence.
    pub dependent: u32,
}

/// Returns the short name of a generator.
pub fn generator_name(generator: Generator) -> &'static str {
    match generator {
        Generator::Responses => "G1",
        Generator::Joint => "G2",
        Generator::Habits => "G3",
        Generator::TwoByTwo => "2x2",
        Generator::ThreeByTwentyFive => "3x25",
        Generator::Stay95 => "stay95",
        Generator::Stay25 => "stay25",
        Generator::Rare => "rare",
        Generator::EpsilonGreedy => "epsilon-greedy",
        Generator::Copy(25) => "copy25",
        Generator::Copy(_) => "copy",
        Generator::Answer64 => "copy64",
        Generator::Weak(25) => "weak25",
        Generator::Weak(64) => "weak64",
        Generator::Weak(_) => "weak",
        Generator::Masked => "masked",
        Generator::Segments => "segments",
    }
}

/// Returns the name of an arm.
pub fn arm_name(arm: Arm) -> &'static str {
    match arm {
        Arm::Plain => "plain",
        Arm::LeakFree => "leak-free",
        Arm::Shuffled => "shuffled",
    }
}

impl World {
    /// Draws the world, sends it to a service and asks about every state.
    pub async fn cases(&self, seed: u64, methods: &[Method]) -> Result<Vec<Case>, Problem> {
        let dependent = f64::from(self.dependent) / 100.0;
        let drawn = planted(
            self.generator,
            &Options {
                states: self.states,
                dependent,
                arm: self.arm,
                seed,
            },
        );

        let mut service = Service::open(&self.schema()).await?;
        for (segment, records) in sent(&drawn) {
            service.count(segment.as_ref(), &records).await?;
        }

        service.fit().await?;
        let states: Vec<Vec<f32>> = (0..self.states).map(|i| vec![i as f32]).collect();
        let answers = service.ask(&states, &question(methods)).await?;
        let papers = service.ask(&states, &by_the_paper()).await?;
        service.close().await?;
        let case = |((state, answer), paper): ((Planted, Answer), Answer)| Case {
            planted: state.dependent,
            planted_information: state.information,
            information: if self.arm == Arm::Shuffled {
                0.0
            } else {
                state.information
            },
            answer,
            paper: paper.verdict,
        };

        Ok(drawn
            .into_iter()
            .zip(answers)
            .zip(papers)
            .map(case)
            .collect())
    }

    /// Describes the environment: the state is a number, and each agent has one action.
    fn schema(&self) -> SchemaDraft {
        let agent = |name: &str, actions| AgentDraft {
            name: name.into(),
            action: vec![integer("action", actions)],
            ..AgentDraft::default()
        };
        let alphabet = self.generator.alphabet();

        SchemaDraft {
            state: vec![integer("state", self.states as u64)],
            agents: vec![
                agent("ego", alphabet.rows),
                agent("other", alphabet.columns),
            ],
            ..SchemaDraft::default()
        }
    }
}

/// Describes a feature that takes whole numbers from 0.
fn integer(name: &str, values: u64) -> FeatureDraft {
    FeatureDraft {
        name: name.into(),
        unit: None,
        kinds: vec![KindDraft::Integer(0, values as i64 - 1)],
    }
}

/// Returns what is sent: segment after segment where visits were drawn in segments, else everything
/// under none.
fn sent(drawn: &[Planted]) -> Vec<(Option<Label>, Vec<Record>)> {
    let segments = drawn.first().map_or(0, |state| state.segments.len());
    if segments == 0 {
        return vec![(
            None,
            drawn
                .iter()
                .enumerate()
                .flat_map(|(i, state)| records(i, &state.table))
                .collect(),
        )];
    }

    let of = |at: usize| {
        drawn
            .iter()
            .enumerate()
            .flat_map(move |(i, state)| records(i, &state.segments[at]))
    };

    (0..segments)
        .map(|at| (Some(segment(at)), of(at).collect()))
        .collect()
}

fn segment(at: usize) -> Label {
    format!("segment-{at}").parse().expect("a label")
}

/// Returns the records of a state. Every visit was drawn by itself, so each is an entry.
fn records(state: usize, table: &Table) -> impl Iterator<Item = Record> {
    table.cells().iter().map(move |cell| {
        let [ego, other] = [
            table.row_labels()[cell.row as usize],
            table.column_labels()[cell.column as usize],
        ];
        let actions = [ego, other].map(|action| action as f32).to_vec();
        Record {
            entry: Entry::Entered,
            count: cell.n,
            ..Record::new(vec![state as f32], actions)
        }
    })
}

/// Asks what the methods rest on.
fn question(methods: &[Method]) -> QuestionDraft {
    let wanted = |method| methods.contains(&method);
    let estimators = [
        (Method::Excess, Estimator::Excess),
        (Method::Nsb, Estimator::Nsb),
    ];
    let estimators = estimators.into_iter().filter(|(method, _)| wanted(*method));

    QuestionDraft {
        estimators: estimators
            .map(|(_, estimator)| estimator.as_str().into())
            .collect(),
        view: Some(View::Figures.as_str().into()),
        significance: wanted(Method::Permutation).then(|| "pooled".into()),
        ..QuestionDraft::default()
    }
}

fn by_the_paper() -> QuestionDraft {
    let rule = RuleDraft {
        kind: Some(RuleKind::Paper.as_str().into()),
        ..RuleDraft::default()
    };
    let pair = PairDraft {
        rule,
        ..PairDraft::default()
    };
    QuestionDraft {
        pair,
        view: Some(View::Verdict.as_str().into()),
        ..QuestionDraft::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn visits_that_were_drawn_in_segments_are_sent_in_segments() {
        let drawn = planted(
            Generator::Segments,
            &Options {
                states: 2,
                ..Options::default()
            },
        );
        let sent = sent(&drawn);
        let names: Vec<String> = sent
            .iter()
            .flat_map(|(label, _)| label.as_ref().map(Label::to_string))
            .collect();
        assert_eq!(
            (names[0].as_str(), names[7].as_str(), names.len()),
            ("segment-0", "segment-7", 8)
        );
        for (_, records) in &sent {
            assert_eq!(
                records.iter().map(|record| record.count).sum::<u64>(),
                2 * 40
            );
        }
    }
}
