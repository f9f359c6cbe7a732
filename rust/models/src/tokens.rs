//! Training of tokens: cross entropy with labels smoothed by distance, mirrored rows (rivals.md#tokens).

use crate::batch::{Batch, Targets};
use crate::config::ModelConfig;
use crate::error::Result;
use crate::guidance::Guidance;
use crate::plan_model::{PlanModel, Samples, TorchKind, TrainingStep};
use crate::plan_space::PlanSpace;
use crate::tape::{self, Parameters, Tape};
use crate::torch::{Torch, to_vec};
use crate::train::config::TrainConfig;
use ccdiff_nets::inputs::segments::SEGMENT_ODD;
use ccdiff_nets::inputs::tokens::{near_columns, own_columns};
use ccdiff_nets::networks::planner::{Asked, Proposes, Weighted};
use ccdiff_nets::networks::tokens::{BINS, NUM_TOKENS, Network, TOKEN_STEPS, token_of};
use tch::{Kind, Tensor, nn};

/// Tokens.
pub(crate) const TOKENS: TorchKind = TorchKind {
    name: "tokens",
    build: |p, config| Ok(Box::new(Tokens::new(p, config))),
    fast: |settings| TrainConfig {
        batch_scenes: 160,
        learning_rate: 1.5e-3,
        drop_route: 0.5,
        collision_weight: 0.0,
        ..settings
    },
};

/// Share of a label that is spread over the tokens beside it, by a Gaussian of one bin on each axis.
const SMOOTHED: f64 = 0.1;

/// A network of tokens on torch.
#[derive(Debug)]
pub struct Tokens {
    network: Network<Torch>,
    space: PlanSpace,
    /// Weights [bins, bins] of the bins beside each bin.
    beside: Tensor,
    /// −1 for the numbers that change sign in a mirror: own, neighbours, lines.
    mirrors: [Tensor; 3],
}

/// Rows whose next token is logged.
struct Labelled {
    own: Tensor,
    near: Tensor,
    lines: Tensor,
    /// Bins [L, 2] on the device of the inputs.
    bins: Tensor,
}

impl Tokens {
    /// A network with fresh weights under a path.
    pub fn new(p: &nn::Path, config: &ModelConfig) -> Self {
        let far = |a: usize, b: usize| -0.5 * (a as f32 - b as f32).powi(2);
        let weight = |at: usize| if at / BINS == at % BINS { 0.0 } else { far(at / BINS, at % BINS).exp() };
        let weights: Vec<f32> = (0..BINS * BINS).map(weight).collect();
        let beside = Tensor::from_slice(&weights).view([BINS as i64, BINS as i64]);
        let beside = &beside / beside.sum_dim_intlist([1i64].as_slice(), true, Kind::Float);
        let signs = |odd: Vec<bool>| {
            let signs: Vec<f32> = odd.into_iter().map(|odd| if odd { -1.0 } else { 1.0 }).collect();
            Tensor::from_slice(&signs).to_device(p.device())
        };
        Self {
            network: Network::new(p, config),
            space: PlanSpace::new(config, p.device()),
            beside: beside.to_device(p.device()),
            mirrors: [
                signs(own_columns(config.route_points_m.len()).map(|c| c.0).collect()),
                signs(near_columns().map(|c| c.0).collect()),
                signs(SEGMENT_ODD.to_vec()),
            ],
        }
    }

    fn logits(&self, own: &Tensor, near: &Tensor, lines: &Tensor) -> Tensor {
        self.network.logits(&own.unsqueeze(1), near, lines).squeeze_dim(1)
    }

    /// The loss of the logits that are made of own numbers, neighbours and lines.
    fn loss_of(
        &self,
        step: &TrainingStep<'_>,
        logits: impl FnOnce(&Tensor, &Tensor, &Tensor) -> Tensor,
    ) -> Tensor {
        let draw = step.draw(2);
        let Some((rows, mirrors)) = Self::labelled(step.batch, step.targets, |row| draw.uniform(row) < 0.5)
        else {
            return (self.beside.sum(Kind::Float) * 0.0).set_requires_grad(true);
        };
        let mirrors: Vec<f32> = mirrors.into_iter().map(|m| f32::from(u8::from(m))).collect();
        let mirrors = Tensor::from_slice(&mirrors).to_device(rows.own.device());
        let [own, near, lines] = &self.mirrors;
        let logits = logits(
            &mirrored(&rows.own, own, &mirrors),
            &mirrored(&rows.near, near, &mirrors),
            &mirrored(&rows.lines, lines, &mirrors),
        );
        let log_p = logits.log_softmax(-1, Kind::Float);
        let soft = |axis: i64| self.beside.index_select(0, &rows.bins.select(1, axis));
        let soft = (soft(0).unsqueeze(2) * soft(1).unsqueeze(1)).flatten(1, 2) * SMOOTHED;
        let hard = log_p.gather(1, &token(&rows.bins), false).squeeze_dim(1) * (1.0 - SMOOTHED);
        let soft = (soft * &log_p).sum_dim_intlist([1i64].as_slice(), false, Kind::Float);
        -(hard + soft).mean(Kind::Float)
    }

