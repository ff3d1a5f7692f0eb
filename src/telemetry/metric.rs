//! Metrics in the exposition format of Prometheus: counters, gauges and histograms with few labels,
//! each declared once.
//!
//! A series that this process counts is kept here, for ever: only for labels whose values are few.
//! What is true of something that may go, an environment, is told anew on the [`Page`] of each
//! scrape, and is gone with it.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// A declared metric, with the series of it that are kept.
pub struct Metric {
    /// `nudge_<noun>_<unit>[_total]`, in base units.
    pub name: &'static str,
    /// How its numbers behave.
    pub kind: Kind,
    /// The names of its labels.
    pub labels: &'static [&'static str],
    /// What it says: a sentence without its full stop.
    pub help: &'static str,
    /// In order of their labels.
    series: Mutex<Vec<(Labels, Value)>>,
}

/// The type of a metric (counter, gauge or histogram).
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// It only grows, from 0 at the start of the process.
    Counter,
    /// It is as it is now.
    Gauge,
    /// Counts of values up to each of these bounds.
    Histogram(&'static [f64]),
}

/// The values of the labels, in the order of their names.
type Labels = Vec<String>;

#[derive(Debug, Clone)]
enum Value {
    Number(f64),
    Distribution {
        up_to: Vec<u64>,
        count: u64,
        sum: f64,
    },
}

impl Kind {
    /// Returns the word of the exposition format.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Counter => "counter",
            Self::Gauge => "gauge",
            Self::Histogram(_) => "histogram",
        }
    }
}

impl Metric {
    /// Declares a counter.
    pub const fn counter(
        name: &'static str,
        labels: &'static [&'static str],
        help: &'static str,
    ) -> Self {
        Self::new(Kind::Counter, name, labels, help)
    }

    /// Declares a gauge.
    pub const fn gauge(
        name: &'static str,
        labels: &'static [&'static str],
        help: &'static str,
    ) -> Self {
        Self::new(Kind::Gauge, name, labels, help)
    }

    /// Declares a histogram with buckets up to each of these bounds.
    pub const fn histogram(
        name: &'static str,
        bounds: &'static [f64],
        labels: &'static [&'static str],
        help: &'static str,
    ) -> Self {
        Self::new(Kind::Histogram(bounds), name, labels, help)
    }

    const fn new(
        kind: Kind,
        name: &'static str,
        labels: &'static [&'static str],
        help: &'static str,
    ) -> Self {
        Self {
            name,
            kind,
            labels,
            help,
            series: Mutex::new(Vec::new()),
        }
    }

    /// Lets a series be told before anything happened, so that the first time is seen as a change.
    pub(super) fn begin(&self, labels: &[&str]) {
        self.with(labels, |_| {});
    }

    /// Adds to a number.
    pub(super) fn add(&self, labels: &[&str], by: f64) {
        self.with(labels, |value| match value {
            Value::Number(number) => *number += by,
            Value::Distribution { .. } => {}
        });
    }

    /// Sets a number.
    pub(super) fn set(&self, labels: &[&str], to: f64) {
        self.with(labels, |value| *value = Value::Number(to));
    }

    /// Notes one value of a histogram.
    pub(super) fn observe(&self, labels: &[&str], observed: f64) {
        let Kind::Histogram(bounds) = self.kind else {
            return;
        };
        self.with(labels, |value| {
            let Value::Distribution { up_to, count, sum } = value else {
                return;
            };
            if let Some(at) = bounds.iter().position(|bound| observed <= *bound) {
                up_to[at] += 1;
            }
            *count += 1;
            *sum += observed;
        });
    }

    fn with(&self, labels: &[&str], change: impl FnOnce(&mut Value)) {
        debug_assert_eq!(labels.len(), self.labels.len(), "{}", self.name);
        let mut series = self.kept();
        // By every request several times: labels are copied where a series is new.
        let compare = |(kept, _): &(Labels, Value)| {
            kept.iter().map(String::as_str).cmp(labels.iter().copied())
        };
        let at = series.binary_search_by(compare).unwrap_or_else(|at| {
            let labels = labels.iter().map(|label| (*label).to_owned()).collect();
            series.insert(at, (labels, self.nothing()));
            at
        });
        change(&mut series[at].1);
    }

    fn nothing(&self) -> Value {
        match self.kind {
            Kind::Counter | Kind::Gauge => Value::Number(0.0),
            Kind::Histogram(bounds) => Value::Distribution {
                up_to: vec![0; bounds.len()],
                count: 0,
                sum: 0.0,
            },
        }
    }

    fn kept(&self) -> MutexGuard<'_, Vec<(Labels, Value)>> {
        self.series.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes the metric with its kept series and those of a page.
    fn render(&self, page: &Page, text: &mut String) {
        let Self {
            name, kind, help, ..
        } = self;
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "# HELP {name} {help}\n# TYPE {name} {}",
            kind.as_str()
        );

        for (labels, value) in &*self.kept() {
            self.render_series(labels, value, text);
        }

        for (labels, number) in page.0.get(name).into_iter().flatten() {
            self.render_series(labels, &Value::Number(*number), text);
        }
    }

    fn render_series(&self, labels: &[String], value: &Value, text: &mut String) {
        let labels = self
            .labels
            .iter()
            .copied()
            .zip(labels.iter().map(String::as_str))
            .collect::<Vec<_>>();
        match (value, self.kind) {
            (Value::Distribution { up_to, count, sum }, Kind::Histogram(bounds)) => {
                let mut below = 0;
                for (bound, number) in bounds.iter().zip(up_to) {
                    below += number;
                    line(
                        text,
                        self.name,
                        "_bucket",
                        &labels,
                        Some(&bound.to_string()),
                        below as f64,
                    );
                }
                line(
                    text,
                    self.name,
                    "_bucket",
                    &labels,
                    Some("+Inf"),
                    *count as f64,
                );
                line(text, self.name, "_sum", &labels, None, *sum);
                line(text, self.name, "_count", &labels, None, *count as f64);
            }
            (Value::Number(number), _) => line(text, self.name, "", &labels, None, *number),
            (Value::Distribution { .. }, _) => {}
        }
    }
}

