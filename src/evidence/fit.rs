//! What all states of an environment say together: how many are dependent, and how strongly rows are drawn to their base. By expectation and
//! maximisation (Dempster, Laird & Rubin 1977).
//!
//! A table is read in both ways, columns that respond to rows and rows that respond to columns, and the slabs of both are components of one mixture: so
//! one fit serves both directions of a pair, and the order of the variables changes nothing.

use super::base::Base;
use super::counted::Counted;
use super::habits::Uses;
use super::increments::add;
use super::likelihood::{Likelihood, NullMixture, columns};
use super::parameters::{
    AROUND, CUT, DEVIANT_SLABS, DEVIANTS, Expected, FIXED, HABITS, NULLS, OWN_GRID, OWN_SLABS, Parameters, Segmented,
    SideParameters,
};
use super::prior::ln_sum;
use crate::information::{Alphabet, Table};

/// Rounds of the fit, from [`Parameters::cold`]: without slabs of one deviating row, then with them and the null's weights as they are, since their
/// evidence depends on those.
const ROUNDS: [usize; 2] = [40, 80];

/// Draws from which a state takes part in a fit. Thousands of states of two or three draws are all explained alike by no dependence in varied habits and by
/// much dependence in usual ones: fitted to them, the share of dependent states was .45 to .9 where .31 were.
const FEWEST_DRAWS: u64 = 6;

/// A fit, whole: plain data, from which a [`Prior`](super::Prior) can be made again to the bit.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// The alphabets of the pair; rows are the actions of the earlier variable.
    pub alphabet: Alphabet,
    /// What the earlier variable does on the whole, and what the later one does.
    pub bases: [Base; 2],
    /// What was found.
    pub parameters: Parameters,
    /// The states it was found from: those whose tables can tell dependence from independence.
    pub states: u64,
}

impl Fit {
    /// Returns what is supposed before any state was fitted.
    pub fn cold(alphabet: Alphabet) -> Self {
        let base = |letters: u64| Base::new(&vec![0; letters as usize]);
        let bases = [base(alphabet.rows), base(alphabet.columns)];
        Self { alphabet, bases, parameters: Parameters::cold(), states: 0 }
    }
}

/// Gathers states and fits them: about 1.5 kB a state that can tell, none for the others.
pub struct Fitter {
    alphabet: Alphabet,
    likelihoods: [Likelihood; 2],
    habits: [[Option<f64>; 2]; 2],
    states: Vec<State>,
}

/// What one state says, as multiples of its likeliest component, in either way to read it.
struct State {
    slices: Vec<[Table; 2]>,
    sides: [Side; 2],
    /// The same of its parts, where it was seen in several segments.
    cut: Option<[Cut; 2]>,
}

/// What one state says where its columns respond to its rows.
struct Side {
    nulls: Vec<Scaled<NULLS>>,
    anchors: Vec<Scaled<NULLS>>,
    fixed: Scaled<FIXED>,
    /// Relative to the null, as are the deviants.
    own: Scaled<OWN_GRID>,
    deviants: Option<Scaled<DEVIANTS>>,
}

/// What the parts of a state say, cut by segment.
struct Cut {
    nulls: Vec<Scaled<NULLS>>,
    /// Relative to habits that are alike in all parts.
    around: Scaled<AROUND>,
    fixed: Scaled<FIXED>,
    /// Relative to the parts' null.
    own: Scaled<OWN_GRID>,
    /// Those with more than one visit.
    parts: Vec<Part>,
    /// Where one part alone depends, relative to the parts' null.
    one: Scaled<OWN_GRID>,
}

/// A part of a state.
struct Part {
    null: Scaled<NULLS>,
    fixed: Scaled<FIXED>,
    /// ln of its share of the visits beyond the first.
    ln_share: f64,
}

/// The numbers `parts` times e^`ln_scale`; the largest part is 1.
struct Scaled<const L: usize> {
    ln_scale: f64,
    parts: [f64; L],
}

impl<const L: usize> Scaled<L> {
    fn new(logarithms: [f64; L]) -> Self {
        let ln_scale = logarithms.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        Self { ln_scale, parts: logarithms.map(|ln| (ln - ln_scale).exp()) }
    }

    fn logarithms(&self) -> [f64; L] {
        self.parts.map(|part| self.ln_scale + part.ln())
    }

    fn ln_weighted(&self, weights: &[f64]) -> f64 {
        self.ln_scale + self.weighted(weights).ln()
    }

    fn weighted(&self, weights: &[f64]) -> f64 {
        self.parts.iter().zip(weights).map(|(part, weight)| part * weight).sum()
    }

