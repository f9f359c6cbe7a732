//! What happens to agents at one step: contacts, leaving the road, driving against traffic, leaders.
//!
//! In: states, footprints and kinds of the agents of one world and the indices built from its map. Out: pairs and flags.
//! Decides nothing about what follows from an event, and allocates nothing after its first calls.

mod collision;
mod fault;
mod lane_facts;
mod leader;
pub mod limits;
mod off_road;
mod ttc;

pub use collision::{Collisions, Contact, ContactKind};
pub(crate) use fault::{bearing_cos, is_at_fault};
pub use fault::{expected_contact_s, rear_axle};
pub use lane_facts::{LaneFacts, in_intersection, lane_facts, lane_that_holds, straddles_lanes};
pub use leader::{ANTICIPATION_S, Leader, leader};
pub use off_road::{OffRoad, off_road};
pub use ttc::{LeastTimes, time_to_contact};
