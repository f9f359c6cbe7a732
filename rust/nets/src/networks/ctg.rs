//! CTG: diffusion of one agent's actions by the half of a U-Net (rivals.md#ctg).
//!
//! ```text
//! noisy knots ─► states [52, 6] ─► block ─► 26 ─► block ─► 13 ─► blocks ─► clean knots [13, 2]
//! ```
//! Agents see each other in the trunk alone: no attention between their plans.
//!
//! Differs from the paper: knots stand 0.4 s apart, which is where the U-Net's second halving ends, so the way back up
//! is left out; the condition is the trunk's.

use crate::compute::backend::Backend;
use crate::compute::cpu::Cpu;
use crate::compute::layers::embed::StepEmbedding;
use crate::config::ModelConfig;
use crate::error::{Result, require};
use crate::networks::cpu_planner::on_cpu;
use crate::networks::denoising::Denoising;
use crate::networks::kind::NetworkKind;
use crate::networks::planner::Denoises;
use crate::networks::trunk::Trunk;
use crate::sampling::plan_space::PlanSpace;

/// Diffusion of each agent's actions.
pub const CTG: NetworkKind = NetworkKind {
    denoises: true,
    fits,
    ..NetworkKind::with_trunk("ctg", "CTG", on_cpu::<Denoising<HalfUnet<Cpu>>>)
};

/// Channels after the rolled-out states' six.
const WIDTHS: [i64; 3] = [32, 48, 64];
/// Numbers of a state.
const STATE: i64 = 6;
/// Width of the embedded diffusion step.
const STEP_WIDTH: i64 = 32;
/// Groups of channels that are normalised together.
const GROUPS: i64 = 8;
/// Width of the convolutions.
const KERNEL: i64 = 5;

/// Checks that the halved steps are those of the knots.
fn fits(config: &ModelConfig) -> Result<()> {
    let (stride, expected) = (config.knot_stride, "4: the steps of a plan are halved twice");
    require(stride == 4, "model.knot_stride", stride, expected)
}

/// Convolution over time, group normalisation, Mish.
#[derive(Debug)]
struct ConvBlock<B: Backend>(B::Filter, B::Groups);

impl<B: Backend> ConvBlock<B> {
    fn new(p: &B::Path<'_>, inputs: i64, outputs: i64) -> Self {
        let filter = B::filter(&B::sub(p, "conv"), inputs, outputs, KERNEL, 1);
        Self(filter, B::groups(&B::sub(p, "norm"), GROUPS, outputs))
    }

    fn forward(&self, x: &B::Tensor) -> B::Tensor {
        B::groups_mish(&self.1, B::filtered(&self.0, x))
    }
}

/// Two such blocks with the condition between them, and a shortcut.
#[derive(Debug)]
struct Residual<B: Backend> {
    first: ConvBlock<B>,
    condition: B::Joint,
    second: ConvBlock<B>,
    shortcut: Option<B::Filter>,
}

impl<B: Backend> Residual<B> {
    fn new(p: &B::Path<'_>, inputs: i64, outputs: i64, width: i64) -> Self {
        let at = |name| B::sub(p, name);
        Self {
            first: ConvBlock::new(&at("first"), inputs, outputs),
            condition: B::joint(&at("condition"), STEP_WIDTH, width, outputs),
            second: ConvBlock::new(&at("second"), outputs, outputs),
            shortcut: (inputs != outputs).then(|| B::filter(&at("shortcut"), inputs, outputs, 1, 1)),
        }
    }

    /// `x` [R, steps, inputs], embedded steps and tokens → [R, steps, outputs].
    fn forward(&self, x: B::Tensor, step: &B::Tensor, token: &B::Tensor) -> B::Tensor {
        let (of_step, of_token) = B::apply_joint(&self.condition, step, token);
        let y = B::sum(self.first.forward(&x), &B::sum(of_token, &of_step));
        let y = self.second.forward(&y);
        match &self.shortcut {
            Some(shortcut) => B::sum(y, &B::filtered(shortcut, &x)),
            None => B::sum(y, &x),
        }
    }
}

/// The denoiser.
#[derive(Debug)]
pub struct HalfUnet<B: Backend> {
    space: PlanSpace,
    trunk: Trunk<B>,
    step: StepEmbedding<B>,
    down: Vec<(Residual<B>, B::Filter)>,
    middle: Vec<Residual<B>>,
    last: ConvBlock<B>,
    out: B::Filter,
}

/// What is known of the agents.
#[derive(Debug)]
pub struct Condition<B: Backend> {
    /// Mish of their tokens [R, 1, d].
    pub token: B::Tensor,
    /// Speeds [R].
    pub speed: B::Tensor,
}

impl<B: Backend> Denoises<B> for HalfUnet<B> {
    type Context = Condition<B>;

    fn new(p: &B::Path<'_>, config: &ModelConfig) -> Self {
        let numbered = |name, i: usize| B::sub(&B::sub(p, name), &i.to_string());
        let residual =
            |name, i, inputs, outputs| Residual::new(&numbered(name, i), inputs, outputs, config.width);
        let [first, second, third] = WIDTHS;
        let down = [(STATE, first), (first, second)].into_iter().enumerate().map(|(i, (inputs, outputs))| {
            let halve = B::filter(&numbered("halve", i), outputs, outputs, 3, 2);
            (residual("down", i, inputs, outputs), halve)
        });
        Self {
            space: PlanSpace::new(config),
            trunk: Trunk::new(&B::sub(p, "trunk"), config),
            step: StepEmbedding::new(&B::sub(p, "step"), config.diffusion_steps, STEP_WIDTH),
            down: down.collect(),
            middle: vec![residual("middle", 0, second, third), residual("middle", 1, third, third)],
            last: ConvBlock::new(&B::sub(p, "last"), third, first),
            out: B::filter(&B::sub(p, "out"), first, 2, 1, 1),
        }
    }

    fn config(&self) -> &ModelConfig {
        self.trunk.config()
    }

    fn encode(&self, batch: &B::Batch<'_>) -> Condition<B> {
        let token = B::mish(&self.trunk.forward(batch).token);
        Condition { token, speed: B::placed(batch, B::plain(batch).speed()) }
    }

    fn predict(
        &self,
        context: &Condition<B>,
        noisy: &B::Tensor,
        steps: &[usize],
    ) -> (B::Tensor, Option<B::Attention>) {
        let step = B::mish(&self.step.forward(steps));
        let mut x = B::cut(&B::plan(&self.space, noisy, &context.speed), STATE);
        for (block, halve) in &self.down {
            x = B::filtered(halve, &block.forward(x, &step, &context.token));
        }
        for block in &self.middle {
            x = block.forward(x, &step, &context.token);
        }
        (B::filtered(&self.out, &self.last.forward(&x)), None)
    }
}
