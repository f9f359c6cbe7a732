//! BITS: spatial goals, a policy that drives to a goal, a predictor of the others, choice among the plans
//! (rivals.md#bits).
//!
//! ```text
//! map tokens, state ─► cells of a grid ahead ─► N goals ─► policy ─► N plans ─► choice against predicted others
//! ```
//! Differs from the paper: 32 x 32 cells of 2 m, not 224 x 224 of 0.5 m; every neighbour is a row of its own, so the
//! predictor sees it in its own frame; goals are conditioned on as the grid gives them back.

use super::moved;
use crate::batch::Batch;
use crate::config::{MapConfig, ModelConfig};
use crate::error::{ModelError, Result};
use crate::features::row_offsets;
use crate::guidance::Guidance;
use crate::losses::plan_loss;
use crate::noise::Noise;
use crate::plan_model::{PlanModel, TorchKind, TrainingStep};
use crate::plan_space::PlanSpace;
use crate::raster::ZERO;
use crate::sampler::{SampleOptions, Samples, to_vec};
use crate::torch::Torch;
use crate::trunk::{Encoded, Trunk};
use ccdiff_nets::layers::perceptron::Perceptron;
use ccdiff_nets::simnet::HIDDEN;
use tch::{Kind, Tensor, nn};

/// BITS.
pub(crate) const BITS: TorchKind = TorchKind {
    name: "bits",
    build: |p, config| Ok(Box::new(Bits::new(p, config)?)),
    fast: |settings| settings,
};

/// Cells along a side of the goal grid.
const SIDE: i64 = 32;
/// Cells along a side of a map token.
const CELLS_PER_TOKEN: i64 = 4;
/// Channels of a cell: logit, place within it (2), cosine and sine of the heading there.
const CHANNELS: i64 = 5;
/// Hidden width of the goal head, width of an encoded goal.
const GOAL_WIDTHS: (i64, i64) = (96, 32);
/// Positions of goals are divided by this, metres.
const GOAL_SCALE_M: f64 = 20.0;

/// Where a grid of goals lies in the agent's frame.
#[derive(Debug, Clone, Copy)]
struct Grid {
    cell_m: f64,
    /// Cells behind the agent.
    behind: f64,
}

impl Grid {
    fn new(map: &MapConfig) -> Self {
        let cell_px = map.size_px as f64 / SIDE as f64;
        Self { cell_m: cell_px * f64::from(map.metres_per_px), behind: map.agent_column_px as f64 / cell_px }
    }

    /// Cell [R] (int64) of points, and the place within it [R, 2] in [0, 1); points outside go to the border.
    fn encode(self, x: &Tensor, y: &Tensor) -> (Tensor, Tensor) {
        let side = SIDE as f64;
        let column = (x / self.cell_m + self.behind).clamp(0.0, side - 1e-5);
        let row = (y / self.cell_m + side / 2.0).clamp(0.0, side - 1e-5);
        let (whole_column, whole_row) = (column.floor(), row.floor());
        let cell = (&whole_row * side + &whole_column).to_kind(Kind::Int64);
        (cell, Tensor::stack(&[column - whole_column, row - whole_row], 1))
    }

    /// x, y (m) of a place within cells, and whether the cell is on the border, each [R].
    fn decode(self, cell: &Tensor, within: &Tensor) -> (Tensor, Tensor, Tensor) {
        let row = cell.divide_scalar_mode(SIDE, "floor");
        let column = cell - &row * SIDE;
        let edge = |t: &Tensor| t.eq(0).logical_or(&t.eq(SIDE - 1));
        let border = edge(&row).logical_or(&edge(&column)).to_kind(Kind::Float);
        let x = (column.to_kind(Kind::Float) + within.select(1, 0) - self.behind) * self.cell_m;
        let y = (row.to_kind(Kind::Float) + within.select(1, 1) - SIDE as f64 / 2.0) * self.cell_m;
        (x, y, border)
    }
}

/// The three networks on their trunk.
#[derive(Debug)]
pub struct Bits {
    space: PlanSpace,
    grid: Grid,
    trunk: Trunk,
    film: nn::Linear,
    cells: Perceptron<Torch>,
    goal: nn::Linear,
    policy: Perceptron<Torch>,
    predictor: Perceptron<Torch>,
}

