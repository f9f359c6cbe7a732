//! Limits of nuPlan's closed-loop metrics, for rewards, for PDM-Closed and, in the file of the protocol, for the score.

use crate::geom::Real;

/// Lowest and highest acceleration in comfort, m/s².
pub const ACCELERATION_MPS2: [Real; 2] = [-4.05, 2.40];
/// Highest acceleration to a side, m/s².
pub const LATERAL_ACCELERATION_MPS2: Real = 4.89;
/// Highest jerk, m/s³.
pub const JERK_MPS3: Real = 8.37;
/// Highest jerk along the heading, m/s³.
pub const LONGITUDINAL_JERK_MPS3: Real = 4.13;
/// Highest yaw rate, rad/s.
pub const YAW_RATE_RADPS: Real = 0.95;
/// Highest yaw acceleration, rad/s².
pub const YAW_ACCELERATION_RADPS2: Real = 1.93;
/// Least time to contact, seconds.
pub const TTC_S: Real = 0.95;
/// Speed up to which an ego has no time to contact, m/s.
pub const STANDING_MPS: Real = 5e-3;
/// Speed up to which an agent counts as stopped in a contact, m/s.
pub const STOPPED_MPS: Real = 0.05;
/// Cosine of the bearing from the rear axle above which an agent is ahead, and below minus which behind (30 degrees).
pub const AHEAD_COS: Real = 0.866_025_4;
