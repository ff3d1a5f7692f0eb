//! Marginal likelihoods of one state under every hypothesis, kept for the E-step of EM: weights are
//! fitted to them over and over.

use super::cut::{Cut, SegmentWeights};
use super::increments::add;
use super::likelihood::{Likelihood, NullMixture, columns};
use super::log_space::Scaled;
use super::margins::{FittedMargins, MixedMargins, usual_habits};
use super::parameters::{
    APART, DEVIANT_SLABS, DEVIANTS, ExpectedCounts, ExpectedFamilies, FIXED, HABITS, OWN_GRID,
    OWN_SLABS, Parameters, SideParameters,
};
use crate::information::Table;

/// The marginal likelihoods of one state, as multiples of its likeliest component, in either way to
/// read it.
pub(super) struct State {
    slices: Vec<[Table; 2]>,
    sides: [Side; 2],
    /// The same of its parts, where it was seen in several segments.
    cut: Option<[Cut; 2]>,
}

/// The marginal likelihoods of one state where its columns respond to its rows.
pub(super) struct Side {
    nulls: FittedMargins,
    anchors: FittedMargins,
    fixed: Scaled<FIXED>,
    /// Relative to the null, as are the deviants.
    own: Scaled<OWN_GRID>,
    deviants: Option<Scaled<DEVIANTS>>,
}

/// The weights of one round of EM, with what follows from them for every state alike.
pub(super) struct Round<'a> {
    parameters: &'a Parameters,
    segments: SegmentWeights,
    /// By side: the weights of the slabs on fixed bases for a state of several slices, whose habits
    /// are as usual as they say.
    usual: [[f64; FIXED]; 2],
}

impl<'a> Round<'a> {
    /// Begins a round by these parameters.
    pub fn new(parameters: &'a Parameters) -> Self {
        let usual = |side: &SideParameters| {
            let usual = usual_habits(&side.nulls);
            std::array::from_fn(|slab| side.slabs[slab] * usual[slab])
        };
        Self {
            parameters,
            segments: SegmentWeights::new(parameters),
            usual: parameters.sides.each_ref().map(usual),
        }
    }

    fn side(&self, at: usize) -> SideWeights<'_> {
        SideWeights {
            parameters: &self.parameters.sides[at],
            usual: &self.usual[at],
        }
    }
}

/// The weights of one side in a round of EM.
#[derive(Clone, Copy)]
struct SideWeights<'a> {
    parameters: &'a SideParameters,
    usual: &'a [f64; FIXED],
}

/// The margins of one side of a state, mixed by the present weights.
struct SideMargins {
    nulls: MixedMargins,
    anchors: MixedMargins,
}

/// The responsibilities of a state's hypotheses: their probabilities by the present weights.
pub(super) struct Responsibilities {
    pub independent: f64,
    margins: [SideMargins; 2],
    /// By side: of the slabs on fixed bases, of those on the state's own marginal, and of the
    /// deviants.
    shared: [[f64; 3]; 2],
    /// By side: of the first two, cut by segment, and in one segment alone.
    cut: [[f64; 2]; 2],
    one: [[f64; 2]; 2],
    /// By side: of each kind of the responder's habits, where they are told by its margin alone.
    habits: [[f64; HABITS]; 2],
    /// By side: the likeliest component by which habits are drawn anew in each segment.
    likeliest: [usize; 2],
}

impl State {
    /// Looks at the slices that can tell dependence from independence, and at their parts by
    /// segment, if there are any; `is_whole` where those are of one table.
    pub fn new(
        likelihoods: &[Likelihood; 2],
        slices: Vec<[Table; 2]>,
        is_whole: bool,
        parts: &[Table],
    ) -> Self {
        let side =
            |side: usize| Side::new(&likelihoods[side], slices.iter().map(|slice| &slice[side]));
        let sides = [side(0), side(1)];

        let parts: Vec<[Table; 2]> = parts
            .iter()
            .map(|part| [part.clone(), part.transposed()])
            .collect();

        let cut = |side: usize| {
            Cut::new(
                &likelihoods[side],
                is_whole,
                parts.iter().map(|part| &part[side]),
            )
        };
        let cut = (!parts.is_empty()).then(|| [cut(0), cut(1)]);

        Self { slices, sides, cut }
    }

