//! Embeddings of positions, diffusion steps and histories.

use crate::config::{HistoryTokens, ModelConfig};
use crate::features::HISTORY_FEATURES;
use tch::nn::{self, Module};
use tch::{Device, Kind, Tensor};

/// Places on routes are given in units of so many metres.
const ROUTE_SCALE_M: f64 = 20.0;

/// Sinusoidal table [positions, width], sine and cosine interleaved, base 10⁴.
pub(crate) fn positions(positions: usize, width: i64, device: Device) -> Tensor {
    let half = width / 2;
    let mut table = Vec::with_capacity(positions * width as usize);
    for p in 0..positions {
        for i in 0..half {
            let angle = p as f64 * (-(2.0 * i as f64) / width as f64 * 1e4f64.ln()).exp();
            table.extend([angle.sin() as f32, angle.cos() as f32]);
        }
    }
    Tensor::from_slice(&table).view([positions as i64, width]).to_device(device)
}

/// Sinusoidal table [steps, width] of the diffusion steps: a sine block, then a cosine block.
fn diffusion_steps(steps: usize, width: i64, device: Device) -> Tensor {
    let half = width / 2;
    let rate = 1e4f64.ln() / (half - 1).max(1) as f64;
    let mut table = Vec::with_capacity(steps * width as usize);
    for k in 0..steps {
        let angle = |i: i64| k as f64 * (-(i as f64) * rate).exp();
        table.extend((0..half).map(|i| angle(i).sin() as f32));
        table.extend((0..half).map(|i| angle(i).cos() as f32));
    }
    Tensor::from_slice(&table).view([steps as i64, width]).to_device(device)
}

/// Diffusion step → width: sinusoid, Linear, Mish, Linear.
#[derive(Debug)]
pub(crate) struct StepEmbedding {
    table: Tensor,
    up: nn::Linear,
    down: nn::Linear,
}

impl StepEmbedding {
    pub(crate) fn new(p: &nn::Path, steps: usize, d: i64) -> Self {
        Self {
            table: diffusion_steps(steps, d, p.device()),
            up: nn::linear(p / "up", d, 4 * d, Default::default()),
            down: nn::linear(p / "down", 4 * d, d, Default::default()),
        }
    }

    /// `steps` [R] int64 → [R, 1, d].
    pub(crate) fn forward(&self, steps: &Tensor) -> Tensor {
        self.table.index_select(0, steps).apply(&self.up).mish().apply(&self.down).unsqueeze(1)
    }
}

/// Histories → tokens.
#[derive(Debug)]
pub(crate) enum HistoryEmbedding {
    PerStep(nn::Linear),
    Summary(nn::Linear, nn::Linear),
}

impl HistoryEmbedding {
    pub(crate) fn new(p: &nn::Path, config: &ModelConfig) -> Self {
        let d = config.width;
        match config.history {
            HistoryTokens::PerStep => {
                Self::PerStep(nn::linear(p / "step", HISTORY_FEATURES as i64 - 1, d, Default::default()))
            }
            HistoryTokens::Summary => {
                let inputs = (config.history_steps * HISTORY_FEATURES) as i64;
                Self::Summary(
                    nn::linear(p / "in", inputs, 4 * d, Default::default()),
                    nn::linear(p / "out", 4 * d, d, Default::default()),
                )
            }
        }
    }

    /// Normalised histories [R, H, 8] → tokens [R, H or 1, d].
    pub(crate) fn forward(&self, history: &Tensor) -> Tensor {
        match self {
            Self::PerStep(step) => step.forward(&history.narrow(2, 0, HISTORY_FEATURES as i64 - 1)),
            Self::Summary(first, second) => {
                history.flatten(1, 2).apply(first).relu().apply(second).unsqueeze(1)
            }
        }
    }
}

/// Routes ahead → a part of the history's tokens, at first none.
#[derive(Debug)]
pub(crate) struct RouteEmbedding {
    up: nn::Linear,
    down: nn::Linear,
}

impl RouteEmbedding {
    pub(crate) fn new(p: &nn::Path, config: &ModelConfig) -> Self {
        let (inputs, d) = (1 + 2 * config.route_points_m.len() as i64, config.width);
        let nothing = nn::LinearConfig {
            ws_init: nn::Init::Const(0.0),
            bs_init: Some(nn::Init::Const(0.0)),
            bias: true,
        };
        Self {
            up: nn::linear(p / "up", inputs, 4 * d, Default::default()),
            down: nn::linear(p / "down", 4 * d, d, nothing),
        }
    }

    /// Routes [R, 1 + 2 P], places in metres → [R, 1, d].
    pub(crate) fn forward(&self, route: &Tensor) -> Tensor {
        let told = route.narrow(1, 0, 1);
        let places = route.narrow(1, 1, route.size()[1] - 1) / ROUTE_SCALE_M;
        let token = Tensor::cat(&[&told, &places], 1).apply(&self.up).relu().apply(&self.down);
        (token * told).unsqueeze(1)
    }
}

/// Histories [R, H, 8] with standardised places, speeds and sizes, zero where not available.
pub(crate) fn standardised_history(raw: &Tensor, config: &ModelConfig) -> Tensor {
    let n = &config.normalisation;
    let available = raw.narrow(2, 7, 1);
    let place = standardise(&raw.narrow(2, 0, 2), &n.history_mean[..2], &n.history_std[..2]);
    let body = standardise(&raw.narrow(2, 4, 3), &n.history_mean[2..], &n.history_std[2..]);
    Tensor::cat(&[&place, &raw.narrow(2, 2, 2), &body, &available], 2) * &available
}

/// (x - mean) / std over the last dimension.
pub(crate) fn standardise(x: &Tensor, mean: &[f64], std: &[f64]) -> Tensor {
    let row = |v: &[f64]| Tensor::from_slice(v).to_kind(Kind::Float).to_device(x.device());
    (x - row(mean)) / row(std)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The figures were computed in numpy from the definition, apart from this code.
    #[test]
    fn a_diffusion_step_is_embedded_as_tabulated() {
        let row: Vec<f32> = Vec::try_from(diffusion_steps(11, 32, Device::Cpu).get(10)).unwrap();
        for (at, want) in
            [(0, -0.5440), (1, -0.7653), (2, 0.2113), (15, 0.0010), (16, -0.8391), (17, 0.6437), (31, 1.0)]
        {
            assert!((row[at] - want).abs() < 1e-4, "{at}: {}", row[at]);
        }
    }
}
