//! What can go wrong when an image is asked for.

/// Everything the renderer refuses, with the facts a caller needs to mend it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RenderError {
    /// A size, a number of the camera or of something to be drawn is not usable.
    #[error("{what} is {got}, expected {expected}")]
    Value {
        /// The field, or the thing and its place in the list.
        what: String,
        /// The value found.
        got: String,
        /// The rule it breaks.
        expected: String,
    },
    /// A layer of the map holds a number that is not finite or a line of fewer than two points.
    #[error("map layer {layer} holds points that are not finite, or a line of fewer than two points")]
    Map {
        /// The layer.
        layer: &'static str,
    },
}

impl RenderError {
    pub(crate) fn value(what: impl Into<String>, got: impl ToString, expected: impl Into<String>) -> Self {
        Self::Value { what: what.into(), got: got.to_string(), expected: expected.into() }
    }

    /// The image has no pixels, or too many.
    pub(crate) fn size(width: u32, height: u32) -> Self {
        let expected = format!("1 to {} on each side", crate::MAX_SIDE_PX);
        Self::value("image size", format!("{width} x {height} pixels"), expected)
    }
}

/// Result with [`RenderError`].
pub type Result<T> = std::result::Result<T, RenderError>;
