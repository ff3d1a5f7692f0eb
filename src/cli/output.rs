//! Standard output: text and tables that may be cut off at any time.

use std::io::{ErrorKind, Write};
use std::path::Path;

use super::Failure;

/// Prints a text, with a line end behind it if it has none.
pub(super) fn print(text: &str) -> Result<(), Failure> {
    let mut stdout = std::io::stdout().lock();
    let end = if text.ends_with('\n') { "" } else { "\n" };
    let written = write!(stdout, "{text}{end}").and_then(|()| stdout.flush());
    written.map_err(|error| match error.kind() {
        ErrorKind::BrokenPipe => Failure::unheard(),
        _ => Failure::usage(format!("cannot write to standard output: {error}")),
    })
}

/// Prints JSON as people read it.
pub(super) fn print_json(value: &serde_json::Value) -> Result<(), Failure> {
    print(&format!("{value:#}"))
}

/// Returns what REST would tell.
pub(super) fn to_json(value: impl serde::Serialize) -> serde_json::Value {
    serde_json::to_value(value)
        .expect("answers have text for keys and no number that JSON cannot hold")
}

/// A table in plain text.
pub(super) struct Table {
    rows: Vec<Vec<String>>,
}

impl Table {
    /// Begins a table with these titles.
    pub(super) fn new(titles: &[&str]) -> Self {
        Self {
            rows: vec![titles.iter().map(|title| (*title).to_owned()).collect()],
        }
    }

    /// Adds a row of as many cells.
    pub(super) fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.rows.push(cells.into_iter().collect());
    }

    /// Returns the table with columns two spaces apart; numbers stand to the right, but for the
    /// first column, which names the row.
    pub(super) fn render(&self, indent: &str) -> String {
        let columns = self.rows[0].len();
        let width = |column: usize| {
            self.rows
                .iter()
                .map(|row| row[column].chars().count())
                .max()
                .unwrap_or(0)
        };
        let widths: Vec<usize> = (0..columns).map(width).collect();
        let numeric: Vec<bool> = (0..columns).map(|column| self.is_numeric(column)).collect();
        let cell = |(i, text): (usize, &String)| match (numeric[i], widths[i]) {
            (true, width) => format!("{text:>width$}"),
            (false, width) => format!("{text:<width$}"),
        };
        let line = |row: &Vec<String>| {
            let cells: Vec<String> = row.iter().enumerate().map(cell).collect();
            format!("{indent}{}\n", cells.join("  ").trim_end())
        };
        self.rows.iter().map(line).collect()
    }

    fn is_numeric(&self, column: usize) -> bool {
        let number = |text: &str| text == "-" || text.replace(',', "").parse::<f64>().is_ok();
        column > 0 && self.rows.len() > 1 && self.rows[1..].iter().all(|row| number(&row[column]))
    }
}

/// Returns a count with its thousands apart: 46,729.
pub(super) fn count(number: u64) -> String {
    let digits = number.to_string();
    let mut apart = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            apart.push(',');
        }
        apart.push(digit);
    }
    apart
}

/// Returns a figure with four decimals.
pub(super) fn figure(number: f64) -> String {
    format!("{number:.4}")
}

/// Returns a figure with four decimals, or a dash where there is none.
pub(super) fn figure_or_dash(number: Option<f64>) -> String {
    number.map_or("-".into(), figure)
}

/// Returns a number with so many significant digits, whole ones always, and no zeros at the end.
pub(super) fn significant(number: f64, digits: i32) -> String {
    let whole = if number > 0.0 {
        number.log10().floor() as i32 + 1
    } else {
        1
    };
    let unit = 10_f64.powi((digits - whole).max(0));
    ((number * unit).round() / unit).to_string()
}

/// Returns a share in per cent.
pub(super) fn percent(share: f64) -> String {
    format!("{} %", significant(100.0 * share, 2))
}

/// Returns how a file cannot be read.
pub(super) fn cannot_read(file: &Path, error: &std::io::Error) -> Failure {
    Failure::usage(format!("cannot read {}: {error}", file.display()))
}

/// Returns how a file cannot be written; a reader that has gone, as `head` does, is no fault.
pub(super) fn cannot_write(file: &Path, error: &std::io::Error) -> Failure {
    match error.kind() {
        ErrorKind::BrokenPipe => Failure::unheard(),
        _ => Failure::usage(format!("cannot write {}: {error}", file.display())),
    }
}

/// Says in words how many steps lie between two actions.
pub(super) fn steps_later(lag: u32) -> String {
    match lag {
        0 => "same tick".into(),
        1 => "1 step later".into(),
        lag => format!("{lag} steps later"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_stand_to_the_right() {
        let mut table = Table::new(&["name", "visits"]);
        table.row(["hallway".into(), count(7)]);
        table.row(["x".into(), count(1_234_567)]);
        assert_eq!(
            table.render("  "),
            "  name        visits\n  hallway          7\n  x        1,234,567\n"
        );
    }

    #[test]
    fn what_is_small_keeps_its_digits() {
        assert_eq!(
            [0.5, 0.721_347, 12.345, 0.000_4, 0.0, 8.0].map(|n| significant(n, 3)),
            ["0.5", "0.721", "12.3", "0.0004", "0", "8"]
        );
        assert_eq!(
            [0.721, 1.154, 0.0123, 0.0, 0.5].map(percent),
            ["72 %", "115 %", "1.2 %", "0 %", "50 %"]
        );
    }

    #[test]
    fn thousands_are_apart() {
        assert_eq!(
            [0, 999, 1_000, 46_729].map(count),
            ["0", "999", "1,000", "46,729"]
        );
    }
}
