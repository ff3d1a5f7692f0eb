//! The assessment of one state by its counts: its tables, what the evidence says of them, and the
//! verdict. Where the counts do not decide, a network's prediction may.

use super::policy_segments::PolicySegments;
use crate::domain::{
    Basis, Cell, Counts, Dependence, Evidence, Probability, Rule, RuleKind, Schema, Scope,
    SegmentId, Segmentation, StateKey, Tally, Verdict, View,
};
use crate::evidence::{self, Believed, PolicyBelief, PolicyPosterior, RegionState};
use crate::information::{self, ExpectedMethod, Table, plug_in};
use crate::model::{Network, Prediction};
use crate::priors::{
    self, EvidenceInputs, Informed, Observations, PassEvidence, StateEvidence, Tables,
};

/// What assesses states: a schema, a question's scope, the fitted prior that the evidence rests on,
/// and the network that is asked where the counts do not decide.
#[derive(Clone, Copy)]
pub struct Assessor<'a> {
    pub schema: &'a Schema,
    pub scope: &'a Scope,
    /// The segments to count; all if `None`.
    pub segments: Option<&'a [SegmentId]>,
    /// Whose habits weigh the ego's actions.
    pub policy: &'a PolicySegments,
    pub informed: Option<&'a Informed>,
    /// Who is asked where the counts do not decide.
    pub network: Option<&'a Network>,
    /// Whether figures are wanted: a verdict by the paper's rule needs no evidence.
    pub view: View,
    /// Which evidence is remembered.
    pub memory: Memory<'a>,
}

/// Which evidence is remembered (memoisation).
#[derive(Clone, Copy)]
pub enum Memory<'a> {
    /// None: that of a choice of segments, which few ask about again.
    Nothing,
    /// That of states, with all their segments, which many ask about again.
    States,
    /// That of equal counts, in a pass over all states.
    Counts(&'a PassEvidence),
}

/// What was found about one state, in nats.
pub struct Assessment {
    /// The sum of its cells.
    pub tally: Tally,
    /// How many segments have visits here.
    pub segments: u64,
    /// Plug-in mutual information.
    pub plug_in: f64,
    /// Its mean under independence, and how that was computed; `None` in the view `verdict`.
    pub expected: Option<(f64, ExpectedMethod)>,
    /// What its counts support; `None` where nobody asks, or the alphabets are too large.
    pub evidence: Option<Evidence>,
    /// The verdict.
    pub verdict: Verdict,
    /// What it rests on.
    pub basis: Basis,
}

impl Assessment {
    /// Returns which segments the counts come from, and whether habits differ by them.
    pub fn segmentation(&self) -> Segmentation {
        Segmentation {
            count: self.segments,
            differ: self.evidence.and_then(|evidence| evidence.differ),
        }
    }
}

