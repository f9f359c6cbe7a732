//! CTG: diffusion of one agent's actions by the half of a U-Net (rivals.md#ctg).
//!
//! ```text
//! noisy knots ─► states [6, 52] ─► block ─► 26 ─► block ─► 13 ─► blocks ─► clean knots [2, 13]
//! ```
//! Agents see each other in the trunk alone: no attention between their plans.
//!
//! Differs from the paper: knots stand 0.4 s apart, which is where the U-Net's second halving ends, so the way back up
//! is left out; the condition is the trunk's, not that of a raster.

use crate::batch::Batch;
use crate::config::ModelConfig;
use crate::diffusion::Diffusion;
use crate::plan_model::TorchKind;
use crate::plan_space::PlanSpace;
use crate::sampler::Denoiser;
use crate::torch::Torch;
use crate::trunk::{Encoded, Trunk};
use ccdiff_nets::layers::embed::StepEmbedding;
use tch::{Tensor, nn};

/// CTG.
pub(crate) const CTG: TorchKind = TorchKind {
    name: "ctg",
    build: |p, config| Ok(Box::new(Diffusion::new(HalfUnet::new(p, config))?)),
    fast: |settings| settings,
};

/// Channels after the rolled-out states' six.
const WIDTHS: [i64; 3] = [32, 48, 64];
/// Width of the embedded diffusion step.
const STEP_WIDTH: i64 = 32;
/// Groups of channels that are normalised together.
const GROUPS: i64 = 8;
/// Width of the convolutions.
const KERNEL: i64 = 5;

/// Convolution over time, group normalisation, Mish.
#[derive(Debug)]
struct ConvBlock(nn::Conv1D, nn::GroupNorm);

impl ConvBlock {
    fn new(p: &nn::Path, inputs: i64, outputs: i64) -> Self {
        let same = nn::ConvConfig { padding: KERNEL / 2, ..Default::default() };
        Self(
            nn::conv1d(p / "conv", inputs, outputs, KERNEL, same),
            nn::group_norm(p / "norm", GROUPS, outputs, Default::default()),
        )
    }

    fn forward(&self, x: &Tensor) -> Tensor {
        x.apply(&self.0).apply(&self.1).mish()
    }
}

/// Two such blocks with the condition between them, and a shortcut.
#[derive(Debug)]
struct Residual {
    first: ConvBlock,
    condition: nn::Linear,
    second: ConvBlock,
    shortcut: Option<nn::Conv1D>,
}

impl Residual {
    fn new(p: &nn::Path, inputs: i64, outputs: i64, condition: i64) -> Self {
        Self {
            first: ConvBlock::new(&(p / "first"), inputs, outputs),
            condition: nn::linear(p / "condition", condition, outputs, Default::default()),
            second: ConvBlock::new(&(p / "second"), outputs, outputs),
            shortcut: (inputs != outputs)
                .then(|| nn::conv1d(p / "shortcut", inputs, outputs, 1, Default::default())),
        }
    }

    /// `x` [R, inputs, steps], `condition` [R, width] → [R, outputs, steps].
    fn forward(&self, x: &Tensor, condition: &Tensor) -> Tensor {
        let y = self.first.forward(x) + condition.mish().apply(&self.condition).unsqueeze(2);
        let kept = self.shortcut.as_ref().map_or_else(|| x.shallow_clone(), |s| x.apply(s));
        self.second.forward(&y) + kept
    }
}

/// The denoiser.
#[derive(Debug)]
pub struct HalfUnet {
    space: PlanSpace,
    trunk: Trunk,
    step: StepEmbedding<Torch>,
    down: Vec<(Residual, nn::Conv1D)>,
    middle: Vec<Residual>,
    last: ConvBlock,
    out: nn::Conv1D,
}

/// Tokens [R, d] and speeds [R] of the agents.
#[derive(Debug)]
pub struct Condition {
    token: Tensor,
    speed_mps: Tensor,
}

