//! How far the p-values of pooled evidence are from 100,000 permutations within strata, on recorded
//! play and on planted pools; what a pool costs; and how far the mean under independence is from
//! permutations.
//!
//! `cargo bench --bench pooled` prints all of it (minutes); `cargo bench --bench pooled -- tails`,
//! `-- cost` or `-- means` a part.

#![allow(missing_docs)]

use std::collections::BTreeMap;
use std::time::Instant;

use nudge_core::domain::Entry;
use nudge_core::information::pooled::{MomentsMemo, Pool, Pooled, Stratum, gamma_tail};
use nudge_core::information::{Alphabet, Moments, Table, expected_if_independent};
use nudge_core::tracks::EntryRule;
use nudge_worlds::recordings::overcooked::{Game, decompressed, embedded, read_games};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const PERMUTATIONS: usize = 100_000;
const LEVELS: [f64; 4] = [0.05, 0.01, 0.001, 0.0001];

fn main() {
    let asked: Vec<String> = std::env::args()
        .skip(1)
        .filter(|argument| !argument.starts_with("--"))
        .collect();
    let wants = |part: &str| asked.is_empty() || asked.iter().any(|one| one == part);

    if wants("tails") {
        tails();
    }
    if wants("cost") {
        cost();
    }
    if wants("means") {
        means();
    }
}

/// Prints, of each pool, p over the share of permutations that reach the same statistic, where
/// that share is nearest to each level; and in brackets that of the gamma distribution alone.
fn tails() {
    println!("p / share of {PERMUTATIONS} permutations (gamma alone / share) at {LEVELS:?}");
    for planted in PLANTED {
        tail(&planted.name(), &planted.pool());
    }
    let splits: Vec<Vec<Game>> = embedded().iter().map(|(_, bytes)| games(bytes)).collect();
    for question in QUESTIONS {
        tail(&question.name(), &question.strata(&splits[question.split]));
    }
}

fn tail(name: &str, strata: &[Table]) {
    let mut shuffled: Vec<Shuffled> = strata
        .iter()
        .filter(|table| !table.is_line())
        .map(Shuffled::new)
        .collect();
    let mut drawn: Vec<(f64, u64)> = (0..PERMUTATIONS as u64)
        .map(|seed| (permuted(&mut shuffled, seed), seed))
        .collect();
    drawn.sort_by(|a, b| b.0.total_cmp(&a.0));

    let pooled = pool(strata);
    print!(
        "{name:<38} {:>4} strata {:>5} visits {:<13}",
        shuffled.len(),
        pooled.visits,
        pooled.method.as_str()
    );
    for level in LEVELS {
        let (statistic, seed) = drawn[(level * PERMUTATIONS as f64) as usize];
        let reaching = drawn.partition_point(|one| one.0 >= statistic - 1e-9);
        let share = reaching as f64 / PERMUTATIONS as f64;

        permuted(&mut shuffled, seed);
        let tables: Vec<Table> = shuffled.iter().map(Shuffled::table).collect();
        let again = pool(&tables);
        print!(
            "  {share:.4}: {:.2} ({:.2})",
            again.p_value / share,
            gamma_tail(statistic, moments(&again)) / share
        );
    }
    println!();
}

fn moments(pooled: &Pooled) -> Moments {
    let visits = pooled.visits as f64;
    Moments {
        mean: pooled.expected_if_independent * visits,
        variance: (pooled.excess_deviation * visits).powi(2),
    }
}

fn pool(strata: &[Table]) -> Pooled {
    // The test of one pattern takes part where it would: to 25 letters.
    let letters = |labels: fn(&Table) -> &[u64]| {
        strata
            .iter()
            .flat_map(labels)
            .max()
            .map_or(0, |last| last + 1)
    };
    let mut pool = Pool::new(Alphabet {
        rows: letters(Table::row_labels),
        columns: letters(Table::column_labels),
    });
    let mut memo = MomentsMemo::default();
    for (state, table) in (0..).zip(strata) {
        pool.add(
            Stratum {
                state,
                segment: 0,
                table,
            },
            &mut memo,
        );
    }
    pool.pooled(1)
}

/// Returns the statistic of all strata, each shuffled by the seed.
fn permuted(strata: &mut [Shuffled], seed: u64) -> f64 {
    let mut random = Pcg64::seed_from_u64(seed);
    strata
        .iter_mut()
        .map(|stratum| stratum.shuffle(&mut random))
        .sum()
}

/// A stratum whose visits are shuffled, in code of its own.
struct Shuffled {
    rows: Vec<u64>,
    ordered: Vec<usize>,
    labels: Vec<usize>,
    of_margins: f64,
    x_ln_x: Vec<f64>,
    counts: Vec<usize>,
}

