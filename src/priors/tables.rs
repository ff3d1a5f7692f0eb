//! Contingency tables of the cells of a state that tell of a pair: whole, and stratified by the
//! joint action of the agents held fixed, and by segment.

use std::borrow::Cow;

use crate::domain::{Cell, Exchange, Independence, Pair, Schema, SegmentId, Tally, Within};
use crate::evidence::{self, Ego};
use crate::information::{self, ExpectedMethod, Table, pooled};

/// The tables of one state for one pair.
pub struct Tables {
    /// Over all cells; rows are the ego's actions.
    pub whole: Table,
    /// How many segments have visits here.
    pub segments: u64,
    /// The strata: one for each joint action of the agents held fixed, in their order; empty where
    /// none is.
    strata: Vec<Table>,
    /// The same cut further by segment, where figures are means over segments and there are
    /// several; else empty.
    by_segment: Vec<Table>,
}

/// The observations that the evidence about a state rests on, as independent draws: rows for the
/// earlier agent.
#[derive(Debug, Clone)]
pub struct Observations<'a> {
    /// The strata: a table for each joint action of the agents held fixed.
    pub strata: Cow<'a, [Table]>,
    /// The parts by segment of those strata that can tell dependence from independence; none where
    /// there is one segment, or segments are of no concern.
    parts: Vec<Table>,
}

/// A stratum of one state.
#[derive(Debug, Clone, PartialEq)]
pub struct Stratum {
    /// The joint action of what is held fixed.
    pub held: u64,
    /// The segment; 0 where segments are pooled.
    pub segment: SegmentId,
    /// Its draws, rows for the ego.
    pub table: Table,
}

impl Stratum {
    /// Returns it as a pool takes it, of the state with this number.
    pub fn of_state(&self, state: u64) -> pooled::Stratum<'_> {
        pooled::Stratum {
            state,
            segment: self.segment.0.unsigned_abs(),
            table: &self.table,
        }
    }
}

impl Observations<'_> {
    /// Returns them as the evidence takes them.
    pub fn counted(&self) -> evidence::Counted<'_> {
        evidence::Counted {
            slices: &self.strata,
            parts: &self.parts,
        }
    }

    /// Returns how many tables they are.
    pub fn tables(&self) -> usize {
        self.strata.len() + self.parts.len()
    }

    /// Returns the same for those who keep them.
    pub fn into_owned(self) -> Observations<'static> {
        Observations {
            strata: self.strata.into_owned().into(),
            parts: self.parts,
        }
    }
}

/// Returns where the ego of a pair stands in the tables of its observations.
pub fn ego(pair: &Pair) -> Ego {
    if pair.ego < pair.other || pair.later.is_some() {
        Ego::Rows
    } else {
        Ego::Columns
    }
}

