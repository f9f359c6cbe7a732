//! Training of tokens: cross entropy with labels smoothed by distance, mirrored rows (rivals.md#tokens).

use crate::batch::{Batch, Targets};
use crate::plan_model::{Learns, TrainingStep};
use crate::plan_space::PlanSpace;
use crate::torch::{Torch, tensor, to_vec};
use crate::train::config::TrainConfig;
use ccdiff_nets::compute::numbers::Array;
use ccdiff_nets::inputs::segments::SEGMENT_ODD;
use ccdiff_nets::inputs::tokens::{near_columns, own_columns};
use ccdiff_nets::networks::planner::Proposes;
use ccdiff_nets::networks::tokens::{BINS, NUM_TOKENS, Network, TOKEN_STEPS, token_of};
use tch::{Kind, Tensor};

/// Share of a label that is spread over the tokens beside it, by a Gaussian of one bin on each axis.
const SMOOTHED: f64 = 0.1;

/// Rows whose next token is logged: own numbers, neighbours and lines, and the bins of the token [L, 2].
struct Labelled {
    inputs: [Array; 3],
    bins: Tensor,
}

impl Labelled {
    /// Those of a batch, those mirrored that `mirrored` says; `None` without any.
    fn new(
        batch: &Batch,
        targets: &Targets,
        num_places: usize,
        mirrored: impl Fn(u64) -> bool,
    ) -> Option<Self> {
        let (states, valid) = (to_vec(&targets.states), to_vec(&targets.valid));
        let steps = targets.valid.size()[1] as usize;
        let known: Vec<bool> = batch.scenes.iter().flat_map(|s| &s.tokens.known).copied().collect();
        let speeds = batch.scenes.iter().flat_map(|s| &s.speed_mps);
        let (mut rows, mut bins) = (Vec::new(), Vec::new());
        for (row, speed) in speeds.enumerate() {
            // the speed at the end lies between those of the steps before and after it
            if valid[row * steps + TOKEN_STEPS] < 0.5 || !known[row] {
                continue;
            }
            let state = |step: usize| &states[(row * steps + step) * 6..][..6];
            let (last, next) = (state(TOKEN_STEPS - 1), state(TOKEN_STEPS));
            let mirror = mirrored(row as u64);
            let yaw_rate = if mirror { -last[5] } else { last[5] };
            rows.push((row, mirror));
            bins.extend(token_of(0.5 * (last[2] + next[2]) - speed, yaw_rate).map(|bin| bin as i64));
        }
        let lines = batch.numbers().lines()?;
        if rows.is_empty() {
            return None;
        }
        let (own, near, _) = batch.numbers().tokens();
        let of = |all: Array, odd: Vec<bool>| {
            let row = |(row, mirror): &(usize, bool)| {
                let numbers = all.numbers[row * all.row()..][..all.row()].iter().zip(odd.iter().cycle());
                let sign = if *mirror { -1.0 } else { 1.0 };
                numbers.map(move |(x, odd)| if *odd { sign * x } else { *x }).collect::<Vec<f32>>()
            };
            all.like(rows.iter().flat_map(row).collect())
        };
        let inputs = [
            of(own, own_columns(num_places).map(|c| c.0).collect()),
            of(near, near_columns().map(|c| c.0).collect()),
            of(lines, SEGMENT_ODD.to_vec()),
        ];
        Some(Self { inputs, bins: Tensor::from_slice(&bins).view([-1, 2]).to_device(batch.device) })
    }

    /// Logarithms of the probabilities of all tokens [L, tokens].
    fn log_p(&self, network: &Network<Torch>, batch: &Batch) -> Tensor {
        let [own, near, lines] = self.inputs.each_ref().map(|x| tensor(x.clone(), batch.device));
        let size = [self.bins.size()[0], NUM_TOKENS as i64];
        network.logits(&own, &near, &lines).view(size).log_softmax(-1, Kind::Float)
    }

    /// Index [L, 1] of the tokens.
    fn token(&self) -> Tensor {
        (self.bins.select(1, 0) * BINS as i64 + self.bins.select(1, 1)).unsqueeze(1)
    }
}

/// Weights [bins, bins] of the bins beside each bin.
fn beside(batch: &Batch) -> Tensor {
    let far = |a: usize, b: usize| -0.5 * (a as f32 - b as f32).powi(2);
    let weight = |at: usize| if at / BINS == at % BINS { 0.0 } else { far(at / BINS, at % BINS).exp() };
    let weights: Vec<f32> = (0..BINS * BINS).map(weight).collect();
    let weights = Tensor::from_slice(&weights).view([BINS as i64, BINS as i64]).to_device(batch.device);
    &weights / weights.sum_dim_intlist([1i64].as_slice(), true, Kind::Float)
}

impl Learns for Network<Torch> {
    fn fast(settings: TrainConfig) -> TrainConfig {
        TrainConfig {
            batch_scenes: 160,
            learning_rate: 1.5e-3,
            drop_route: 0.5,
            collision_weight: 0.0,
            ..settings
        }
    }

    fn loss(&self, _: &PlanSpace, step: &TrainingStep<'_>) -> Tensor {
        let (draw, beside) = (step.draw(2), beside(step.batch));
        let places = self.config().route_points_m.len();
        let rows = Labelled::new(step.batch, step.targets, places, |row| draw.uniform(row) < 0.5);
        let Some(rows) = rows else {
            return (beside.sum(Kind::Float) * 0.0).set_requires_grad(true);
        };
        let log_p = rows.log_p(self, step.batch);
        let soft = |axis: i64| beside.index_select(0, &rows.bins.select(1, axis));
        let soft = (soft(0).unsqueeze(2) * soft(1).unsqueeze(1)).flatten(1, 2) * SMOOTHED;
        let hard = log_p.gather(1, &rows.token(), false).squeeze_dim(1) * (1.0 - SMOOTHED);
        let soft = (soft * &log_p).sum_dim_intlist([1i64].as_slice(), false, Kind::Float);
        -(hard + soft).mean(Kind::Float)
    }

    fn nats(&self, batch: &Batch, targets: &Targets) -> Option<(f64, usize)> {
        let rows = Labelled::new(batch, targets, self.config().route_points_m.len(), |_| false)?;
        let found = -rows.log_p(self, batch).gather(1, &rows.token(), false).sum(Kind::Double);
        Some((found.double_value(&[]), rows.bins.size()[0] as usize))
    }
}
