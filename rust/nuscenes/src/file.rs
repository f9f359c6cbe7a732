//! Reading of regular files alone: what else a folder may hold blocks its reader, or has no end.

use std::fs::{File, metadata};
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

/// Files that are read at once are far smaller.
const MOST_BYTES: u64 = 1 << 30;

/// Opens a file, or what a link to one leads to.
///
/// # Errors
/// Whatever the system says; [`ErrorKind::InvalidInput`] where it is no regular file.
pub(crate) fn open(path: &Path) -> Result<File> {
    let refuse = || Err(Error::new(ErrorKind::InvalidInput, "it is not a regular file"));
    // asked first: to open a pipe waits for its writer
    if !metadata(path)?.is_file() {
        return refuse();
    }
    let file = File::open(path)?;
    if file.metadata()?.is_file() { Ok(file) } else { refuse() }
}

/// The bytes of a file.
///
/// # Errors
/// As [`open`], and for a file of more than 1 GiB.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>> {
    let file = open(path)?;
    let len = file.metadata()?.len();
    if len > MOST_BYTES {
        return Err(Error::new(ErrorKind::InvalidInput, "it has more than 1 GiB"));
    }
    let mut bytes = Vec::with_capacity(len as usize + 1);
    file.take(MOST_BYTES).read_to_end(&mut bytes)?;
    Ok(bytes)
}
