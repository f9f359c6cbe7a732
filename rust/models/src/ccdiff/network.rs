//! The whole network.

use crate::batch::Batch;
use crate::config::{HistoryTokens, ModelConfig};
use crate::diffusion::Denoiser;
use crate::layers::attention::{Attention, TemporalLayer};
use crate::layers::edge::{self, EdgeEncoder};
use crate::layers::embed::{self, HistoryEmbedding, RouteEmbedding, StepEmbedding};
use crate::layers::map::MapNetwork;
use crate::layers::social::{EdgeAwareLayer, PlainLayer, Slots};
use crate::plan_space::PlanSpace;
use tch::{Kind, Tensor, nn};

/// Decoder rounds: the first ends in the edge-aware social layers, the second in a plain one.
const ROUNDS: usize = 2;

/// One decoder round.
#[derive(Debug)]
struct Round {
    map: Option<Attention>,
    temporal: Vec<TemporalLayer>,
}

/// Weights of a CCDiff network and what is computed from its configuration.
#[derive(Debug)]
pub struct Network {
    space: PlanSpace,
    history: HistoryEmbedding,
    route: Option<RouteEmbedding>,
    noisy: nn::Linear,
    step: StepEmbedding,
    edges: EdgeEncoder,
    map: Option<MapNetwork>,
    rounds: Vec<Round>,
    edge_aware: Vec<EdgeAwareLayer>,
    edge_norm: nn::LayerNorm,
    plain: PlainLayer,
    out: nn::Linear,
    positions: Tensor,
}

/// What does not depend on the noisy plan: computed once per plan, used in every denoising step.
#[derive(Debug)]
pub struct Context {
    history: Tensor,
    edges: Tensor,
    slots: Slots,
    /// Keys and values of the map tokens for each round that attends to the map.
    map: Vec<Option<(Tensor, Tensor)>>,
    seen: Option<Tensor>,
    speed_mps: Tensor,
}

impl Network {
    /// A network with fresh weights under a path.
    pub fn new(p: &nn::Path, config: &ModelConfig) -> Self {
        let (d, heads) = (config.width, config.heads);
        let rounds = (0..ROUNDS)
            .map(|r| {
                let q = p / "round" / r;
                Round {
                    map: config
                        .map
                        .as_ref()
                        .filter(|m| m.rounds.contains(&r))
                        .map(|m| Attention::new(&(&q / "map"), d, m.feature_width, heads)),
                    temporal: (0..config.temporal_layers)
                        .map(|l| TemporalLayer::new(&(&q / "temporal" / l), d, heads, config.feed_forward))
                        .collect(),
                }
            })
            .collect();
        let tokens = config.history_token_steps().len() + config.num_knots();
        let hidden = config.social_feed_forward;
        Self {
            space: PlanSpace::new(config, p.device()),
            history: HistoryEmbedding::new(&(p / "history"), config),
            noisy: nn::linear(p / "noisy", 6 * config.knot_stride as i64, d, Default::default()),
            step: StepEmbedding::new(&(p / "step"), config.diffusion_steps, d),
            edges: EdgeEncoder::new(&(p / "edges"), config.edge_width),
            map: config.map.as_ref().map(|m| MapNetwork::new(&(p / "map"), m, config.history_steps)),
            rounds,
            edge_aware: (0..config.edge_layers)
                .map(|l| EdgeAwareLayer::new(&(p / "edge_aware" / l), d, config.edge_width, heads, hidden))
                .collect(),
            edge_norm: nn::layer_norm(p / "edge_norm", vec![d], Default::default()),
            plain: PlainLayer::new(&(p / "plain"), d, heads, config.feed_forward),
            out: nn::linear(p / "out", d, 2, Default::default()),
            positions: embed::positions(tokens, d, p.device()),
            // last, so that the others' first weights do not depend on it
            route: (!config.route_points_m.is_empty()).then(|| RouteEmbedding::new(&(p / "route"), config)),
        }
    }

    /// The configuration.
    pub fn config(&self) -> &ModelConfig {
        self.space.config()
    }

