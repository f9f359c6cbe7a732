//! What every baseline sees of an agent: its history, the map around it, its neighbours (rivals.md#trunk).

use crate::batch::Batch;
use crate::config::ModelConfig;
use crate::layers::inputs;
use crate::layers::social::Slots;
use crate::torch::Torch;
use ccdiff_nets::layers::attention::Attention;
use ccdiff_nets::layers::edge::EdgeEncoder;
use ccdiff_nets::layers::embed::HistoryEmbedding;
use ccdiff_nets::layers::map::MapNetwork;
use ccdiff_nets::layers::social::EdgeAwareLayer;
use tch::{Tensor, nn};

/// One token per agent: history, then attention to the map, then to the neighbours at their edges now.
#[derive(Debug)]
pub(crate) struct Trunk {
    config: ModelConfig,
    history: HistoryEmbedding<Torch>,
    map: Option<(MapNetwork<Torch>, Attention<Torch>)>,
    edges: EdgeEncoder<Torch>,
    social: EdgeAwareLayer<Torch>,
    norm: nn::LayerNorm,
}

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

impl Trunk {
    pub(crate) fn new(p: &nn::Path, config: &ModelConfig) -> Self {
        let (d, heads) = (config.width, config.heads);
        let of_map = |m| {
            let network = MapNetwork::new(&(p / "map"), m, config.history_steps);
            (network, Attention::new(&(p / "map_attention"), d, m.feature_width, heads))
        };
        let hidden = config.social_feed_forward;
        Self {
            history: HistoryEmbedding::new(&(p / "history"), config),
            map: config.map.as_ref().map(of_map),
            edges: EdgeEncoder::new(&(p / "edges"), config.edge_width),
            social: EdgeAwareLayer::new(&(p / "social"), d, config.edge_width, heads, hidden),
            norm: nn::layer_norm(p / "norm", vec![d], Default::default()),
            config: config.clone(),
        }
    }

    pub(crate) fn forward(&self, batch: &Batch, train: bool) -> Encoded {
        let history = inputs::standardised_history(&batch.history, &self.config);
        let mut x = self.history.forward(&history);
        let map = self.map.as_ref().and_then(|(network, attention)| {
            let tokens = network.forward(batch, train)?;
            x = &x + attention.forward(&x, &attention.memory(&tokens), None);
            Some(tokens)
        });
        // the first token's edges are those of now
        let (edges, available) = inputs::at_tokens(&batch.edges, &self.config);
        let edges = self.edges.forward(&edges.narrow(2, 0, 1));
        let slots = Slots::new(&batch.neighbours, &batch.is_edge, &available.narrow(2, 0, 1));
        let (x, _) = self.social.forward(&x, &x, &edges, &slots);
        let token = x.apply(&self.norm).squeeze_dim(1);
        let n = &self.config.normalisation;
        let speed = (&batch.speed_mps - n.trajectory_mean[2]) / n.trajectory_std[2];
        let state = Tensor::cat(&[&token, &speed.unsqueeze(1)], 1);
        Encoded { token, state, edges, slots, map }
    }
}
