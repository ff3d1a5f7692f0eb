//! Advisory lock of the database file (`flock`), which keeps it to a single writing process. It is
//! on the inode of the database itself, so that no other name of the file leads around it.
//!
//! * The kernel lets go of it when the process ends, however it ends. SQLite's own locks are let go
//!   between transactions.
//! * It is another kind of lock than SQLite's, which are `fcntl`: the two do not see each other.
//!   But the kernel drops all `fcntl` locks of a process on a file when any descriptor of that file
//!   is closed. So this one is opened before SQLite opens the file, and closed after SQLite has
//!   closed it; where that is not known, it is kept, and taken again by the next store of this
//!   process.
//! * Builds up to e25d303 lock a file beside the database instead, which is taken too: theirs and
//!   this refuse each other.
//!
//! Who only reads (`nudge check`) takes no lock. Not for network file systems, on which a journal
//! in shared memory does not work either.

use std::collections::HashMap;
use std::ffi::OsString;
use std::fs::{File, Metadata, TryLockError};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};

use super::error::unopenable;
use crate::store::StoreError;

/// A file, whatever its name: its device and its inode.
type Inode = (u64, u64);

/// The databases that stores of this process have open (`None`), or had (`Some`, of which SQLite
/// may not have closed every descriptor yet). Opening one of the first a second time, only to find
/// it locked, would close a descriptor.
static OPENED: LazyLock<Mutex<HashMap<Inode, Option<File>>>> = LazyLock::new(Mutex::default);

/// A file under the name that it was opened by.
#[derive(Debug, Clone)]
pub(super) struct Identity {
    path: PathBuf,
    inode: Inode,
}

/// The lock of a database.
pub(super) struct Lock {
    identity: Identity,
    /// Until it is let go.
    file: Option<File>,
    /// For builds that do not look at the database's own.
    beside: Vec<Beside>,
}

/// The lock file of earlier builds. Let go by name: a process that is being started has a copy of
/// the file until it is another program, and closing ours would leave it locked meanwhile.
struct Beside(File);

impl Identity {
    /// Returns the file that a name leads to.
    pub(super) fn of_file(path: &Path) -> Result<Self, StoreError> {
        let found = std::fs::metadata(path).map_err(|error| unopenable(path, error))?;
        Ok(Self {
            path: path.to_owned(),
            inode: inode(&found),
        })
    }

    /// Returns the journal of a database that is open: SQLite keeps it beside the file itself,
    /// wherever a link to it stands.
    pub(super) fn of_journal(database: &Path) -> Result<Self, String> {
        let real = database
            .canonicalize()
            .map_err(|error| format!("{}: {error}", database.display()))?;
        let mut path = real.into_os_string();
        path.push("-wal");
        let path = PathBuf::from(path);
        let found =
            std::fs::metadata(&path).map_err(|error| format!("{}: {error}", path.display()))?;
        Ok(Self {
            path,
            inode: inode(&found),
        })
    }

    /// Returns the name.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns why the name does not lead to the file any more, if it does not.
    pub(super) fn check(&self) -> Result<(), String> {
        match std::fs::metadata(&self.path) {
            Ok(found) if inode(&found) == self.inode => Ok(()),
            Ok(_) => Err(format!(
                "another file is at {} now: stop the service before you replace its database",
                self.path.display()
            )),
            Err(error) => Err(format!("{}: {error}", self.path.display())),
        }
    }
}

impl Lock {
    /// Takes the lock of a database, whose file is made if it is missing.
    pub(super) fn take(path: &Path) -> Result<Self, StoreError> {
        let (inode, file) = locked(path)?;
        let identity = Identity {
            path: path.to_owned(),
            inode,
        };

        // From here on the file is let go again if the rest fails.
        let mut lock = Self {
            identity,
            file: Some(file),
            beside: Vec::new(),
        };

        for name in names(path) {
            lock.beside.extend(Beside::take(&name, path)?);
        }
        Ok(lock)
    }

