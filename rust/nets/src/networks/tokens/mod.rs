//! Tokens: each vehicle draws a change of speed and a yaw rate from a grid and holds them for half a second (rivals.md#tokens).
//!
//! ```text
//! own motion, route ─► query ─► 2 rounds: [neighbours] [lines of the map] feed forward ─► one of 21 x 21 tokens
//! ```
//! After KiGRAS (Zhao et al. 2025: a grid of controls of a unicycle) and SMART (Wu et al. 2024: the next token of every vehicle).
//! Differs from both: a vehicle is a row of its own, in its own frame; elements are attended to without projections.

pub(crate) mod draw;
pub(crate) mod grid;
mod network;

pub(crate) use draw::{Now, drawn};
pub use grid::{BINS, NUM_TOKENS, TOKEN_STEPS, token_of};
pub use network::Network;

use crate::compute::cpu::Cpu;
use crate::config::{ModelConfig, NeighbourOrder};
use crate::error::{Result, require};
use crate::inputs::tokens::{HISTORY_STEPS, NEAR, build};
use crate::networks::cpu_planner::on_cpu;
use crate::networks::kind::NetworkKind;

/// Each agent's next token of a grid of motions.
pub const TOKENS: NetworkKind = NetworkKind {
    routes: true,
    samples_tokens: true,
    sizes,
    fits,
    features: build,
    ..NetworkKind::of("tokens", "Tokens", on_cpu::<Network<Cpu>>)
};

/// Places on a route that the network is told of, metres ahead.
const ROUTE_POINTS_M: [f32; 16] =
    [0.0, 3.0, 6.0, 9.0, 12.0, 16.0, 20.0, 24.0, 28.0, 32.0, 36.0, 40.0, 45.0, 50.0, 55.0, 60.0];

/// A preset's sizes with a memory of 6 s, plans of 2.5 s.
fn sizes(preset: ModelConfig) -> ModelConfig {
    ModelConfig {
        neighbour_order: NeighbourOrder::Distance,
        history_steps: HISTORY_STEPS,
        horizon_steps: 5 * TOKEN_STEPS,
        knot_stride: 1,
        width: 96,
        edge_width: 64,
        feed_forward: 192,
        temporal_layers: 2,
        max_neighbours: NEAR,
        max_agents: 32,
        route_points_m: ROUTE_POINTS_M.to_vec(),
        ..preset
    }
}

/// Checks what tokens are made of.
fn fits(config: &ModelConfig) -> Result<()> {
    let (steps, stride, horizon) = (config.history_steps, config.knot_stride, config.horizon_steps);
    let fits = config.map.is_some() && steps == HISTORY_STEPS && stride == 1;
    let got = format!("a history of {steps} steps, knots of {stride}");
    require(fits, "model", got, "lines of the map, 62 steps and knots of 1 for tokens")?;
    require(horizon > TOKEN_STEPS, "model.horizon_steps", horizon, "more than a token's 5")
}