fn line(
    text: &mut String,
    name: &str,
    suffix: &str,
    labels: &[(&str, &str)],
    bound: Option<&str>,
    number: f64,
) {
    let all = labels
        .iter()
        .copied()
        .chain(bound.map(|bound| ("le", bound)));
    // An empty label is none.
    let told: Vec<String> = all
        .filter(|(_, value)| !value.is_empty())
        .map(|(name, value)| label(name, value))
        .collect();
    let labels = if told.is_empty() {
        String::new()
    } else {
        format!("{{{}}}", told.join(","))
    };

    let _ = writeln!(text, "{name}{suffix}{labels} {number}");
}

/// Returns a label as the exposition format writes it.
fn label(name: &str, value: &str) -> String {
    format!(
        "{name}=\"{}\"",
        value
            .replace('\\', r"\\")
            .replace('"', "\\\"")
            .replace('\n', r"\n")
    )
}

/// Series that are collected at one scrape and not kept.
#[derive(Default)]
pub struct Page(BTreeMap<&'static str, Vec<(Labels, f64)>>);

impl Page {
    /// Tells a number of a metric.
    pub fn tell(&mut self, metric: &Metric, labels: &[&str], number: f64) {
        debug_assert_eq!(labels.len(), metric.labels.len(), "{}", metric.name);
        let labels = labels.iter().map(|label| (*label).to_owned()).collect();
        self.0
            .entry(metric.name)
            .or_default()
            .push((labels, number));
    }

    /// Returns these metrics in the exposition format.
    pub(super) fn render(&self, metrics: &[&Metric]) -> String {
        let mut text = String::new();
        metrics
            .iter()
            .for_each(|metric| metric.render(self, &mut text));
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metrics_are_told_in_the_format_of_prometheus() {
        static ASKED: Metric = Metric::counter("asked_total", &["by"], "Questions");
        static SIZE: Metric = Metric::gauge("size_bytes", &["of"], "Bytes");
        static TOOK: Metric = Metric::histogram("took_seconds", &[0.5, 2.5], &["by"], "Time");
        ASKED.begin(&["nobody"]);
        ASKED.add(&["a \"b\"\\c\nd"], 2.0);
        ASKED.add(&["a \"b\"\\c\nd"], 1.0);
        SIZE.set(&[""], 7.0);
        [0.5, 0.6, 3.0]
            .into_iter()
            .for_each(|took| TOOK.observe(&["x"], took));
        let mut page = Page::default();
        page.tell(&SIZE, &["lane"], 1e12);
        let expected = r#"# HELP asked_total Questions
# TYPE asked_total counter
asked_total{by="a \"b\"\\c\nd"} 3
asked_total{by="nobody"} 0
# HELP size_bytes Bytes
# TYPE size_bytes gauge
size_bytes 7
size_bytes{of="lane"} 1000000000000
# HELP took_seconds Time
# TYPE took_seconds histogram
took_seconds_bucket{by="x",le="0.5"} 1
took_seconds_bucket{by="x",le="2.5"} 2
took_seconds_bucket{by="x",le="+Inf"} 3
took_seconds_sum{by="x"} 4.1
took_seconds_count{by="x"} 3
"#;
        assert_eq!(page.render(&[&ASKED, &SIZE, &TOOK]), expected);
        assert!(
            !Page::default().render(&[&SIZE]).contains("lane"),
            "what is told at one scrape is gone with it"
        );
    }
}
