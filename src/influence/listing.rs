//! Pagination of states in an order, by tokens that name the place of the last row.

use super::count_ranking::CountRanking;
use super::discoveries::FoundDiscoveries;
use super::labels::{bins, names};
use super::order::{OrderBy, Orders, Ranked, SortOrder};
use super::pass_cache::PassResult;
use super::row::Row;
use super::size;
use super::state_ranking::StateRanking;
use crate::api::{self, proto};
use crate::domain::draft::ListingDraft;
use crate::domain::{
    Discovery, FitId, Pair, Schema, Scope, SegmentId, StateFigures, StateKey, StatePage, Unit,
    Verdict, page_size,
};
use crate::error::{Fault, Problem};
use crate::store::ByVisits;

/// A checked request for a page.
pub struct Listing {
    order: SortOrder,
    min_visits: u64,
    verdict: Option<Verdict>,
    /// Which states are discoveries, if only those are wanted.
    pub discovery: Option<Discovery>,
    size: usize,
    after: Option<Place>,
}

/// The place of a row in an order.
type Place = (u64, StateKey);

impl Listing {
    /// Checks a request for a page and lists every fault.
    pub fn new(schema: &Schema, draft: &ListingDraft) -> Result<Self, Problem> {
        let mut faults = Vec::new();
        let mut keep = |pointer: &str, detail: String| faults.push(Fault::new(pointer, detail));
        let order = order(draft.order_by.as_deref())
            .map_err(|detail| keep("/order_by", detail))
            .ok();

        let verdict = draft.verdict.as_deref().map(str::parse).transpose();
        let verdict = verdict
            .map_err(|detail| keep("/verdict", detail))
            .unwrap_or_default();

        let token = draft
            .page_token
            .as_deref()
            .filter(|token| !token.is_empty());
        let after = order.and_then(|order| {
            token
                .map(|token| place(schema, order, token))
                .transpose()
                .map_err(|detail| keep("/page_token", detail))
                .ok()
        });

        let size = page_size(draft.page_size)
            .map_err(|problem| faults.extend(problem.faults))
            .ok();
        let discovery = Discovery::new(&draft.discovery)
            .map_err(|found| faults.extend(found))
            .unwrap_or_default();

        match (order, after, size) {
            (Some(order), Some(after), Some(size)) if faults.is_empty() => Ok(Self {
                order,
                min_visits: draft.min_visits,
                verdict,
                discovery,
                size,
                after,
            }),
            _ => Err(Problem::invalid("listing", faults)),
        }
    }

    /// Returns whether the page can be chosen without evidence on every state.
    pub fn needs_evidence(&self) -> bool {
        self.order.by.needs_evidence() || self.verdict.is_some() || self.discovery.is_some()
    }

    /// Returns what is asked of the store for a page by visits, with one state more than the page
    /// may have; `None` for other pages, and for a pair that not every visit tells of.
    pub fn by_visits(
        &self,
        schema: &Schema,
        pair: &Pair,
        segments: Option<&[SegmentId]>,
    ) -> Option<ByVisits> {
        let is_so = self.order.by == OrderBy::Visits && !self.needs_evidence();
        let is_told_by_all = pair.later.is_none() && !schema.may_lack_actions();
        (is_so && is_told_by_all).then(|| ByVisits {
            segments: segments.map(<[_]>::to_vec),
            min_visits: self.min_visits,
            descending: self.order.descending,
            after: self
                .after
                .as_ref()
                .map(|(rank, key)| (self.order.directed(*rank), key.clone())),
            states: self.size as u32 + 1,
        })
    }

    /// Returns how many of the rows that the store found are the page, and its token.
    pub fn cut(&self, schema: &Schema, rows: &[Row]) -> (usize, Option<String>) {
        let page = api::page_of(rows.iter(), self.size, 0, |row| {
            size::most_listed(schema, &row.key)
        });
        let next_page_token = page
            .items
            .last()
            .filter(|_| page.has_more)
            .map(|row| token_of(self.order, self.order.directed(row.visits), &row.key));
        (page.items.len(), next_page_token)
    }

    /// Returns the page of a ranking; of the discoveries only, if there are any to tell.
    pub fn page(
        &self,
        schema: &Schema,
        scope: &Scope,
        ranking: &PassResult<StateRanking>,
        found: Option<&FoundDiscoveries>,
    ) -> StatePage {
        let is_found = |position: usize| found.is_none_or(|found| found.rows[position]);
        let wants = |position: usize| {
            is_found(position)
                && self
                    .verdict
                    .is_none_or(|wanted| ranking.rows.verdict(position) == wanted)
        };
        let figures = |at: usize| StateFigures {
            p_value: found.and_then(|found| found.p_values.get(at).copied().flatten()),
            ..figures(schema, scope.unit, &ranking.rows.row(at))
        };
        let bytes = |at: usize| api::bytes(&proto::StateFigures::from(figures(at)));

        let Chosen {
            positions,
            next_page_token,
        } = self.chosen(&ranking.rows, &ranking.orders, wants, bytes);
        let states = positions.into_iter().map(figures).collect();
        let made_from = MadeFrom {
            as_of: ranking.as_of,
            fit: ranking.fit,
        };
        page(schema, scope, made_from, (states, next_page_token))
    }

