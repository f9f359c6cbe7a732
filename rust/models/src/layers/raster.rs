//! From agent-centred rasters to map tokens.

use super::resnet::ResNet18;
use crate::config::{MapConfig, MapEncoder};
use tch::{Kind, Tensor, nn};

/// Raster [R, channels, size, size] (bytes) → tokens [R, S, feature width].
#[derive(Debug)]
pub enum RasterEncoder {
    /// As in the paper.
    ResNet(Box<ResNet18>),
    /// Three convolutions.
    Light(Box<LightEncoder>),
}

impl RasterEncoder {
    pub(crate) fn new(p: &nn::Path, config: &MapConfig, history_steps: usize) -> Self {
        let channels = config.num_channels(history_steps) as i64;
        match config.encoder {
            MapEncoder::ResNet18 => Self::ResNet(Box::new(ResNet18::new(p, channels, config.feature_width))),
            MapEncoder::Light | MapEncoder::Polylines => {
                Self::Light(Box::new(LightEncoder::new(p, config, channels)))
            }
        }
    }

    pub(crate) fn forward(&self, image: &Tensor, train: bool) -> Tensor {
        let numbers = (image.to_kind(Kind::Float) - f64::from(crate::raster::ZERO)) * (1.0 / 127.0);
        match self {
            Self::ResNet(net) => net.forward(&numbers, train).unsqueeze(1),
            Self::Light(net) => net.forward(&numbers),
        }
    }
}

/// Three strided convolutions; every pixel of the last is a token with a learned position.
#[derive(Debug)]
pub struct LightEncoder {
    convolutions: Vec<nn::Conv2D>,
    norm: nn::LayerNorm,
    place: Tensor,
}

impl LightEncoder {
    fn new(p: &nn::Path, config: &MapConfig, channels: i64) -> Self {
        let width = config.feature_width;
        let down = nn::ConvConfig { stride: 2, padding: 1, ..nn::ConvConfig::default() };
        let sizes = [(channels, width / 4, 4), (width / 4, width / 2, 4), (width / 2, width, 4)];
        let side = (config.size_px / 8) as i64;
        Self {
            convolutions: sizes
                .into_iter()
                .enumerate()
                .map(|(i, (inputs, outputs, kernel))| {
                    nn::conv2d(p / "conv" / i, inputs, outputs, kernel, down)
                })
                .collect(),
            norm: nn::layer_norm(p / "norm", vec![width], Default::default()),
            place: p.var("place", &[1, side * side, width], nn::Init::Randn { mean: 0.0, stdev: 0.5 }),
        }
    }

    fn forward(&self, image: &Tensor) -> Tensor {
        let x = self.convolutions.iter().fold(image.shallow_clone(), |x, c| x.apply(c).relu());
        x.flatten(2, 3).transpose(1, 2).apply(&self.norm) + &self.place
    }
}
