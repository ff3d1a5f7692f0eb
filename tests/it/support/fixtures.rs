//! Databases that earlier builds left, and what those told of them: see `tests/fixtures/README.md`.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use flate2::read::GzDecoder;
use serde_json::Value;
use tempfile::TempDir;

/// The last landed build before forms had versions: every kind of form is in its database.
pub const BEFORE_VERSIONS: &str = "schema-3-a8c9617";

/// A database that some build left.
pub struct Fixture {
    /// The number of its migrations and its commit.
    pub name: String,
    /// A directory with a copy of it.
    pub directory: Arc<TempDir>,
    /// What was sent and asked, and what was answered.
    pub told: Value,
}

impl Fixture {
    /// Returns every fixture, in order of name.
    pub fn all() -> Vec<Self> {
        let files = std::fs::read_dir(folder())
            .expect("a folder")
            .map(|entry| entry.expect("an entry").file_name());
        let names =
            files.filter_map(|file| Some(file.to_str()?.strip_suffix(".db.gz")?.to_owned()));
        let mut names: Vec<String> = names.collect();
        names.sort();
        names.iter().map(|name| Self::named(name)).collect()
    }

    /// Returns the fixture of that name.
    pub fn named(name: &str) -> Self {
        let directory = TempDir::new().expect("a temporary directory");
        let database = unpacked(&folder().join(format!("{name}.db.gz")));
        std::fs::write(directory.path().join("nudge.db"), database).expect("written");
        let told = unpacked(&folder().join(format!("{name}.json.gz")));
        let told = serde_json::from_slice(&told).expect("JSON");
        Self {
            name: name.to_owned(),
            directory: Arc::new(directory),
            told,
        }
    }

    /// Returns the database.
    pub fn path(&self) -> PathBuf {
        self.directory.path().join("nudge.db")
    }

    /// Returns what was sent: path, body and answer.
    pub fn posted(&self) -> impl Iterator<Item = (&str, &Value, &Value)> {
        let posted = self.told["posted"].as_array().expect("a list").iter();
        posted.map(|one| {
            (
                one["path"].as_str().expect("a path"),
                &one["body"],
                &one["answer"],
            )
        })
    }

    /// Returns what was asked: path and answer.
    pub fn got(&self) -> impl Iterator<Item = (&str, &Value)> {
        let got = self.told["got"].as_array().expect("a list").iter();
        got.map(|one| (one["path"].as_str().expect("a path"), &one["answer"]))
    }
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures")
}

fn unpacked(path: &Path) -> Vec<u8> {
    let file =
        std::fs::File::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut bytes = Vec::new();
    GzDecoder::new(file).read_to_end(&mut bytes).expect("gzip");
    bytes
}
