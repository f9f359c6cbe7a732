//! The CCDiff network: causal scene encoder and decoder that predicts the clean actions (reference.md#network).
//!
//! ```text
//! histories, noisy plan ─► tokens ─► round 0: [map] temporal, edge-aware social (masked by G)
//!                                    round 1: [map] temporal, plain social (masked by G) ─► clean action knots
//! ```
//! [`Denoises::encode`] computes what does not depend on the noisy plan once; [`Denoises::predict`] runs per step.

use crate::compute::backend::{Backend, KeyValue};
use crate::compute::layers::attention::{Attention, EncoderLayer};
use crate::compute::layers::edge::EdgeEncoder;
use crate::compute::layers::embed::{self, HistoryEmbedding, RouteEmbedding, StepEmbedding};
use crate::compute::layers::map::LineEncoder;
use crate::compute::layers::social::EdgeAwareLayer;
use crate::config::{HistoryTokens, ModelConfig};
use crate::networks::planner::Denoises;
use crate::sampling::plan_space::PlanSpace;

/// Decoder rounds: the first ends in the edge-aware social layers, the second in a plain one.
const ROUNDS: usize = 2;

/// One decoder round.
#[derive(Debug)]
struct Round<B: Backend> {
    map: Option<Attention<B>>,
    temporal: Vec<EncoderLayer<B>>,
}

/// Weights of a CCDiff network and what is computed from its configuration.
#[derive(Debug)]
pub struct Network<B: Backend> {
    config: ModelConfig,
    space: PlanSpace,
    history: HistoryEmbedding<B>,
    route: Option<RouteEmbedding<B>>,
    noisy: B::Linear,
    step: StepEmbedding<B>,
    edges: EdgeEncoder<B>,
    map: Option<LineEncoder<B>>,
    rounds: Vec<Round<B>>,
    edge_aware: Vec<EdgeAwareLayer<B>>,
    edge_norm: B::Norm,
    plain: EncoderLayer<B>,
    out: B::Linear,
    positions: B::Tensor,
}

/// What does not depend on the noisy plan: computed once per plan, used in every denoising step.
#[derive(Debug)]
pub struct Context<B: Backend> {
    /// Tokens of the histories.
    pub history: B::Tensor,
    /// Encoded edges.
    pub edges: B::Tensor,
    /// The rows in the slots of each row.
    pub slots: B::Slots,
    /// Keys and values of the map tokens for each round that attends to the map.
    pub map: Vec<Option<KeyValue<B>>>,
    /// Current speeds [R].
    pub speed: B::Tensor,
}

impl<B: Backend> Denoises<B> for Network<B> {
    type Context = Context<B>;

    fn new(p: &B::Path<'_>, config: &ModelConfig) -> Self {
        let (d, heads) = (config.width, config.heads);
        let at = |name: &str| B::sub(p, name);
        let numbered = |name: &str, i: usize| B::sub(&B::sub(p, name), &i.to_string());
        let rounds = (0..ROUNDS)
            .map(|r| {
                let q = numbered("round", r);
                let map = config.map.as_ref().filter(|m| m.rounds.contains(&r));
                let temporal = |l: usize| {
                    let p = B::sub(&B::sub(&q, "temporal"), &l.to_string());
                    EncoderLayer::new(&p, &B::sub(&p, "attention"), d, heads, config.feed_forward)
                };
                Round {
                    map: map.map(|m| Attention::new(&B::sub(&q, "map"), d, m.feature_width, heads)),
                    temporal: (0..config.temporal_layers).map(temporal).collect(),
                }
            })
            .collect();
        let tokens = config.history_token_steps().len() + config.num_knots();
        let hidden = config.social_feed_forward;
        Self {
            space: PlanSpace::new(config),
            history: HistoryEmbedding::new(&at("history"), config),
            noisy: B::linear(&at("noisy"), 6 * config.knot_stride as i64, d),
            step: StepEmbedding::new(&at("step"), config.diffusion_steps, d),
            edges: EdgeEncoder::new(&at("edges"), config.edge_width),
            map: config.map.as_ref().map(|m| LineEncoder::new(&at("map"), m.feature_width)),
            rounds,
            edge_aware: (0..config.edge_layers)
                .map(|l| EdgeAwareLayer::new(&numbered("edge_aware", l), d, config.edge_width, heads, hidden))
                .collect(),
            edge_norm: B::norm(&at("edge_norm"), d),
            plain: EncoderLayer::new(&at("plain"), &at("plain"), d, heads, config.feed_forward),
            out: B::linear(&at("out"), d, 2),
            positions: B::table(p, &embed::positions(tokens, d), d),
            // last, so that the others' first weights do not depend on it
            route: (!config.route_points_m.is_empty()).then(|| RouteEmbedding::new(&at("route"), config)),
            config: config.clone(),
        }
    }

    fn config(&self) -> &ModelConfig {
        &self.config
    }

    fn slots(context: &Context<B>) -> Option<&B::Slots> {
        Some(&context.slots)
    }

    fn encode(&self, batch: &B::Batch<'_>) -> Context<B> {
        let config = self.config();
        let (plain, placed) = (B::plain(batch), |x| B::placed(batch, x));
        let (edges, slots) = B::edges(batch, config, true);
        let map_tokens = self.map.as_ref().and_then(|m| m.forward(batch));
        let of_round = |r: &Round<B>| r.map.as_ref().zip(map_tokens.as_ref()).map(|(a, t)| a.memory(t));
        let map = self.rounds.iter().map(of_round).collect();
        let mut history = self.history.forward(&placed(plain.history(config)));
        if let Some((embedding, (route, told))) = self.route.as_ref().zip(plain.route()) {
            history = B::sum(embedding.forward(&placed(route), &placed(told)), &history);
        }
        // of one history token, that of now, which those of the plan move on
        let edges = self.edges.forward(&edges, config.history == HistoryTokens::Summary);
        Context { history, edges, slots, map, speed: placed(plain.speed()) }
    }

    /// With the attention weights of the first edge-aware layer.
    fn predict(
        &self,
        context: &Context<B>,
        noisy: &B::Tensor,
        steps: &[usize],
    ) -> (B::Tensor, Option<B::Attention>) {
        let plan = B::apply(&self.noisy, &B::plan(&self.space, noisy, &context.speed));
        // with one history token, its content also goes straight into the plan's tokens
        let carried = self.config.history == HistoryTokens::Summary;
        let mut x = B::stream(&context.history, plan, carried, self.step.forward(steps));
        let mut attention = None;
        for (r, round) in self.rounds.iter().enumerate() {
            if let (Some(layer), Some(kv)) = (&round.map, &context.map[r]) {
                x = B::sum(layer.forward(&x, kv, None), &x);
            }
            x = B::sum(x, &self.positions);
            for layer in &round.temporal {
                x = layer.within(&x, &context.slots);
            }
            if r == 0 {
                let memory = x;
                let mut own = None;
                for layer in &self.edge_aware {
                    let from = own.as_ref().unwrap_or(&memory);
                    let (y, weights) = layer.forward(from, &memory, &context.edges, &context.slots);
                    own = Some(y);
                    attention.get_or_insert(weights);
                }
                x = B::normed(&self.edge_norm, own.as_ref().unwrap_or(&memory), false);
            } else {
                x = self.plain.across(&x, &context.slots);
            }
        }
        (B::apply(&self.out, &B::last(&x, self.config.num_knots() as i64)), attention)
    }
}
