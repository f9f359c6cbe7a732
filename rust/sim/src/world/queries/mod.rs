//! What is asked of worlds between their steps, and snapshots: no step needs it.

mod candidates;
mod inspect;
mod map;
mod score_facts;
mod snapshot;

pub use candidates::{CANDIDATE_BOUND, CANDIDATE_FEATURES, Candidates, OWN_FEATURES};
pub use inspect::WorldStatus;
pub(super) use inspect::no_index;
pub use map::LaneAhead;
pub use score_facts::ScoreFacts;
