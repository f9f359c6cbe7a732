//! What a network is: sizes, map view, graph thresholds, normalisation. Stored with the weights.

use crate::error::{ModelError, Result};
use serde::{Deserialize, Serialize};

/// Which network it is, by its name in files, options and tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModelKind {
    /// Scene diffusion over the decision causal graph.
    #[default]
    Ccdiff,
    /// One plan per agent by regression.
    Simnet,
    /// Latents of all agents decoded jointly, after the paper.
    Trafficsim,
    /// Latents of each agent under a fixed prior, as ported by others.
    TrafficsimPort,
    /// Latents of each agent under a learned prior, optimised.
    Strive,
    /// Goals on a grid, a policy that drives to them, a choice among them.
    Bits,
    /// Diffusion of each agent's actions.
    Ctg,
    /// Scene diffusion over a graph of distances.
    Ctgpp,
}

impl ModelKind {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Ccdiff,
        Self::Simnet,
        Self::Trafficsim,
        Self::TrafficsimPort,
        Self::Strive,
        Self::Bits,
        Self::Ctg,
        Self::Ctgpp,
    ];

    /// The name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ccdiff => "ccdiff",
            Self::Simnet => "simnet",
            Self::Trafficsim => "trafficsim",
            Self::TrafficsimPort => "trafficsim_port",
            Self::Strive => "strive",
            Self::Bits => "bits",
            Self::Ctg => "ctg",
            Self::Ctgpp => "ctgpp",
        }
    }

    /// The kind of a name.
    ///
    /// # Errors
    /// [`ModelError::Config`] for any other name.
    pub fn named(name: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name).ok_or_else(|| ModelError::Config {
            field: "model",
            got: format!("{name:?}"),
            expected: "ccdiff, simnet, trafficsim, trafficsim_port, strive, bits, ctg or ctgpp",
        })
    }

    /// Whether plans are denoised step by step.
    pub fn denoises(self) -> bool {
        matches!(self, Self::Ccdiff | Self::Ctg | Self::Ctgpp)
    }

    /// Whether plans attend to each other, so that there is attention to tell of.
    pub fn attends(self) -> bool {
        matches!(self, Self::Ccdiff | Self::Ctgpp)
    }

    /// Whether it reads agents by the trunk that all but the scene diffusions share.
    fn has_trunk(self) -> bool {
        !self.attends()
    }
}

/// Which neighbours an agent is joined with, and in which order they take its slots.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NeighbourOrder {
    /// Those of the decision causal graph, by time to contact or headway.
    #[default]
    Urgency,
    /// All within the distance of the graph, nearest first.
    Distance,
}

/// How an agent's history becomes tokens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HistoryTokens {
    /// One token per history step, by one linear layer (paper).
    PerStep,
    /// One token for the whole history, by a two-layer perceptron.
    Summary,
}

/// Which network reads the map raster.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MapEncoder {
    /// ResNet-18: one token per agent (paper).
    ResNet18,
    /// Three strided convolutions: one token per 8 x 8 pixels.
    Light,
}

/// The agent-centred map raster and its encoder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MapConfig {
    /// Network that reads the raster.
    pub encoder: MapEncoder,
    /// Width and height in pixels.
    pub size_px: usize,
    /// Side of a pixel, metres.
    pub metres_per_px: f32,
    /// Column of the agent (x runs along columns); its row is the middle one.
    pub agent_column_px: usize,
    /// Whether two layers with the direction of the lanes (cosine, sine) follow the three of the paper.
    pub lane_direction: bool,
    /// Whether one channel per history step with the agents' pixels comes first.
    pub history_channels: bool,
    /// Width of the encoder's tokens.
    pub feature_width: i64,
    /// Resolution of the scene's bitmap that rasters are cut from, pixels per metre.
    pub bitmap_px_per_m: f32,
    /// Decoder rounds that attend to the map.
    pub rounds: Vec<usize>,
}

/// Means and standard deviations estimated from the training data; x_n = (x - mean) / std.
///
/// Differs from the released code, which adds the mean instead of subtracting it (reference.md#normalisation).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Normalisation {
    /// Mean of the future x, y, v, yaw, acceleration, yaw rate in the agent frame.
    pub trajectory_mean: [f64; 6],
    /// Their standard deviations.
    pub trajectory_std: [f64; 6],
    /// Mean of the action knots: acceleration, yaw rate.
    pub action_mean: [f64; 2],
    /// Their standard deviations.
    pub action_std: [f64; 2],
    /// Mean of the history's x, y, v, length, width in the agent frame.
    pub history_mean: [f64; 5],
    /// Their standard deviations.
    pub history_std: [f64; 5],
    /// Standard deviation of relative positions x, y of joined pairs, metres.
    pub edge_position_std: [f64; 2],
    /// Standard deviation of relative velocities of joined pairs, metres per second.
    pub edge_velocity_std: f64,
}

