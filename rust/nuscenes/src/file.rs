//! Reading of regular files alone: what else a folder may hold blocks its reader, or has no end.

use std::fs::{File, metadata};
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

/// Files that are read at once are far smaller.
pub(crate) const MOST_BYTES: u64 = 1 << 30;

/// Opens a file, or what a link to one leads to.
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
pub(crate) fn read(path: &Path, most: u64) -> Result<Vec<u8>> {
    let file = open(path)?;
    let len = file.metadata()?.len();
    if len > most {
        let message = format!("it is {len} bytes long, expected at most {most}");
        return Err(Error::new(ErrorKind::InvalidInput, message));
    }
    let mut bytes = Vec::with_capacity(len as usize + 1);
    file.take(most).read_to_end(&mut bytes)?;
    Ok(bytes)
}
