//! Top-down images of a scene or a running world, drawn on the processor.
//!
//! What flows in: a [`Drawing`] — map layers, agents as boxes, trails, a route, plans, causal arrows — and
//! a [`Camera`]. What flows out: an opaque RGB image, [H, W, 3] bytes, or the same as SVG. The same input gives the same bytes.
//!
//! ```text
//! Map ──► MapLayers ──┐
//!  (once per scene)   ├─► Drawing ──► render(drawing, camera) ──► Image
//! agents, lines ──────┘
//! ```
//!
//! Every colour is in [`palette`], every length and time that the replay page shares in [`look`].

mod agents;
mod camera;
mod canvas;
mod drawing;
mod error;
mod image;
mod layers;
mod lines;
mod log;
pub mod look;
pub mod palette;
mod shown;
mod text;
mod world;

pub use agents::AgentBox;
pub use camera::{Camera, MAX_SIDE_PX, NORTH_UP_RAD};
pub use drawing::{Drawing, render, render_svg};
pub use error::{RenderError, Result};
pub use image::Image;
pub use layers::MapLayers;
pub use lines::{Arrow, Line};
pub use palette::{DrawStyle, Rgb, Theme};
pub use shown::{Centre, Frame, Shown};
pub use world::{Trail, Trails};
