//! What can go wrong when an image is asked for.

/// Everything the renderer refuses, with the facts a caller needs to mend it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RenderError {
    /// A size, a number of the camera or the middle of the image is not usable.
    #[error("{field} is {got}, expected {expected}")]
    Config {
        /// The field.
        field: &'static str,
        /// The value found.
        got: String,
        /// The rule it breaks.
        expected: String,
    },
    /// Something to be drawn holds a number that is not finite, or a size that is not positive.
    #[error("{what} {index} is {got}, expected {expected}")]
    Item {
        /// Kind of thing.
        what: &'static str,
        /// Its place in the list.
        index: usize,
        /// The value found.
        got: String,
        /// The rule it breaks.
        expected: &'static str,
    },
    /// A layer of the map holds a number that is not finite or a line of fewer than two points.
    #[error("map layer {layer} holds points that are not finite, or a line of fewer than two points")]
    Map {
        /// The layer.
        layer: &'static str,
    },
    /// A step that the log does not have.
    #[error("step {got} of a log of {num_steps} steps, expected 0 to {}", num_steps.saturating_sub(1))]
    Step {
        /// The step asked for.
        got: usize,
        /// Steps of the log.
        num_steps: usize,
    },
}

impl RenderError {
    pub(crate) fn config(field: &'static str, got: String, expected: &str) -> Self {
        Self::Config { field, got, expected: expected.into() }
    }

    /// The image has no pixels, or too many.
    pub(crate) fn size(width: u32, height: u32) -> Self {
        let got = format!("{width} x {height} pixels");
        Self::config("image size", got, &format!("1 to {} on each side", crate::MAX_SIDE_PX))
    }
}

/// Result with [`RenderError`].
pub type Result<T> = std::result::Result<T, RenderError>;
