//! Pages of states in an order.

use super::answer::bins;
use super::survey::{Order, OrderBy, Row, Survey};
use crate::domain::draft::ListingDraft;
use crate::domain::{Schema, Scope, StateFigures, StateKey, StatePage, Verdict, page_size};
use crate::error::{Fault, Problem};
use crate::evidence;

/// A checked request for a page.
pub struct Listing {
    order: Order,
    min_visits: u64,
    verdict: Option<Verdict>,
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
        let order = order(draft.order_by.as_deref()).map_err(|detail| keep("/order_by", detail)).ok();
        let verdict = draft.verdict.as_deref().map(str::parse).transpose();
        let verdict = verdict.map_err(|detail| keep("/verdict", detail)).unwrap_or_default();
        let token = draft.page_token.as_deref().filter(|token| !token.is_empty());
        let after = order.and_then(|order| {
            token
                .map(|token| place(schema, order, token))
                .transpose()
                .map_err(|detail| keep("/page_token", detail))
                .ok()
        });
        let size = page_size(draft.page_size).map_err(|problem| faults.extend(problem.faults)).ok();
        match (order, after, size) {
            (Some(order), Some(after), Some(size)) if faults.is_empty() => {
                Ok(Self { order, min_visits: draft.min_visits, verdict, size, after })
            }
            _ => Err(Problem::invalid("listing", faults)),
        }
    }

    /// Returns the page of a survey.
    pub fn page(&self, schema: &Schema, scope: &Scope, survey: &Survey) -> StatePage {
        let positions = survey.ordered(self.order);
        let row = |position: &u32| &survey.rows[*position as usize];
        let passed = |position: &u32| self.after.as_ref().is_some_and(|after| self.place_of(row(position)) <= *after);
        let start = positions.partition_point(passed);
        let wanted = positions[start..].iter().map(row).filter(|row| self.wants(scope, row));
        let mut rows: Vec<&Row> = wanted.take(self.size + 1).collect();
        let more = rows.len() > self.size;
        rows.truncate(self.size);
        let next_page_token = rows.last().filter(|_| more).map(|row| self.token(row));
        let states = rows.into_iter().map(|row| figures(schema, scope, row)).collect();
        StatePage { states, next_page_token, as_of: survey.as_of, unit: scope.unit }
    }

    fn wants(&self, scope: &Scope, row: &Row) -> bool {
        let verdict = || evidence::decide(&scope.rule, row.visits, row.plug_in, None);
        row.visits >= self.min_visits && self.verdict.is_none_or(|wanted| verdict() == wanted)
    }

    fn place_of(&self, row: &Row) -> Place {
        (self.order.rank(row), row.key.clone())
    }

    fn token(&self, row: &Row) -> String {
        format!("{}-{:x}-{}", order_word(self.order), self.order.rank(row), row.key)
    }
}

fn figures(schema: &Schema, scope: &Scope, row: &Row) -> StateFigures {
    StateFigures {
        key: row.key.clone(),
        bins: bins(schema, &row.key),
        visits: row.visits,
        plug_in: scope.unit.from_nats(row.plug_in),
        expected_if_independent: scope.unit.from_nats(row.expected),
        verdict: evidence::decide(&scope.rule, row.visits, row.plug_in, None),
    }
}

fn order(text: Option<&str>) -> Result<Order, String> {
    let text = text.unwrap_or("visits desc");
    let mut words = text.split_ascii_whitespace();
    let by = match words.next() {
        Some("visits") => Some(OrderBy::Visits),
        Some("plug_in") => Some(OrderBy::PlugIn),
        _ => None,
    };
    let descending = match words.next() {
        None | Some("desc") => Some(true),
        Some("asc") => Some(false),
        Some(_) => None,
    };
    match (by, descending, words.next()) {
        (Some(by), Some(descending), None) => Ok(Order { by, descending }),
        _ => Err(format!("got {text:?}, expected visits or plug_in, then desc or asc")),
    }
}

fn order_word(order: Order) -> &'static str {
    match (order.by, order.descending) {
        (OrderBy::Visits, true) => "vd",
        (OrderBy::Visits, false) => "va",
        (OrderBy::PlugIn, true) => "pd",
        (OrderBy::PlugIn, false) => "pa",
    }
}

fn place(schema: &Schema, order: Order, token: &str) -> Result<Place, String> {
    let wrong = || format!("got {token:?}, expected the next_page_token of a page in this order");
    let mut parts = token.splitn(3, '-');
    if parts.next() != Some(order_word(order)) {
        return Err(wrong());
    }
    let rank = parts.next().and_then(|rank| u64::from_str_radix(rank, 16).ok());
    let key = parts.next().and_then(|key| schema.key_of_text(key).ok());
    rank.zip(key).ok_or_else(wrong)
}