impl Default for Normalisation {
    /// Round numbers of the right size; [`crate::dataset::Dataset::estimate_normalisation`] gives the real ones.
    fn default() -> Self {
        Self {
            trajectory_mean: [0.0; 6],
            trajectory_std: [12.0, 1.5, 4.0, 0.2, 0.8, 0.07],
            action_mean: [0.0; 2],
            action_std: [0.8, 0.07],
            history_mean: [-6.0, 0.0, 4.0, 4.8, 2.0],
            history_std: [7.0, 0.7, 4.0, 1.4, 0.4],
            edge_position_std: [12.0, 8.0],
            edge_velocity_std: 5.0,
        }
    }
}

/// Sizes and switches of a planning network.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModelConfig {
    /// Which network.
    #[serde(default)]
    pub kind: ModelKind,
    /// Name of the preset this came from.
    pub preset: String,
    /// History steps, the current one included.
    pub history_steps: usize,
    /// Future steps of a plan.
    pub horizon_steps: usize,
    /// Time between steps, seconds.
    pub dt_s: f64,
    /// Steps between action knots; 1: every step is a knot (paper). Knots are joined linearly.
    pub knot_stride: usize,
    /// How histories become tokens.
    pub history: HistoryTokens,
    /// Token width.
    pub width: i64,
    /// Attention heads.
    pub heads: i64,
    /// Hidden width of the temporal and plain social layers.
    pub feed_forward: i64,
    /// Hidden width of the edge-aware social layers.
    pub social_feed_forward: i64,
    /// Width of the edge features.
    pub edge_width: i64,
    /// Temporal layers per decoder round.
    pub temporal_layers: usize,
    /// Edge-aware social layers of the first round.
    pub edge_layers: usize,
    /// Map raster and encoder; `None`: the network is blind to the map.
    pub map: Option<MapConfig>,
    /// Neighbours join the decision causal graph up to this time to contact, seconds.
    pub ttc_threshold_s: f32,
    /// An agent ahead in one's corridor also joins the graph up to this headway, seconds; 0: by time to contact alone.
    ///
    /// Differs from the paper where it is not 0: see `features::urgency`. Weights without the entry were trained with 0.
    #[serde(default)]
    pub headway_threshold_s: f32,
    /// Neighbours join the graph up to this distance, metres.
    pub distance_threshold_m: f32,
    /// Which neighbours are joined, and their order.
    #[serde(default)]
    pub neighbour_order: NeighbourOrder,
    /// Most neighbours of an agent, the first in their order.
    pub max_neighbours: usize,
    /// Training samples hold the agents within this distance of the centre agent, metres.
    pub agents_within_m: f32,
    /// And at most so many, the nearest.
    pub max_agents: usize,
    /// Diffusion steps K.
    pub diffusion_steps: usize,
    /// Weights of x, y, v, yaw, acceleration, yaw rate in the loss.
    pub loss_weights: [f64; 6],
    /// Constants of the data.
    pub normalisation: Normalisation,
}

impl ModelConfig {
    /// The sizes of the paper's table: 83 tokens of width 128, ResNet-18 at 224 x 224.
    ///
    /// Differs from the released code: the map is attended to (reference.md#map), every social layer is masked by G.
    pub fn paper() -> Self {
        Self {
            kind: ModelKind::Ccdiff,
            preset: "paper".into(),
            history_steps: 31,
            horizon_steps: 52,
            dt_s: 0.1,
            knot_stride: 1,
            history: HistoryTokens::PerStep,
            width: 128,
            heads: 16,
            feed_forward: 384,
            social_feed_forward: 512,
            edge_width: 64,
            temporal_layers: 2,
            edge_layers: 4,
            map: Some(MapConfig {
                encoder: MapEncoder::ResNet18,
                size_px: 224,
                metres_per_px: 0.5,
                agent_column_px: 56,
                lane_direction: false,
                history_channels: true,
                feature_width: 256,
                bitmap_px_per_m: 2.0,
                rounds: vec![1],
            }),
            ttc_threshold_s: 3.0,
            headway_threshold_s: 0.0,
            distance_threshold_m: 50.0,
            neighbour_order: NeighbourOrder::Urgency,
            max_neighbours: 20,
            agents_within_m: 50.0,
            max_agents: 21,
            diffusion_steps: 100,
            loss_weights: [1.0; 6],
            normalisation: Normalisation::default(),
        }
    }