impl Tables {
    /// Builds the tables of these cells; figures are of the pooled ones.
    pub fn new<'a>(
        schema: &Schema,
        pair: &Pair,
        cells: impl Iterator<Item = &'a Cell> + Clone,
    ) -> Self {
        Self::within(schema, pair, Within::default(), cells)
    }

    /// Builds the tables of these cells; figures are within what is said.
    pub fn within<'a>(
        schema: &Schema,
        pair: &Pair,
        within: Within,
        cells: impl Iterator<Item = &'a Cell> + Clone,
    ) -> Self {
        let whole = Table::from_counts(
            cells
                .clone()
                .map(|cell| counted(schema, pair, cell, visits)),
        );
        let strata = pair
            .is_conditional(schema)
            .then(|| tables_of_strata(schema, pair, cells.clone(), visits, no_more));

        let segments = segments(cells.clone().map(|cell| cell.segment));
        // Within the only segment everything is what it is pooled.
        let is_cut = within == Within::Segments && segments > 1;
        let by_segment = is_cut.then(|| tables_of_strata(schema, pair, cells, visits, by_segment));

        Self {
            whole,
            segments,
            strata: strata.unwrap_or_default(),
            by_segment: by_segment.unwrap_or_default(),
        }
    }

    /// Returns the strata of a conditional independence test: tables of what counts as independent
    /// draws, rows for the earlier agent, one for each joint action of the agents held fixed. Draws
    /// are entries where every transition carried the flag, else visits.
    pub fn strata_of_observations<'a>(
        &self,
        schema: &Schema,
        pair: &Pair,
        cells: impl Iterator<Item = &'a Cell> + Clone,
    ) -> Cow<'_, [Table]> {
        let undirected = pair.undirected();
        let independence = Independence::from(Tally::sum(cells.clone()));
        match (independence, undirected == *pair, self.strata.is_empty()) {
            (Independence::Assumed, true, true) => std::slice::from_ref(&self.whole).into(),
            (Independence::Assumed, true, false) => self.strata.as_slice().into(),
            _ => {
                tables_of_strata(schema, &undirected, cells, observed(independence), no_more).into()
            }
        }
    }

    /// Returns the strata of what counts as independent draws, rows for the ego: one for each joint
    /// action of what is held fixed, cut by segment too unless segments are to be pooled.
    pub fn strata_within<'a>(
        schema: &Schema,
        pair: &Pair,
        within: Within,
        cells: impl Iterator<Item = &'a Cell> + Clone,
    ) -> Vec<Stratum> {
        let count = observed(Independence::from(Tally::sum(cells.clone())));
        let cut = match within {
            Within::Pooled => stratified(schema, pair, cells, count, no_more),
            Within::Auto | Within::Segments => stratified(schema, pair, cells, count, by_segment),
        };
        let stratum = |((held, segment), table): (StratumKey, Table)| Stratum {
            held,
            segment: segment.unwrap_or(POOLED),
            table,
        };
        cut.into_iter().map(stratum).collect()
    }

    /// Returns what counts as independent draws of the ego's actions, as rows.
    pub fn of_ego<'a>(
        schema: &Schema,
        pair: &Pair,
        cells: impl Iterator<Item = &'a Cell> + Clone,
    ) -> Table {
        let count = observed(Independence::from(Tally::sum(cells.clone())));
        Table::from_counts(cells.map(|cell| (pair.actions(schema, cell).0, 0, count(cell))))
    }

    /// Returns the strata of observations cut by segment, rows for the earlier agent.
    pub fn strata_by_segment<'a>(
        schema: &Schema,
        pair: &Pair,
        cells: impl Iterator<Item = &'a Cell> + Clone,
    ) -> Vec<Table> {
        let count = observed(Independence::from(Tally::sum(cells.clone())));
        tables_of_strata(schema, &pair.undirected(), cells, count, by_segment)
    }

    /// Returns the strata within which a permutation test may exchange draws, without any other
    /// table: who tests thousands of conditions on one state needs no more.
    pub fn exchangeable_alone<'a>(
        schema: &Schema,
        pair: &Pair,
        exchange: Exchange,
        cells: impl Iterator<Item = &'a Cell> + Clone,
    ) -> Vec<Table> {
        let is_cut = exchange == Exchange::WithinSegments
            && segments(cells.clone().map(|cell| cell.segment)) > 1;
        if is_cut {
            return Self::strata_by_segment(schema, pair, cells);
        }
        let count = observed(Independence::from(Tally::sum(cells.clone())));
        tables_of_strata(schema, &pair.undirected(), cells, count, no_more)
    }

    /// Returns the strata within which a permutation test may exchange draws: cut by segment or
    /// not.
    pub fn exchangeable<'a>(
        &self,
        schema: &Schema,
        pair: &Pair,
        exchange: Exchange,
        cells: impl Iterator<Item = &'a Cell> + Clone,
    ) -> Cow<'_, [Table]> {
        match exchange {
            Exchange::WithinSegments if self.segments > 1 => {
                Self::strata_by_segment(schema, pair, cells).into()
            }
            Exchange::WithinSegments | Exchange::Pooled => {
                self.strata_of_observations(schema, pair, cells)
            }
        }
    }

    /// Returns the observations that the evidence rests on: the pooled ones, with their parts by
    /// segment unless they are to be pooled.
    pub fn observations<'a>(
        &self,
        schema: &Schema,
        pair: &Pair,
        within: Within,
        cells: impl Iterator<Item = &'a Cell> + Clone,
    ) -> Observations<'_> {
        let strata = self.strata_of_observations(schema, pair, cells.clone());

        let is_cut = within != Within::Pooled
            && self.segments > 1
            && strata.iter().any(|stratum| !stratum.is_line());
        let parts = if is_cut {
            telling(&strata, Self::strata_cut(schema, pair, cells))
        } else {
            Vec::new()
        };
        Observations { strata, parts }
    }

    /// Returns the observations cut by segment, stratum by stratum, but for segments without any.
    fn strata_cut<'a>(
        schema: &Schema,
        pair: &Pair,
        cells: impl Iterator<Item = &'a Cell> + Clone,
    ) -> Vec<Vec<Table>> {
        let count = observed(Independence::from(Tally::sum(cells.clone())));
        let cut = stratified(schema, &pair.undirected(), cells, count, by_segment);
        let by_stratum = cut.chunk_by(|((a, _), _), ((b, _), _)| a == b);
        let parts = |stratum: &[(StratumKey, Table)]| {
            stratum
                .iter()
                .map(|(_, part)| part.clone())
                .filter(|part| part.total() > 0)
                .collect()
        };
        by_stratum.map(parts).collect()
    }

    /// Returns the tables that figures are a mean over; none where they are of the whole.
    fn averaged(&self) -> &[Table] {
        if self.by_segment.is_empty() {
            &self.strata
        } else {
            &self.by_segment
        }
    }

    /// Returns a figure of the table, or its mean over the strata where agents are held fixed, or
    /// over segments where it is within them.
    pub fn figure(&self, figure: impl Fn(&Table) -> f64) -> f64 {
        match self.averaged() {
            [] => figure(&self.whole),
            tables => information::conditional(tables, figure),
        }
    }

    /// Returns plug-in mutual information under a policy in nats, and its mean under independence.
    pub fn under_policy(&self, policy: information::policy::Policy<'_>, seed: u64) -> [f64; 2] {
        let expected = |table: &Table| match table.total() {
            0 => 0.0,
            n => information::policy::null_under_policy(table, policy, seed).mean / n as f64,
        };
        [
            self.figure(|table| information::policy::under_policy(table, policy).information),
            self.figure(expected),
        ]
    }

    /// Returns the mean of plug-in mutual information under independence, in nats, and how it was
    /// computed.
    pub fn expected_if_independent(&self) -> (f64, ExpectedMethod) {
        let averaged = self.averaged();
        if averaged.is_empty() {
            return information::expected_if_independent(&self.whole);
        }
        let mut method = ExpectedMethod::Hypergeometric;
        let mean = information::conditional(averaged, |stratum| {
            let (expected, of_stratum) = information::expected_if_independent(stratum);
            if of_stratum == ExpectedMethod::Asymptotic {
                method = of_stratum;
            }
            expected
        });
        (mean, method)
    }

    /// Returns the plug-in divergence of the ego's action at a row of the whole table, in nats: its
    /// mean over the strata or segments, weighted by how often the action was seen in each, so that
    /// plug-in mutual information is its mean over the ego's actions.
    pub fn divergence(&self, row: usize) -> f64 {
        let averaged = self.averaged();
        if averaged.is_empty() {
            return information::divergence(&self.whole, row);
        }
        let label = self.whole.row_labels()[row];
        let parts = averaged.iter().filter_map(|stratum| {
            let at = stratum.row_labels().binary_search(&label).ok()?;
            Some(stratum.rows()[at] as f64 * information::divergence(stratum, at))
        });
        parts.sum::<f64>() / self.whole.rows()[row] as f64
    }
}