impl Assessor<'_> {
    /// Returns what the network says of states; `None` where there is none.
    pub fn predictions(&self, keys: &[StateKey]) -> Vec<Option<Prediction>> {
        let Some(network) = self.network else {
            return vec![None; keys.len()];
        };
        let threshold = self.scope.rule.threshold_nats();
        let predictions = match self.memory {
            Memory::States => network.predict(keys, threshold),
            Memory::Nothing | Memory::Counts(_) => network.predict_once(keys, threshold),
        };
        predictions.into_iter().map(Some).collect()
    }

    /// Assesses a state by its counts, and where they do not decide, by what the network says of it.
    pub fn assess(
        &self,
        key: &StateKey,
        counts: &Counts,
        predicted: Option<Prediction>,
    ) -> Assessment {
        let rule = &self.scope.rule;
        let cells = || counts.of_pair(self.schema, &self.scope.pair, self.segments);
        let tally = Tally::sum(cells());

        // What the network says is held against the evidence, whatever the rule and the view.
        let is_wanted =
            self.view != View::Verdict || rule.kind == RuleKind::Evidence || self.network.is_some();
        let wanted = self.informed.filter(|_| is_wanted);
        let found = wanted.map(|informed| self.remembered(informed, key, tally, counts));
        let (segments, plug_in, expected) = match &found {
            Some(found) => (found.segments, found.plug_in, Some(found.expected)),
            None => {
                let tables = self.tables(cells());
                let expected =
                    (self.view != View::Verdict).then(|| tables.expected_if_independent());
                (tables.segments, tables.figure(plug_in), expected)
            }
        };
        let evidence = found.map(|found| found.evidence);

        let visits = tally.n;
        let believed = found.as_ref().map(|found| &found.believed);
        let counted = self.decide(rule.kind, visits, plug_in, believed);
        let predicted = match counted {
            Verdict::Undecided => {
                let settled = self.decide(RuleKind::Evidence, visits, plug_in, believed);
                self.predicted_verdict(settled, evidence, predicted)
            }
            _ => None,
        };

        let (verdict, basis) = predicted.unwrap_or((counted, evidence::basis(visits)));
        Assessment {
            tally,
            segments,
            plug_in,
            expected: expected.filter(|_| self.view != View::Verdict),
            evidence,
            verdict,
            basis,
        }
    }

    /// Returns what a state with these cells adds to what is believed of a region, and P(habits differ
    /// by segment) where that is known; `None` where the alphabets are too large for evidence.
    pub fn region_state(
        &self,
        tally: Tally,
        counts: &Counts,
    ) -> Option<(RegionState, Option<f64>)> {
        let informed = self.informed?;
        let Scope { pair, within, .. } = self.scope;
        let cells = || counts.of_pair(self.schema, pair, self.segments);
        let tables = self.tables(cells());
        let observations = tables.observations(self.schema, pair, *within, cells());

        let posterior = informed
            .prior
            .posterior(&informed.habits, observations.counted());
        let differ = posterior.by_segment().map(|by_segment| by_segment.differ);
        let state = match self.habits(counts) {
            None => RegionState::new(tally.n, &posterior),
            Some(done) => {
                let (policy, _) = self.weights(informed, &done);
                self.policy_posterior(informed, &observations, &policy)
                    .region_state(tally.n)
            }
        };
        Some((state, differ))
    }

    /// Returns the verdict of the counts by a kind of rule.
    fn decide(
        &self,
        kind: RuleKind,
        visits: u64,
        plug_in: f64,
        believed: Option<&Believed>,
    ) -> Verdict {
        let rule = Rule {
            kind,
            ..self.scope.rule
        };
        match self.is_open() {
            true => evidence::decide(&rule, visits, plug_in, believed),
            false => Verdict::Undecided,
        }
    }

    /// Returns the verdict of the network, if it can tell anything of this state at this threshold
    /// and does not say what the counts exclude: many visits may be too sure of the answer to have
    /// moved a prior that was as sure, and the paper's rule may be open where the evidence has
    /// `settled` it.
    fn predicted_verdict(
        &self,
        settled: Verdict,
        evidence: Option<Evidence>,
        predicted: Option<Prediction>,
    ) -> Option<(Verdict, Basis)> {
        let (network, predicted) = (self.network?, predicted?);
        if !self.is_open() || !network.can_decide(&predicted) {
            return None;
        }

        let threshold = self.scope.rule.threshold_nats();
        let unseen = self.informed?.unseen(threshold).above;
        let verdict = network.decide(&predicted, self.scope.rule.confidence, unseen);

        let [lower, upper] = evidence.map_or([f64::NEG_INFINITY, f64::INFINITY], |evidence| {
            evidence.interval
        });
        let is_independent =
            evidence.is_some_and(|evidence| evidence.dependence == Dependence::Excluded);

        let is_excluded = match verdict {
            Verdict::Influences => {
                upper < threshold || is_independent || settled == Verdict::NoInfluence
            }
            Verdict::NoInfluence => lower > threshold || settled == Verdict::Influences,
            Verdict::Undecided => false,
        };
        (!is_excluded).then_some((verdict, Basis::Model(network.version)))
    }

    /// Returns whether there is anything to decide: where one of the two agents has a single
    /// action, neither rule tells more than that.
    pub fn is_open(&self) -> bool {
        self.scope.pair.alphabet(self.schema).largest_information() > 0.0
    }

    /// Returns the tables of a state by its cells.
    pub fn tables<'c>(&self, cells: impl Iterator<Item = &'c Cell> + Clone) -> Tables {
        Tables::within(self.schema, &self.scope.pair, self.scope.within, cells)
    }

    fn remembered(
        &self,
        informed: &Informed,
        key: &StateKey,
        tally: Tally,
        counts: &Counts,
    ) -> StateEvidence {
        let find = || self.weigh(informed, counts);
        match self.memory {
            Memory::Nothing => find(),
            Memory::Counts(memory) => {
                let cells = counts.of_pair(self.schema, &self.scope.pair, self.segments);
                memory.get_or_find(cells, find)
            }
            Memory::States => {
                let inputs = EvidenceInputs {
                    tally,
                    revision: informed.revision,
                    threshold: self.scope.rule.threshold_nats(),
                    within: self.scope.within,
                    ego: priors::ego(&self.scope.pair),
                };
                informed.evidence_cache.get_or_find(key, inputs, find)
            }
        }
    }

    /// Returns what the counts of a state support and show, in nats.
    fn weigh(&self, informed: &Informed, counts: &Counts) -> StateEvidence {
        let Scope { pair, within, .. } = self.scope;
        let cells = || counts.of_pair(self.schema, pair, self.segments);
        let tables = self.tables(cells());
        let observations = tables.observations(self.schema, pair, *within, cells());
        let (evidence, believed) = self.weigh_evidence(informed, &observations);

        let seen = StateEvidence {
            segments: tables.segments,
            plug_in: tables.figure(plug_in),
            expected: tables.expected_if_independent(),
            evidence,
            believed,
        };
        match self.habits(counts) {
            None => seen,
            Some(done) => self.under_policy(informed, &done, &tables, &observations, seen),
        }
    }

    /// Returns what the ego did in a state where the policy looks, as rows; `None` where the policy is
    /// the one that was seen in all counts.
    fn habits(&self, counts: &Counts) -> Option<Table> {
        let pair = &self.scope.pair;
        let of_ego = |segments: Option<&[SegmentId]>, left_out: &[SegmentId]| {
            let cells = counts.of_pair(self.schema, pair, segments);
            let cells = cells.filter(|cell| !left_out.contains(&cell.segment));
            Tables::of_ego(self.schema, pair, cells)
        };
        match self.policy {
            PolicySegments::Observed => None,
            PolicySegments::Uniform => Some(Table::default()),
            PolicySegments::Within(segments) => Some(of_ego(Some(segments), &[])),
            PolicySegments::Outside(explored) => {
                let is_explored = |cell: &Cell| explored.contains(&cell.segment);
                let mut counted = counts.of_pair(self.schema, pair, self.segments);
                counted.any(is_explored).then(|| of_ego(None, explored))
            }
        }
    }

    /// Returns the policy of an ego that did this in a state, and how it weighs tables.
    fn weights<'t>(
        &self,
        informed: &Informed,
        done: &'t Table,
    ) -> (PolicyBelief, information::policy::Policy<'t>) {
        let (prior, ego) = (&informed.prior, priors::ego(&self.scope.pair));
        match self.policy {
            PolicySegments::Uniform => {
                let actions = self.scope.pair.alphabet(self.schema).rows;
                (
                    prior.uniform_policy(&informed.habits, ego),
                    information::policy::Policy::Uniform { actions },
                )
            }
            _ => (
                prior.policy_seen(&informed.habits, ego, done),
                information::policy::Policy::Habits(done),
            ),
        }
    }

    /// Returns what a state supports and shows under the question's policy, beside what it does under
    /// the one that was seen.
    fn under_policy(
        &self,
        informed: &Informed,
        done: &Table,
        tables: &Tables,
        observations: &Observations<'_>,
        seen: StateEvidence,
    ) -> StateEvidence {
        /// Of permutations: what they show depends on nothing else.
        const SEED: u64 = 1;
        let (policy, weights) = self.weights(informed, done);
        let posterior = self.policy_posterior(informed, observations, &policy);

        let [plug_in, expected] = tables.under_policy(weights, SEED);
        let believed = Believed {
            now: posterior.beliefs(self.scope.rule.threshold_nats()),
            ..seen.believed
        };
        StateEvidence {
            plug_in,
            expected: (expected, ExpectedMethod::Permutation),
            evidence: Evidence {
                probability: Probability {
                    dependent: believed.now.dependent,
                    above_threshold: believed.now.above,
                },
                posterior_mean: posterior.mean(),
                interval: posterior.interval(),
                ..seen.evidence
            },
            believed,
            ..seen
        }
    }

    fn policy_posterior(
        &self,
        informed: &Informed,
        observations: &Observations<'_>,
        policy: &PolicyBelief,
    ) -> PolicyPosterior {
        let (habits, ego) = (&informed.habits, priors::ego(&self.scope.pair));
        let counted = observations.counted();
        informed.prior.under_policy(habits, counted, ego, policy)
    }

    /// Returns what the observations of a state support, in nats: as it is told, and as it decides.
    fn weigh_evidence(
        &self,
        informed: &Informed,
        observations: &Observations<'_>,
    ) -> (Evidence, Believed) {
        let threshold = self.scope.rule.threshold_nats();
        let posterior = informed
            .prior
            .posterior(&informed.habits, observations.counted());
        let believed = Believed::new(
            posterior.beliefs(threshold),
            informed.unseen(threshold),
            &observations.strata,
        );
        let evidence = Evidence {
            dependence: evidence::dependence(&believed),
            probability: Probability {
                dependent: believed.now.dependent,
                above_threshold: believed.now.above,
            },
            // A negative zero would be told as "-0".
            posterior_mean: posterior.mean() + 0.0,
            interval: posterior.interval(),
            differ: posterior.by_segment().map(|by_segment| by_segment.differ),
            pooled: posterior.by_segment().map(|by_segment| by_segment.pooled),
        };
        (evidence, believed)
    }
}