impl Shuffled {
    fn new(table: &Table) -> Self {
        let x_ln_x: Vec<f64> = (0..=table.total())
            .map(|n| n as f64 * (n.max(1) as f64).ln())
            .collect();
        let of_lines = |sums: &[u64]| sums.iter().map(|&sum| x_ln_x[sum as usize]).sum::<f64>();
        let ordered: Vec<usize> = table
            .columns()
            .iter()
            .enumerate()
            .flat_map(|(column, &sum)| std::iter::repeat_n(column, sum as usize))
            .collect();

        Self {
            rows: table.rows().to_vec(),
            labels: ordered.clone(),
            ordered,
            of_margins: x_ln_x[table.total() as usize]
                - of_lines(table.rows())
                - of_lines(table.columns()),
            counts: vec![0; table.columns().len()],
            x_ln_x,
        }
    }

    fn shuffle(&mut self, random: &mut Pcg64) -> f64 {
        self.labels.copy_from_slice(&self.ordered);
        self.labels.shuffle(random);

        let mut statistic = self.of_margins;
        let mut labels = self.labels.iter();
        for &row in &self.rows {
            self.counts.fill(0);
            labels
                .by_ref()
                .take(row as usize)
                .for_each(|&label| self.counts[label] += 1);
            statistic += self.counts.iter().map(|&n| self.x_ln_x[n]).sum::<f64>();
        }
        statistic
    }

    /// Returns the table of the visits as they are shuffled now.
    fn table(&self) -> Table {
        let rows = (0..)
            .zip(&self.rows)
            .flat_map(|(row, &sum)| std::iter::repeat_n(row, sum as usize));
        Table::from_counts(
            rows.zip(&self.labels)
                .map(|(row, &label)| (row, label as u64, 1)),
        )
    }
}

/// A question about recorded play: the other's action so many ticks after the ego's, given its own
/// a tick before that, within states and trials.
struct Question {
    split: usize,
    layout: &'static str,
    ego: usize,
    lag: usize,
    within_trials: bool,
}

const fn question(split: usize, layout: &'static str, ego: usize, lag: usize) -> Question {
    Question {
        split,
        layout,
        ego,
        lag,
        within_trials: true,
    }
}

const QUESTIONS: [Question; 9] = [
    question(0, "forced_coordination", 1, 6),
    question(0, "forced_coordination", 0, 3),
    Question {
        within_trials: false,
        ..question(0, "forced_coordination", 1, 6)
    },
    question(1, "forced_coordination", 1, 6),
    question(0, "cramped_room", 0, 5),
    question(1, "cramped_room", 1, 0),
    question(0, "coordination_ring", 0, 4),
    question(0, "asymmetric_advantages", 0, 3),
    question(1, "counter_circuit", 1, 2),
];

impl Question {
    fn name(&self) -> String {
        let other = 1 - self.ego;
        let split = ["train", "test"][self.split];
        let strata = if self.within_trials { "" } else { " pooled" };
        format!(
            "{} {}>{other} lag {} {split}{strata}",
            self.layout, self.ego, self.lag
        )
    }

    fn strata(&self, games: &[Game]) -> Vec<Table> {
        let mut strata = BTreeMap::<_, Vec<(u64, u64, u64)>>::new();
        let played = games.iter().filter(|game| game.layout == self.layout);

        for (trial, game) in played.enumerate() {
            let mut rule = EntryRule::new([6, 6]);
            let action = |step: usize, player: usize| game.steps[step].actions[player] as u64;
            for (at, step) in game.steps.iter().enumerate() {
                let state = step
                    .players
                    .map(|one| [one.x, one.y, one.orientation as u8, one.held as u8]);
                let entry = rule.entry(&state, &[0, 1].map(|player| Some(action(at, player))));
                let later = at + self.lag;
                if entry != Entry::Entered || later >= game.steps.len() {
                    continue;
                }
                let other = 1 - self.ego;
                let given = (self.lag > 0).then(|| action(later - 1, other));
                let trial = self.within_trials.then_some(trial);
                let cell = (action(at, self.ego), action(later, other), 1);
                strata.entry((state, given, trial)).or_default().push(cell);
            }
        }
        strata.into_values().map(Table::from_counts).collect()
    }
}

fn games(bytes: &[u8]) -> Vec<Game> {
    let bytes = decompressed(bytes).expect("the recordings are gzip");
    read_games(&bytes).expect("the recordings can be read")
}

/// A pool of independent actions: so many strata of so many visits, of so many letters, the first
/// of which is chosen with an extra probability.
struct Planted {
    strata: usize,
    visits: [u64; 2],
    letters: u64,
    habit: f64,
}

const fn planted(strata: usize, visits: [u64; 2], letters: u64, habit: f64) -> Planted {
    Planted {
        strata,
        visits,
        letters,
        habit,
    }
}