    /// Encodes histories, edges and maps. `train` switches batch normalisation.
    pub fn encode(&self, batch: &Batch, train: bool) -> Context {
        let config = self.config();
        let history = embed::standardised_history(&batch.history, config);
        let available = batch.history.narrow(2, 7, 1);
        let (edges, edge_available) = edge::at_tokens(&batch.edges, config);
        let map_tokens = self.map.as_ref().zip(batch.image.as_ref()).map(|(m, i)| m.forward(i, train));
        let map = self
            .rounds
            .iter()
            .map(|r| r.map.as_ref().zip(map_tokens.as_ref()).map(|(a, t)| a.memory(t)))
            .collect();
        let seen = (config.history == HistoryTokens::PerStep).then(|| {
            let past = available.squeeze_dim(2).gt(0.5);
            let future = past.narrow(1, config.history_steps as i64 - 1, 1);
            let future = future.expand([-1, config.num_knots() as i64], false);
            Tensor::cat(&[past, future], 1).unsqueeze(1).unsqueeze(1)
        });
        let history = self.history.forward(&history);
        let history = match self.route.as_ref().zip(batch.route.as_ref()) {
            Some((embedding, route)) => history + embedding.forward(route),
            None => history,
        };
        Context {
            history,
            edges: self.edges.forward(&edges),
            slots: Slots::new(&batch.neighbours, &batch.is_edge, &edge_available),
            map,
            seen,
            speed_mps: batch.speed_mps.shallow_clone(),
        }
    }

    /// Predicts the clean knots from noisy ones.
    ///
    /// # Shapes
    /// `noisy` [R, knots, 2] normalised, `steps` [R] int64 diffusion steps → [R, knots, 2] normalised.
    pub fn denoise(&self, context: &Context, noisy: &Tensor, steps: &Tensor) -> Tensor {
        self.denoise_explained(context, noisy, steps).0
    }

    /// As [`Self::denoise`], with the attention weights of the first edge-aware layer, mean of heads, [R, K, T].
    pub fn denoise_explained(&self, context: &Context, noisy: &Tensor, steps: &Tensor) -> (Tensor, Tensor) {
        let config = self.config();
        let plan = self.space.standardised_states(&self.space.states(noisy, &context.speed_mps));
        let knots = config.num_knots() as i64;
        let future = plan.reshape([-1, knots, 6 * config.knot_stride as i64]).apply(&self.noisy);
        let future = match config.history {
            HistoryTokens::PerStep => future,
            // with one history token, its content also goes straight into the plan's tokens
            HistoryTokens::Summary => future + &context.history,
        };
        let mut x = Tensor::cat(&[&context.history, &future], 1) + self.step.forward(steps);
        let mut attention = None;
        for (r, round) in self.rounds.iter().enumerate() {
            if let (Some(layer), Some(kv)) = (&round.map, &context.map[r]) {
                x = &x + layer.forward(&x, kv, None);
            }
            x = &x + &self.positions;
            for layer in &round.temporal {
                x = layer.forward(&x, context.seen.as_ref());
            }
            if r == 0 {
                let memory = x.shallow_clone();
                for layer in &self.edge_aware {
                    let (y, weights) = layer.forward(&x, &memory, &context.edges, &context.slots);
                    x = y;
                    attention.get_or_insert(weights);
                }
                x = x.apply(&self.edge_norm);
            } else {
                x = self.plain.forward(&x, &context.slots);
            }
        }
        let history = context.history.size()[1];
        let clean = x.narrow(1, history, knots).apply(&self.out);
        let attention = attention.map_or_else(
            || Tensor::zeros([0], (Kind::Float, clean.device())),
            |a| a.mean_dim([3i64].as_slice(), false, Kind::Float),
        );
        (clean, attention)
    }
}

impl Denoiser for Network {
    type Context = Context;

    fn space(&self) -> &PlanSpace {
        &self.space
    }

    fn encode(&self, batch: &Batch, train: bool) -> Context {
        Self::encode(self, batch, train)
    }

    fn repeated(context: &Context, samples: i64) -> Context {
        context.repeated(samples)
    }

    fn predict(&self, context: &Context, noisy: &Tensor, steps: &Tensor) -> (Tensor, Option<Tensor>) {
        let (clean, attention) = self.denoise_explained(context, noisy, steps);
        (clean, Some(attention))
    }
}

impl Context {
    /// The same context for N samples: rows are repeated sample by sample, [N · R].
    #[must_use]
    pub fn repeated(&self, samples: i64) -> Self {
        let repeat = |t: &Tensor| {
            let mut times = vec![1; t.dim()];
            times[0] = samples;
            t.repeat(times)
        };
        Self {
            history: repeat(&self.history),
            edges: repeat(&self.edges),
            slots: self.slots.repeated(samples),
            map: self.map.iter().map(|m| m.as_ref().map(|(k, v)| (repeat(k), repeat(v)))).collect(),
            seen: self.seen.as_ref().map(repeat),
            speed_mps: repeat(&self.speed_mps),
        }
    }

    /// Current speeds [R].
    pub fn speed_mps(&self) -> &Tensor {
        &self.speed_mps
    }
}
