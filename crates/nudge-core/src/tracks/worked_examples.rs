//! The figures of `docs/turns-and-lags.md`: games played, followed by tracks, counted and read off
//! the page.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::{Step, Track};
use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft};
use crate::domain::{Entry, Record, Schema, SchemaDraft};
use crate::information::{Table, conditional, plug_in};

const PAGE: &str = include_str!("../../../../docs/turns-and-lags.md");

const ROUNDS: usize = 3_000;

/// Stands for the action of whoever took none.
const ABSENT: u64 = u64::MAX;

/// A game of two players with so many moves and one state, with lags 1 and 2.
fn schema(moves: i64) -> Schema {
    let feature = |name: &str, most| FeatureDraft {
        name: name.into(),
        unit: None,
        kinds: vec![KindDraft::Integer(0, most)],
    };
    let player = |name: &str| AgentDraft {
        name: name.into(),
        action: vec![feature("move", moves - 1)],
        may_be_absent: true,
    };
    let draft = SchemaDraft {
        state: vec![feature("game", 0)],
        agents: vec![player("a"), player("b")],
        lags: vec![1, 2],
        ..SchemaDraft::default()
    };
    Schema::try_from(&draft).expect("valid")
}

/// What both players do, step after step; none where one does not act.
type Played = Vec<[Option<u64>; 2]>;

/// Sends a game as a client would, and returns what is released.
fn transitions(moves: i64, played: &Played) -> Vec<Record> {
    let mut track = Track::of_rounds(&schema(moves));
    let step = |actions: &[Option<u64>; 2]| {
        let values = actions.map(|action| action.unwrap_or(0) as f32);
        let acts = actions.map(|action| action.is_some());
        Step::new(vec![0.0], values.to_vec()).acting(acts.to_vec())
    };
    let mut records: Vec<Record> = played
        .iter()
        .filter_map(|at| track.step(step(at)))
        .collect();
    records.extend(track.end());
    records
}

/// The action of an agent so many steps after a transition; the outcomes are a@1, a@2, b@1, b@2.
fn action(record: &Record, agent: usize, lag: usize) -> Option<u64> {
    let has = |flags: &[bool], at: usize| flags.get(at).copied().unwrap_or(true);
    match lag.checked_sub(1) {
        None => has(&record.actions_present, agent).then(|| record.actions[agent] as u64),
        Some(at) => {
            let at = 2 * agent + at;
            let is_there = !record.outcomes.is_empty() && has(&record.outcomes_present, at);
            is_there.then(|| record.outcomes[at] as u64)
        }
    }
}

/// Tables of I(ego now; other k later | other's own action at k - 1), one for each of these.
fn tables(records: &[Record], ego: usize, lag: usize) -> Vec<Table> {
    let other = 1 - ego;
    let given = |record: &Record| match lag {
        0 => 0,
        _ => action(record, other, lag - 1).unwrap_or(ABSENT),
    };
    let drawn = |record: &&Record| record.entry == Entry::Entered;
    let slice = |letter: u64| {
        let of_letter = records.iter().filter(drawn);
        let of_letter = of_letter.filter(|record| given(record) == letter);
        let pairs = of_letter
            .filter_map(|record| Some((action(record, ego, 0)?, action(record, other, lag)?, 1)));
        Table::from_counts(pairs)
    };
    [0, 1, 2, 3, ABSENT].map(slice).to_vec()
}

/// Returns the plug-in conditional mutual information as the page has it; none without visits.
fn told(records: &[Record], ego: usize, lag: usize) -> Option<String> {
    let tables = tables(records, ego, lag);
    let seen = tables.iter().any(|table| table.total() > 0);
    seen.then(|| format!("{:.2}", conditional(&tables, plug_in)))
}

fn assert_on_page(row: &str, times: usize) {
    assert_eq!(PAGE.matches(row).count(), times, "the page has not {row:?}");
}

/// A random player against one that answers its last move.
fn repeated(moves: u64, answer: fn(u64) -> u64) -> Vec<Record> {
    let mut rng = Pcg64::seed_from_u64(1);
    let random: Vec<u64> = (0..ROUNDS).map(|_| rng.random_range(0..moves)).collect();
    let answers = [0]
        .into_iter()
        .chain(random.iter().map(|last| answer(*last) % moves));
    let played: Played = random
        .iter()
        .zip(answers)
        .map(|(random, answer)| [Some(*random), Some(answer)])
        .collect();
    transitions(moves as i64, &played)
}

#[test]
fn tit_for_tat_answers_at_lag_1() {
    let records = repeated(2, |last| last);
    let of = |ego| [0, 1, 2].map(|lag| told(&records, ego, lag).expect("seen"));
    assert_eq!(
        [of(0), of(1)],
        [["0.00", "0.69", "0.00"], ["0.00", "0.00", "0.00"]]
    );
    for row in ["| 0 | 0.00 | 0.00 |", "| 2 | 0.00 | 0.00 |"] {
        assert_on_page(row, 2);
    }
    assert_on_page("| 1 | 0.69 | 0.00 |", 1);
}

#[test]
fn who_beats_the_last_move_answers_at_lag_1() {
    let records = repeated(3, |last| last + 1);
    let of = |ego| [0, 1, 2].map(|lag| told(&records, ego, lag).expect("seen"));
    assert_eq!(
        [of(0), of(1)],
        [["0.00", "1.10", "0.00"], ["0.00", "0.00", "0.00"]]
    );
    assert_on_page("| 1 | 1.10 | 0.00 |", 1);
}

#[test]
fn turns_are_no_influence_and_replies_are() {
    let game = |copies: bool, waits: Option<u64>| {
        let (mut rng, mut last) = (Pcg64::seed_from_u64(2), 0);
        let mut step = |at: usize| {
            let replies = copies && !at.is_multiple_of(2);
            last = if replies {
                last
            } else {
                rng.random_range(0..3)
            };
            match at % 2 {
                0 => [Some(last), waits],
                _ => [waits, Some(last)],
            }
        };
        (0..ROUNDS).map(&mut step).collect::<Played>()
    };
    let sent = |copies, waits| transitions(4, &game(copies, waits));

    for copies in [false, true] {
        assert_eq!(told(&sent(copies, Some(3)), 0, 0).as_deref(), Some("0.69"));
        assert_eq!(told(&sent(copies, None), 0, 0), None);
        assert_eq!(told(&sent(copies, None), 0, 2), None);
    }
    assert_eq!(told(&sent(false, None), 0, 1).as_deref(), Some("0.00"));
    assert_eq!(told(&sent(true, None), 0, 1).as_deref(), Some("1.10"));
    assert_on_page("| a label \"none\" for who waits | 0 | 0.69 | 0.69 |", 1);
    assert_on_page("| absent | 1 | 0.00 | 1.10 |", 1);
}

#[test]
fn padding_is_dependence() {
    let shown = |padding| {
        let pairs = (0..4).flat_map(|a| (0..4).map(move |b| (a, b, 12)));
        plug_in(&Table::from_counts(pairs.chain([(0, 0, padding)])))
    };
    let told = format!(
        "show {:.2} nats; with 96 steps of padding behind them {:.2}",
        shown(0),
        shown(96)
    );
    assert_on_page(&told, 1);
    let chance = 9.0 / 2.0 / (192.0 + 96.0);
    assert_on_page(
        &format!("is {:.0} times what chance", shown(96) / chance),
        1,
    );
}