const PLANTED: [Planted; 20] = [
    planted(1, [10, 20], 3, 0.0),
    planted(2, [10, 30], 6, 0.0),
    planted(3, [4, 8], 3, 0.0),
    planted(5, [4, 8], 2, 0.0),
    planted(5, [4, 8], 6, 0.0),
    planted(10, [2, 6], 6, 0.0),
    planted(10, [3, 10], 2, 0.0),
    planted(10, [10, 30], 6, 0.5),
    planted(20, [2, 5], 6, 0.0),
    planted(20, [5, 20], 6, 0.8),
    planted(50, [2, 5], 6, 0.3),
    planted(50, [3, 10], 6, 0.8),
    planted(100, [2, 4], 6, 0.5),
    planted(100, [2, 20], 25, 0.5),
    planted(200, [2, 5], 6, 0.7),
    planted(300, [2, 10], 3, 0.8),
    planted(5, [50, 100], 6, 0.9),
    planted(20, [50, 100], 6, 0.9),
    planted(30, [10, 60], 2, 0.9),
    planted(100, [10, 60], 2, 0.95),
];

impl Planted {
    fn name(&self) -> String {
        let [least, most] = self.visits;
        format!(
            "{} x {least}..{most} of {} letters, {}",
            self.strata, self.letters, self.habit
        )
    }

    fn pool(&self) -> Vec<Table> {
        let mut random = Pcg64::seed_from_u64(self.strata as u64 + self.letters);
        (0..self.strata).map(|_| self.table(&mut random)).collect()
    }

    fn table(&self, random: &mut Pcg64) -> Table {
        let visits = random.random_range(self.visits[0]..=self.visits[1]);
        let letter = |random: &mut Pcg64| {
            if random.random_bool(self.habit) {
                0
            } else {
                random.random_range(0..self.letters)
            }
        };
        let mut cell = || (letter(random), letter(random), 1);
        Table::from_counts((0..visits).map(|_| cell()).collect::<Vec<_>>())
    }
}

/// Prints what a stratum costs, with and without margins that were met before.
fn cost() {
    const STRATA: usize = 20_000;
    for (visits, letters) in [
        (10, 6),
        (30, 6),
        (60, 6),
        (300, 6),
        (3_000, 6),
        (30, 25),
        (300, 25),
    ] {
        let strata = planted(STRATA, [visits, visits], letters, 0.3).pool();
        let alone = nanoseconds(&strata, |table| {
            MomentsMemo::default().moments(table);
        });
        let mut memo = MomentsMemo::default();
        let kept = nanoseconds(&strata, |table| {
            memo.moments(table);
        });
        let began = Instant::now();
        pool(&strata);
        let whole = began.elapsed().as_nanos() as f64 / STRATA as f64;
        println!(
            "{visits:>5} visits, {letters:>2} letters: moments {alone:.0} ns, with a memo \
             {kept:.0} ns; a stratum of a pool {whole:.0} ns"
        );
    }
}

fn nanoseconds(strata: &[Table], mut each: impl FnMut(&Table)) -> f64 {
    let began = Instant::now();
    strata.iter().for_each(&mut each);
    began.elapsed().as_nanos() as f64 / strata.len() as f64
}

/// Prints the mean of the plug-in over permutations beside the expected one.
fn means() {
    for letters in [2, 6, 25, 64, 256] {
        for visits in [10, 100, 1_000, 10_000, 100_000, 1_000_000] {
            mean(letters, visits);
        }
    }
}

fn mean(letters: u64, visits: u64) {
    let mut random = Pcg64::seed_from_u64(letters);
    let table = planted(1, [visits, visits], letters, 0.2).table(&mut random);
    let mut shuffled = Shuffled::new(&table);
    let rounds = (20_000_000 / visits).clamp(20, 20_000);
    let drawn: Vec<f64> = (0..rounds)
        .map(|_| shuffled.shuffle(&mut random) / visits as f64)
        .collect();
    let mean = drawn.iter().sum::<f64>() / rounds as f64;
    let squares: f64 = drawn.iter().map(|one| (one - mean).powi(2)).sum();
    let error = (squares / (rounds * (rounds - 1)) as f64).sqrt();

    let began = Instant::now();
    let (expected, method) = expected_if_independent(&table);
    let took = began.elapsed();
    let occupied = [table.rows(), table.columns()].map(|sums| sums.len() as f64);
    let leading = (occupied[0] - 1.0) * (occupied[1] - 1.0) / (2.0 * visits as f64);
    println!(
        "{letters:>4} letters {visits:>8} visits: permutations {mean:.6} +- {error:.6}, expected \
         {expected:.6} ({}), (R - 1)(K - 1) / 2N {leading:.6}, {took:.1?}",
        method.as_str()
    );
}