    /// Adds a number of states to the components, in proportion to their weighted parts.
    fn share(&self, states: f64, weights: &[f64], expected: &mut [f64]) {
        let scale = states / self.weighted(weights);
        for ((expected, part), weight) in expected.iter_mut().zip(self.parts).zip(weights) {
            *expected += scale * part * weight;
        }
    }
}

impl Fitter {
    /// Begins a fit of a pair with these alphabets, whose letters all states of the environment use so.
    pub fn new(alphabet: Alphabet, uses: &Uses) -> Self {
        let [rows, columns] = uses.bases();
        let likelihoods = [Likelihood::new(alphabet.rows, columns), Likelihood::new(alphabet.columns, rows)];
        let [habits, in_segments] = [uses.concentrations(), uses.concentrations_in_segments()];
        let habits = [0, 1].map(|side| [habits[side], in_segments[side]]);
        Self { alphabet, likelihoods, habits, states: Vec::new() }
    }

    /// Adds a state by its tables, one for each joint action of the agents held fixed, and their parts by segment. Sums run in the order of adding, so that
    /// the same states in the same order give the same bits.
    ///
    /// Slices of one occupied row or column are left out: they are as likely either way, so they would leave the share of dependent states and the
    /// weights of the slabs where those settle without them. So are states of fewer than six draws.
    pub fn add<'a>(&mut self, counted: impl Into<Counted<'a>>) {
        let Counted { slices, parts } = counted.into();
        let telling = slices.iter().filter(|slice| !slice.is_line());
        let telling: Vec<[Table; 2]> = telling.map(|slice| [slice.clone(), slice.transposed()]).collect();
        let draws: u64 = telling.iter().map(|[slice, _]| slice.total()).sum();
        if draws >= FEWEST_DRAWS {
            let side = |side: usize| Side::new(&self.likelihoods[side], telling.iter().map(|slice| &slice[side]));
            let parts: Vec<[Table; 2]> = parts.iter().map(|part| [part.clone(), part.transposed()]).collect();
            let cut = |side: usize| {
                Cut::new(&self.likelihoods[side], slices.len() == 1, parts.iter().map(|part| &part[side]))
            };
            let cut = (!parts.is_empty()).then(|| [cut(0), cut(1)]);
            self.states.push(State { sides: [side(0), side(1)], cut, slices: telling });
        }
    }

    /// Fits.
    pub fn fit(mut self) -> Fit {
        let mut parameters = Parameters::cold();
        for _ in 0..ROUNDS[0] {
            parameters = round(&self.states, &parameters);
        }
        self.look_for_deviants(&parameters);
        let nulls = parameters.clone().sides.map(|side| side.nulls);
        for _ in 0..ROUNDS[1] {
            parameters = round(&self.states, &parameters);
            parameters.sides.iter_mut().zip(&nulls).for_each(|(side, nulls)| side.nulls.clone_from(nulls));
        }
        let [columns, rows] = self.likelihoods.map(|likelihood| likelihood.base);
        for (side, [habit, in_segments]) in parameters.sides.iter_mut().zip(self.habits) {
            (side.habit, side.habit_in_segments) = (habit, in_segments);
        }
        Fit { alphabet: self.alphabet, bases: [rows, columns], parameters, states: self.states.len() as u64 }
    }

    fn look_for_deviants(&mut self, parameters: &Parameters) {
        for (side, likelihood) in self.likelihoods.iter().enumerate() {
            let nulls = NullMixture::new(&parameters.sides[side].nulls);
            for state in &mut self.states {
                let mut deviants = [0.0; DEVIANTS];
                for slice in &state.slices {
                    let null = nulls.given(&likelihood.shared(columns(&slice[side]), slice[side].total()));
                    add(&mut deviants, &likelihood.deviants(&slice[side], &nulls, &null).evidence());
                }
                state.sides[side].deviants = Some(Scaled::new(deviants));
            }
        }
    }
}

fn round(states: &[State], parameters: &Parameters) -> Parameters {
    let (mut dependent, mut expected) = (0.0, [Expected::default(), Expected::default()]);
    let mut segmented = Segmented::default();
    let weights = FamilyWeights::new(parameters);
    for state in states {
        let shares = state.shares(parameters, &weights);
        dependent += 1.0 - shares.independent;
        state.expect(&shares, parameters, &mut expected, &mut segmented);
    }
    Parameters::estimated(states.len() as f64, dependent, &expected, segmented)
}

/// The weights of the families, and how much more each slab weighs in those that have no slabs of one deviating row.
pub(super) struct FamilyWeights {
    pub families: [f64; 3],
    pub cut: f64,
}