    /// The rows of a batch whose next token is logged, those mirrored that `mirrored` says; `None` without any.
    fn labelled(
        batch: &Batch,
        targets: &Targets,
        mirrored: impl Fn(u64) -> bool,
    ) -> Option<(Labelled, Vec<bool>)> {
        let (states, valid) = (to_vec(&targets.states), to_vec(&targets.valid));
        let (speeds, steps) = (to_vec(&batch.speed_mps), targets.valid.size()[1] as usize);
        let (mut rows, mut bins, mut mirrors) = (Vec::new(), Vec::new(), Vec::new());
        for (row, speed) in speeds.iter().enumerate() {
            // the speed at the end lies between those of the steps before and after it
            if valid[row * steps + TOKEN_STEPS] < 0.5 || !batch.tokens.known[row] {
                continue;
            }
            let state = |step: usize| &states[(row * steps + step) * 6..][..6];
            let (last, next) = (state(TOKEN_STEPS - 1), state(TOKEN_STEPS));
            let mirror = mirrored(row as u64);
            let [v, w] = token_of(0.5 * (last[2] + next[2]) - speed, if mirror { -last[5] } else { last[5] });
            rows.push(row as i64);
            bins.extend([v as i64, w as i64]);
            mirrors.push(mirror);
        }
        if rows.is_empty() {
            return None;
        }
        let device = batch.speed_mps.device();
        let at = Tensor::from_slice(&rows).to_device(device);
        let of = |t: &Tensor| t.index_select(0, &at);
        let lines = batch.lines.as_ref()?;
        let bins = Tensor::from_slice(&bins).view([-1, 2]).to_device(device);
        Some((
            Labelled { own: of(&batch.tokens.own), near: of(&batch.tokens.near), lines: of(lines), bins },
            mirrors,
        ))
    }
}

/// Rows [L, ..] with the signs of the last axis where they are mirrored.
fn mirrored(x: &Tensor, signs: &Tensor, mirrors: &Tensor) -> Tensor {
    let mut shape = vec![1; x.dim()];
    shape[0] = -1;
    x * (mirrors.view(shape.as_slice()) * (signs - 1.0) + 1.0)
}

impl PlanModel for Tokens {
    fn space(&self) -> &PlanSpace {
        &self.space
    }

    fn loss(&self, step: &TrainingStep<'_>) -> Tensor {
        self.loss_of(step, |own, near, lines| self.logits(own, near, lines))
    }

    fn learn(&self, step: &TrainingStep<'_>, parameters: &Parameters) -> Option<f64> {
        Some(tape::learnt(|| {
            self.loss_of(step, |own, near, lines| {
                let network = Network::<Tape>::new(&parameters.root(), self.space.config());
                let tokens = |x: &Tensor| tape::data(x, x.size()[1] as usize);
                let own = tape::data(own, 1);
                let logits = network.logits(&own, &tokens(near), &tokens(lines));
                tape::leaf(&logits, &[near.size()[0], NUM_TOKENS as i64])
            })
        }))
    }

    fn nats(&self, batch: &Batch, targets: &Targets) -> Option<(f64, usize)> {
        let (rows, _) = Self::labelled(batch, targets, |_| false)?;
        let log_p = self.logits(&rows.own, &rows.near, &rows.lines).log_softmax(-1, Kind::Float);
        let found = -log_p.gather(1, &token(&rows.bins), false).sum(Kind::Double);
        Some((found.double_value(&[]), rows.bins.size()[0] as usize))
    }

    fn propose(&self, batch: &Batch, asked: &Asked<'_>, guide: Option<&mut Guidance<'_>>) -> Result<Samples> {
        Ok((self.network.propose(batch, asked, guide)?, Vec::new()))
    }
}

/// Index [L, 1] of tokens of bins [L, 2].
fn token(bins: &Tensor) -> Tensor {
    debug_assert_eq!(NUM_TOKENS, BINS * BINS);
    (bins.select(1, 0) * BINS as i64 + bins.select(1, 1)).unsqueeze(1)
}
