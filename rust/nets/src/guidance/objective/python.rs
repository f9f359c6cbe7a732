//! A loss that is written in Python: `{"kind": "python", "call": "module:function"}` (docs/configuration.md#objectives).
//!
//! The function takes states [N, M, T, 4] (x, y, speed, heading; scene frame) of all samples of a world at once and what is
//! known of its agents; losses [N, M] and their gradient with respect to the states come back. Whoever links Python says how
//! it is called ([`connect`]); this crate knows nothing of it.

use super::Evaluation;
use crate::guidance::context::GuidanceContext;
use crate::guidance::rollout::Rollout;
use ccdiff_sim::options;
use ccdiff_sim::options::WEIGHT;
use std::sync::OnceLock;

options! {
    /// Settings of a loss that is written in Python.
    #[derive(Clone)]
    #[serde(deny_unknown_fields, default)]
    pub struct PythonCost {
        /// Signed weight; the weighted loss is minimised.
        weight: f32 = 1.0, range WEIGHT;
        /// The function, or `"module:name"` of it: from states [N, M, T, 4] and what is known of the agents to losses [N, M].
        call: String = String::new();
        /// Whether it takes arrays and returns their gradient behind the losses; otherwise it takes and returns torch tensors.
        own_gradient: bool = false;
    }
}

/// Losses [N, M] and their gradient with respect to the states [N, M, T, 4].
pub type Called = (Vec<f32>, Vec<f32>);
/// Calls the function, with the plans of N samples of a world, and whether a gradient is needed; an error is text.
pub type Caller = fn(&PythonCost, &GuidanceContext<'_>, &[&Rollout], bool) -> Result<Called, String>;

static CALLER: OnceLock<Caller> = OnceLock::new();

/// Says how Python is called; the first one counts.
pub fn connect(caller: Caller) {
    CALLER.get_or_init(|| caller);
}

impl PythonCost {
    /// Adds losses and gradients of N samples of a world. An error is kept by the context.
    pub(super) fn evaluate(
        &self,
        context: &GuidanceContext<'_>,
        plans: &[&Rollout],
        out: &mut [Evaluation<'_>],
    ) {
        let (m, t) = (context.num_agents(), plans.first().map_or(0, |plan| plan.num_steps));
        let called = match CALLER.get() {
            _ if context.failure.get().is_some() => return,
            Some(caller) => caller(self, context, plans, out.iter().any(|out| out.scale != 0.0)),
            None => Err("Python is not there".into()),
        };
        let fits = |(losses, gradient): &Called| {
            losses.len() == plans.len() * m && gradient.len() == losses.len() * t * 4
        };
        let (losses, gradient) = match called {
            Ok(called) if fits(&called) => called,
            Ok(_) => return context.fail(format!("{}: losses or gradients of another shape", self.call)),
            Err(error) => return context.fail(format!("{}: {error}", self.call)),
        };
        let samples = losses.chunks_exact(m.max(1)).zip(gradient.chunks_exact((m * t * 4).max(1)));
        for ((losses, gradient), out) in samples.zip(out) {
            for agent in (0..m).filter(|agent| out.wanted[*agent]) {
                out.losses[agent] += losses[agent];
            }
            for (at, of) in gradient.chunks_exact(4).enumerate() {
                for (sum, of) in [
                    &mut out.gradient.x[at],
                    &mut out.gradient.y[at],
                    &mut out.gradient.speed[at],
                    &mut out.gradient.heading[at],
                ]
                .into_iter()
                .zip(of)
                {
                    *sum += out.scale * of;
                }
            }
        }
    }
}