/// The row, the column and the count of a cell of a table.
type Counted = (u64, u64, u64);

/// What a stratum is of: the joint action of the agents held fixed, and what it is cut by further.
type StratumKey = (u64, Option<SegmentId>);

/// The segment of strata that are not cut by it.
const POOLED: SegmentId = SegmentId(0);

fn visits(cell: &Cell) -> u64 {
    cell.tally.n
}

/// Returns how many segments are named, some of them often.
fn segments(mut named: impl Iterator<Item = SegmentId>) -> u64 {
    let Some(first) = named.next() else { return 0 };
    // Most states have one, and are asked about by the million.
    let mut others: Vec<SegmentId> = named.filter(|segment| *segment != first).collect();
    others.sort_unstable();
    others.dedup();
    1 + others.len() as u64
}

/// Returns the parts of those strata that can tell dependence from independence; none where each
/// has a single one.
fn telling(strata: &[Table], parts: Vec<Vec<Table>>) -> Vec<Table> {
    let telling = strata
        .iter()
        .zip(parts)
        .filter(|(stratum, _)| !stratum.is_line())
        .map(|(_, parts)| parts);
    let telling: Vec<Vec<Table>> = telling.collect();
    if telling.iter().all(|parts| parts.len() < 2) {
        Vec::new()
    } else {
        telling.concat()
    }
}

