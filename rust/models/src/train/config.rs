//! How a network is trained.

use crate::error::Result;
use ccdiff_sim::options;
use ccdiff_sim::options::within;

options! {
    /// How a network is trained. The defaults are those of the preset `"paper"` for CCDiff (reference.md#training-settings).
    #[derive(Clone)]
    pub struct TrainConfig {
        /// Scenes per step.
        batch_scenes: usize = 4, range within(1.0, 65_536.0);
        /// Peak learning rate.
        learning_rate: f64 = 1e-4, range within(0.0, 1000.0).open_below();
        /// Steps of linear warm-up.
        warmup_steps: u64 = 0, range within(0.0, 1e9);
        /// Decay of the moving average of the weights.
        ema_decay: f64 = 0.995, range within(0.0, 1.0).open_above();
        /// Until this step the average is a copy of the weights.
        ema_start: u64 = 4000, range within(0.0, 1e9);
        /// Probability that a scene's G is replaced by the identity.
        drop_graph: f64 = 0.1, range within(0.0, 1.0);
        /// Probability that an agent's route is hidden from a network with routes.
        #[serde(default)]
        drop_route: f64 = 0.0, range within(0.0, 1.0);
        /// Whether some agents are displaced from or along their logged path, with a future that leads back (ours).
        #[serde(default)]
        perturb: bool = false;
        /// Weight of the overlap of plans with logged futures of neighbours in the graph (metres, mean over steps),
        /// scaled by sqrt(alpha bar) of the sample; 0: no such loss (paper).
        #[serde(default)]
        collision_weight: f64 = 0.0, range within(0.0, 1e6);
        /// Denoising steps of a teacher whose plans the network learns to make in one step; 0: it learns from the log.
        #[serde(default)]
        teacher_steps: usize = 0, range within(0.0, 1000.0);
        /// Largest norm of the gradient.
        clip_norm: f64 = 100.0, range within(0.0, 1e6).open_below();
        /// Seed of batches, noise and dropping.
        seed: u64 = 0;
    }
}

impl TrainConfig {
    /// Larger steps and batches than the paper's.
    pub(crate) fn fast() -> Self {
        Self {
            batch_scenes: 24,
            learning_rate: 1e-3,
            warmup_steps: 200,
            ema_start: 200,
            clip_norm: 1.0,
            perturb: true,
            collision_weight: 0.2,
            ..Self::default()
        }
    }

    pub(crate) fn validated(self) -> Result<Self> {
        options::check("training", &self)?;
        Ok(self)
    }
}