    /// Returns which file is locked.
    pub(super) fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Lets go and closes the file. SQLite must have closed it everywhere in this process.
    pub(super) fn close(mut self) {
        if let Some(file) = self.file.take() {
            let_go(&file);
            opened().remove(&self.identity.inode);
        }
    }
}

impl Drop for Lock {
    /// Lets go, and keeps the descriptor: SQLite may be about to close its own.
    fn drop(&mut self) {
        if let Some(file) = self.file.take() {
            let_go(&file);
            opened().insert(self.identity.inode, Some(file));
        }
    }
}

impl Beside {
    /// Takes the file of a name. Where it cannot be made there is none: the database's own lock is
    /// what counts.
    fn take(name: &Path, database: &Path) -> Result<Option<Self>, StoreError> {
        let file = match File::options()
            .create(true)
            .truncate(false)
            .write(true)
            .open(name)
        {
            Ok(file) => file,
            Err(error) => {
                tracing::warn!(file = %name.display(), %error, "builds before this one will not see that the database is in use");
                return Ok(None);
            }
        };

        match file.try_lock() {
            Ok(()) => Ok(Some(Self(file))),
            Err(TryLockError::WouldBlock) => Err(in_use(database)),
            Err(TryLockError::Error(error)) => {
                Err(unopenable(name, format!("cannot lock it: {error}")))
            }
        }
    }
}

impl Drop for Beside {
    fn drop(&mut self) {
        let_go(&self.0);
    }
}

/// Returns the locked file that the name leads to. It may be replaced between the opening and the
/// lock: then it is begun anew.
fn locked(path: &Path) -> Result<(Inode, File), StoreError> {
    const ATTEMPTS: u32 = 100;
    let mut opened = opened();
    for _ in 0..ATTEMPTS {
        let file = match std::fs::metadata(path)
            .ok()
            .and_then(|found| opened.get_mut(&inode(&found)))
        {
            Some(kept) => kept.take().ok_or_else(|| in_use(path))?,
            None => open(path)?,
        };
        let found = file.metadata().map_err(|error| unopenable(path, error))?;
        let inode = inode(&found);

        match file.try_lock() {
            Ok(())
                if (Identity {
                    path: path.to_owned(),
                    inode,
                })
                .check()
                .is_ok() =>
            {
                warn_of_names(path, &found);
                opened.insert(inode, None);
                return Ok((inode, file));
            }
            Ok(()) => let_go(&file),
            Err(TryLockError::WouldBlock) => {
                opened.insert(inode, Some(file));
                return Err(in_use(path));
            }
            Err(TryLockError::Error(error)) => {
                return Err(unopenable(path, format!("cannot lock it: {error}")));
            }
        }
        opened.insert(inode, Some(file));
    }
    Err(unopenable(
        path,
        "it is replaced again and again by another program",
    ))
}

fn open(path: &Path) -> Result<File, StoreError> {
    let open = File::options()
        .create(true)
        .truncate(false)
        .read(true)
        .write(true)
        .open(path);
    let advice = "give this user the right to write the file and its directory";
    open.map_err(|error| unopenable(path, format!("it cannot be written ({error}); {advice}")))
}

/// A journal stands beside the name by which the database was opened: under another one what was
/// committed last would be missing.
fn warn_of_names(path: &Path, found: &Metadata) {
    if found.nlink() > 1 {
        tracing::warn!(
            database = %path.display(),
            names = found.nlink(),
            "the database has several names (hard links): open it by the same one always"
        );
    }
}

/// Returns the lock files of earlier builds: beside the name that was given, and beside the one
/// that it leads to.
fn names(path: &Path) -> Vec<PathBuf> {
    let mut names = vec![lock_file(path)];
    let directory = path.parent().and_then(|parent| parent.canonicalize().ok());

    if let Ok(real) = path.canonicalize()
        && (directory.as_deref(), path.file_name()) != (real.parent(), real.file_name())
    {
        names.push(lock_file(&real));
    }
    names
}

fn lock_file(database: &Path) -> PathBuf {
    let mut name = OsString::from(database);
    name.push(".lock");
    PathBuf::from(name)
}

fn inode(of: &Metadata) -> Inode {
    (of.dev(), of.ino())
}

