//! ResNet-18 with any number of input channels.

use tch::nn::{self, ModuleT};
use tch::{Kind, Tensor};

fn conv(p: nn::Path, inputs: i64, outputs: i64, kernel: i64, stride: i64) -> nn::Conv2D {
    let config = nn::ConvConfig { stride, padding: kernel / 2, bias: false, ..nn::ConvConfig::default() };
    nn::conv2d(p, inputs, outputs, kernel, config)
}

fn batch_norm(p: nn::Path, channels: i64) -> nn::BatchNorm {
    nn::batch_norm2d(p, channels, Default::default())
}

/// Two 3 x 3 convolutions with a shortcut.
#[derive(Debug)]
struct Block {
    first: (nn::Conv2D, nn::BatchNorm),
    second: (nn::Conv2D, nn::BatchNorm),
    shortcut: Option<(nn::Conv2D, nn::BatchNorm)>,
}

impl Block {
    fn new(p: &nn::Path, inputs: i64, outputs: i64, stride: i64) -> Self {
        Self {
            first: (conv(p / "conv1", inputs, outputs, 3, stride), batch_norm(p / "norm1", outputs)),
            second: (conv(p / "conv2", outputs, outputs, 3, 1), batch_norm(p / "norm2", outputs)),
            shortcut: (stride != 1 || inputs != outputs)
                .then(|| (conv(p / "conv0", inputs, outputs, 1, stride), batch_norm(p / "norm0", outputs))),
        }
    }

    fn forward(&self, x: &Tensor, train: bool) -> Tensor {
        let apply = |x: &Tensor, (c, n): &(nn::Conv2D, nn::BatchNorm)| n.forward_t(&x.apply(c), train);
        let y = apply(&apply(x, &self.first).relu(), &self.second);
        let short = self.shortcut.as_ref().map_or_else(|| x.shallow_clone(), |s| apply(x, s));
        (y + short).relu()
    }
}

/// The trunk and its last linear layer: [R, channels, H, W] → [R, outputs].
#[derive(Debug)]
pub struct ResNet18 {
    stem: nn::Conv2D,
    stem_norm: nn::BatchNorm,
    blocks: Vec<Block>,
    out: nn::Linear,
}

impl ResNet18 {
    pub(crate) fn new(p: &nn::Path, channels: i64, outputs: i64) -> Self {
        let mut blocks = Vec::with_capacity(8);
        let mut inputs = 64;
        for (stage, width) in [64, 128, 256, 512].into_iter().enumerate() {
            for half in 0..2 {
                let stride = if stage > 0 && half == 0 { 2 } else { 1 };
                blocks.push(Block::new(&(p / "stage" / stage / half), inputs, width, stride));
                inputs = width;
            }
        }
        Self {
            stem: conv(p / "stem", channels, 64, 7, 2),
            stem_norm: batch_norm(p / "stem_norm", 64),
            blocks,
            out: nn::linear(p / "out", 512, outputs, Default::default()),
        }
    }

    pub(crate) fn forward(&self, image: &Tensor, train: bool) -> Tensor {
        let mut x = self.stem_norm.forward_t(&image.apply(&self.stem), train).relu();
        x = x.max_pool2d([3, 3], [2, 2], [1, 1], [1, 1], false);
        for block in &self.blocks {
            x = block.forward(&x, train);
        }
        x.mean_dim([2i64, 3].as_slice(), false, Kind::Float).apply(&self.out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn with_34_channels_and_128_outputs_it_has_the_released_number_of_parameters() {
        let vs = nn::VarStore::new(tch::Device::Cpu);
        let net = ResNet18::new(&vs.root(), 34, 128);
        let count: usize = vs.trainable_variables().iter().map(Tensor::numel).sum();
        assert_eq!(count, 11_339_392);
        let image = Tensor::zeros([1, 34, 64, 64], (Kind::Float, tch::Device::Cpu));
        assert_eq!(net.forward(&image, false).size(), [1, 128]);
    }
}