impl FamilyWeights {
    pub fn new(parameters: &Parameters) -> Self {
        let [first, second] = [0, 1].map(|side: usize| parameters.sides[side].slabs[..CUT].iter().sum::<f64>());
        Self { families: parameters.families, cut: 1.0 / (first + second) }
    }
}

/// The probabilities of a state's hypotheses.
#[derive(Default)]
struct Shares {
    independent: f64,
    /// By side: of the slabs on fixed bases, of those on the state's own marginal, and of the deviants.
    shared: [[f64; 3]; 2],
    /// By side: of the first two, cut by segment, and in one segment alone.
    cut: [[f64; 2]; 2],
    one: [[f64; 2]; 2],
    /// By side: of each kind of the responder's habits, where they are told by its margin alone.
    habits: [[f64; HABITS]; 2],
}

impl State {
    /// Returns the probabilities of its hypotheses.
    fn shares(&self, parameters: &Parameters, weights: &FamilyWeights) -> Shares {
        let ln_dependent = parameters.dependent.ln();
        let mut shared =
            [0, 1].map(|at| self.sides[at].ln_hypotheses(&parameters.sides[at]).map(|ln| ln + ln_dependent));
        let mut cut = [[f64::NEG_INFINITY; 2]; 2];
        let (mut one, mut kinds) = (cut, [[0.0; HABITS]; 2]);
        if let Some(parts) = &self.cut {
            let [f_shared, f_cut, f_one] = weights.families.map(f64::ln);
            let more = weights.cut.ln() + ln_dependent;
            for side in 0..2 {
                let of_side = &parameters.sides[side];
                let pooled = self.sides[side].ln_null(of_side);
                let apart = parts[side].ln_null(of_side) - pooled;
                let habits = SegmentHabits::new(&of_side.segments, apart, &parts[side].around.logarithms());
                shared[side].iter_mut().for_each(|ln| *ln += f_shared - habits.ln);
                let own = |own: &Scaled<OWN_GRID>| own.ln_weighted(&of_side.slabs[OWN_SLABS]) + habits.ln_differ;
                let fixed = parts[side].fixed.ln_weighted(&of_side.slabs[..FIXED]) - pooled;
                cut[side] = [fixed, own(&parts[side].own)].map(|ln| ln + f_cut + more - habits.ln);
                let fixed = parts[side].ln_one_fixed(of_side) + apart;
                one[side] = [fixed, own(&parts[side].one)].map(|ln| ln + f_one + more - habits.ln);
                kinds[side] = habits.kinds;
            }
        }
        let independent = (-parameters.dependent).ln_1p();
        let all = || [shared.as_flattened(), cut.as_flattened(), one.as_flattened()].into_iter().flatten();
        let largest = all().fold(independent, |largest, ln| largest.max(*ln));
        let part = |ln: f64| (ln - largest).exp();
        let (shared, cut, one) = (shared.map(|s| s.map(part)), cut.map(|s| s.map(part)), one.map(|s| s.map(part)));
        // Each side by itself, so that the order of the variables changes no bit.
        let side = |at: usize| [&shared[at][..], &cut[at], &one[at]].into_iter().flatten().sum::<f64>();
        let total = part(independent) + (side(0) + side(1));
        let share = |part: f64| part / total;
        Shares {
            independent: share(part(independent)),
            shared: shared.map(|side| side.map(share)),
            cut: cut.map(|side| side.map(share)),
            one: one.map(|side| side.map(share)),
            habits: kinds,
        }
    }