impl HalfUnet {
    /// A network with fresh weights under a path.
    pub fn new(p: &nn::Path, config: &ModelConfig) -> Self {
        let condition = STEP_WIDTH + config.width;
        let residual = |name: &str, i: usize, inputs, outputs| {
            Residual::new(&(p / name / i), inputs, outputs, condition)
        };
        let halved = nn::ConvConfig { stride: 2, padding: 1, ..Default::default() };
        let [first, second, third] = WIDTHS;
        let down = [(6, first), (first, second)].into_iter().enumerate().map(|(i, (inputs, outputs))| {
            let halve = nn::conv1d(p / "halve" / i, outputs, outputs, 3, halved);
            (residual("down", i, inputs, outputs), halve)
        });
        Self {
            space: PlanSpace::new(config, p.device()),
            trunk: Trunk::new(&(p / "trunk"), config),
            step: StepEmbedding::new(&(p / "step"), config.diffusion_steps, STEP_WIDTH),
            down: down.collect(),
            middle: vec![residual("middle", 0, second, third), residual("middle", 1, third, third)],
            last: ConvBlock::new(&(p / "last"), third, first),
            out: nn::conv1d(p / "out", first, 2, 1, Default::default()),
        }
    }
}

impl Denoiser for HalfUnet {
    type Context = Condition;

    fn space(&self) -> &PlanSpace {
        &self.space
    }

    fn encode(&self, batch: &Batch, train: bool) -> Condition {
        Condition {
            token: Encoded::new(&self.trunk, batch, train).token,
            speed_mps: batch.speed_mps.shallow_clone(),
        }
    }

    fn repeated(context: &Condition, samples: i64) -> Condition {
        Condition {
            token: context.token.repeat([samples, 1]),
            speed_mps: context.speed_mps.repeat([samples]),
        }
    }

    fn predict(&self, context: &Condition, noisy: &Tensor, steps: &Tensor) -> (Tensor, Option<Tensor>) {
        let plan = self.space.standardised_states(&self.space.states(noisy, &context.speed_mps));
        let condition = Tensor::cat(&[&self.step.forward(steps).squeeze_dim(1), &context.token], 1);
        let mut x = plan.transpose(1, 2);
        for (block, halve) in &self.down {
            x = block.forward(&x, &condition).apply(halve);
        }
        for block in &self.middle {
            x = block.forward(&x, &condition);
        }
        (self.last.forward(&x).apply(&self.out).transpose(1, 2).contiguous(), None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tch::nn::Module;
    use tch::{Device, Kind};

    fn numbers(tensor: &Tensor) -> Vec<f64> {
        Vec::try_from(&tensor.flatten(0, -1).to_kind(Kind::Double)).unwrap()
    }

    fn assert_near(got: &Tensor, want: &[f64]) {
        let got = numbers(got);
        assert_eq!(got.len(), want.len());
        assert!(got.iter().zip(want).all(|(g, w)| (g - w).abs() < 1e-4), "{got:?}, expected {want:?}");
    }

    /// The figures were computed in numpy from the definitions, apart from this code.
    #[test]
    fn its_parts_have_the_tabulated_values() {
        assert_near(&Tensor::from_slice(&[1.0f32, -1.0, 0.5]).mish(), &[0.8651, -0.3034, 0.3752]);
        let store = nn::VarStore::new(Device::Cpu);
        let norm = nn::group_norm(store.root(), GROUPS, 16, Default::default());
        let x = Tensor::arange(32, (Kind::Float, Device::Cpu)).view([1, 16, 2]) * 0.1;
        assert_near(&norm.forward(&x), &[-1.3411, -0.4470, 0.4470, 1.3411].repeat(8));
    }

    #[test]
    fn the_steps_are_halved_twice_until_they_are_those_of_the_knots() {
        let store = nn::VarStore::new(Device::Cpu);
        let network = HalfUnet::new(&store.root(), &ModelConfig::of("ctg", "fast").unwrap());
        let condition =
            Tensor::zeros([3, STEP_WIDTH + network.space.config().width], (Kind::Float, Device::Cpu));
        let mut x = Tensor::zeros([3, 6, 52], (Kind::Float, Device::Cpu));
        let mut steps = Vec::new();
        for (block, halve) in &network.down {
            x = block.forward(&x, &condition).apply(halve);
            steps.push(x.size()[2]);
        }
        assert_eq!(steps, [26, 13]);
        assert_eq!(network.space.config().horizon_steps, 52);
    }
}