impl Bits {
    /// A network with fresh weights under a path.
    ///
    /// # Errors
    /// [`ModelError::Config`] without a map.
    pub fn new(p: &nn::Path, config: &ModelConfig) -> Result<Self> {
        let tokens = SIDE / CELLS_PER_TOKEN;
        let map = config.map.as_ref().filter(|m| m.size_px as i64 == 8 * tokens).ok_or_else(|| {
            let expected = "a map of 64 pixels: goals are drawn from it";
            ModelError::Config { field: "map", got: format!("{:?}", config.map), expected }
        })?;
        let (d, out) = (config.width, 2 * config.num_knots() as i64);
        let mlp = |name: &str, widths: &[i64]| Perceptron::new(&(p / name), widths);
        let per_token = CHANNELS * CELLS_PER_TOKEN * CELLS_PER_TOKEN;
        let (hidden, goal) = GOAL_WIDTHS;
        Ok(Self {
            space: PlanSpace::new(config, p.device()),
            grid: Grid::new(map),
            trunk: Trunk::new(&(p / "trunk"), config),
            film: nn::linear(p / "film", d + 1, 2 * map.feature_width, Default::default()),
            cells: mlp("cells", &[map.feature_width, hidden, per_token]),
            goal: nn::linear(p / "goal", 5, goal, Default::default()),
            policy: mlp("policy", &[d + 1 + goal, HIDDEN, HIDDEN, out]),
            predictor: mlp("predictor", &[d + 1, HIDDEN, out]),
        })
    }

    /// The channels of all cells, [R, 5, SIDE²], row-major.
    fn maps(&self, seen: &Encoded) -> Tensor {
        let film = seen.state.apply(&self.film).unsqueeze(1).chunk(2, 2);
        let tokens = seen.map.as_ref().map_or_else(Tensor::new, Tensor::shallow_clone);
        let cells = self.cells.forward(&(&tokens * (&film[0] + 1.0) + &film[1]));
        on_grid(&cells)
    }

    fn predicted(&self, seen: &Encoded) -> Tensor {
        self.predictor.forward(&seen.state).view([seen.state.size()[0], -1, 2])
    }

    /// Knots of plans to goals: states [R, d + 1]; x, y, cos, sin, border of the goals, each [R].
    fn plans(&self, state: &Tensor, goal: &[Tensor; 5]) -> Tensor {
        let [x, y, cos, sin, border] = goal;
        let goal = Tensor::stack(&[&(x / GOAL_SCALE_M), &(y / GOAL_SCALE_M), cos, sin, border], 1);
        let input = Tensor::cat(&[state, &goal.apply(&self.goal).relu()], 1);
        self.policy.forward(&input).view([state.size()[0], -1, 2])
    }

    /// Probabilities [R, SIDE²] (f64) of the cells, zero off the road where there is any road.
    fn probabilities(&self, batch: &Batch, maps: &Tensor) -> Tensor {
        let p = maps.select(1, 0).to_kind(Kind::Double).softmax(1, Kind::Double);
        let Some(image) = &batch.image else { return p };
        let drivable = (image.narrow(1, 0, 1).to_kind(Kind::Float) - f64::from(ZERO)).clamp_min(0.0);
        let px = image.size()[2] / SIDE;
        let drivable = drivable.max_pool2d([px, px], [px, px], [0, 0], [1, 1], false).gt(0.0).flatten(1, 3);
        let masked = &p * drivable.to_kind(Kind::Double);
        let some = masked.sum_dim_intlist([1i64].as_slice(), true, Kind::Double).gt(0.0);
        masked.where_self(&some, &p)
    }
}

/// Numbers of tokens [R, tokens, channels · 16] at the cells that they cover, [R, channels, SIDE²].
fn on_grid(tokens: &Tensor) -> Tensor {
    let side = SIDE / CELLS_PER_TOKEN;
    let maps = tokens.transpose(1, 2).contiguous().view([tokens.size()[0], -1, side, side]);
    maps.pixel_shuffle(CELLS_PER_TOKEN).flatten(2, 3)
}

