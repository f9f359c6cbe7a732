//! The trunk of the rivals as tensors of rows.

use crate::batch::Batch;
use crate::layers::social::Slots;
use crate::torch::Torch;
use tch::Tensor;

/// The trunk on libtorch.
pub(crate) type Trunk = ccdiff_nets::trunk::Trunk<Torch>;

/// What the trunk says of R agents.
#[derive(Debug)]
pub(crate) struct Encoded {
    /// The agents' tokens [R, d].
    pub(crate) token: Tensor,
    /// Tokens and normalised speeds [R, d + 1].
    pub(crate) state: Tensor,
    /// Encoded edges now [R, K, 1, edge width].
    pub(crate) edges: Tensor,
    /// Who sits in which slot.
    pub(crate) slots: Slots,
    /// Map tokens [R, S, feature width]; `None` without a map.
    pub(crate) map: Option<Tensor>,
}

impl Encoded {
    /// A batch as the trunk encodes it. `train` switches batch normalisation.
    pub(crate) fn new(trunk: &Trunk, batch: &Batch, train: bool) -> Self {
        let seen = trunk.forward(batch, train);
        let (token, state) = (seen.token.squeeze_dim(1), seen.state.squeeze_dim(1));
        Self { token, state, edges: seen.edges, slots: seen.slots, map: seen.map }
    }

    /// The same agents N times, sample by sample; without map tokens, which no decoder reads.
    pub(crate) fn repeated(&self, samples: i64) -> Self {
        Self {
            token: self.token.repeat([samples, 1]),
            state: self.state.repeat([samples, 1]),
            edges: self.edges.repeat([samples, 1, 1, 1]),
            slots: self.slots.repeated(samples),
            map: None,
        }
    }
}
