//! What can go wrong when an image is asked for.

/// Everything the renderer refuses, with the facts a caller needs to mend it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RenderError {
    /// The image has no pixels or too many.
    #[error("image size is {width} x {height} pixels, expected 1 to {max} on each side")]
    Size {
        /// Width asked for, pixels.
        width: u32,
        /// Height asked for, pixels.
        height: u32,
        /// Largest side allowed, pixels.
        max: u32,
    },
    /// A number of the camera is not usable.
    #[error("camera: {field} is {got}, expected {expected}")]
    Camera {
        /// The field.
        field: &'static str,
        /// The value found.
        got: String,
        /// The rule it breaks.
        expected: &'static str,
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
    /// The middle of the image cannot be found.
    #[error("centre of the image is {got}, expected {expected}")]
    Centre {
        /// What was asked for.
        got: String,
        /// The rule it breaks.
        expected: &'static str,
    },
}

/// Result with [`RenderError`].
pub type Result<T> = std::result::Result<T, RenderError>;
