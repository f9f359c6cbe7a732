//! What the model crate refuses.

use std::path::PathBuf;

/// Everything that can go wrong in features, training, sampling and weight files.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// A configuration value is out of its range or contradicts another one.
    #[error("config: {field} is {got}, expected {expected}")]
    Config {
        /// Path of the field.
        field: &'static str,
        /// The value found.
        got: String,
        /// The rule it breaks.
        expected: &'static str,
    },
    /// An array or tensor has the wrong length or shape.
    #[error("{what} is {got}, expected {expected}")]
    Shape {
        /// Which array.
        what: &'static str,
        /// What was found.
        got: String,
        /// What was needed.
        expected: String,
    },
    /// A set of scenes holds nothing to train on.
    #[error("{num_scenes} scenes give no training sample: {expected}")]
    NoSamples {
        /// Scenes handed in.
        num_scenes: usize,
        /// What a sample needs.
        expected: String,
    },
    /// A weight file or training state does not hold what this code reads.
    #[error("checkpoint: {entry} is {got}, expected {expected}: {}", path.display())]
    Checkpoint {
        /// The file.
        path: PathBuf,
        /// The tensor or header field.
        entry: String,
        /// What was found.
        got: String,
        /// What was needed.
        expected: String,
    },
    /// A file could not be read or written.
    #[error("{action}: {source}: {}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// Why it failed.
        source: std::io::Error,
    },
    /// The loss is not finite any more.
    #[error(
        "loss is {loss} at step {step}, expected a finite number: lower the learning rate or check the data"
    )]
    Diverged {
        /// Training step.
        step: u64,
        /// The loss.
        loss: f64,
    },
    /// libtorch refused an operation.
    #[error("libtorch in {operation}: {message}")]
    Torch {
        /// What was being done.
        operation: &'static str,
        /// libtorch's message without its stack.
        message: String,
    },
    /// The simulator's geometry refused its input.
    #[error(transparent)]
    Sim(#[from] ccdiff_sim::SimError),
}

/// Result with [`ModelError`].
pub type Result<T> = std::result::Result<T, ModelError>;

/// Checks a rule of a configuration value.
///
/// # Errors
/// [`ModelError::Config`] where it does not hold.
pub fn require(holds: bool, field: &'static str, got: impl ToString, expected: &'static str) -> Result<()> {
    if holds { Ok(()) } else { Err(ModelError::Config { field, got: got.to_string(), expected }) }
}

impl ModelError {
    /// A libtorch failure, its message cut before the C++ stack.
    pub fn torch(operation: &'static str, message: &str) -> Self {
        let end = message.find("Exception raised from").unwrap_or(message.len());
        Self::Torch {
            operation,
            message: message[..end].trim_end_matches(['\\', 'n', '\n', ' ']).to_string(),
        }
    }
}
