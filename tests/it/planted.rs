//! The method by evidence, measured where the truth is known: a small copy of what the planted
//! experiment reports.

use nudge::domain::{Dependence, Rule, RuleKind, Verdict};
use nudge::evidence::{Believed, Ego, Fitter, Posterior, Prior, Uses, decide, dependence};
use nudge::information::{Table, divergence, plug_in};
use nudge::simulation::planted::{Arm, Generator, Options, Planted, planted};

/// Figures are means over the states of these seeds.
const SEEDS: [u64; 3] = [1, 2, 3];
const STATES: usize = 600;

/// What a method is worth, over all seeds.
#[derive(Default)]
struct Score {
    /// Area under the curve of "there is influence".
    ranking: f64,
    /// F1 of "MI > 0.5 nats".
    strong: f64,
    /// Root mean square error of mutual information, in nats.
    error: f64,
}

fn states(generator: Generator, arm: Arm, dependent: f64, seed: u64) -> Vec<Planted> {
    planted(
        generator,
        &Options {
            states: STATES,
            dependent,
            arm,
            seed,
        },
    )
}

fn fitted(generator: Generator, states: &[Planted]) -> Prior {
    let alphabet = generator.alphabet();
    let mut uses = Uses::new(alphabet);
    states
        .iter()
        .for_each(|state| uses.add(std::slice::from_ref(&state.table)));
    let mut fitter = Fitter::new(alphabet, &uses);
    states
        .iter()
        .for_each(|state| fitter.add(std::slice::from_ref(&state.table)));
    Prior::new(&fitter.fit())
}

fn posteriors(prior: &Prior, states: &[Planted]) -> Vec<Posterior> {
    states
        .iter()
        .map(|state| prior.posterior(prior.habits(), std::slice::from_ref(&state.table)))
        .collect()
}

/// Returns what is believed at half a nat.
fn believed(prior: &Prior, state: &Planted, posterior: &Posterior) -> Believed {
    Believed::new(
        posterior.beliefs(0.5),
        prior.unseen().beliefs(0.5),
        std::slice::from_ref(&state.table),
    )
}

fn verdict(state: &Planted, believed: &Believed) -> Verdict {
    let rule = Rule {
        kind: RuleKind::Evidence,
        ..Rule::default()
    };
    decide(&rule, state.table.total(), 0.0, Some(believed))
}

/// Returns the probability that a state with influence is ranked above one without.
fn ranking(states: &[Planted], scores: &[f64]) -> f64 {
    let of = |dependent: bool| {
        states
            .iter()
            .zip(scores)
            .filter(move |(state, _)| state.dependent == dependent)
    };
    let won = |high: &f64| {
        of(false)
            .map(|(_, low)| {
                if high > low {
                    1.0
                } else if high == low {
                    0.5
                } else {
                    0.0
                }
            })
            .sum::<f64>()
    };
    of(true).map(|(_, high)| won(high)).sum::<f64>() / (of(true).count() * of(false).count()) as f64
}

fn f1(states: &[Planted], called: impl Iterator<Item = bool>) -> f64 {
    let (mut hits, mut all) = (0.0, 0.0);
    for (state, called) in states.iter().zip(called) {
        let strong = state.information > 0.5;
        hits += f64::from(u8::from(strong && called));
        all += f64::from(u8::from(strong) + u8::from(called));
    }
    2.0 * hits / all
}

fn error(states: &[Planted], estimates: impl Iterator<Item = f64>) -> f64 {
    let squares: f64 = states
        .iter()
        .zip(estimates)
        .map(|(state, mi)| (mi - state.information).powi(2))
        .sum();
    (squares / states.len() as f64).sqrt()
}