    /// Looks for rows that deviate from the null of a side, which is mixed so.
    pub fn look_for_deviants(&mut self, side: usize, likelihood: &Likelihood, nulls: &NullMixture) {
        let are_several = self.sides[side].nulls.are_several();
        let found = |table: &Table| {
            if are_several {
                return likelihood.deviants_at_margins(table);
            }
            let null = nulls.given(&likelihood.shared(columns(table), table.total()));
            likelihood.deviants(table, nulls, &null)
        };

        let mut deviants = [0.0; DEVIANTS];
        for slice in &self.slices {
            add(&mut deviants, &found(&slice[side]).evidence());
        }
        self.sides[side].deviants = Some(Scaled::new(deviants));
    }

    /// Returns the responsibilities of its hypotheses, the E-step of EM.
    pub fn responsibilities(&self, round: &Round<'_>) -> Responsibilities {
        let Round {
            parameters,
            segments: weights,
            ..
        } = round;
        let ln_dependent = parameters.dependent.ln();
        let margins = [0, 1].map(|at| self.sides[at].margins(&parameters.sides[at].nulls));
        let mut shared = [0, 1].map(|at| {
            self.sides[at]
                .ln_hypotheses(round.side(at), &margins[at])
                .map(|ln| ln + ln_dependent)
        });

        let mut cut = [[f64::NEG_INFINITY; 2]; 2];
        let (mut one, mut kinds, mut likeliest) = (cut, [[0.0; HABITS]; 2], [0; 2]);

        if let Some(parts) = &self.cut {
            let [f_shared, f_cut, f_one] = weights.families;
            let more = weights.cut + ln_dependent;
            for side in 0..2 {
                let of_side = &parameters.sides[side];
                let pooled = margins[side].nulls.ln();
                let habits = parts[side].habits(pooled, &weights.habits[side]);

                shared[side]
                    .iter_mut()
                    .for_each(|ln| *ln += f_shared - habits.ln);

                let own = |own: &Scaled<OWN_GRID>| {
                    own.ln_weighted(&of_side.slabs[OWN_SLABS]) + habits.ln_differ
                };
                let fixed = parts[side].fixed.ln_weighted(&of_side.slabs[..FIXED]) - pooled;
                cut[side] = [fixed, own(&parts[side].own)].map(|ln| ln + f_cut + more - habits.ln);
                let fixed = parts[side].ln_one_fixed(habits.likeliest, of_side) + habits.ln_apart;
                one[side] = [fixed, own(&parts[side].one)].map(|ln| ln + f_one + more - habits.ln);
                (kinds[side], likeliest[side]) = (habits.kinds, habits.likeliest);
            }
        }

        let independent = (-parameters.dependent).ln_1p();
        let all = || {
            [
                shared.as_flattened(),
                cut.as_flattened(),
                one.as_flattened(),
            ]
            .into_iter()
            .flatten()
        };

        let largest = all().fold(independent, |largest, ln| largest.max(*ln));
        let part = |ln: f64| (ln - largest).exp();
        let (shared, cut, one) = (
            shared.map(|s| s.map(part)),
            cut.map(|s| s.map(part)),
            one.map(|s| s.map(part)),
        );

        // Each side by itself, so that the order of the variables changes no bit.
        let side = |at: usize| {
            [&shared[at][..], &cut[at], &one[at]]
                .into_iter()
                .flatten()
                .sum::<f64>()
        };

        let total = part(independent) + (side(0) + side(1));
        let share = |part: f64| part / total;

        Responsibilities {
            independent: share(part(independent)),
            margins,
            shared: shared.map(|side| side.map(share)),
            cut: cut.map(|side| side.map(share)),
            one: one.map(|side| side.map(share)),
            habits: kinds,
            likeliest,
        }
    }