    /// Returns the states of the page by ranks alone.
    pub fn keys(&self, schema: &Schema, ranks: &CountRanking) -> (Vec<StateKey>, Option<String>) {
        let bytes = |at: usize| size::most_listed(schema, &ranks.rows.key(at));
        let Chosen {
            positions,
            next_page_token,
        } = self.chosen(&ranks.rows, &ranks.orders, |_| true, bytes);
        (
            positions.into_iter().map(|at| ranks.rows.key(at)).collect(),
            next_page_token,
        )
    }

    /// Chooses the rows of the page, by position; `bytes` are those of what will be told of each.
    fn chosen(
        &self,
        rows: &impl Ranked,
        orders: &Orders,
        wants: impl Fn(usize) -> bool,
        bytes: impl Fn(usize) -> usize,
    ) -> Chosen {
        let passed = |at: &u32| {
            self.after.as_ref().is_some_and(|(rank, key)| {
                let at = *at as usize;
                (self.order.rank(rows, at), rows.bins(at)) <= (*rank, key.bins())
            })
        };

        let positions = orders.positions(rows, self.order);
        let start = positions.partition_point(passed);
        let wanted = positions[start..]
            .iter()
            .map(|at| *at as usize)
            .filter(|at| rows.visits(*at) >= self.min_visits && wants(*at));

        let page = api::page_of(wanted, self.size, 0, |at| bytes(*at));
        let next_page_token = page.items.last().filter(|_| page.has_more).map(|at| {
            let key = StateKey::new(rows.bins(*at));
            token_of(self.order, self.order.rank(rows, *at), &key)
        });
        Chosen {
            positions: page.items,
            next_page_token,
        }
    }
}

/// The rows of a page.
struct Chosen {
    positions: Vec<usize>,
    next_page_token: Option<String>,
}

/// What a page was made from.
#[derive(Clone, Copy)]
pub struct MadeFrom {
    /// The revision.
    pub as_of: u64,
    /// The fit that its order and its figures rest on.
    pub fit: FitId,
}

/// Returns a page of what is known of these states, and its token.
pub fn page_of(
    schema: &Schema,
    scope: &Scope,
    made_from: MadeFrom,
    (rows, next_page_token): (&[Row], Option<String>),
) -> StatePage {
    let states = rows.iter().map(|row| figures(schema, scope.unit, row));
    page(
        schema,
        scope,
        made_from,
        (states.collect(), next_page_token),
    )
}

fn page(
    schema: &Schema,
    scope: &Scope,
    MadeFrom { as_of, fit }: MadeFrom,
    (states, next_page_token): (Vec<StateFigures>, Option<String>),
) -> StatePage {
    StatePage {
        labels: names(schema, &scope.pair),
        lag: scope.pair.lag(schema),
        states,
        next_page_token,
        as_of,
        fit,
        unit: scope.unit,
    }
}

/// Returns what is told of a state.
pub fn figures(schema: &Schema, unit: Unit, row: &Row) -> StateFigures {
    StateFigures {
        key: row.key.clone(),
        bins: bins(schema, &row.key),
        visits: row.visits,
        plug_in: unit.from_nats(row.plug_in),
        expected_if_independent: unit.from_nats(row.expected),
        verdict: row.verdict,
        basis: row.basis,
        evidence: row.evidence.map(|evidence| evidence.in_unit(unit)),
        p_value: None,
    }
}

fn order(text: Option<&str>) -> Result<SortOrder, String> {
    let text = text.unwrap_or("visits desc");
    let (by, direction) = text.split_once(' ').unwrap_or((text, "desc"));
    let by = match by {
        "visits" => Some(OrderBy::Visits),
        "plug_in" => Some(OrderBy::PlugIn),
        "posterior_mean" => Some(OrderBy::PosteriorMean),
        "p_dependent" => Some(OrderBy::Dependent),
        _ => None,
    };

    let descending = match direction {
        "desc" => Some(true),
        "asc" => Some(false),
        _ => None,
    };

    match (by, descending) {
        (Some(by), Some(descending)) => Ok(SortOrder { by, descending }),
        _ => Err(format!(
            "got {text:?}, expected visits, plug_in, posterior_mean or p_dependent, then desc or asc"
        )),
    }
}

fn order_word(order: SortOrder) -> &'static str {
    match (order.by, order.descending) {
        (OrderBy::Visits, true) => "vd",
        (OrderBy::Visits, false) => "va",
        (OrderBy::PlugIn, true) => "pd",
        (OrderBy::PlugIn, false) => "pa",
        (OrderBy::PosteriorMean, true) => "md",
        (OrderBy::PosteriorMean, false) => "ma",
        (OrderBy::Dependent, true) => "dd",
        (OrderBy::Dependent, false) => "da",
    }
}

fn place(schema: &Schema, order: SortOrder, token: &str) -> Result<Place, String> {
    let wrong = || format!("got {token:?}, expected the next_page_token of a page in this order");
    let mut parts = token.splitn(3, '-');
    if parts.next() != Some(order_word(order)) {
        return Err(wrong());
    }

    let rank = parts
        .next()
        .and_then(|rank| u64::from_str_radix(rank, 16).ok());
    let key = parts.next().and_then(|key| schema.key_of_text(key).ok());
    // As it was written, so that no other text is taken for one.
    rank.zip(key)
        .filter(|(rank, key)| token_of(order, *rank, key) == token)
        .ok_or_else(wrong)
}

fn token_of(order: SortOrder, rank: u64, key: &StateKey) -> String {
    format!("{}-{rank:x}-{key}", order_word(order))
}
