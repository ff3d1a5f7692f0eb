//! One factorisation of a joint distribution, ready to answer: p(row) p(column | row), in which
//! columns respond to rows.

use super::base::{Alike, Groups};
use super::deviants::{Deviants, Deviating};
use super::habits::Usage;
use super::increments::{add, depth};
use super::likelihood::{Likelihood, NullMixture, columns};
use super::margins::{Margins, usual_habits};
use super::moments::{
    Concentration, Letter, Moments, Pair, Policy, Slab, Slice, Term, moments, two_rows,
};
use super::parameters::{
    CUT, DEVIANT_CONCENTRATIONS, DEVIANT_GRID, DEVIANT_SLABS, FIXED, FIXED_CONCENTRATIONS,
    FIXED_GRID, NULL_GRID, OWN_CONCENTRATIONS, OWN_GRID, OWN_SLABS, SLABS, SideParameters,
};
use super::parts_evidence::{PartEvidence, PartsEvidence};
use crate::information::Table;

/// Rows below this share of a deviant's posterior weight are left out of its moments.
const NEGLIGIBLE: f64 = 0.1;
/// The most rows that are looked at: where more are as probable, the counts say little of it, and
/// each row would say about the same.
const MOST_DEVIATING: usize = 3;

/// One factorisation of a joint distribution, ready to answer: driver, then responder.
pub(super) struct Side {
    pub likelihood: Likelihood,
    pub nulls: NullMixture,
    /// ln w.
    pub ln_slabs: [f64; SLABS],
    /// ln of how likely habits are that are as usual as the slabs on fixed bases say.
    ln_usual_habits: [f64; FIXED],
    /// kappa, and kappa'.
    pub habit: Option<f64>,
    habit_in_segments: Option<f64>,
    /// That of r + k by visits r, then by slab.
    concentrations: Vec<[Concentration; OWN_GRID]>,
    /// On the environment's base, and the uniform one.
    bases: [Vec<Tabulated>; 2],
    /// The same of the row that deviates, and of the others, whose counts have one visit more.
    deviants: [Vec<Tabulated>; 2],
    others: Tabulated,
    groups: Groups,
}

/// What the margins of a state's slices say: under the null, and of the rows that both hypotheses
/// have alike.
pub(super) struct StateMargins {
    /// Whether several slices can tell dependence from independence.
    are_several: bool,
    nulls: Margins,
    anchors: Margins,
}

impl StateMargins {
    pub fn none(are_several: bool) -> Self {
        Self {
            are_several,
            nulls: Margins::none(),
            anchors: Margins::none(),
        }
    }
}

/// The terms of one slab on a fixed base.
struct Tabulated {
    depth: u64,
    /// By letter, then by count.
    terms: Vec<Term>,
    /// sum_j k m_j psi(k m_j + 1).
    psi: f64,
}

impl Side {
    pub fn new(likelihood: Likelihood, parameters: &SideParameters) -> Self {
        let shares = likelihood.base.shares();
        let letters = shares.len().max(1) as f64;
        let tabulated = |concentrations: &[f64]| {
            let of = |shares: &[f64], times: f64| {
                let of_each = concentrations
                    .iter()
                    .map(|k| Tabulated::new(*k, shares, times));
                of_each.collect::<Vec<_>>()
            };
            [of(shares, 1.0), of(&[1.0 / letters], letters)]
        };

        Self {
            bases: tabulated(&FIXED_CONCENTRATIONS),
            deviants: tabulated(&DEVIANT_CONCENTRATIONS),
            others: Tabulated::new(1.0, shares, 1.0),
            groups: Groups::new(shares),
            nulls: NullMixture::new(&parameters.nulls),
            ln_slabs: std::array::from_fn(|slab| parameters.slabs[slab].ln()),
            ln_usual_habits: usual_habits(&parameters.nulls).map(f64::ln),
            habit: parameters.habit,
            habit_in_segments: parameters.habit_in_segments,
            concentrations: (0..depth(1))
                .map(|r| OWN_CONCENTRATIONS.map(|k| Concentration::new(r as f64 + k)))
                .collect(),
            likelihood,
        }
    }