    /// Adds the state to the expected counts of all that it may be an instance of.
    pub fn expect(
        &self,
        responsibilities: &Responsibilities,
        round: &Round<'_>,
        expected: &mut [ExpectedCounts; 2],
        segmented: &mut ExpectedFamilies,
    ) {
        let Responsibilities {
            independent,
            margins,
            shared,
            cut,
            one,
            habits,
            likeliest,
        } = responsibilities;

        let total = |side: usize| {
            [&shared[side][..], &cut[side], &one[side]]
                .into_iter()
                .flatten()
                .sum::<f64>()
        };

        for side in 0..2 {
            let (of_side, expected) = (round.side(side), &mut expected[side]);
            // Where the other variable responds, this one's habits are told by its margin alone.
            let free = independent + total(1 - side);
            let [fixed, own, deviant] = shared[side];

            let margins = &margins[side];
            let Some(parts) = &self.cut else {
                let null = free + own + deviant;
                self.sides[side].expect(shared[side], null, of_side, margins, expected);
                continue;
            };

            let alike = habits[side][0];
            let null = free * alike + own + deviant;
            self.sides[side].expect([fixed, own, deviant], null, of_side, margins, expected);
            parts[side].expect(
                [cut[side], one[side]],
                likeliest[side],
                of_side.parameters,
                &mut expected.slabs,
            );

            // Slabs on the parts' marginals go with habits that differ in any way, those on fixed
            // bases in one segment with such as are drawn anew.
            let sum_of = |kinds: std::ops::Range<usize>| {
                habits[side][kinds]
                    .iter()
                    .sum::<f64>()
                    .max(f64::MIN_POSITIVE)
            };
            let (own, one_fixed) = (
                (cut[side][1] + one[side][1]) / sum_of(1..HABITS),
                one[side][0] / sum_of(APART),
            );

            let kinds = (0..).zip(habits[side]).map(|(kind, p)| {
                let differ = if kind == 0 { 0.0 } else { own };
                let apart = if APART.contains(&kind) {
                    one_fixed
                } else {
                    0.0
                };
                p * (free + differ + apart)
            });

            expected
                .habits
                .iter_mut()
                .zip(kinds)
                .for_each(|(sum, p)| *sum += p);
        }

        if self.cut.is_some() {
            let family = |by_side: [f64; 2]| by_side[0] + by_side[1];
            let sums = [
                shared.map(|s| s.iter().sum()),
                cut.map(|s| s.iter().sum()),
                one.map(|s| s.iter().sum()),
            ];

            segmented
                .families
                .iter_mut()
                .zip(sums)
                .for_each(|(sum, by_side)| *sum += family(by_side));
        }
    }
}

impl Side {
    fn new<'a>(likelihood: &Likelihood, slices: impl Iterator<Item = &'a Table>) -> Self {
        let (mut fixed, mut own) = ([0.0; FIXED], [0.0; OWN_GRID]);
        let (mut nulls, mut anchors) = (Vec::new(), Vec::new());
        for evidence in slices.map(|slice| likelihood.evidence(slice)) {
            nulls.push(evidence.nulls);
            anchors.extend(evidence.anchor);
            add(&mut fixed, &evidence.fixed);
            add(&mut own, &evidence.own);
        }

        Self {
            nulls: FittedMargins::new(&nulls),
            anchors: FittedMargins::new(&anchors),
            fixed: Scaled::new(fixed),
            own: Scaled::new(own),
            deviants: None,
        }
    }

    /// Returns, relative to the null, how likely the state is under all slabs on fixed bases, on
    /// its own marginal, and of one deviating row.
    fn ln_hypotheses(&self, weights: SideWeights<'_>, margins: &SideMargins) -> [f64; 3] {
        let slabs = &weights.parameters.slabs;

        [
            self.fixed.ln_weighted(self.on_fixed_bases(weights)) + margins.anchors.ln()
                - margins.nulls.ln(),
            self.own.ln_weighted(&slabs[OWN_SLABS]),
            self.deviants
                .as_ref()
                .map_or(f64::NEG_INFINITY, |deviants| {
                    deviants.ln_weighted(&slabs[DEVIANT_SLABS])
                }),
        ]
    }

    /// Returns the weights of the slabs on fixed bases: as they are for a state of one slice, which
    /// most are.
    fn on_fixed_bases<'w>(&self, weights: SideWeights<'w>) -> &'w [f64] {
        if self.nulls.are_several() {
            weights.usual
        } else {
            &weights.parameters.slabs[..FIXED]
        }
    }

    fn margins(&self, nulls: &[f64]) -> SideMargins {
        SideMargins {
            nulls: self.nulls.mixed(nulls),
            anchors: self.anchors.mixed(nulls),
        }
    }

    /// Adds the state to the components in proportion to their probabilities; all but slabs on
    /// fixed bases have the null's response.
    fn expect(
        &self,
        [fixed, own, deviant]: [f64; 3],
        null: f64,
        weights: SideWeights<'_>,
        margins: &SideMargins,
        expected: &mut ExpectedCounts,
    ) {
        let SideParameters { nulls, slabs, .. } = weights.parameters;
        self.fixed.share(
            fixed,
            self.on_fixed_bases(weights),
            &mut expected.slabs[..FIXED],
        );
        self.own
            .share(own, &slabs[OWN_SLABS], &mut expected.slabs[OWN_SLABS]);

        if let Some(deviants) = &self.deviants {
            deviants.share(
                deviant,
                &slabs[DEVIANT_SLABS],
                &mut expected.slabs[DEVIANT_SLABS],
            );
        }

        self.nulls
            .share(&margins.nulls, null, nulls, &mut expected.nulls);
        self.anchors
            .share(&margins.anchors, fixed, nulls, &mut expected.nulls);
    }
}