fn in_use(path: &Path) -> StoreError {
    StoreError::InUse(path.display().to_string())
}

fn let_go(file: &File) {
    if let Err(error) = file.unlock() {
        tracing::warn!(%error, "the lock of a database could not be let go");
    }
}

fn opened() -> MutexGuard<'static, HashMap<Inode, Option<File>>> {
    OPENED.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(path: &Path) -> Lock {
        Lock::take(path).expect("free")
    }

    #[track_caller]
    fn assert_in_use(path: &Path) {
        assert!(
            matches!(Lock::take(path), Err(StoreError::InUse(_))),
            "{}",
            path.display()
        );
    }

    /// A file, and other ways to it.
    fn names_of_one() -> (tempfile::TempDir, [PathBuf; 4]) {
        let directory = tempfile::tempdir().expect("a directory");
        let [file, soft, hard, through] = ["nudge.db", "soft.db", "hard.db", "elsewhere/nudge.db"]
            .map(|name| directory.path().join(name));
        std::fs::write(&file, "").expect("written");
        std::os::unix::fs::symlink(&file, &soft).expect("a link");
        std::fs::hard_link(&file, &hard).expect("a link");
        std::os::unix::fs::symlink(directory.path(), directory.path().join("elsewhere"))
            .expect("a link");
        (directory, [file, soft, hard, through])
    }

    #[test]
    fn no_other_name_leads_around_the_lock() {
        let (_directory, names) = names_of_one();
        for name in &names {
            let lock = taken(name);
            names.iter().for_each(|other| assert_in_use(other));
            drop(lock);
        }
        // Closed instead of dropped, and taken by what was kept.
        taken(&names[0]).close();
        let lock = taken(&names[1]);
        assert_in_use(&names[0]);
        lock.close();
    }

    #[test]
    fn another_process_is_refused_by_either_lock() {
        let (_directory, names) = names_of_one();
        for held in [names[0].clone(), names_beside(&names[0])] {
            let other = File::options()
                .create(true)
                .truncate(false)
                .write(true)
                .open(&held)
                .expect("opened");
            other.try_lock().expect("free");
            names[..2].iter().for_each(|name| assert_in_use(name));
            drop(other);
            drop(taken(&names[0]));
        }
        let lock = taken(&names[1]);
        for name in [&names[1], &names[0]] {
            let old = File::open(names_beside(name)).expect("made");
            assert!(
                matches!(old.try_lock(), Err(TryLockError::WouldBlock)),
                "a build before this one is refused"
            );
        }
        std::fs::remove_file(names_beside(&names[0])).expect("removed");
        let other = File::open(&names[2]).expect("opened");
        assert!(
            matches!(other.try_lock(), Err(TryLockError::WouldBlock)),
            "with or without the file beside"
        );
        drop(lock);
    }

    fn names_beside(path: &Path) -> PathBuf {
        names(path).remove(0)
    }

    #[test]
    fn a_file_that_is_replaced_is_another_one() {
        let directory = tempfile::tempdir().expect("a directory");
        let path = directory.path().join("nudge.db");
        let lock = taken(&path);
        assert_eq!(lock.identity().check(), Ok(()));
        std::fs::rename(&path, directory.path().join("away.db")).expect("moved");
        assert!(
            lock.identity()
                .check()
                .expect_err("gone")
                .contains("No such file")
        );
        std::fs::write(&path, "").expect("written");
        assert!(
            lock.identity()
                .check()
                .expect_err("another")
                .contains("another file is at")
        );
    }

    #[test]
    fn a_loop_of_links_or_a_directory_is_told() {
        let directory = tempfile::tempdir().expect("a directory");
        let path = directory.path().join("nudge.db");
        std::os::unix::fs::symlink(&path, &path).expect("a link");
        assert!(matches!(
            Lock::take(&path),
            Err(StoreError::Unopenable { .. })
        ));
        let Err(StoreError::Unopenable { why, .. }) = Lock::take(directory.path()) else {
            panic!("a directory")
        };
        assert!(why.contains("give this user the right"), "{why}");
    }
}
