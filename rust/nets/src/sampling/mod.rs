//! How plans are drawn: noise, its schedule, the sampler, the space of plans.

pub mod noise;
pub mod plan_space;
pub mod sampler;
pub mod schedule;
