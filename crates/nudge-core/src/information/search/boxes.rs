//! All rules with a condition on each of some coordinates: sums over boxes of a small grid, by
//! adding a layer at a time, so that each rule costs one addition.

use super::column::{Codes, Column};
use super::sum::{FEWEST_VISITS, Sum};

/// Scores closer than this, relative to the larger, are a tie: rounding apart, they are the same.
const TIE: f64 = 1e-9;

/// The best rule with a condition on each of some columns.
#[derive(Debug)]
pub(super) struct Best {
    /// D^2 / 2V - k ln C.
    pub score: f64,
    /// Of each column.
    pub ranges: Vec<Codes>,
}

impl Best {
    /// Returns whether it is better than a score, and no tie.
    pub fn beats(&self, score: f64) -> bool {
        self.score > score + TIE * score.abs()
    }
}

/// Some columns and the sums of all states by their codes in them, the first column most
/// significant.
pub(super) struct Tuple<'a> {
    columns: &'a [&'a Column],
    grid: Vec<Sum>,
}

impl<'a> Tuple<'a> {
    pub fn new(columns: &'a [&'a Column], codes: &[&[u8]], sums: &[Sum]) -> Self {
        let cells = columns.iter().map(|column| column.width()).product();
        let mut grid = vec![Sum::default(); cells];
        for (state, sum) in sums.iter().enumerate() {
            let digits = columns.iter().zip(codes);
            let cell = digits.fold(0, |cell, (column, codes)| {
                cell * column.width() + usize::from(codes[state])
            });
            grid[cell].add(sum);
        }
        Self { columns, grid }
    }

    /// Returns the best rule, where `price` is taken from the score of each; `None` where all have
    /// too few visits or lie below independence.
    pub fn best(&self, price: f64) -> Option<Best> {
        let mut highest = Highest {
            bar: 0.0,
            ranges: None,
        };
        let mut layers: Vec<Vec<Sum>> = Vec::new();
        let mut cells = self.grid.len();
        for column in self.columns {
            cells /= column.width();
            layers.push(vec![Sum::default(); cells]);
        }
        let mut ranges = Vec::with_capacity(self.columns.len());
        highest.look(&self.grid, self.columns, &mut layers, &mut ranges);

        let score = highest.bar / 2.0 - price;
        highest.ranges.map(|ranges| Best { score, ranges })
    }
}

/// The highest D^2 / V so far, and where.
struct Highest {
    bar: f64,
    ranges: Option<Vec<Codes>>,
}

impl Highest {
    /// Looks at all rules of a grid of some columns, within the ranges of those before them.
    fn look(
        &mut self,
        grid: &[Sum],
        columns: &[&Column],
        layers: &mut [Vec<Sum>],
        ranges: &mut Vec<Codes>,
    ) {
        let [column, behind @ ..] = columns else {
            return;
        };
        let [layer, layers @ ..] = layers else { return };
        if behind.is_empty() {
            return self.look_along(grid, column, ranges);
        }

        let width = layer.len();
        for first in 0..column.named() {
            layer.fill(Sum::default());
            for last in first..=column.last(first) {
                let next = &grid[last * width..(last + 1) * width];
                layer
                    .iter_mut()
                    .zip(next)
                    .for_each(|(sum, next)| sum.add(next));
                let range = [first as u8, last as u8];
                if column.is_free(range) || visits(layer) < FEWEST_VISITS {
                    continue;
                }
                ranges.push(range);
                self.look(layer, behind, layers, ranges);
                ranges.pop();
            }
        }
    }

    fn look_along(&mut self, line: &[Sum], column: &Column, ranges: &[Codes]) {
        for first in 0..column.named() {
            let mut sum = Sum::default();
            for (last, next) in (first..=column.last(first)).zip(&line[first..]) {
                sum.add(next);
                let is_higher = sum.beyond * sum.beyond > self.bar * (1.0 + TIE) * sum.variance;
                if !is_higher || sum.beyond <= 0.0 || sum.visits < FEWEST_VISITS {
                    continue;
                }
                let range = [first as u8, last as u8];
                if !sum.is_silent() && !column.is_free(range) {
                    self.bar = sum.beyond * sum.beyond / sum.variance;
                    self.ranges = Some([ranges, &[range]].concat());
                }
            }
        }
    }
}

fn visits(layer: &[Sum]) -> u64 {
    layer.iter().map(|sum| sum.visits).sum()
}
