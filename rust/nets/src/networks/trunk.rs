//! What every rival sees of an agent: its history, the map around it, its neighbours (rivals.md#trunk).

use crate::compute::backend::Backend;
use crate::compute::layers::attention::Attention;
use crate::compute::layers::edge::EdgeEncoder;
use crate::compute::layers::embed::HistoryEmbedding;
use crate::compute::layers::map::LineEncoder;
use crate::compute::layers::social::EdgeAwareLayer;
use crate::config::ModelConfig;

/// One token per agent: history, then attention to the map, then to the neighbours at their edges now.
#[derive(Debug)]
pub struct Trunk<B: Backend> {
    config: ModelConfig,
    history: HistoryEmbedding<B>,
    map: Option<(LineEncoder<B>, Attention<B>)>,
    edges: EdgeEncoder<B>,
    social: EdgeAwareLayer<B>,
    norm: B::Norm,
}

/// What the trunk says of R agents.
#[derive(Debug)]
pub struct Encoded<B: Backend> {
    /// The agents' tokens [R, 1, d].
    pub token: B::Tensor,
    /// Tokens and normalised speeds [R, 1, d + 1].
    pub state: B::Tensor,
    /// Normalised speeds [R, 1, 1].
    pub speed: B::Tensor,
    /// Encoded edges now.
    pub edges: B::Tensor,
    /// The rows in the slots of each row.
    pub slots: B::Slots,
    /// Map tokens [R, S, feature width]; `None` without a map.
    pub map: Option<B::Tensor>,
}

impl<B: Backend> Trunk<B> {
    /// A trunk with its weights under a path.
    pub fn new(p: &B::Path<'_>, config: &ModelConfig) -> Self {
        let (d, heads) = (config.width, config.heads);
        let at = |name| B::sub(p, name);
        let hidden = config.social_feed_forward;
        Self {
            history: HistoryEmbedding::new(&at("history"), config),
            map: config.map.as_ref().map(|m| {
                let lines = LineEncoder::new(&at("map"), m.feature_width);
                (lines, Attention::new(&at("map_attention"), d, m.feature_width, heads))
            }),
            edges: EdgeEncoder::new(&at("edges"), config.edge_width),
            social: EdgeAwareLayer::new(&at("social"), d, config.edge_width, heads, hidden),
            norm: B::norm(&at("norm"), d),
            config: config.clone(),
        }
    }

    /// The configuration.
    pub fn config(&self) -> &ModelConfig {
        &self.config
    }

    /// Encodes a batch.
    pub fn forward(&self, batch: &B::Batch<'_>) -> Encoded<B> {
        let config = &self.config;
        let (plain, placed) = (B::plain(batch), |x| B::placed(batch, x));
        let mut x = self.history.forward(&placed(plain.history(config)));
        let map = self.map.as_ref().and_then(|(lines, attention)| {
            let tokens = lines.forward(batch)?;
            x = B::sum(attention.forward(&x, &attention.memory(&tokens), None), &x);
            Some(tokens)
        });
        let (edges, slots) = B::edges(batch, config, false);
        let edges = self.edges.forward(&edges, false);
        let (x, _) = self.social.forward(&x, &x, &edges, &slots);
        let token = B::normed(&self.norm, &x, false);
        let speed = placed(plain.standard_speed(config));
        let state = B::beside(&token, &speed);
        Encoded { token, state, speed, edges, slots, map }
    }
}
