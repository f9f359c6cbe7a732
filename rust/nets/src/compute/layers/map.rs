//! From what agents see of the map to map tokens.

use crate::compute::backend::Backend;
use crate::config::{MapConfig, MapEncoder};
use crate::inputs::segments::SEGMENT_FEATURES;

/// Rasters or lines → tokens [R, S, feature width].
#[derive(Debug)]
pub enum MapNetwork<B: Backend> {
    /// Of rasters.
    Raster(Box<B::Raster>),
    /// Of lines.
    Lines(Box<LineEncoder<B>>),
}

impl<B: Backend> MapNetwork<B> {
    /// The encoder that the configuration names.
    pub fn new(p: &B::Path<'_>, config: &MapConfig, history_steps: usize) -> Self {
        match config.encoder {
            MapEncoder::Polylines => Self::Lines(Box::new(LineEncoder::new(p, config.feature_width))),
            MapEncoder::ResNet18 | MapEncoder::Light => {
                Self::Raster(Box::new(B::raster(p, config, history_steps)))
            }
        }
    }

    /// Tokens of the map; `None` where the batch has none.
    pub fn forward(&self, batch: &B::Batch<'_>, train: bool) -> Option<B::Tensor> {
        match self {
            Self::Raster(net) => B::raster_tokens(net, batch, train),
            Self::Lines(net) => B::lines(batch).map(|lines| net.forward(&lines)),
        }
    }
}

/// A perceptron for each line, then a layer that also sees what stands out among all of them.
#[derive(Debug)]
pub struct LineEncoder<B: Backend> {
    line: [B::Linear; 2],
    among_all: B::Joint,
    norm: B::Norm,
}

impl<B: Backend> LineEncoder<B> {
    fn new(p: &B::Path<'_>, width: i64) -> Self {
        let line = |name, inputs| B::linear(&B::sub(&B::sub(p, "line"), name), inputs, width);
        Self {
            line: [line("0", SEGMENT_FEATURES as i64), line("1", width)],
            among_all: B::joint(&B::sub(&B::sub(p, "among_all"), "0"), width, width, width),
            norm: B::norm(&B::sub(p, "norm"), width),
        }
    }

    fn forward(&self, lines: &B::Tensor) -> B::Tensor {
        let x = B::apply_relu(&self.line[1], &B::apply_relu(&self.line[0], lines));
        let (own, greatest) = B::apply_joint(&self.among_all, &x, &B::greatest(&x));
        B::normed(&self.norm, &B::sum_token(own, &greatest))
    }
}