    /// Small enough to train on one core: 14 tokens of width 64, action knots every 0.4 s, 64 x 64 map at 1 m a pixel.
    pub fn fast() -> Self {
        Self {
            preset: "fast".into(),
            knot_stride: 4,
            history: HistoryTokens::Summary,
            width: 64,
            heads: 4,
            feed_forward: 192,
            social_feed_forward: 192,
            edge_width: 32,
            temporal_layers: 1,
            edge_layers: 1,
            map: Some(MapConfig {
                encoder: MapEncoder::Light,
                size_px: 64,
                metres_per_px: 1.0,
                agent_column_px: 10,
                lane_direction: true,
                history_channels: false,
                feature_width: 64,
                bitmap_px_per_m: 1.0,
                rounds: vec![0, 1],
            }),
            headway_threshold_s: 3.0,
            max_neighbours: 8,
            agents_within_m: 80.0,
            ..Self::paper()
        }
    }

    /// A preset by name.
    ///
    /// # Errors
    /// [`ModelError::Config`] for another name than `paper` and `fast`.
    pub fn preset(name: &str) -> Result<Self> {
        match name {
            "paper" => Ok(Self::paper()),
            "fast" => Ok(Self::fast()),
            _ => Err(ModelError::Config {
                field: "preset",
                got: format!("{name:?}"),
                expected: "\"paper\" or \"fast\"",
            }),
        }
    }

    /// A kind of network in a preset's sizes. All but CCDiff see neighbours by distance.
    ///
    /// # Errors
    /// As [`Self::preset`].
    pub fn of(kind: ModelKind, preset: &str) -> Result<Self> {
        let config = Self::preset(preset)?;
        match kind {
            ModelKind::Ccdiff => Ok(config),
            _ => Self { kind, neighbour_order: NeighbourOrder::Distance, ..config }.validated(),
        }
    }

    /// Checks that the sizes fit together.
    ///
    /// # Errors
    /// [`ModelError::Config`] names the first field that does not.
    pub fn validated(self) -> Result<Self> {
        let fail =
            |field: &'static str, got: String, expected| Err(ModelError::Config { field, got, expected });
        if self.heads < 1 || self.width < 2 || self.width % self.heads != 0 || self.width % 2 != 0 {
            return fail(
                "width",
                format!("{} for {} heads", self.width, self.heads),
                "an even multiple of heads",
            );
        }
        if self.history_steps < 2 || self.horizon_steps < 1 {
            return fail(
                "history_steps, horizon_steps",
                format!("{}, {}", self.history_steps, self.horizon_steps),
                "at least 2 and 1",
            );
        }
        if self.knot_stride < 1 || !self.horizon_steps.is_multiple_of(self.knot_stride) {
            return fail("knot_stride", self.knot_stride.to_string(), "a divisor of horizon_steps");
        }
        if !(self.dt_s > 0.0 && self.dt_s.is_finite()) {
            return fail("dt_s", self.dt_s.to_string(), "a positive number of seconds");
        }
        if self.temporal_layers < 1 || self.edge_layers < 1 || self.max_agents < 1 {
            return fail("temporal_layers, edge_layers, max_agents", "0".into(), "at least one of each");
        }
        if !(self.headway_threshold_s >= 0.0 && self.headway_threshold_s.is_finite()) {
            return fail("headway_threshold_s", self.headway_threshold_s.to_string(), "at least 0");
        }
        if self.kind.has_trunk() && self.history != HistoryTokens::Summary {
            return fail(
                "history",
                format!("{:?}", self.history),
                "a summary, as in \"fast\", for this model",
            );
        }
        if self.diffusion_steps < 2 {
            return fail("diffusion_steps", self.diffusion_steps.to_string(), "at least 2");
        }
        for (field, got, most) in self.sizes() {
            if !usize::try_from(got).is_ok_and(|got| got <= most) {
                return fail(field, got.to_string(), "a size of a network that fits into memory");
            }
        }
        if let Some(map) = &self.map {
            if map.size_px < 8 || map.size_px % 8 != 0 || map.agent_column_px >= map.size_px {
                return fail(
                    "map.size_px",
                    map.size_px.to_string(),
                    "a multiple of 8 with the agent inside the raster",
                );
            }
            if !(map.metres_per_px > 0.0 && map.bitmap_px_per_m > 0.0) {
                return fail("map.metres_per_px", map.metres_per_px.to_string(), "a positive resolution");
            }
        }
        let n = &self.normalisation;
        let stds = n
            .trajectory_std
            .iter()
            .chain(&n.action_std)
            .chain(&n.history_std)
            .chain(&n.edge_position_std)
            .chain([&n.edge_velocity_std]);
        for std in stds {
            if !(*std > 0.0 && std.is_finite()) {
                return fail("normalisation", std.to_string(), "positive standard deviations");
            }
        }
        Ok(self)
    }

