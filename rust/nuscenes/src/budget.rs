//! How much a load may make: many records may name one, and files of megabytes must not take gigabytes.

use serde::{Deserialize, Deserializer, de::Error};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// Longest text that other records repeat, bytes.
const LONGEST_NAME: usize = 200;

/// What has been made by all threads, and how much may be.
pub(crate) struct Budget {
    made: AtomicUsize,
    most: usize,
}

impl Budget {
    pub(crate) fn new(most: usize) -> Self {
        Self { made: AtomicUsize::new(0), most }
    }

    /// Counts what is made; whether all that has been made may be.
    pub(crate) fn covers(&self, count: usize) -> bool {
        self.made.fetch_add(count, Relaxed) + count <= self.most
    }
}

/// Reads a text that other records repeat.
pub(crate) fn name<'de, D: Deserializer<'de>>(from: D) -> Result<String, D::Error> {
    let text = String::deserialize(from)?;
    if text.len() <= LONGEST_NAME {
        return Ok(text);
    }
    Err(D::Error::custom(format!("a text of {} bytes, expected at most {LONGEST_NAME}", text.len())))
}
