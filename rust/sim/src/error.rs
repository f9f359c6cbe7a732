//! What can go wrong when scenes, configurations or actions are handed to the simulator.

use std::borrow::Cow;

/// Everything the simulator refuses, with the facts a caller needs to mend it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum SimError {
    /// A scene breaks a rule of [`crate::scene::Scene`].
    #[error("scene {scene:?}: {field} is {got}, expected {expected}")]
    Scene { scene: String, field: String, got: String, expected: Cow<'static, str> },
    /// A configuration value is out of its range or contradicts another one.
    #[error("config: {field} is {got}, expected {expected}")]
    Config { field: Cow<'static, str>, got: String, expected: String },
    /// A buffer or an array handed in has the wrong length.
    #[error("{what} has {got} elements, expected {expected}")]
    Length { what: &'static str, got: usize, expected: usize },
    /// An action is not a finite number, or not one of the grid's indices.
    #[error("action of world {world}, agent slot {slot}: {got}, expected {expected}")]
    Action { world: usize, slot: usize, got: String, expected: String },
    /// `step` was called for a world that was never reset, or that ended in DISABLED autoreset mode.
    #[error("world {world} must be reset before it is stepped: {why}")]
    ResetNeeded { world: usize, why: &'static str },
    /// An index or name that does not exist.
    #[error("unknown {what} {got}, expected {expected}")]
    Unknown { what: &'static str, got: String, expected: String },
    /// A snapshot or a certificate that does not belong to this configuration, or is damaged.
    #[error("snapshot: {0}")]
    Snapshot(String),
    /// A driver of traffic failed.
    #[error("driver {driver:?}: {message}")]
    Driver { driver: String, message: String },
}

impl SimError {
    /// [`SimError::Config`] of a field.
    pub fn config(
        field: impl Into<Cow<'static, str>>,
        got: impl ToString,
        expected: impl Into<String>,
    ) -> Self {
        Self::Config { field: field.into(), got: got.to_string(), expected: expected.into() }
    }

    /// [`SimError::Unknown`] of a kind of thing.
    pub fn unknown(what: &'static str, got: impl ToString, expected: impl Into<String>) -> Self {
        Self::Unknown { what, got: got.to_string(), expected: expected.into() }
    }
}

/// Refuses an array of another length than expected.
///
/// # Errors
/// [`SimError::Length`].
pub fn check_length(what: &'static str, got: usize, expected: usize) -> Result<()> {
    if got == expected { Ok(()) } else { Err(SimError::Length { what, got, expected }) }
}

/// Result with [`SimError`].
pub type Result<T> = std::result::Result<T, SimError>;