    /// Adds the log Bayes factor of every slab against the null of a slice by itself, unless the
    /// slice cannot tell dependence from independence; and that null to the state's. Returns what
    /// its rows say for deviating.
    pub fn add_bayes_factors(
        &self,
        table: &Table,
        slabs: &mut [f64; SLABS],
        state: &mut StateMargins,
    ) -> Deviants {
        let evidence = self.likelihood.evidence(table);
        let null = self.nulls.given(&evidence.nulls);
        let deviants = if state.are_several && !table.is_line() {
            self.likelihood.deviants_at_margins(table)
        } else {
            self.likelihood.deviants(table, &self.nulls, &null)
        };
        if !table.is_line() {
            let anchored = evidence.anchor.as_ref().map_or(0.0, |anchor| {
                let ln = self.nulls.ln_mixed(anchor);
                state.anchors.add(anchor, ln);
                ln
            });

            slabs
                .iter_mut()
                .zip(&evidence.fixed)
                .for_each(|(ln, by)| *ln += by + anchored - null.ln);
            slabs[OWN_SLABS]
                .iter_mut()
                .zip(&evidence.own)
                .for_each(|(ln, by)| *ln += by);
            slabs[DEVIANT_SLABS]
                .iter_mut()
                .zip(deviants.evidence())
                .for_each(|(ln, by)| *ln += by);

            state.nulls.add(&evidence.nulls, null.ln);
        }
        deviants
    }

    /// Corrects the Bayes factors of several slices for what they have in common, and returns ln of
    /// the null of all.
    pub fn join(&self, state: &StateMargins, slabs: &mut [f64; SLABS]) -> f64 {
        let StateMargins { nulls, anchors, .. } = state;
        let beyond = anchors.beyond_apart(&self.nulls) - nulls.beyond_apart(&self.nulls);
        if nulls.are_several() {
            slabs
                .iter_mut()
                .zip(&self.ln_usual_habits)
                .for_each(|(ln, usual)| *ln += beyond + usual);
        }
        nulls.ln(&self.nulls)
    }

    /// Adds what a part of a state says that was visited more than once.
    pub fn add_part(&self, part: &Table, evidence: &mut PartsEvidence) {
        let (null, apart) = (
            self.likelihood.shared(columns(part), part.total()),
            self.likelihood.rows_apart(part),
        );

        evidence
            .cut
            .iter_mut()
            .zip(apart)
            .for_each(|(ln, by)| *ln += by);
        add(&mut evidence.null, &null);

        let mut alone = [0.0; CUT];
        alone[..FIXED].copy_from_slice(&apart);
        if !part.is_line() {
            let own = self.likelihood.on_own_marginal(part);
            evidence.cut[OWN_SLABS]
                .iter_mut()
                .zip(&own)
                .for_each(|(ln, by)| *ln += by);
            alone[OWN_SLABS].copy_from_slice(&own);
        }

        evidence.parts.push(PartEvidence {
            beyond: (part.total() - 1) as f64,
            slabs: alone,
            null,
        });
    }

    /// Adds what so many parts of one visit of a letter say, for which concentrations are of no
    /// concern: DM(1; k m) = m_j.
    pub fn add_single_visits(&self, letter: usize, parts: f64, evidence: &mut PartsEvidence) {
        let shares = [
            self.likelihood.base.shares()[letter],
            1.0 / self.letters() as f64,
        ];
        let ln_shares = shares.map(|share| parts * share.ln());

        for (cut, ln) in evidence.cut[..FIXED].chunks_mut(FIXED_GRID).zip(ln_shares) {
            cut.iter_mut().for_each(|sum| *sum += ln);
        }
        for (null, ln) in evidence.null.chunks_mut(NULL_GRID).zip(ln_shares) {
            null.iter_mut().for_each(|sum| *sum += ln);
        }
    }

    /// Looks at a part of a state, given the driver's policy in the state.
    pub fn part<'a>(&self, part: &'a Table, usage: &'a Usage) -> Slice<'a> {
        /// Slabs of one deviating row are not cut.
        const NONE: &Deviants = &Deviants::none();
        Slice::new(
            part,
            NONE,
            self.part_policy(part.total(), usage),
            self.groups.without(part.column_labels()),
        )
    }

