//! From the bytes of a CSV file, gzipped or not, to games. Every error names its line and column.

use std::borrow::Cow;
use std::collections::{HashMap, HashSet};
use std::io::Read;

use super::state::parse_state;
use super::{Game, Kitchen, Move, Step};
use crate::recordings::RecordingError;

const COLUMNS: [&str; 6] = ["layout", "trial", "t", "state", "action0", "action1"];

/// Returns the text of a file: what a gzipped one holds, any other as it is.
pub fn decompressed(bytes: &[u8]) -> Result<Cow<'_, [u8]>, RecordingError> {
    const GZIP: [u8; 2] = [0x1f, 0x8b];
    if !bytes.starts_with(&GZIP) {
        return Ok(Cow::Borrowed(bytes));
    }
    let mut text = Vec::new();
    let read = flate2::read::MultiGzDecoder::new(bytes).read_to_end(&mut text);
    read.map_err(|error| RecordingError::Unreadable(format!("broken gzip: {error}")))?;
    Ok(Cow::Owned(text))
}

/// Reads the games of a CSV file, gzipped or not, in its order.
///
/// Rows of a game follow each other with `t` going up by one; every player stands where the layout
/// lets them.
pub fn read_games(bytes: &[u8]) -> Result<Vec<Game>, RecordingError> {
    let text = decompressed(bytes)?;
    let mut rows = csv::Reader::from_reader(text.as_ref());
    let columns = columns(rows.headers().map_err(|error| row_error(&error))?)?;
    let mut games = Games::default();
    for record in rows.records() {
        let record = record.map_err(|error| row_error(&error))?;
        let line = record.position().map_or(0, csv::Position::line);
        games.add(&Row {
            line,
            record: &record,
            columns,
        })?;
    }
    Ok(games.games)
}

fn columns(header: &csv::StringRecord) -> Result<[usize; 6], RecordingError> {
    let mut found = [0; COLUMNS.len()];
    for (place, name) in found.iter_mut().zip(COLUMNS) {
        *place = header
            .iter()
            .position(|one| one == name)
            .ok_or(RecordingError::MissingColumn(name))?;
    }
    Ok(found)
}

fn row_error(error: &csv::Error) -> RecordingError {
    match (error.position(), error.kind()) {
        (
            Some(position),
            csv::ErrorKind::UnequalLengths {
                expected_len, len, ..
            },
        ) => {
            let why = format!("got {len} columns, expected {expected_len}");
            RecordingError::Row {
                line: position.line(),
                why,
            }
        }
        (Some(position), csv::ErrorKind::Utf8 { .. }) => RecordingError::Row {
            line: position.line(),
            why: "is not UTF-8".into(),
        },
        _ => RecordingError::Unreadable(error.to_string()),
    }
}

/// One row, which knows where it stands.
#[derive(Clone, Copy)]
struct Row<'a> {
    line: u64,
    record: &'a csv::StringRecord,
    columns: [usize; 6],
}

impl<'a> Row<'a> {
    fn text(&self, column: usize) -> &'a str {
        self.record.get(self.columns[column]).unwrap_or_default()
    }

    /// Reads one field by its place in [`COLUMNS`].
    fn field<T>(
        &self,
        column: usize,
        parse: impl Fn(&'a str) -> Result<T, String>,
    ) -> Result<T, RecordingError> {
        let wrong = |why| RecordingError::Field {
            line: self.line,
            column: COLUMNS[column],
            why,
        };
        parse(self.text(column)).map_err(wrong)
    }

    fn step(&self, kitchen: &Kitchen) -> Result<Step, RecordingError> {
        let (players, objects) = self.field(3, |text| parse_state(text, kitchen))?;
        Ok(Step {
            players,
            objects,
            actions: [self.field(4, Move::parse)?, self.field(5, Move::parse)?],
        })
    }
}

/// The games read so far.
#[derive(Default)]
struct Games {
    games: Vec<Game>,
    next_t: u64,
    seen: HashSet<(String, String)>,
    kitchens: HashMap<String, Kitchen>,
}

impl Games {
    fn add(&mut self, row: &Row<'_>) -> Result<(), RecordingError> {
        let (layout, trial) = (row.text(0), row.text(1));
        let t = row.field(2, |text| {
            text.parse::<u32>()
                .map(u64::from)
                .map_err(|_| not_a_time(text))
        })?;
        if self
            .games
            .last()
            .is_some_and(|game| game.layout == layout && game.trial == trial)
        {
            row.field(2, |_| {
                if t == self.next_t {
                    Ok(())
                } else {
                    Err(format!("got {t}, expected {}", self.next_t))
                }
            })?;
        } else {
            self.begin(row, layout, trial)?;
        }

        self.next_t = t + 1;
        let step = row.step(&self.kitchens[layout])?;
        if let Some(game) = self.games.last_mut() {
            game.steps.push(step);
        }
        Ok(())
    }

    fn begin(&mut self, row: &Row<'_>, layout: &str, trial: &str) -> Result<(), RecordingError> {
        let known =
            |name: &str| Kitchen::named(name).ok_or_else(|| format!("unknown layout {name:?}"));
        if !self.kitchens.contains_key(layout) {
            self.kitchens.insert(layout.into(), row.field(0, known)?);
        }

        let is_new = self.seen.insert((layout.into(), trial.into()));
        row.field(1, |_| {
            is_new.then_some(()).ok_or_else(|| {
                format!("{trial:?} was read before, its rows must follow each other")
            })
        })?;

        self.games.push(Game {
            layout: layout.into(),
            trial: trial.into(),
            steps: Vec::new(),
        });
        Ok(())
    }
}

fn not_a_time(text: &str) -> String {
    format!("got {text:?}, expected the number of a step")
}