/// Returns the scores of the plug-in and of the posterior.
fn scores(generator: Generator) -> [Score; 2] {
    let mut scores = [Score::default(), Score::default()];
    for seed in SEEDS {
        let states = states(generator, Arm::Plain, 0.3, seed);
        let believed = posteriors(&fitted(generator, &states), &states);
        let plug: Vec<f64> = states.iter().map(|state| plug_in(&state.table)).collect();
        let dependent: Vec<f64> = believed.iter().map(Posterior::dependent).collect();
        let share = 1.0 / SEEDS.len() as f64;
        for (score, ranks) in scores.iter_mut().zip([&plug, &dependent]) {
            score.ranking += share * ranking(&states, ranks);
        }
        scores[0].strong += share * f1(&states, plug.iter().map(|mi| *mi > 0.5));
        scores[1].strong += share
            * f1(
                &states,
                believed.iter().map(|posterior| posterior.above(0.5) > 0.5),
            );
        scores[0].error += share * error(&states, plug.iter().copied());
        scores[1].error += share * error(&states, believed.iter().map(Posterior::mean));
    }
    scores
}

#[test]
fn evidence_finds_what_the_plug_in_does_not() {
    // Means over ten seeds of 2,500 states lie .03 or more to the good side of each bound. F1 is
    // that of calling at a probability of one half, and these three small worlds of G2 and G3
    // happen to lie .05 below it.
    let bounds = [(0.81, 0.40, 0.17), (0.88, 0.57, 0.23), (0.85, 0.44, 0.19)];
    for (generator, (ranking, strong, error)) in Generator::USUAL.into_iter().zip(bounds) {
        let [plug_in, evidence] = scores(generator);

        let told = (evidence.ranking, evidence.strong, evidence.error);
        assert!(
            told.0 > ranking && told.1 > strong && told.2 < error,
            "{generator:?}: {told:?}"
        );
        assert!(
            told.0 > plug_in.ranking + 0.05
                && told.1 > plug_in.strong
                && told.2 < 0.7 * plug_in.error
        );
    }
}

#[test]
fn intervals_hold_the_truth() {
    for generator in Generator::USUAL {
        let states = states(generator, Arm::Plain, 0.3, 4);
        let believed = posteriors(&fitted(generator, &states), &states);
        let held = |(state, posterior): &(&Planted, &Posterior)| {
            let [low, high] = posterior.interval();
            low <= state.information + 1e-12 && state.information <= high
        };
        let share = |kept: fn(&Planted) -> bool| {
            let all: Vec<_> = states
                .iter()
                .zip(&believed)
                .filter(|(state, _)| kept(state))
                .collect();
            all.iter().filter(|pair| held(pair)).count() as f64 / all.len() as f64
        };

        assert!(
            share(|_| true) > 0.95 && share(|state| state.dependent) > 0.9,
            "{generator:?}"
        );
    }
}

/// What is said of a hard world of 400 states.
struct Told {
    /// How often the interval holds the truth where there is dependence.
    covered: f64,
    /// How often dependence is excluded where there is some, and established where there is none.
    excluded: f64,
    established: f64,
    /// How often `influences` is said, and how often it is wrong.
    called: usize,
    wrong: usize,
    /// Whether any of the states seen once or twice has a verdict.
    decides_on_two: bool,
}

fn said_of_states(generator: Generator) -> Told {
    let dependent = if matches!(generator, Generator::Weak(_)) {
        0.5
    } else {
        0.3
    };
    let states = planted(
        generator,
        &Options {
            states: 400,
            dependent,
            arm: Arm::Plain,
            seed: 9,
        },
    );
    let prior = fitted(generator, &states);
    let all: Vec<(Planted, Posterior, Believed)> = posteriors(&prior, &states)
        .into_iter()
        .zip(states)
        .map(|(posterior, state)| {
            let believed = believed(&prior, &state, &posterior);
            (state, posterior, believed)
        })
        .collect();
    let share = |of: bool, is: &dyn Fn(&(Planted, Posterior, Believed)) -> bool| {
        let these: Vec<_> = all
            .iter()
            .filter(|(state, ..)| state.dependent == of)
            .collect();
        these.iter().filter(|one| is(one)).count() as f64 / these.len() as f64
    };
    let called = || {
        all.iter()
            .filter(|(state, _, believed)| verdict(state, believed) == Verdict::Influences)
    };
    Told {
        covered: share(true, &|(state, posterior, _)| {
            let [low, high] = posterior.interval();
            low <= state.information && state.information <= high
        }),
        excluded: share(true, &|(.., believed)| {
            dependence(believed) == Dependence::Excluded
        }),
        established: share(false, &|(.., believed)| {
            dependence(believed) == Dependence::Established
        }),
        called: called().count(),
        wrong: called()
            .filter(|(state, ..)| state.information <= 0.5)
            .count(),
        decides_on_two: all.iter().any(|(state, _, believed)| {
            state.table.total() <= 2 && verdict(state, believed) != Verdict::Undecided
        }),
    }
}

