//! Encodes answers about regions: pooled evidence, and what is believed of mean mutual information.

use nudge_core::domain::{AtGrain, RegionAnswer, RegionAnswers, RegionFigures};
use nudge_core::information::pooled::Pooled;

use super::answer::{dependence, interval, version};
use super::profile::null_band;
use crate::proto;

/// Null moments of pooled strata are exact.
const EXACT: &str = "hypergeometric";

impl From<RegionAnswers> for proto::BatchGetInfluenceResponse {
    fn from(answers: RegionAnswers) -> Self {
        Self {
            labels: Some(answers.labels.into()),
            lag: answers.lag,
            answers: answers.answers.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<RegionAnswers> for proto::GetInfluenceResponse {
    fn from(answers: RegionAnswers) -> Self {
        Self {
            labels: Some(answers.labels.into()),
            lag: answers.lag,
            answer: answers.answers.into_iter().next().map(Into::into),
        }
    }
}

impl From<RegionAnswer> for proto::Answer {
    fn from(answer: RegionAnswer) -> Self {
        let by_action = answer.by_action.into_iter().flatten();
        let base = Self {
            region: Some(answer.region.draft().into()),
            region_in_words: answer.region.to_string(),
            visits: answer.tally.n,
            verdict: proto::Verdict::from(answer.verdict).into(),
            basis: proto::Basis::from(answer.basis).into(),
            basis_version: version(answer.basis),
            by_action: by_action.map(Into::into).collect(),
            ..Self::default()
        };
        match answer.figures {
            None => base,
            Some(figures) => Self {
                entries: answer.tally.entries,
                ..with_figures(base, *figures)
            },
        }
    }
}

fn with_figures(base: proto::Answer, figures: RegionFigures) -> proto::Answer {
    let pooled = &figures.pooled;
    let (left_out, stratified) = match figures.grain {
        None => (Vec::new(), None),
        Some(AtGrain {
            left_out,
            stratified,
        }) => (left_out, Some(stratified.into())),
    };
    let mutual_information = proto::MutualInformation {
        posterior_mean: figures.evidence.map(|evidence| evidence.posterior_mean),
        interval: figures.evidence.map(|evidence| interval(evidence.interval)),
        stratified,
        ..mutual_information(pooled)
    };

    proto::Answer {
        unit: figures.unit.as_str().into(),
        threshold: Some(figures.threshold),
        share: figures.share,
        rule: figures.rule.as_str().into(),
        mutual_information: Some(mutual_information),
        lag: Some(figures.lag),
        directed: Some(figures.lag > 0),
        revision: Some(figures.revision),
        independence: figures.independence.as_str().into(),
        dependence: dependence(figures.evidence),
        probability: figures.evidence.map(|evidence| evidence.probability.into()),
        dependent_share: figures
            .evidence
            .map(|evidence| evidence.probability.dependent),
        segmentation: Some(figures.segmentation.into()),
        strata: Some(strata(pooled)),
        p_value: Some(pooled.p_value),
        p_value_same_pattern: pooled.same_pattern.map(|test| test.p_value),
        left_out,
        warnings: figures.warnings,
        fit: Some(figures.fit.into()),
        ..base
    }
}

fn mutual_information(pooled: &Pooled) -> proto::MutualInformation {
    proto::MutualInformation {
        plug_in: pooled.plug_in,
        expected_if_independent: pooled.expected_if_independent,
        expected_method: EXACT.into(),
        excess: Some(pooled.excess),
        null: Some(null_band(pooled)),
        size: Some(pooled.size),
        size_interval: pooled.size_interval.map(Into::into),
        size_interval_new_segments: pooled.size_interval_new_segments.map(Into::into),
        share: Some(pooled.share),
        ..proto::MutualInformation::default()
    }
}

fn strata(pooled: &Pooled) -> proto::Strata {
    proto::Strata {
        states: pooled.states,
        strata: pooled.strata,
        draws: pooled.visits,
        effective_visits: pooled.effective_visits,
    }
}

impl From<Pooled> for proto::Stratified {
    fn from(pooled: Pooled) -> Self {
        Self {
            strata: Some(strata(&pooled)),
            plug_in: pooled.plug_in,
            expected_if_independent: pooled.expected_if_independent,
            excess: pooled.excess,
            null: Some(null_band(&pooled)),
            p_value: pooled.p_value,
            p_value_same_pattern: pooled.same_pattern.map(|test| test.p_value),
            size: pooled.size,
            size_interval: pooled.size_interval.map(Into::into),
            size_interval_new_segments: pooled.size_interval_new_segments.map(Into::into),
            share: pooled.share,
        }
    }
}
