//! Stands between a server and its disk: a library that is loaded before libc (`LD_PRELOAD`), fails
//! what it is told to fail, keeps to a budget of bytes, and writes down what reached the disk in
//! which order.
//!
//! No module of the tests: `shim` builds it with `rustc --crate-type cdylib`, and nothing but std
//! is in it. It watches the files of one directory, `NUDGE_SHIM_DIRECTORY`, and is told what to do
//! through words of a mapped file, `NUDGE_SHIM_CONTROL`, which the test may change at any time.
//! With `NUDGE_SHIM_LOG` it records every change and every sync, and spares the real syncs: what
//! they promise is then read from the log.

use std::ffi::{CStr, OsString, c_char, c_int, c_long, c_void};
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::os::fd::AsRawFd;
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{LazyLock, Mutex, PoisonError};

const ENOSPC: c_int = 28;
const RTLD_NEXT: *mut c_void = -1_isize as *mut c_void;
const SIGKILL: c_int = 9;

/// The classes of calls, as bits of [`Words::mask`].
const WRITE: u64 = 1;
const SYNC: u64 = 2;
const TRUNCATE: u64 = 4;
const READ: u64 = 8;
const UNLINK: u64 = 16;

unsafe extern "C" {
    fn dlsym(handle: *mut c_void, name: *const c_char) -> *mut c_void;
    fn __errno_location() -> *mut c_int;
    fn mmap(at: *mut c_void, length: usize, protection: c_int, flags: c_int, fd: c_int, offset: c_long) -> *mut c_void;
    fn getpid() -> c_int;
    fn kill(process: c_int, signal: c_int) -> c_int;
}

/// What the test says and is told, in the order of the file.
#[repr(C)]
struct Words {
    /// Which classes of calls are counted, and failed.
    mask: AtomicU64,
    /// How many of them pass before the first fails.
    pass: AtomicU64,
    /// How many fail then; the largest number: all.
    failures: AtomicU64,
    /// With which error; none: the process dies instead, as by kill -9.
    errno: AtomicU64,
    /// How many bytes the directory's files may have; none: as many as they like.
    budget: AtomicU64,
    /// How many calls of those classes there were.
    seen: AtomicU64,
    /// How many were failed.
    failed: AtomicU64,
}

struct Shim {
    directory: PathBuf,
    words: &'static Words,
    log: Option<Mutex<File>>,
}

static SHIM: LazyLock<Option<Shim>> = LazyLock::new(Shim::from_environment);

impl Shim {
    fn from_environment() -> Option<Self> {
        let directory = PathBuf::from(std::env::var_os("NUDGE_SHIM_DIRECTORY")?);
        let control = OpenOptions::new().read(true).write(true).open(std::env::var_os("NUDGE_SHIM_CONTROL")?).ok()?;
        const READ_AND_WRITE: c_int = 3;
        const SHARED: c_int = 1;
        let length = size_of::<Words>();
        // SAFETY: a new mapping of a file that the test made with more than this length, and never
        // unmapped.
        let words = unsafe { mmap(std::ptr::null_mut(), length, READ_AND_WRITE, SHARED, control.as_raw_fd(), 0) };
        assert!(words as isize != -1, "the control file can be mapped");
        let log = std::env::var_os("NUDGE_SHIM_LOG")
            .map(|path| Mutex::new(OpenOptions::new().append(true).create(true).open(path).expect("a log")));
        // SAFETY: page-aligned, long enough, and shared: atomics are what it is changed by.
        Some(Self { directory, words: unsafe { &*words.cast::<Words>() }, log })
    }

    /// Counts a call, and fails it with an error if its time has come.
    fn gate(&self, class: u64) -> Result<(), c_int> {
        let words = self.words;
        if words.mask.load(Ordering::SeqCst) & class == 0 {
            return Ok(());
        }
        words.seen.fetch_add(1, Ordering::SeqCst);
        let one_less = |left: u64| if left == u64::MAX { Some(left) } else { left.checked_sub(1) };
        if words.pass.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |left| left.checked_sub(1)).is_ok()
            || words.failures.fetch_update(Ordering::SeqCst, Ordering::SeqCst, one_less).is_err()
        {
            return Ok(());
        }
        words.failed.fetch_add(1, Ordering::SeqCst);
        match words.errno.load(Ordering::SeqCst) {
            0 => die(),
            errno => Err(errno as c_int),
        }
    }

    /// Returns how many bytes of a write there is room for. Only what makes a file longer needs
    /// any.
    fn room(&self, name: &Path, offset: u64, length: usize) -> Result<usize, c_int> {
        let budget = self.words.budget.load(Ordering::SeqCst);
        if budget == 0 {
            return Ok(length);
        }
        let size = |path: &Path| path.metadata().map_or(0, |found| found.len());
        let files = std::fs::read_dir(&self.directory).map_err(|_| ENOSPC)?;
        let used: u64 = files.flatten().map(|file| size(&file.path())).sum();
        let end = size(&self.directory.join(name)) + budget.saturating_sub(used);
        match end.saturating_sub(offset) {
            0 => Err(ENOSPC),
            room => Ok(length.min(room as usize)),
        }
    }

    /// Appends a record: a letter, the name, two numbers, and bytes.
    fn record(&self, letter: u8, name: &Path, offset: u64, length: u64, bytes: &[u8]) {
        let Some(log) = &self.log else { return };
        let name = name.as_os_str().as_bytes();
        let mut record = vec![letter, name.len() as u8];
        record.extend(name);
        record.extend(offset.to_le_bytes());
        record.extend(length.to_le_bytes());
        record.extend(bytes);
        let mut log = log.lock().unwrap_or_else(PoisonError::into_inner);
        // A record that is cut short by a kill is none.
        log.write_all(&record).expect("the log can be written");
    }
}

