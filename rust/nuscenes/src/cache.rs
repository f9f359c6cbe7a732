//! Built scenes on disk: one file per scene, named by what it was built from.
//!
//! A scene's key is a hash of the paths, sizes and times of all tables and of its location's map, of the options and of
//! this format's version, so a changed file or option simply leads to another name. Files are written aside and renamed,
//! carry a checksum of their name and contents, and can be deleted at any time. The checksum finds damage, not forgers.

use crate::error::{NuscenesError, Result};
use crate::file;
use crate::report::CacheReport;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::fs::{self, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::UNIX_EPOCH;
use xxhash_rust::xxh3::{Xxh3, xxh3_128};

/// Raised whenever scenes are built or encoded differently.
const FORMAT: u32 = 8;
const MAGIC: &[u8; 8] = b"ccdscene";
const CHECKSUM_BYTES: usize = 16;

/// A 128-bit hash.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Hash(pub(crate) u128);

impl Hash {
    /// Hash of a value's postcard bytes and this format's version.
    pub(crate) fn of<T: Serialize>(value: &T) -> Result<Self> {
        let bytes = postcard::to_stdvec(&(FORMAT, env!("CARGO_PKG_VERSION"), value))
            .map_err(|e| NuscenesError::Bytes(e.to_string()))?;
        Ok(Self(xxh3_128(&bytes)))
    }
}

/// The cache folder, or nothing at all.
#[derive(Debug)]
pub(crate) struct Cache {
    folder: Option<PathBuf>,
    notes: Mutex<Vec<String>>,
}

/// What changes with a file: its path, size, times and inode; `what` it is is for the message.
pub(crate) fn stamp(path: &Path, what: &str) -> Result<Hash> {
    let failed = |e| NuscenesError::from_io(path, what, e);
    let metadata = fs::metadata(path).map_err(failed)?;
    #[cfg(unix)]
    let changed = {
        use std::os::unix::fs::MetadataExt;
        [metadata.ctime(), metadata.ctime_nsec(), metadata.ino() as i64]
    };
    #[cfg(not(unix))]
    let changed = [0_i64; 3];
    let modified = metadata.modified().unwrap_or(UNIX_EPOCH);
    let modified_ns = modified.duration_since(UNIX_EPOCH).map_or(0, |d| d.as_nanos());
    let full_path = std::path::absolute(path).map_err(failed)?;
    Hash::of(&(full_path.to_string_lossy(), metadata.len(), modified_ns, changed))
}

impl Cache {
    pub(crate) fn new(folder: Option<&Path>) -> Self {
        Self { folder: folder.map(|f| f.join(format!("scenes-{FORMAT}"))), notes: Mutex::default() }
    }

    pub(crate) fn is_on(&self) -> bool {
        self.folder.is_some()
    }

    fn note(&self, text: String) {
        if let Ok(mut notes) = self.notes.lock() {
            notes.push(text);
        }
    }

    /// Facts for the report, apart from hits and builds.
    pub(crate) fn report(&self) -> CacheReport {
        let mut notes = self.notes.lock().map(|n| n.clone()).unwrap_or_default();
        notes.sort_unstable();
        notes.dedup();
        CacheReport {
            directory: self.folder.as_ref().map(|f| f.display().to_string()),
            notes,
            ..CacheReport::default()
        }
    }

    fn file(&self, kind: &str, name: Hash) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(kind).join(format!("{:032x}", name.0)))
    }

    /// The value of that name; `None` where there is none or where it is damaged (noted).
    pub(crate) fn get<T: DeserializeOwned>(&self, kind: &str, name: Hash) -> Option<T> {
        let path = self.file(kind, name)?;
        let bytes = match file::read(&path, file::MOST_BYTES) {
            Err(e) if e.kind() == ErrorKind::NotFound => return None,
            found => found.unwrap_or_default(),
        };
        let value = unframed(&bytes, kind, name).and_then(|payload| postcard::from_bytes(payload).ok());
        if value.is_none() {
            self.note(format!("damaged file built again: {}", path.display()));
        }
        value
    }

    /// Writes a value under a name. A cache that cannot be written is noted, never an error.
    pub(crate) fn put<T: Serialize>(&self, kind: &str, name: Hash, value: &T) {
        let Some(path) = self.file(kind, name) else { return };
        if let Err(reason) = write_aside(&path, kind, name, value) {
            let folder = path.parent().unwrap_or(&path).display();
            self.note(format!("cannot write to {folder}: {reason}"));
        }
    }
}

/// Checksum of what a file holds under its kind and name: under another name it is none of the cache's.
fn checksum(kind: &str, name: Hash, payload: &[u8]) -> [u8; CHECKSUM_BYTES] {
    let mut hasher = Xxh3::new();
    for part in [kind.as_bytes(), &name.0.to_le_bytes(), payload] {
        hasher.update(part);
    }
    hasher.digest128().to_le_bytes()
}

/// The payload of a cache file whose checksum holds.
fn unframed<'a>(bytes: &'a [u8], kind: &str, name: Hash) -> Option<&'a [u8]> {
    let (found, payload) = bytes.strip_prefix(MAGIC)?.split_at_checked(CHECKSUM_BYTES)?;
    (found == checksum(kind, name, payload)).then_some(payload)
}

fn write_aside<T: Serialize>(
    path: &Path,
    kind: &str,
    name: Hash,
    value: &T,
) -> std::result::Result<(), String> {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    let payload = postcard::to_stdvec(value).map_err(|e| e.to_string())?;
    let mut bytes = Vec::with_capacity(MAGIC.len() + CHECKSUM_BYTES + payload.len());
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&checksum(kind, name, &payload));
    bytes.extend_from_slice(&payload);
    let unique = COUNTER.fetch_add(1, Ordering::Relaxed);
    let aside = path.with_extension(format!("{}-{unique}.part", std::process::id()));
    let folder = path.parent().ok_or("no folder")?;
    let written = fs::create_dir_all(folder)
        // a file of that name, or a link, is none of ours
        .and_then(|()| OpenOptions::new().write(true).create_new(true).open(&aside)?.write_all(&bytes))
        .and_then(|()| fs::rename(&aside, path));
    written.map_err(|e| {
        // best effort: what is left of a failed write is never read
        let _ = fs::remove_file(&aside);
        e.to_string()
    })
}