    /// Adds the state to all that it is an instance of, in proportion to the probabilities.
    fn expect(
        &self,
        shares: &Shares,
        parameters: &Parameters,
        expected: &mut [Expected; 2],
        segmented: &mut Segmented,
    ) {
        let Shares { independent, shared, cut, one, habits } = shares;
        let total = |side: usize| [&shared[side][..], &cut[side], &one[side]].into_iter().flatten().sum::<f64>();
        for side in 0..2 {
            let (of_side, expected) = (&parameters.sides[side], &mut expected[side]);
            // Where the other variable responds, this one's habits are told by its margin alone.
            let free = independent + total(1 - side);
            let [fixed, own, deviant] = shared[side];
            let Some(parts) = &self.cut else {
                self.sides[side].expect(shared[side], free + own + deviant, of_side, expected);
                continue;
            };
            let [alike, apart] = [habits[side][0], habits[side][1]];
            let differ = 1.0 - alike;
            let null = free * alike + own + deviant;
            self.sides[side].expect([fixed, own, deviant], null, of_side, expected);
            let own = cut[side][1] + one[side][1];
            let apart = free * apart + own * apart / differ.max(f64::MIN_POSITIVE) + one[side][0];
            parts[side].expect([cut[side], one[side]], apart, of_side, expected);
            let kinds = (0..).zip(habits[side]).map(|(kind, p)| {
                let of_own = if kind == 0 { 0.0 } else { own * p / differ.max(f64::MIN_POSITIVE) };
                free * p + of_own + if kind == 1 { one[side][0] } else { 0.0 }
            });
            expected.habits.iter_mut().zip(kinds).for_each(|(sum, p)| *sum += p);
        }
        if self.cut.is_some() {
            let family = |by_side: [f64; 2]| by_side[0] + by_side[1];
            let sums = [shared.map(|s| s.iter().sum()), cut.map(|s| s.iter().sum()), one.map(|s| s.iter().sum())];
            segmented.families.iter_mut().zip(sums).for_each(|(sum, by_side)| *sum += family(by_side));
        }
    }
}

/// What a state says of its habits in segments, relative to the null whose habits are alike in all of them.
pub(super) struct SegmentHabits {
    /// ln of the null of all kinds, and of those that differ.
    pub ln: f64,
    pub ln_differ: f64,
    /// The probability of each kind.
    pub kinds: [f64; HABITS],
}

impl SegmentHabits {
    /// Weighs the kinds, given ln l of habits that are drawn around the environment's, and around the state's.
    pub fn new(weights: &[f64], apart: f64, around: &[f64; AROUND]) -> Self {
        let relative = |kind: usize| match kind {
            0 => 0.0,
            1 => apart,
            _ => around[kind - 2],
        };
        let logarithms: [f64; HABITS] = std::array::from_fn(|kind| weights[kind].ln() + relative(kind));
        let differ: f64 = weights[1..].iter().sum();
        let ln = ln_sum(&logarithms);
        Self { ln, ln_differ: ln_sum(&logarithms[1..]) - differ.ln(), kinds: logarithms.map(|one| (one - ln).exp()) }
    }
}

impl Cut {
    /// Looks at the parts of a state; `is_whole` where they are of one table.
    fn new<'a>(likelihood: &Likelihood, is_whole: bool, parts: impl Iterator<Item = &'a Table> + Clone) -> Self {
        let null = |part: &Table| Scaled::new(likelihood.shared(columns(part), part.total()));
        let (mut fixed, mut own) = ([0.0; FIXED], [0.0; OWN_GRID]);
        let (mut several, mut one) = (Vec::new(), Vec::new());
        for part in parts.clone() {
            let apart = likelihood.rows_apart(part);
            add(&mut fixed, &apart);
            let of_part = if part.is_line() { [0.0; OWN_GRID] } else { likelihood.evidence(part).own };
            add(&mut own, &of_part);
            let beyond = part.total().saturating_sub(1) as f64;
            one.push((beyond, of_part));
            if beyond > 0.0 {
                several.push(Part { null: null(part), fixed: Scaled::new(apart), ln_share: beyond.ln() });
            }
        }
        let total: f64 = one.iter().map(|(beyond, _)| beyond).sum();
        several.iter_mut().for_each(|part| part.ln_share -= total.ln());
        let around = if is_whole { likelihood.around(parts.clone()) } else { [0.0; AROUND] };
        Self {
            nulls: parts.map(null).collect(),
            around: Scaled::new(around),
            fixed: Scaled::new(fixed),
            own: Scaled::new(own),
            parts: several,
            one: Scaled::new(ln_mean(&one)),
        }
    }

    fn ln_null(&self, parameters: &SideParameters) -> f64 {
        self.nulls.iter().map(|part| part.ln_weighted(&parameters.nulls)).sum()
    }

    /// Returns ln of the mean over the parts of the slabs on fixed bases in one of them, relative to the null.
    fn ln_one_fixed(&self, parameters: &SideParameters) -> f64 {
        let told: Vec<f64> = self.parts.iter().map(|part| part.ln_fixed(parameters)).collect();
        if told.is_empty() { NOTHING } else { ln_sum(&told) }
    }

    /// Adds the state to the components, all parts together as one: `apart` states have the parts' own habits.
    fn expect(&self, [cut, one]: [[f64; 2]; 2], apart: f64, parameters: &SideParameters, expected: &mut Expected) {
        let SideParameters { nulls, slabs, .. } = parameters;
        self.fixed.share(cut[0], &slabs[..FIXED], &mut expected.slabs[..FIXED]);
        self.own.share(cut[1], &slabs[OWN_SLABS], &mut expected.slabs[OWN_SLABS]);
        self.one.share(one[1], &slabs[OWN_SLABS], &mut expected.slabs[OWN_SLABS]);
        let all = self.ln_one_fixed(parameters);
        for part in &self.parts {
            let share = one[0] * (part.ln_fixed(parameters) - all).exp();
            part.fixed.share(share, &slabs[..FIXED], &mut expected.slabs[..FIXED]);
        }
        let parts = self.nulls.len() as f64;
        self.nulls.iter().for_each(|part| part.share(apart / parts, nulls, &mut expected.nulls));
    }
}