fn die() -> ! {
    // SAFETY: no arguments that could be wrong.
    unsafe { kill(getpid(), SIGKILL) };
    loop {
        std::thread::park();
    }
}

/// Returns the shim and the file's name where the file is watched. The directory itself has the
/// empty name.
fn watched(fd: c_int) -> Option<(&'static Shim, PathBuf)> {
    let shim = SHIM.as_ref()?;
    let path = std::fs::read_link(format!("/proc/self/fd/{fd}")).ok()?;
    // What waits to be closed after it was deleted is the same file still.
    let path = path.as_os_str().as_bytes();
    let path = OsString::from_vec(path.strip_suffix(b" (deleted)").unwrap_or(path).to_vec());
    Some((shim, Path::new(&path).strip_prefix(&shim.directory).ok()?.to_owned()))
}

fn fail<T: From<i8>>(errno: c_int) -> T {
    // SAFETY: this thread's own.
    unsafe { *__errno_location() = errno };
    T::from(-1)
}

/// The function of libc that stands behind one of ours.
macro_rules! real {
    ($name:ident: $type:ty) => {{
        static REAL: LazyLock<usize> = LazyLock::new(|| {
            let name = concat!(stringify!($name), "\0");
            // SAFETY: a name with its end.
            unsafe { dlsym(RTLD_NEXT, name.as_ptr().cast()) as usize }
        });
        // SAFETY: libc's function of that name has that type.
        unsafe { std::mem::transmute::<usize, $type>(*REAL) }
    }};
}

/// # Safety
/// As `pwrite(2)`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pwrite64(fd: c_int, data: *const c_void, length: usize, offset: i64) -> isize {
    let real = real!(pwrite64: unsafe extern "C" fn(c_int, *const c_void, usize, i64) -> isize);
    let Some((shim, name)) = watched(fd) else { return unsafe { real(fd, data, length, offset) } };
    match shim.gate(WRITE).and_then(|()| shim.room(&name, offset as u64, length)) {
        Err(errno) => fail(errno),
        Ok(length) => {
            // SAFETY: the caller's bytes.
            let bytes = unsafe { std::slice::from_raw_parts(data.cast::<u8>(), length) };
            shim.record(b'w', &name, offset as u64, length as u64, bytes);
            unsafe { real(fd, data, length, offset) }
        }
    }
}

/// # Safety
/// As `pwrite(2)`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pwrite(fd: c_int, data: *const c_void, length: usize, offset: i64) -> isize {
    unsafe { pwrite64(fd, data, length, offset) }
}

/// # Safety
/// As `pread(2)`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pread64(fd: c_int, data: *mut c_void, length: usize, offset: i64) -> isize {
    let real = real!(pread64: unsafe extern "C" fn(c_int, *mut c_void, usize, i64) -> isize);
    match watched(fd).map(|(shim, _)| shim.gate(READ)) {
        Some(Err(errno)) => fail(errno),
        _ => unsafe { real(fd, data, length, offset) },
    }
}

/// # Safety
/// As `fsync(2)`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fsync(fd: c_int) -> c_int {
    let real = real!(fsync: unsafe extern "C" fn(c_int) -> c_int);
    let Some((shim, name)) = watched(fd) else { return unsafe { real(fd) } };
    match shim.gate(SYNC) {
        Err(errno) => fail(errno),
        Ok(()) if shim.log.is_some() => {
            shim.record(b's', &name, 0, 0, &[]);
            0
        }
        Ok(()) => unsafe { real(fd) },
    }
}

/// # Safety
/// As `fdatasync(2)`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fdatasync(fd: c_int) -> c_int {
    unsafe { fsync(fd) }
}

/// # Safety
/// As `ftruncate(2)`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ftruncate64(fd: c_int, length: i64) -> c_int {
    let real = real!(ftruncate64: unsafe extern "C" fn(c_int, i64) -> c_int);
    let Some((shim, name)) = watched(fd) else { return unsafe { real(fd, length) } };
    match shim.gate(TRUNCATE) {
        Err(errno) => fail(errno),
        Ok(()) => {
            shim.record(b't', &name, 0, length as u64, &[]);
            unsafe { real(fd, length) }
        }
    }
}

/// # Safety
/// As `ftruncate(2)`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ftruncate(fd: c_int, length: i64) -> c_int {
    unsafe { ftruncate64(fd, length) }
}

/// # Safety
/// As `unlink(2)`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn unlink(path: *const c_char) -> c_int {
    let real = real!(unlink: unsafe extern "C" fn(*const c_char) -> c_int);
    // SAFETY: the caller's path, with its end.
    let named = Path::new(std::ffi::OsStr::from_bytes(unsafe { CStr::from_ptr(path) }.to_bytes()));
    let Some(shim) = SHIM.as_ref() else { return unsafe { real(path) } };
    let Ok(name) = named.strip_prefix(&shim.directory) else { return unsafe { real(path) } };
    match shim.gate(UNLINK) {
        Err(errno) => fail(errno),
        Ok(()) => {
            shim.record(b'u', name, 0, 0, &[]);
            unsafe { real(path) }
        }
    }
}
