//! Top-down images, drawn on the processor.
//!
//! What flows in: a [`Drawing`] — map layers, agents as boxes, trails, a route, plans — and
//! a [`Camera`]. What flows out: an opaque RGB image, [H, W, 3] bytes from the top row down, or the same as SVG. The same input gives the same bytes.
//!
//! ```text
//! Map ──► MapLayers ──┐
//!  (once per scene)   ├─► Drawing ──► render(drawing, camera) ──► bytes
//! agents, lines ──────┘
//! ```
//!
//! Every colour is in [`palette`], every length and time that the replay page shares in [`look`].

mod agents;
mod camera;
mod canvas;
mod drawing;
mod error;
mod layers;
mod lines;
pub mod look;
pub mod palette;
mod text;

pub use agents::AgentBox;
pub use camera::{Camera, MAX_SIDE_PX, NORTH_UP_RAD};
pub use drawing::{Drawing, render, render_svg};
pub use error::{RenderError, Result};
pub use layers::MapLayers;
pub use lines::Line;
pub use palette::{DrawStyle, Rgb, Theme};