    /// Sizes with what they may be at most: a header of a weight file could say anything.
    fn sizes(&self) -> Vec<(&'static str, i64, usize)> {
        let size = |n: usize| i64::try_from(n).unwrap_or(i64::MAX);
        let mut sizes = vec![
            ("history_steps", size(self.history_steps), 1000),
            ("horizon_steps", size(self.horizon_steps), 1000),
            ("width", self.width, 4096),
            ("feed_forward", self.feed_forward, 65_536),
            ("social_feed_forward", self.social_feed_forward, 65_536),
            ("edge_width", self.edge_width, 4096),
            ("temporal_layers", size(self.temporal_layers), 64),
            ("edge_layers", size(self.edge_layers), 64),
            ("max_neighbours", size(self.max_neighbours), 4096),
            ("max_agents", size(self.max_agents), 4096),
            ("diffusion_steps", size(self.diffusion_steps), 10_000),
        ];
        if let Some(map) = &self.map {
            sizes.extend([
                ("map.size_px", size(map.size_px), 4096),
                ("map.feature_width", map.feature_width, 8192),
                ("map.rounds", size(map.rounds.len()), 64),
            ]);
        }
        sizes
    }

    /// Number of action knots, which is the number of future tokens.
    pub fn num_knots(&self) -> usize {
        self.horizon_steps / self.knot_stride
    }

    /// History steps that have a token of their own, as indices into the history.
    pub fn history_token_steps(&self) -> Vec<usize> {
        match self.history {
            HistoryTokens::PerStep => (0..self.history_steps).collect(),
            HistoryTokens::Summary => vec![self.history_steps - 1],
        }
    }

    /// Seconds after now of the middle of each future token.
    pub fn future_token_times_s(&self) -> Vec<f64> {
        let stride = self.knot_stride as f64;
        (0..self.num_knots()).map(|k| (k as f64 * stride + 0.5 * (stride + 1.0)) * self.dt_s).collect()
    }
}

impl MapConfig {
    /// Layers of the raster besides the history channels.
    pub fn num_layers(&self) -> usize {
        if self.lane_direction { 5 } else { 3 }
    }

    /// All channels of the raster.
    pub fn num_channels(&self, history_steps: usize) -> usize {
        self.num_layers() + if self.history_channels { history_steps } else { 0 }
    }

    /// Farthest corner of the raster from the agent, metres.
    pub fn reach_m(&self) -> f32 {
        let ahead = self.size_px.saturating_sub(self.agent_column_px).max(self.agent_column_px) as f32;
        let half = 0.5 * self.size_px as f32;
        (ahead * ahead + half * half).sqrt() * self.metres_per_px
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_presets_are_valid_and_a_broken_one_names_its_field() {
        assert_eq!(ModelConfig::preset("paper").unwrap().validated().unwrap().num_knots(), 52);
        assert_eq!(ModelConfig::preset("fast").unwrap().validated().unwrap().num_knots(), 13);
        let broken = ModelConfig { knot_stride: 5, ..ModelConfig::fast() };
        assert!(broken.validated().unwrap_err().to_string().contains("knot_stride"));
        assert!(ModelConfig::preset("huge").is_err());
    }

    #[test]
    fn a_configuration_survives_json() {
        let config = ModelConfig::paper();
        let text = serde_json::to_string(&config).unwrap();
        assert_eq!(serde_json::from_str::<ModelConfig>(&text).unwrap(), config);
        let older = text.replace("\"headway_threshold_s\":0.0,", "");
        assert!(older.len() < text.len());
        assert_eq!(serde_json::from_str::<ModelConfig>(&older).unwrap(), config);
    }
}
