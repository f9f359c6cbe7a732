//! What can be wrong with a data set, its options or its cache, with the facts needed to mend it.

use crate::token::Token;
use ccdiff_sim::SimError;
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// Everything the loader refuses.
#[derive(Debug, thiserror::Error)]
pub enum NuscenesError {
    /// A table or map that the data set must have is not there.
    #[error("{what} is missing: {}", path.display())]
    Missing {
        /// Which part of the data set.
        what: String,
        /// Where it was looked for.
        path: PathBuf,
    },
    /// A file is there but cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A file is not the JSON it should be.
    #[error("invalid JSON at byte {offset}: {message}: {}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// Bytes from its beginning to the record or character at fault.
        offset: u64,
        /// What is wrong, with the beginning of the record.
        message: String,
    },
    /// A record breaks a rule, names one that does not exist, or claims the place of another; or nothing is left to load.
    #[error("{what}: {}", path.display())]
    Data {
        /// The file.
        path: PathBuf,
        /// Record, field, the value found, the rule it breaks.
        what: String,
    },
    /// An option is out of range.
    #[error("option {field} is {got}, expected {expected}")]
    Option {
        /// The option.
        field: &'static str,
        /// The value given.
        got: String,
        /// The rule it breaks.
        expected: &'static str,
    },
    /// A scene that was asked for by name or token is not in the data set.
    #[error("{0}")]
    Unknown(String),
    /// A built scene breaks a rule of the simulator.
    #[error(transparent)]
    Scene(#[from] SimError),
    /// Bytes that should hold a scene do not.
    #[error("scene bytes: {0}")]
    Bytes(String),
}

/// Result with [`NuscenesError`].
pub type Result<T> = std::result::Result<T, NuscenesError>;

impl NuscenesError {
    /// A file that could not be opened or read: missing, or the system's own words.
    pub(crate) fn from_io(path: &Path, what: &str, source: std::io::Error) -> Self {
        if source.kind() == std::io::ErrorKind::NotFound {
            Self::Missing { what: what.to_owned(), path: path.to_owned() }
        } else {
            Self::Io { path: path.to_owned(), source }
        }
    }

    /// A field that holds a value which breaks a rule.
    pub(crate) fn value(
        path: &Path,
        token: impl Display,
        field: &str,
        got: impl Display,
        expected: &str,
    ) -> Self {
        let token = token.to_string();
        Self::Data {
            path: path.to_owned(),
            what: format!("record {token:?}: {field} is {got}, expected {expected}"),
        }
    }

    /// A field that names a record which does not exist.
    pub(crate) fn dangling(path: &Path, token: impl Display, field: &str, got: Token, table: &str) -> Self {
        let (token, got) = (token.to_string(), got.to_string());
        let what = format!("record {token:?}: {field} {got:?} is not in table {table}");
        Self::Data { path: path.to_owned(), what }
    }

    /// Two records that claim the same place.
    pub(crate) fn duplicate(path: &Path, what: &str, got: impl Display) -> Self {
        let got = got.to_string();
        Self::Data { path: path.to_owned(), what: format!("{what} {got:?} is there twice") }
    }
}
