//! The loss of BITS.

use crate::batch::Targets;
use crate::losses::plan_loss;
use crate::plan_model::{Learns, TrainingStep};
use crate::plan_space::PlanSpace;
use crate::torch::{Torch, tensor, to_vec};
use ccdiff_nets::compute::numbers::Array;
use ccdiff_nets::networks::bits::{Bits, CHANNELS, GOAL, Grid, PER_TOKEN, by_token};
use tch::{Kind, Tensor};

/// Where vehicles are at the end of their logged plans.
struct Ends {
    /// Index of the cell among those of all tokens [R, 1], int64.
    cell: Tensor,
    /// Place within the cell [R, 2].
    within: Tensor,
    /// The cells as goals [R, [`GOAL`]].
    goals: Vec<f32>,
}

impl Ends {
    fn new(targets: &Targets) -> Self {
        let (states, valid) = (to_vec(&targets.states), to_vec(&targets.valid));
        let steps = targets.valid.size()[1] as usize;
        let (mut cells, mut places, mut goals) = (Vec::new(), Vec::new(), Vec::new());
        for (states, valid) in states.chunks_exact(6 * steps).zip(valid.chunks_exact(steps)) {
            let last = valid.iter().filter(|v| **v > 0.5).count().max(1) - 1;
            let [x, y, yaw] = [0, 1, 3].map(|c| states[6 * last + c]);
            let (cell, within) = Grid::encode(x, y);
            cells.push(by_token(cell) as i64);
            places.extend(within);
            goals.extend(Grid::goal(cell, within, [yaw.cos(), yaw.sin()]));
        }
        let device = targets.valid.device();
        Self {
            cell: Tensor::from_slice(&cells).view([-1, 1]).to_device(device),
            within: Tensor::from_slice(&places).view([-1, 2]).to_device(device),
            goals,
        }
    }
}

impl Learns for Bits<Torch> {
    /// Cross entropy of the cell where the vehicle will be, errors of its place and heading there, and the losses of the plan to that
    /// goal and of the prediction.
    fn loss(&self, space: &PlanSpace, step: &TrainingStep<'_>) -> Tensor {
        let (batch, targets) = (step.batch, step.targets);
        let seen = self.encode(batch);
        let Some(cells) = self.cells(&seen) else { return Tensor::new() };
        let (rows, per_token) = (batch.num_rows() as i64, PER_TOKEN as i64);
        let cells = cells.view([rows, -1, CHANNELS as i64, per_token]).transpose(1, 2).flatten(2, 3);
        let Ends { cell, within, goals } = Ends::new(targets);
        // a cell counts where it is that of the last step of a plan
        let whole = targets.valid.select(1, targets.valid.size()[1] - 1);
        let mean = |loss: Tensor| (loss * &whole).sum(Kind::Float) / whole.sum(Kind::Float).clamp_min(1.0);
        let entropy = -cells.select(1, 0).log_softmax(1, Kind::Float).gather(1, &cell, false);
        let index = cell.unsqueeze(1).expand([-1, CHANNELS as i64, 1], false);
        let there = cells.gather(2, &index, false).squeeze_dim(2);
        let place = (there.narrow(1, 1, 2).sigmoid() - within).square();
        let place = place.mean_dim([1i64].as_slice(), false, Kind::Float);
        let heading = unit(&there);
        let wanted = Tensor::from_slice(&goals).view([rows, -1]).to_device(batch.device);
        let toward = |c: i64| heading.select(1, c) * wanted.select(1, 2 + c);
        let turned = 1f64 - (toward(0) + toward(1));
        let share = || Tensor::ones([rows], (Kind::Float, cells.device()));
        let weight = step.config.collision_weight;
        let to_log =
            |knots: &Tensor| plan_loss(space, &knots.view([rows, -1, 2]), batch, targets, weight, share);
        mean(entropy.squeeze_dim(1))
            + mean(place)
            + mean(turned)
            + to_log(&self.plans(&seen, &tensor(Array::new(1, GOAL, goals), batch.device)))
            + to_log(&self.predicted(&seen))
    }
}

/// Cosine and sine [R, 2] of the headings in cells' channels [R, 5].
fn unit(channels: &Tensor) -> Tensor {
    let heading = channels.narrow(1, 3, 2);
    let norm = heading.square().sum_dim_intlist([1i64].as_slice(), true, Kind::Float).sqrt();
    heading / norm.clamp_min(1e-6)
}
