//! Who drives an agent.

use serde::{Deserialize, Serialize};

/// Who drives an agent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Driver {
    /// Actions handed to `step`.
    External,
    /// The policy at this place of the batch's table.
    Policy(u16),
    /// Nobody: it is towed by the vehicle that it is hitched to.
    Towed,
}

impl Driver {
    /// Log replay: the first policy of every table.
    pub const REPLAY: Self = Self::Policy(0);
}
