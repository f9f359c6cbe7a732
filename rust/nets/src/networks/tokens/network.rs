//! The network of tokens, on any backend.

use super::{NUM_TOKENS, Now, drawn};
use crate::compute::backend::Backend;
use crate::compute::layers::perceptron::Perceptron;
use crate::config::ModelConfig;
use crate::error::{ModelError, Result};
use crate::guidance::Guide;
use crate::inputs::segments::SEGMENT_FEATURES;
use crate::inputs::tokens::{NEAR_NUMBERS, own_columns};
use crate::networks::planner::{Asked, Proposed, Proposes};

/// Attention of the query to elements, which are their own keys and values.
#[derive(Debug)]
struct Look<B: Backend> {
    norm: B::Norm,
    query: B::Linear,
    out: B::Linear,
    /// Width of a head, and of all of them.
    widths: [i64; 2],
}

impl<B: Backend> Look<B> {
    fn new(p: &B::Path<'_>, width: i64, inner: i64, heads: i64) -> Self {
        Self {
            norm: B::norm(&B::sub(p, "norm"), width),
            query: B::linear(&B::sub(p, "query"), width, heads * inner),
            out: B::linear(&B::sub(p, "out"), heads * inner, width),
            widths: [inner, heads * inner],
        }
    }

    fn forward(&self, x: &B::Tensor, elements: &B::Tensor) -> B::Tensor {
        let query = B::apply(&self.query, &B::normed(&self.norm, x, false));
        // a head is a query of its own
        let [head, all] = self.widths;
        let found = B::attend(&B::cut(&query, head), (elements, elements), 1, None);
        B::apply(&self.out, &B::cut(&found, all))
    }
}

#[derive(Debug)]
struct Round<B: Backend> {
    near: Look<B>,
    lines: Look<B>,
    norm: B::Norm,
    feed: Perceptron<B>,
}

/// Weights of a network of tokens.
#[derive(Debug)]
pub struct Network<B: Backend> {
    own: Perceptron<B>,
    near: Perceptron<B>,
    lines: Perceptron<B>,
    rounds: Vec<Round<B>>,
    norm: B::Norm,
    head: Perceptron<B>,
    config: ModelConfig,
}

impl<B: Backend> Network<B> {
    /// Logits [R, 1, [`NUM_TOKENS`]] from own numbers [R, 1, own], neighbours [R, [`crate::inputs::tokens::NEAR`],
    /// [`NEAR_NUMBERS`]] and lines of the map [R, lines, 20].
    pub fn logits(&self, own: &B::Tensor, near: &B::Tensor, lines: &B::Tensor) -> B::Tensor {
        let (near, lines) = (self.near.forward(near), self.lines.forward(lines));
        let mut x = self.own.forward(own);
        for round in &self.rounds {
            let seen = B::sum(round.lines.forward(&x, &lines), &round.near.forward(&x, &near));
            let y = B::sum(seen, &x);
            x = B::sum(round.feed.forward(&B::normed(&round.norm, &y, false)), &y);
        }
        self.head.forward(&B::normed(&self.norm, &x, false))
    }
}

impl<B: Backend> Proposes<B> for Network<B> {
    fn new(p: &B::Path<'_>, config: &ModelConfig) -> Self {
        let (d, inner) = (config.width, config.edge_width);
        let at = |name: &str| B::sub(p, name);
        let round = |r: usize| {
            let q = B::sub(&at("round"), &r.to_string());
            Round {
                near: Look::new(&B::sub(&q, "near"), d, inner, config.heads),
                lines: Look::new(&B::sub(&q, "lines"), d, inner, config.heads),
                norm: B::norm(&B::sub(&q, "norm"), d),
                feed: Perceptron::feed(&B::sub(&q, "feed"), d, config.feed_forward),
            }
        };
        let own = own_columns(config.route_points_m.len()).count() as i64;
        let part = |name: &str, widths: [i64; 3]| Perceptron::named(&at(name), &["in", "out"], &widths);
        Self {
            own: part("own", [own, d, d]),
            near: part("near", [NEAR_NUMBERS as i64, inner, inner]),
            lines: part("lines", [SEGMENT_FEATURES as i64, inner, inner]),
            rounds: (0..config.temporal_layers).map(round).collect(),
            norm: B::norm(&at("norm"), d),
            head: part("head", [d, d, NUM_TOKENS as i64]),
            config: config.clone(),
        }
    }

    fn config(&self) -> &ModelConfig {
        &self.config
    }

    fn propose(&self, batch: &B::Batch<'_>, asked: &Asked<'_>, guide: Guide<'_, '_>) -> Result<Proposed> {
        let plain = B::plain(batch);
        let Some(lines) = plain.lines() else {
            return Err(ModelError::Shape { what: "map", got: "none".into(), expected: "lines".into() });
        };
        let (own, near, yaw_rate_radps) = plain.tokens();
        let [own, near, lines] = [own, near, lines].map(|x| B::placed(batch, x));
        let logits = B::numbers(&self.logits(&own, &near, &lines));
        let speed_mps = plain.speed().numbers;
        let now = Now { speed_mps: &speed_mps, yaw_rate_radps: &yaw_rate_radps };
        Ok((drawn(&logits, now, asked, self.config(), guide), None))
    }
}
