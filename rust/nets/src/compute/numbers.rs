//! What the kernels compute with: numbers in rows of tokens, and what networks read of scenes.

use crate::config::ModelConfig;
use crate::inputs::features::{EDGE_FEATURES, HISTORY_FEATURES, SceneFeatures};
use crate::inputs::segments::{NUM_SEGMENTS, SEGMENT_FEATURES};
use crate::inputs::tokens::{NEAR, NEAR_NUMBERS};
use crate::kernels::Seen;
use std::ops::Range;
use std::rc::Rc;

/// Places on routes are given in units of so many metres.
const ROUTE_SCALE_M: f32 = 20.0;

/// Numbers [rows, tokens, width].
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Tokens of a row.
    pub tokens: usize,
    /// Numbers of a token.
    pub width: usize,
    /// The numbers, row by row.
    pub numbers: Vec<f32>,
}

impl Array {
    /// Numbers in this shape; the rows follow.
    pub fn new(tokens: usize, width: usize, numbers: Vec<f32>) -> Self {
        Self { tokens, width, numbers }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.numbers.len() / self.row()
    }

    /// Other numbers in the same shape.
    #[must_use]
    pub fn like(&self, numbers: Vec<f32>) -> Self {
        Self { numbers, ..*self }
    }

    /// Numbers of a row.
    pub fn row(&self) -> usize {
        (self.tokens * self.width).max(1)
    }
}

/// Batch of the agents of several scenes.
#[derive(Debug, Clone, Copy)]
pub struct Batch<'a> {
    /// The scenes.
    pub scenes: &'a [SceneFeatures],
    /// Whether every row sees itself alone.
    pub alone: bool,
}

/// The rows that each row sees: the others, or itself where there are none; and itself with the others.
#[derive(Debug)]
pub struct Pairs {
    /// Others.
    pub others: Rc<Seen>,
    /// All.
    pub all: Rc<Seen>,
    /// Slots of a row.
    slots: usize,
}