    /// Returns the policy of the driver in a part of a state with so many visits.
    pub fn part_policy<'a>(&self, visits: u64, usage: &'a Usage) -> Policy<'a> {
        Policy::new(visits, usage, self.habit_in_segments.or(self.habit))
    }

    /// Looks at a slice, given how the environment uses the driver's letters.
    pub fn slice<'a>(
        &self,
        table: &'a Table,
        deviants: &'a Deviants,
        usage: &'a Usage,
    ) -> Slice<'a> {
        Slice::new(
            table,
            deviants,
            self.policy(table, usage),
            self.groups.without(table.column_labels()),
        )
    }

    /// Returns the policy of the driver.
    pub fn policy<'a>(&self, table: &Table, usage: &'a Usage) -> Policy<'a> {
        Policy::new(table.total(), usage, self.habit)
    }

    /// Returns mean and variance of mutual information in a slice under a slab.
    pub fn moments(&self, slab: usize, slice: &Slice<'_>) -> Moments {
        match slab {
            0..FIXED => self.on_fixed_base(slab, slice),
            slab if DEVIANT_SLABS.contains(&slab) => {
                self.deviating(slab - DEVIANT_SLABS.start, slice)
            }
            _ => self.on_own_marginal(slab - FIXED, slice),
        }
    }

    fn on_fixed_base(&self, slab: usize, slice: &Slice<'_>) -> Moments {
        let (on_base, at) = (slab < FIXED_GRID, slab % FIXED_GRID);
        let (k, labels, shares) = (
            FIXED_CONCENTRATIONS[at],
            slice.table.column_labels(),
            self.likelihood.base.shares(),
        );

        let tabulated = &self.bases[usize::from(!on_base)][at];
        let uniform = 1.0 / shares.len() as f64;
        let share = |at: usize| {
            if on_base {
                shares[labels[at] as usize]
            } else {
                uniform
            }
        };
        let letter = |at: usize| if on_base { labels[at] as usize } else { 0 };
        let term = |at: usize, n: u64| tabulated.term(letter(at), n, k * share(at));

        let columns: Vec<Letter> = (0..labels.len())
            .map(|at| Letter {
                share: share(at),
                empty: term(at, 0),
            })
            .collect();

        let alike = [Alike {
            share: uniform,
            letters: (shares.len() - labels.len()) as f64,
        }];
        let rest = match (on_base, shares.len() - labels.len()) {
            (true, _) => &slice.rest[..],
            (false, 0) => &[],
            (false, _) => &alike,
        };

        let slab = Slab {
            concentration: k,
            columns: &columns,
            psi: tabulated.psi,
            rest,
        };

        moments(slice, &slab, self.concentration(at), term)
    }

    fn on_own_marginal(&self, at: usize, slice: &Slice<'_>) -> Moments {
        let (k, table) = (OWN_CONCENTRATIONS[at], slice.table);
        let letter = |at: usize| {
            let share = self.likelihood.own_share(table, at);
            Letter {
                share,
                empty: Term::new(k * share),
            }
        };

        let columns: Vec<Letter> = (0..table.columns().len()).map(letter).collect();
        let own = |group: &Alike| Alike {
            share: group.share / (table.total() as f64 + 1.0),
            ..*group
        };

        let rest: Vec<Alike> = slice.rest.iter().map(own).collect();
        let unvisited = rest
            .iter()
            .map(|group| group.letters * Term::new(k * group.share).psi)
            .sum::<f64>();
        let psi = columns.iter().map(|letter| letter.empty.psi).sum::<f64>() + unvisited;

        let slab = Slab {
            concentration: k,
            columns: &columns,
            psi,
            rest: &rest,
        };

        let term = |at: usize, n: u64| Term::new(n as f64 + k * columns[at].share);
        moments(slice, &slab, self.concentration(at), term)
    }

    /// Returns the concentration r + k of rows with r visits, for k at a place of the grid.
    fn concentration(&self, at: usize) -> impl Fn(u64) -> Concentration {
        move |r: u64| match self.concentrations.get(r as usize) {
            Some(concentrations) => concentrations[at],
            None => Concentration::new(r as f64 + OWN_CONCENTRATIONS[at]),
        }
    }

    /// The moments over which row it is that deviates: the rest answers as it did, with one visit
    /// more spread as the base is.
    fn deviating(&self, deviant: usize, slice: &Slice<'_>) -> Moments {
        let Deviating { rows, untried } = slice.deviants.probable(deviant);
        let mut rows: Vec<(usize, f64)> = rows
            .into_iter()
            .enumerate()
            .filter(|(_, p)| *p > NEGLIGIBLE)
            .collect();
        rows.sort_by(|a, b| b.1.total_cmp(&a.1));
        rows.truncate(MOST_DEVIATING);

        let moments = rows
            .into_iter()
            .map(|(row, p)| (p, self.row_deviating(deviant, slice, Some(row))));
        let mut moments: Vec<(f64, Moments)> = moments.collect();

        let others = untried * slice.unvisited.rows;
        if others > NEGLIGIBLE || moments.is_empty() {
            moments.push((
                others.max(f64::MIN_POSITIVE),
                self.row_deviating(deviant, slice, None),
            ));
        }

        Moments::mixed(&moments)
    }

    /// `None`: a row that was not visited.
    fn row_deviating(&self, deviant: usize, slice: &Slice<'_>, row: Option<usize>) -> Moments {
        let Slice {
            table,
            policy,
            unvisited,
            rest,
            ..
        } = slice;
        let (at, on_base) = (deviant % DEVIANT_GRID, deviant < DEVIANT_GRID);
        let k = DEVIANT_CONCENTRATIONS[at];
        let (own, others) = (&self.deviants[usize::from(!on_base)][at], &self.others);
        let shares = self.likelihood.base.shares();
        let uniform = 1.0 / shares.len() as f64;
        let base = |share: f64| if on_base { share } else { uniform };

        let labels = table.column_labels();
        let mut columns = Vec::with_capacity(labels.len() + rest.len());
        for (label, all) in labels.iter().zip(table.columns()) {
            let letter = *label as usize;
            let share = shares[letter];
            columns.push(Pair {
                a: [*all as f64 + share, k * base(share)],
                terms: [
                    others.term(letter, *all, share),
                    own.term(if on_base { letter } else { 0 }, 0, k * base(share)),
                ],
                letters: 1.0,
            });
        }

        // The row's own visits are its own answers, and not the others'.
        for cell in row.into_iter().flat_map(|row| table.row(row)) {
            let at = cell.column as usize;
            let letter = labels[at] as usize;
            let (share, left) = (shares[letter], table.columns()[at] - cell.n);
            let start = k * base(share);
            columns[at].a = [left as f64 + share, cell.n as f64 + start];
            columns[at].terms = [
                others.term(letter, left, share),
                own.term(if on_base { letter } else { 0 }, cell.n, start),
            ];
        }

        columns.extend(rest.iter().map(|Alike { share, letters }| {
            let a = [*share, k * base(*share)];
            Pair {
                a,
                terms: a.map(Term::new),
                letters: *letters,
            }
        }));

        let p = match row {
            Some(row) => policy.probability(table.row_labels()[row], table.rows()[row]),
            None => unvisited.p / unvisited.rows.max(1.0),
        };
        two_rows(p, policy, &columns)
    }
}

impl Tabulated {
    fn new(k: f64, shares: &[f64], times: f64) -> Self {
        let depth = depth(shares.len());

        let terms = shares
            .iter()
            .flat_map(|share| (0..depth).map(move |n| Term::new(n as f64 + k * share)));
        let psi = shares
            .iter()
            .map(|share| times * Term::new(k * share).psi)
            .sum();

        Self {
            depth,
            terms: terms.collect(),
            psi,
        }
    }

    fn term(&self, letter: usize, n: u64, start: f64) -> Term {
        if n < self.depth {
            self.terms[letter * self.depth as usize + n as usize]
        } else {
            Term::new(n as f64 + start)
        }
    }
}