impl Part {
    fn ln_fixed(&self, SideParameters { nulls, slabs, .. }: &SideParameters) -> f64 {
        self.ln_share + self.fixed.ln_weighted(&slabs[..FIXED]) - self.null.ln_weighted(nulls)
    }
}

/// Returns ln of the mean of e^x over the parts, each by its visits beyond the first: one visit depends on nothing. Nothing at all where there are no others.
pub(super) fn ln_mean<const L: usize>(parts: &[(f64, [f64; L])]) -> [f64; L] {
    let total: f64 = parts.iter().map(|(weight, _)| weight).sum();
    std::array::from_fn(|slab| {
        let largest = parts.iter().fold(f64::NEG_INFINITY, |largest, (_, part)| largest.max(part[slab]));
        let sum: f64 = parts.iter().map(|(weight, part)| weight * (part[slab] - largest).exp()).sum();
        if total > 0.0 { largest + (sum / total).ln() } else { NOTHING }
    })
}

/// ln of what cannot be.
const NOTHING: f64 = -1e300;

impl Side {
    fn new<'a>(likelihood: &Likelihood, slices: impl Iterator<Item = &'a Table>) -> Self {
        let (mut fixed, mut own) = ([0.0; FIXED], [0.0; OWN_GRID]);
        let (mut nulls, mut anchors) = (Vec::new(), Vec::new());
        for evidence in slices.map(|slice| likelihood.evidence(slice)) {
            nulls.push(Scaled::new(evidence.nulls));
            anchors.extend(evidence.anchor.map(Scaled::new));
            add(&mut fixed, &evidence.fixed);
            add(&mut own, &evidence.own);
        }
        Self { nulls, anchors, fixed: Scaled::new(fixed), own: Scaled::new(own), deviants: None }
    }

    /// Returns, relative to the null, how likely the state is under all slabs on fixed bases, on its own marginal, and of one deviating row.
    fn ln_hypotheses(&self, parameters: &SideParameters) -> [f64; 3] {
        let SideParameters { nulls, slabs, .. } = parameters;
        let anchored: f64 = self.anchors.iter().map(|slice| slice.ln_weighted(nulls)).sum();
        [
            self.fixed.ln_weighted(&slabs[..FIXED]) + anchored - self.ln_null(parameters),
            self.own.ln_weighted(&slabs[OWN_SLABS]),
            self.deviants.as_ref().map_or(f64::NEG_INFINITY, |deviants| deviants.ln_weighted(&slabs[DEVIANT_SLABS])),
        ]
    }

    fn ln_null(&self, SideParameters { nulls, .. }: &SideParameters) -> f64 {
        self.nulls.iter().map(|slice| slice.ln_weighted(nulls)).sum()
    }

    /// Adds the state to the components in proportion to their probabilities; all but slabs on fixed bases have the null's response.
    fn expect(&self, [fixed, own, deviant]: [f64; 3], null: f64, parameters: &SideParameters, expected: &mut Expected) {
        let SideParameters { nulls, slabs, .. } = parameters;
        self.fixed.share(fixed, &slabs[..FIXED], &mut expected.slabs[..FIXED]);
        self.own.share(own, &slabs[OWN_SLABS], &mut expected.slabs[OWN_SLABS]);
        if let Some(deviants) = &self.deviants {
            deviants.share(deviant, &slabs[DEVIANT_SLABS], &mut expected.slabs[DEVIANT_SLABS]);
        }
        self.nulls.iter().for_each(|slice| slice.share(null, nulls, &mut expected.nulls));
        self.anchors.iter().for_each(|slice| slice.share(fixed, nulls, &mut expected.nulls));
    }
}

/// Returns numbers in proportion to e^x that sum to 1.
pub(super) fn normalised<const L: usize>(logarithms: [f64; L]) -> [f64; L] {
    let Scaled { parts, .. } = Scaled::new(logarithms);
    let sum: f64 = parts.iter().sum();
    parts.map(|part| part / sum)
}