fn observed(independence: Independence) -> impl Fn(&Cell) -> u64 + Copy {
    move |cell| match independence {
        Independence::Entries => cell.tally.entries.unwrap_or(0),
        Independence::Assumed => cell.tally.n,
    }
}

/// Returns a table for each joint action of the agents held fixed and each value of `further`, in
/// their order.
fn tables_of_strata<'a>(
    schema: &Schema,
    pair: &Pair,
    cells: impl Iterator<Item = &'a Cell>,
    count: impl Fn(&Cell) -> u64 + Copy,
    further: impl Fn(&Cell) -> Option<SegmentId>,
) -> Vec<Table> {
    stratified(schema, pair, cells, count, further)
        .into_iter()
        .map(|(_, table)| table)
        .collect()
}

/// Returns the same with what each is of.
fn stratified<'a>(
    schema: &Schema,
    pair: &Pair,
    cells: impl Iterator<Item = &'a Cell>,
    count: impl Fn(&Cell) -> u64 + Copy,
    further: impl Fn(&Cell) -> Option<SegmentId>,
) -> Vec<(StratumKey, Table)> {
    let of = |cell: &Cell| {
        (
            (pair.stratum(schema, cell), further(cell)),
            counted(schema, pair, cell, count),
        )
    };

    let mut counted: Vec<(StratumKey, Counted)> = cells.map(of).collect();
    counted.sort_by_key(|(stratum, _)| *stratum);
    let strata = counted.chunk_by(|(a, _), (b, _)| a == b);
    strata
        .map(|of| {
            (
                of[0].0,
                Table::from_counts(of.iter().map(|(_, counted)| *counted)),
            )
        })
        .collect()
}

fn by_segment(cell: &Cell) -> Option<SegmentId> {
    Some(cell.segment)
}

fn no_more(_: &Cell) -> Option<SegmentId> {
    None
}