impl Batch<'_> {
    fn numbers(&self, of: impl Fn(&SceneFeatures) -> &[f32]) -> Vec<f32> {
        self.scenes.iter().flat_map(of).copied().collect()
    }

    fn num_rows(&self) -> usize {
        self.scenes.iter().map(|s| s.agents.len()).sum()
    }

    /// Standardised histories [R, H, 8], zero where not available.
    pub fn history(&self, config: &ModelConfig) -> Array {
        let n = &config.normalisation;
        let (mean, std) = (n.history_mean.map(|v| v as f32), n.history_std.map(|v| v as f32));
        let mut numbers = self.numbers(|s| &s.history);
        for x in numbers.as_chunks_mut::<HISTORY_FEATURES>().0 {
            for (at, j) in [(0, 0), (1, 1), (4, 2), (5, 3), (6, 4)] {
                x[at] = (x[at] - mean[j]) / std[j];
            }
            let available = x[7];
            for v in x {
                *v *= available;
            }
        }
        Array::new(config.history_steps, HISTORY_FEATURES, numbers)
    }

    /// Routes [R, 1, 1 + 2 P], places in units of [`ROUTE_SCALE_M`], and whether they are told [R, 1, 1].
    pub fn route(&self) -> Option<(Array, Array)> {
        let mut numbers = self.numbers(|s| &s.route);
        let width = numbers.len().checked_div(self.num_rows()).filter(|width| *width > 0)?;
        let told = numbers.iter().step_by(width).copied().collect();
        for row in numbers.chunks_exact_mut(width) {
            for place in &mut row[1..] {
                *place /= ROUTE_SCALE_M;
            }
        }
        Some((Array::new(1, width, numbers), Array::new(1, 1, told)))
    }

    /// Standardised speeds now [R, 1, 1].
    pub fn standard_speed(&self, config: &ModelConfig) -> Array {
        let n = &config.normalisation;
        let (mean, std) = (n.trajectory_mean[2] as f32, n.trajectory_std[2] as f32);
        let speeds = self.numbers(|s| &s.speed_mps);
        Array::new(1, 1, speeds.into_iter().map(|v| (v - mean) / std).collect())
    }

    /// Speeds now [R, 1, 1].
    pub fn speed(&self) -> Array {
        Array::new(1, 1, self.numbers(|s| &s.speed_mps))
    }

    /// Lines of the map [R, lines, 20]; `None` without them.
    pub fn lines(&self) -> Option<Array> {
        let numbers = self.numbers(|s| &s.segments);
        (!numbers.is_empty()).then(|| Array::new(NUM_SEGMENTS, SEGMENT_FEATURES, numbers))
    }

    /// Inputs of a network of tokens: own numbers [R, 1, own], neighbours [R, near, numbers] and yaw rates now (rad/s) [R].
    pub fn tokens(&self) -> (Array, Array, Vec<f32>) {
        let own = self.numbers(|s| &s.tokens.own);
        let own = Array::new(1, own.len() / self.num_rows().max(1), own);
        let near = Array::new(NEAR, NEAR_NUMBERS, self.numbers(|s| &s.tokens.near));
        (own, near, self.numbers(|s| &s.tokens.yaw_rate_radps))
    }

    /// Edges of the seen pairs, normalised, [.., 8], at every token of now and the future or now alone, and the pairs.
    pub fn edges(&self, config: &ModelConfig, moved: bool) -> (Array, Pairs) {
        let future = config.future_token_times_s().into_iter().filter(|_| moved).map(|t| t as f32);
        let times: Vec<f32> = std::iter::once(0.0).chain(future).collect();
        let n = &config.normalisation;
        let (pos, vel) = (&n.edge_position_std, n.edge_velocity_std);
        let scale = [pos[0], pos[1], 1.0, 1.0, vel, vel, 1.0, 1.0].map(|s| (1.0 / s) as f32);
        let (mut others_of, mut all_of, mut numbers) = (Seen::empty(), Seen::empty(), Vec::new());
        let mut offset = 0;
        for scene in self.scenes {
            let k = scene.num_slots;
            for row in 0..scene.agents.len() {
                let edge = |slot: usize| &scene.edges[(row * k + slot) * EDGE_FEATURES..][..EDGE_FEATURES];
                let sees =
                    |slot: &usize| !self.alone && scene.is_edge[row * k + slot] && edge(*slot)[8] > 0.5;
                let others: Vec<usize> = (1..k).filter(sees).collect();
                let other = |slot: usize| offset + scene.neighbours[row * k + slot];
                all_of.push(std::iter::once(0).chain(others.iter().copied()).map(|s| (other(s), s)));
                // alone: its own slot
                let of = if others.is_empty() { vec![0] } else { others };
                others_of.push(of.iter().map(|s| (other(*s), *s)));
                for x in of.into_iter().map(edge) {
                    for time in &times {
                        numbers.extend([(x[0] + x[4] * time) * scale[0], (x[1] + x[5] * time) * scale[1]]);
                        numbers.extend((2..8).map(|c| x[c] * scale[c]));
                    }
                }
            }
            offset += scene.agents.len();
        }
        let slots = self.scenes.iter().map(|s| s.num_slots).max().unwrap_or(1);
        let pairs = Pairs { others: Rc::new(others_of), all: Rc::new(all_of), slots };
        (Array::new(times.len(), EDGE_FEATURES - 1, numbers), pairs)
    }
}

impl Pairs {
    /// Mean attention [R, slots] to the others over samples and tokens, zero where none is seen.
    pub(crate) fn mean(&self, samples: &[Vec<f32>], tokens: Range<usize>) -> Vec<f32> {
        let (rows, pairs) = (self.others.start.len() - 1, self.others.other.len());
        let mut mean = vec![0.0; rows * self.slots];
        for attention in samples {
            let all = attention.len() / pairs.max(1);
            for row in 0..rows {
                for pair in self.others.start[row]..self.others.start[row + 1] {
                    let of_pair = &attention[pair * all..][tokens.clone()];
                    mean[row * self.slots + self.others.slot[pair]] +=
                        of_pair.iter().sum::<f32>() / (tokens.len() * samples.len()) as f32;
                }
            }
        }
        mean
    }
}