/// Cells [N · R] drawn from unnormalised probabilities [R, cells] by uniform numbers [N · R].
fn drawn(probabilities: &Tensor, uniform: &Tensor) -> Tensor {
    let rows = probabilities.size()[0];
    let cumulative = probabilities.cumsum(1, Kind::Double);
    let last = cumulative.size()[1] - 1;
    let wanted = uniform.view([-1, rows]) * cumulative.select(1, last);
    let wanted = wanted.transpose(0, 1).contiguous();
    let found = wanted.searchsorted(&cumulative, false, true, "right", None::<&Tensor>);
    found.clamp_max(last).transpose(0, 1).contiguous().view([-1])
}

impl PlanModel for Bits {
    fn space(&self) -> &PlanSpace {
        &self.space
    }

    /// Cross entropy of the cell where the vehicle will be, errors of its place and heading there, and the losses of the
    /// plan to that goal and of the prediction.
    fn loss(&self, step: &TrainingStep<'_>) -> Tensor {
        let (batch, targets) = (step.batch, step.targets);
        let seen = Encoded::new(&self.trunk, batch, true);
        let maps = self.maps(&seen);
        let steps = targets.valid.size()[1];
        let count = targets.valid.sum_dim_intlist([1i64].as_slice(), false, Kind::Int64);
        let at = (count - 1).clamp_min(0).view([-1, 1, 1]).expand([-1, 1, 6], false);
        let end = targets.states.gather(1, &at, false).squeeze_dim(1);
        let (cell, within) = self.grid.encode(&end.select(1, 0), &end.select(1, 1));
        let (cos, sin) = (end.select(1, 3).cos(), end.select(1, 3).sin());
        // a cell counts where it is that of the last step of a plan
        let whole = targets.valid.select(1, steps - 1);
        let mean = |loss: Tensor| (loss * &whole).sum(Kind::Float) / whole.sum(Kind::Float).clamp_min(1.0);
        let entropy = -maps.select(1, 0).log_softmax(1, Kind::Float).gather(1, &cell.unsqueeze(1), false);
        let index = cell.view([-1, 1, 1]).expand([-1, CHANNELS, 1], false);
        let there = maps.gather(2, &index, false).squeeze_dim(2);
        let place = (there.narrow(1, 1, 2).sigmoid() - &within).square();
        let place = place.mean_dim([1i64].as_slice(), false, Kind::Float);
        let heading = unit(&there);
        let turned = 1f64 - (heading.select(1, 0) * &cos + heading.select(1, 1) * &sin);
        let (x, y, border) = self.grid.decode(&cell, &within);
        let share = || Tensor::ones([batch.num_rows()], (Kind::Float, maps.device()));
        let weight = step.config.collision_weight;
        let to_log = |knots: &Tensor| plan_loss(&self.space, knots, batch, targets, weight, share);
        let plan = self.plans(&seen.state, &[x, y, cos, sin, border]);
        mean(entropy.squeeze_dim(1))
            + mean(place)
            + mean(turned)
            + to_log(&plan)
            + to_log(&self.predicted(&seen))
    }

    /// Plans to N goals drawn from the grid. Each agent's sample is chosen against the predicted plans of the others.
    fn propose(
        &self,
        batch: &Batch,
        seeds: &[u64],
        options: SampleOptions,
        mut guide: Option<&mut Guidance<'_>>,
    ) -> Result<Samples> {
        batch.rows().check_seeds(seeds)?;
        let n = options.num_samples;
        let seen = Encoded::new(&self.trunk, batch, false);
        let maps = self.maps(&seen);
        let uniform = uniforms(batch, seeds, n);
        let uniform = Tensor::from_slice(&uniform).to_device(maps.device());
        let cell = drawn(&self.probabilities(batch, &maps), &uniform);
        let index = cell.view([-1, 1, 1]).expand([-1, CHANNELS, 1], false);
        let there = maps.repeat([n as i64, 1, 1]).gather(2, &index, false).squeeze_dim(2);
        let (x, y, border) = self.grid.decode(&cell, &there.narrow(1, 1, 2).sigmoid());
        let heading = unit(&there);
        let goal = [x, y, heading.select(1, 0), heading.select(1, 1), border];
        let knots = self.plans(&seen.state.repeat([n as i64, 1]), &goal);
        if let Some(guide) = guide.as_deref_mut() {
            guide.choose_against(to_vec(&self.predicted(&seen)), None)?;
        }
        Ok(Samples { knots: moved(&knots, guide)?, attention: None })
    }
}