fn counted(schema: &Schema, pair: &Pair, cell: &Cell, count: impl Fn(&Cell) -> u64) -> Counted {
    let (ego, other) = pair.actions(schema, cell);
    (ego, other, count(cell))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft};
    use crate::domain::{Counts, Family, SchemaDraft};

    /// Returns a schema of agents with so many actions each.
    fn schema(actions: &[i64]) -> Schema {
        let feature = |name: &str, max| FeatureDraft {
            name: name.into(),
            unit: None,
            kinds: vec![KindDraft::Integer(0, max)],
        };
        let agent = |(at, actions): (usize, &i64)| AgentDraft {
            name: format!("agent{at}"),
            action: vec![feature("move", actions - 1)],
            ..AgentDraft::default()
        };
        let agents = actions.iter().enumerate().map(agent).collect();
        Schema::try_from(&SchemaDraft {
            state: vec![feature("place", 9)],
            agents,
            ..SchemaDraft::default()
        })
        .expect("valid")
    }

    fn pair(ego: usize, other: usize, given: &[usize]) -> Pair {
        Pair::new(ego, other, given.to_vec())
    }

    fn cell(joint: u64, segment: i64, n: u64, entries: impl Into<Option<u64>>) -> Cell {
        Cell {
            joint,
            segment: SegmentId(segment),
            tally: Tally {
                n,
                entries: entries.into(),
            },
        }
    }

    /// Returns what is told of each cell of a table: its labels and its count.
    fn counts(table: &Table) -> Vec<Counted> {
        let labels = |cell: &information::Occupied| {
            (
                table.row_labels()[cell.row as usize],
                table.column_labels()[cell.column as usize],
                cell.n,
            )
        };
        table.cells().iter().map(labels).collect()
    }

    /// Two segments of two agents with two actions, opposite in their habits, each exactly
    /// independent.
    fn opposite() -> Vec<Cell> {
        let n = [[81, 1], [9, 9], [9, 9], [1, 81]];
        let cells = n
            .into_iter()
            .zip(0..)
            .flat_map(|(n, joint)| [cell(joint, 3, n[0], None), cell(joint, 7, n[1], None)]);
        cells.collect()
    }

    /// Returns a schema of agents with so many actions each, which may be absent, and are observed at
    /// these lags.
    fn later(actions: &[i64], lags: &[i64]) -> Schema {
        let mut draft = schema(actions).draft();
        let may = |agent: &mut AgentDraft| agent.may_be_absent = true;
        draft.agents.iter_mut().for_each(may);
        draft.lags = lags.to_vec();
        Schema::try_from(&draft).expect("valid")
    }

    /// Returns the counts of a state, by family and cell.
    fn state(cells: &[(Family, u64, u64)]) -> Counts {
        let mut counts = Counts::default();
        for (family, joint, n) in cells {
            counts.add(*family, cell(*joint, 1, *n, *n));
        }
        counts
    }

    #[test]
    fn a_transition_counts_for_the_pairs_that_acted() {
        // Three agents with two actions each, and the letter 2 for their absence.
        let schema = later(&[2, 2, 2], &[]);
        let joint = |letters: [u64; 3]| letters.iter().fold(0, |joint, letter| joint * 3 + letter);
        let counts = state(&[
            (Family::JOINT, joint([0, 1, 0]), 5),
            (Family::JOINT, joint([1, 1, 2]), 7),
            (Family::JOINT, joint([2, 0, 1]), 11),
            (Family::JOINT, joint([2, 2, 0]), 13),
        ]);
        let told = |pair: &Pair| {
            let cells = counts.of_pair(&schema, pair, None);
            assert_eq!(
                Tally::sum(cells.clone()).n,
                Tables::new(&schema, pair, cells.clone()).whole.total()
            );
            super::tests::counts(&Tables::new(&schema, pair, cells).whole)
        };
        assert_eq!(told(&pair(0, 1, &[])), [(0, 1, 5), (1, 1, 7)]);
        assert_eq!(told(&pair(1, 0, &[])), [(1, 0, 5), (1, 1, 7)]);
        assert_eq!(told(&pair(0, 2, &[])), [(0, 0, 5)]);
        assert_eq!(told(&pair(1, 2, &[])), [(0, 1, 11), (1, 0, 5)]);

        // Of an agent that is held fixed, an absence is a value like others.
        let pair = pair(0, 1, &[2]);
        let cells = counts.of_pair(&schema, &pair, None);
        let strata = Tables::new(&schema, &pair, cells).strata;
        let strata: Vec<_> = strata.iter().map(super::tests::counts).collect();
        assert_eq!(strata, [vec![(0, 1, 5)], vec![(1, 1, 7)]]);
    }

    #[test]
    fn a_later_action_is_told_beside_the_own_one_before_it() {
        let schema = later(&[2, 3], &[1, 2]);
        let pair = pair(0, 1, &[]);
        let [first, second] = [1, 2].map(|lag| pair.at_lag(&schema, lag).expect("declared"));
        assert_eq!(pair.at_lag(&schema, 3), None);
        assert_eq!(pair.at_lag(&schema, 0), Some(pair.clone()));

        // Joint actions of 3 x 4 letters; agent 1 at lag 1 and 2 are outcomes 2 and 3.
        let at = |own: [u64; 2], value: u64| (own[0] * 4 + own[1]) * 3 + value;
        let counts = state(&[
            (Family::JOINT, 1, 99),
            (first.family(), at([0, 3], 2), 5),
            (first.family(), at([1, 3], 0), 4),
            (first.family(), at([1, 0], 1), 2),
            (first.family(), at([2, 0], 1), 50),
            (second.family(), at([1, 2], 2), 3),
        ]);
        assert_eq!(first.family(), Family::of_outcome(2));
        let strata = |pair: &Pair| -> Vec<Vec<Counted>> {
            let cells = counts.of_pair(&schema, pair, None);
            let tables = Tables::new(&schema, pair, cells.clone());
            let observed = tables.strata_of_observations(&schema, pair, cells);
            observed.iter().map(super::tests::counts).collect()
        };
        // Beside what agent 1 did before: 0, or nothing. Where agent 0 was absent it is told of
        // nothing.
        assert_eq!(
            strata(&first),
            [vec![(1, 1, 2)], vec![(0, 2, 5), (1, 0, 4)]]
        );
        assert_eq!(strata(&second), [vec![(1, 2, 3)]]);

        // It has a direction, whichever agent is the earlier.
        let back = super::tests::pair(1, 0, &[])
            .at_lag(&schema, 1)
            .expect("declared");
        assert_eq!((back.undirected(), ego(&back)), (back.clone(), Ego::Rows));
        assert_ne!(back.family(), first.family());
        assert_eq!(strata(&back), [[]; 0]);
    }

    #[test]
    fn observations_are_cut_by_segment_in_their_order() {
        let (schema, cells) = (schema(&[2, 2]), opposite());
        let cuts = Tables::strata_cut(&schema, &pair(0, 1, &[]), cells.iter());
        let [parts] = &cuts[..] else {
            panic!("nobody is held fixed: {cuts:?}")
        };
        let [first, second] = &parts[..] else {
            panic!("two segments: {parts:?}")
        };
        assert_eq!(counts(first), [(0, 0, 81), (0, 1, 9), (1, 0, 9), (1, 1, 1)]);
        assert_eq!(
            counts(second),
            [(0, 0, 1), (0, 1, 9), (1, 0, 9), (1, 1, 81)]
        );
    }

    #[test]
    fn each_stratum_is_cut_by_itself() {
        let schema = schema(&[2, 3, 2]);
        // Agent 2 is held fixed; it did nothing but 1 in segment 5.
        let cells = [
            cell(0, 1, 4, 2),
            cell(1, 1, 3, 1),
            cell(1, 5, 2, 2),
            cell(9, 5, 6, 0),
            cell(11, 1, 5, 5),
        ];
        for pair in [pair(0, 1, &[2]), pair(1, 0, &[2])] {
            let tables = Tables::new(&schema, &pair, cells.iter());
            let cuts = Tables::strata_cut(&schema, &pair, cells.iter());
            let sum = |parts: &Vec<Table>| Table::from_counts(parts.iter().flat_map(counts));
            assert_eq!(
                cuts.iter().map(sum).collect::<Vec<_>>(),
                *tables.strata_of_observations(&schema, &pair, cells.iter()),
                "as without cutting: entries, earlier agent in rows"
            );
            let parts: Vec<Vec<u64>> = cuts
                .iter()
                .map(|parts| parts.iter().map(Table::total).collect())
                .collect();
            // Without an entry (joint action 9) there is nothing to add.
            assert_eq!(parts, [vec![2], vec![6, 2]]);
            let by_segment = Tables::strata_by_segment(&schema, &pair, cells.iter());
            assert_eq!(by_segment, cuts.concat());
        }
    }

    #[test]
    fn the_only_segment_is_the_whole() {
        let (schema, pair) = (schema(&[2, 2]), pair(0, 1, &[]));
        let mut cells = opposite();
        cells.retain(|cell| cell.segment == SegmentId(7));
        let tables = Tables::within(&schema, &pair, Within::Segments, cells.iter());
        assert_eq!(tables.segments, 1);
        assert_eq!(
            Tables::strata_cut(&schema, &pair, cells.iter()),
            [[tables.whole.clone()]]
        );
        let pooled = Tables::new(&schema, &pair, cells.iter());
        assert_eq!(
            tables.figure(information::plug_in).to_bits(),
            pooled.figure(information::plug_in).to_bits()
        );
        assert_eq!(
            tables.expected_if_independent(),
            pooled.expected_if_independent()
        );
        let exchangeable = |exchange| {
            let all = tables.exchangeable(&schema, &pair, exchange, cells.iter());
            let alone = Tables::exchangeable_alone(&schema, &pair, exchange, cells.iter());
            assert_eq!(*all, alone);
            alone
        };
        assert_eq!(
            exchangeable(Exchange::WithinSegments),
            exchangeable(Exchange::Pooled)
        );
        for within in Within::ALL {
            let observations = tables.observations(&schema, &pair, within, cells.iter());
            assert_eq!(
                (&*observations.strata, observations.parts.len()),
                (
                    &*pooled.strata_of_observations(&schema, &pair, cells.iter()),
                    0
                ),
                "{within:?}"
            );
        }
    }

    #[test]
    fn nothing_seen_is_nothing_to_cut() {
        let (schema, pair) = (schema(&[1, 2]), pair(0, 1, &[]));
        let tables = Tables::within(&schema, &pair, Within::Segments, [].iter());
        assert_eq!(
            (tables.segments, tables.figure(information::plug_in)),
            (0, 0.0)
        );
        assert!(Tables::strata_cut(&schema, &pair, [].iter()).is_empty());
        // Seen, but not entered.
        let stays = [cell(0, 1, 4, 0), cell(1, 2, 4, 0)];
        assert_eq!(Tables::strata_cut(&schema, &pair, stays.iter()), [[]]);
        assert_eq!(Tables::new(&schema, &pair, stays.iter()).segments, 2);
    }

    #[test]
    fn figures_within_segments_are_means_by_visits() {
        let (schema, pair) = (schema(&[2, 2]), pair(0, 1, &[]));
        // Beside the two independent segments a third that depends: a hundred visits each, of three
        // hundred.
        let mut cells = opposite();
        cells.extend([cell(0, 9, 50, None), cell(3, 9, 50, None)]);
        let told = |within| Tables::within(&schema, &pair, within, cells.iter());
        let [auto, segments, pooled] = Within::ALL.map(told);
        assert_eq!(auto.segments, 3);
        assert!((segments.figure(information::plug_in) - 2_f64.ln() / 3.0).abs() < 1e-12);
        assert_eq!(
            auto.figure(information::plug_in),
            information::plug_in(&pooled.whole)
        );
        assert_eq!(
            auto.expected_if_independent(),
            pooled.expected_if_independent()
        );
        assert!(
            segments.expected_if_independent().0 > 2.0 * pooled.expected_if_independent().0,
            "three tables"
        );
        assert_eq!(
            segments.strata_of_observations(&schema, &pair, cells.iter()),
            pooled.strata_of_observations(&schema, &pair, cells.iter())
        );
        let mean: f64 = (0..2)
            .map(|row| segments.divergence(row) * segments.whole.rows()[row] as f64 / 300.0)
            .sum();
        assert!(
            (mean - segments.figure(information::plug_in)).abs() < 1e-12,
            "the mean of the ego's actions"
        );
        let observations = |within| auto.observations(&schema, &pair, within, cells.iter());
        let sizes = Within::ALL.map(|within| {
            (
                observations(within).strata.len(),
                observations(within).parts.len(),
            )
        });
        assert_eq!(sizes, [(1, 3), (1, 3), (1, 0)]);
        assert_eq!(
            *observations(Within::Auto).strata,
            *pooled.strata_of_observations(&schema, &pair, cells.iter())
        );
    }
}
