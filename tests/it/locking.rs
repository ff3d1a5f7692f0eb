//! One service to a database, by whatever name it is opened, and SQLite's own locks beside ours.

use std::os::unix::fs::{MetadataExt, symlink};
use std::path::Path;
use std::process::Command;

use nudge::store::{Options, SqliteStore, Store, StoreError};
use tempfile::TempDir;

use crate::cli::{exit_and_texts, nudge, output};
use crate::server::Server;

/// Starts the real binary where it must not start, and returns its one line.
async fn refused(data: &Path) -> String {
    let mut command = Command::new("timeout");
    command
        .args([
            "20",
            env!("CARGO_BIN_EXE_nudge"),
            "serve",
            "--listen",
            "127.0.0.1:0",
            "--data",
        ])
        .arg(data);
    let (code, stdout, stderr) = exit_and_texts(&output(command).await);
    assert_eq!((code, stdout.as_str()), (2, ""), "{stderr}");
    stderr
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_second_service_is_refused_under_every_name_and_without_the_lock_file() {
    let all = TempDir::new().expect("a directory");
    let directory = |name: &str| {
        let directory = all.path().join(name);
        std::fs::create_dir_all(&directory).expect("made");
        directory
    };
    let (first, soft, hard) = (directory("first"), directory("soft"), directory("hard"));
    let server = Server::start(&first, "127.0.0.1:0");
    let database = first.join("nudge.db");
    symlink(&database, soft.join("nudge.db")).expect("a link");
    std::fs::hard_link(&database, hard.join("nudge.db")).expect("a link");
    symlink(&first, all.path().join("through")).expect("a link");
    for lock in [true, false] {
        if !lock {
            std::fs::remove_file(first.join("nudge.db.lock")).expect("removed");
        }
        for name in ["first", "soft", "hard", "through"] {
            let stderr = refused(&all.path().join(name)).await;
            assert!(
                stderr.contains("is in use by another nudge"),
                "{name}: {stderr}"
            );
        }
    }
    // Who only reads is not in the way, and is not kept away.
    let data = first.to_str().expect("text").to_owned();
    let (code, _, stderr) = exit_and_texts(&output(nudge("", &["check", "--data", &data])).await);
    assert_eq!(code, 0, "{stderr}");

    // It is let go when the process ends, however it ends, and a service opened by a link keeps
    // everybody else away too.
    server.kill();
    let server = Server::start(&soft, "127.0.0.1:0");
    assert!(refused(&first).await.contains("is in use"));
    server.kill();
    Server::start(&first, "127.0.0.1:0").kill();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_build_that_locks_a_file_beside_the_database_is_refused_and_refuses() {
    let directory = TempDir::new().expect("a directory");
    let path = directory.path().join("nudge.db.lock");
    let old = std::fs::File::create(&path).expect("made");
    old.try_lock().expect("free");
    assert!(
        refused(directory.path())
            .await
            .contains("is in use by another nudge")
    );
    drop(old);
    let server = Server::start(directory.path(), "127.0.0.1:0");
    let old = std::fs::File::open(&path).expect("there");
    assert!(matches!(
        old.try_lock(),
        Err(std::fs::TryLockError::WouldBlock)
    ));
    server.kill();
}

/// Returns the locks of this process on a file, by kind.
fn locks(path: &Path) -> (usize, usize) {
    let inode = format!(":{} ", std::fs::metadata(path).expect("there").ino());
    let all = std::fs::read_to_string("/proc/locks").expect("locks are told");
    let of = |kind: &str| {
        all.lines()
            .filter(|line| line.contains(kind) && line.contains(&inode))
            .count()
    };
    (of("FLOCK"), of("POSIX"))
}

#[tokio::test]
async fn sqlites_locks_stay_when_a_second_store_is_refused() {
    let directory = TempDir::new().expect("a directory");
    let path = directory.path().join("nudge.db");
    let store = SqliteStore::open(&path, Options::default())
        .await
        .expect("a database");
    let held = locks(&path);
    assert!(
        held.0 == 1 && held.1 > 0,
        "one of ours, and SQLite's: {held:?}"
    );
    let link = directory.path().join("link.db");
    symlink(&path, &link).expect("a link");
    for name in [&path, &link] {
        let second = SqliteStore::open(name, Options::default()).await.err();
        assert!(matches!(second, Some(StoreError::InUse(_))), "{second:?}");
        assert_eq!(locks(&path), held);
    }
    store.close().await;
    assert_eq!(locks(&path), (0, 0));
    // Dropped without being closed, it is free all the same.
    drop(
        SqliteStore::open(&path, Options::default())
            .await
            .expect("a database"),
    );
    SqliteStore::open(&link, Options::default())
        .await
        .expect("a database")
        .close()
        .await;
}