/// Cosine and sine [R, 2] of the headings in cells' channels [R, 5].
fn unit(channels: &Tensor) -> Tensor {
    let heading = channels.narrow(1, 3, 2);
    let norm = heading.square().sum_dim_intlist([1i64].as_slice(), true, Kind::Float).sqrt();
    heading / norm.clamp_min(1e-6)
}

/// Uniform numbers [N · R], sample by sample; a world's are those of its own seed.
fn uniforms(batch: &Batch, seeds: &[u64], samples: usize) -> Vec<f64> {
    let rows: usize = batch.scene_sizes.iter().sum();
    let mut out = vec![0.0; samples * rows];
    for ((size, offset), seed) in batch.scene_sizes.iter().zip(row_offsets(&batch.scene_sizes)).zip(seeds) {
        let noise = Noise::new(*seed, 0);
        for (sample, row) in (0..samples * size).map(|k| (k / size, k % size)) {
            out[sample * rows + offset + row] = noise.uniform((sample * size + row) as u64);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use tch::Device;

    fn grid() -> Grid {
        Grid::new(ModelConfig::fast().map.as_ref().unwrap())
    }

    fn cell_of(x: f32, y: f32) -> (i64, [f64; 2]) {
        let (cell, within) = grid().encode(&Tensor::from_slice(&[x]), &Tensor::from_slice(&[y]));
        (cell.int64_value(&[0]), [0, 1].map(|c| within.double_value(&[0, c])))
    }

    #[test]
    fn cells_are_the_tabulated_ones_and_give_points_back() {
        // tabulated in float64
        assert_eq!(cell_of(0.0, 0.0).0, 517);
        let (cell, [column, row]) = cell_of(12.34, -3.21);
        assert!(cell == 459 && (column - 0.17).abs() < 1e-5 && (row - 0.395).abs() < 1e-5);
        assert_eq!((cell_of(-30.0, 0.0).0, cell_of(100.0, 60.0).0), (512, 1023));
        for (x, y, want, on_border) in [
            (12.34, -3.21, [12.34, -3.21], 0.0),
            (-30.0, 4.0, [-10.0, 4.0], 1.0),
            (100.0, 60.0, [54.0, 32.0], 1.0),
        ] {
            let (cell, within) = grid().encode(&Tensor::from_slice(&[x]), &Tensor::from_slice(&[y]));
            let (x, y, border) = grid().decode(&cell, &within);
            assert!((x.double_value(&[0]) - want[0]).abs() < 1e-3, "{x:?}");
            assert!((y.double_value(&[0]) - want[1]).abs() < 1e-3, "{y:?}");
            assert_eq!(border.double_value(&[0]), on_border);
        }
    }

    #[test]
    fn a_token_covers_four_by_four_cells_in_reading_order() {
        let tokens = Tensor::zeros([1, 64, CHANNELS * 16], (Kind::Float, Device::Cpu));
        let _ = tokens.get(0).get(5 * 8 + 2).get(39).fill_(1.0);
        let found = on_grid(&tokens).get(0).view([CHANNELS, SIDE, SIDE]).nonzero();
        assert_eq!(Vec::<i64>::try_from(found.view([-1])).unwrap(), [2, 21, 11]);
    }

    #[test]
    fn cells_are_drawn_by_their_probabilities_and_never_off_the_mask() {
        let p = Tensor::from_slice(&[0.1f64, 0.0, 0.55, 0.35]).view([1, 4]);
        let uniform = Tensor::from_slice(&[0.05f64, 0.1, 0.5, 0.65, 0.9]);
        let found = Vec::<i64>::try_from(drawn(&p, &uniform)).unwrap();
        assert_eq!((&found[..3], found[4]), ([0, 2, 2].as_slice(), 3));
        let noise = Noise::new(4, 2);
        let count = 100_000;
        let many: Vec<f64> = (0..count).map(|i| noise.uniform(i)).collect();
        let found = drawn(&(&p * 3.0), &Tensor::from_slice(&many));
        for (cell, p) in [0.1, 0.0, 0.55, 0.35].into_iter().enumerate() {
            let got = found.eq(cell as i64).sum(Kind::Int64).int64_value(&[]) as f64;
            let sigma = (count as f64 * p * (1.0 - p)).sqrt();
            assert!((got - count as f64 * p).abs() <= 3.0 * sigma, "cell {cell}: {got}");
        }
    }
}