/// Evidence of 6 x 6 built for varied habits covered .72 of 3 x 25 and .73 of `stay25`, excluded
/// .63 of `rare`, and called noise there.
#[test]
fn hard_worlds_are_told_as_they_are() {
    use Generator::{
        Copy, EpsilonGreedy, Masked, Rare, Stay25, Stay95, ThreeByTwentyFive, TwoByTwo, Weak,
    };
    for generator in [
        TwoByTwo,
        ThreeByTwentyFive,
        Stay95,
        Stay25,
        Rare,
        EpsilonGreedy,
        Copy(6),
        Masked,
        Weak(6),
    ] {
        let Told {
            covered,
            excluded,
            established,
            called,
            wrong,
            decides_on_two,
        } = said_of_states(generator);

        assert!(covered >= 0.86, "{generator:?} covers {covered}");
        assert!(
            excluded <= if generator == Rare { 0.10 } else { 0.04 },
            "{generator:?} excludes {excluded}"
        );
        assert!(
            established <= 0.01,
            "{generator:?} establishes {established}"
        );
        assert!(
            called < 10 || wrong * 4 <= called,
            "{generator:?} calls {called}, {wrong} of them wrong"
        );
        assert!(!decides_on_two, "{generator:?} decides on two visits");
    }
}

#[test]
fn nothing_is_found_where_nothing_is_left() {
    for generator in Generator::USUAL {
        let states = states(generator, Arm::Shuffled, 0.3, 5);
        let prior = fitted(generator, &states);
        let believed = posteriors(&prior, &states);
        let verdict = |(state, posterior): (&Planted, &Posterior)| {
            verdict(state, &self::believed(&prior, state, posterior))
        };

        assert!(believed.iter().map(Posterior::dependent).sum::<f64>() / (STATES as f64) < 0.05);
        assert!(
            states
                .iter()
                .zip(&believed)
                .map(verdict)
                .all(|verdict| verdict != Verdict::Influences)
        );
    }
}

#[test]
fn an_environment_is_all_influence_or_none() {
    for generator in Generator::USUAL {
        let mean = |dependent| {
            let states = states(generator, Arm::Plain, dependent, 6);
            let believed = posteriors(&fitted(generator, &states), &states);
            believed.iter().map(Posterior::dependent).sum::<f64>() / STATES as f64
        };

        assert!(mean(0.0) < 0.05, "{generator:?}");
        assert!(mean(1.0) > 0.6, "{generator:?}");
    }
}

#[test]
fn rare_actions_are_not_called_the_strongest_for_being_rare() {
    let prior = fitted(
        Generator::Responses,
        &states(Generator::Responses, Arm::Plain, 0.3, 7),
    );
    // Both agents play six actions at random, fifty times: 30 of the 0 % dependent states.
    let independent = planted(
        Generator::Responses,
        &Options {
            states: 2_000,
            dependent: 0.0,
            arm: Arm::Plain,
            seed: 8,
        },
    );
    let tables: Vec<&Table> = independent
        .iter()
        .map(|state| &state.table)
        .filter(|t| (40..60).contains(&t.total()))
        .take(30)
        .collect();
    let largest = |figures: &mut dyn Iterator<Item = f64>| figures.fold(0.0, f64::max);

    let plug_in = tables.iter().filter(|table| {
        largest(&mut (0..table.rows().len()).map(|row| divergence(table, row))) > 0.5
    });
    let believed = tables.iter().filter(|table| {
        let actions = prior.by_action(
            prior.habits(),
            std::slice::from_ref::<Table>(table),
            Ego::Rows,
        );
        largest(&mut actions.iter().map(|action| action.divergence_mean)) > 0.5
    });

    let (plug_in, believed) = (plug_in.count(), believed.count());
    assert!(plug_in >= 10 && believed <= 2, "{plug_in} {believed}");
}
