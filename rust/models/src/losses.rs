//! Losses of plans against logged futures.

use crate::batch::{Batch, Targets};
use crate::collision::Neighbours;
use crate::plan_space::PlanSpace;
use ccdiff_nets::inputs::unicycle::plan_limits;
use tch::{Kind, Tensor};

/// Bound of logged yaw rates before they are fitted, as of accelerations: jumps of the log beyond it are label noise.
const YAW_RATE_RADPS: f64 = 1.5;

/// Logged actions [R, T, 2], bounded, zero where not logged.
pub(crate) fn logged_actions(targets: &Targets) -> Tensor {
    let bounds = [plan_limits().acceleration_mps2.map(f64::from), [-YAW_RATE_RADPS, YAW_RATE_RADPS]];
    let bounded: Vec<Tensor> = bounds
        .iter()
        .zip(4..)
        .map(|([low, high], c)| targets.states.select(2, c).clamp(*low, *high) * &targets.valid)
        .collect();
    Tensor::stack(&bounded, 2)
}

/// Mean squared error over the six normalised components of the steps that count [R, T] (reference.md#training).
///
/// Differs from the released code: the mean is over logged steps, not over padding as well.
pub(crate) fn trajectory_loss(
    space: &PlanSpace,
    states: &Tensor,
    targets: &Targets,
    counts: &Tensor,
) -> Tensor {
    let config = space.config();
    let difference = space.standardised_states(states) - space.standardised_states(&targets.states);
    let weights =
        Tensor::from_slice(&config.loss_weights).to_kind(Kind::Float).to_device(difference.device());
    let per_step = (difference.square() * weights).mean_dim([2i64].as_slice(), false, Kind::Float);
    (per_step * counts).sum(Kind::Float) / counts.sum(Kind::Float).clamp_min(1.0)
}

/// Loss of planned knots [R, knots, 2]: their distance to the log and, with a weight above 0, how far they drive over
/// neighbours' logged futures, each row with its share [R].
pub(crate) fn plan_loss(
    space: &PlanSpace,
    knots: &Tensor,
    batch: &Batch,
    targets: &Targets,
    collision_weight: f64,
    share: impl FnOnce() -> Tensor,
) -> Tensor {
    let speed_mps = batch.speed_mps();
    let states = space.states(knots, &speed_mps);
    let neighbours = (collision_weight > 0.0).then(|| Neighbours::new(batch, targets)).flatten();
    let Some(neighbours) = neighbours else {
        return trajectory_loss(space, &states, targets, &targets.valid);
    };
    let driven_into = neighbours.loss(space, knots, &speed_mps, &share());
    trajectory_loss(space, &states, targets, &neighbours.examples(targets)) + driven_into * collision_weight
}
