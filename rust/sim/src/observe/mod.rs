//! What an agent observes: one flat row of numbers, described by one schema.
//!
//! [`Layout`] is the schema: from it come the sizes of buffers, the Gymnasium spaces and `docs/observation.md`.
//! [`Observer`] writes rows. Everything is in the frame of the observing agent (x ahead, y left), scaled and clipped to
//! the bounds of its column; rows for what is not there are zero and masked. There is never a NaN. [`BevConfig`] asks
//! for a bird's-eye raster beside the row.

mod agent_rows;
mod bev;
mod column;
mod columns;
mod frame;
mod layout;
mod map_rows;
mod map_segments;
mod nearest_agents;
mod observer;
mod source;
mod view;

pub use bev::{BEV_CHANNELS, BevChannel, BevConfig};
pub use column::ObservationColumn;
pub use layout::{Entry, EntryKind, Layout, ObservationConfig, all_columns};
pub use map_segments::{MapSegments, Segment, SegmentKind};
pub use observer::Observer;
pub use view::{EgoFacts, RoutePlace, View};
