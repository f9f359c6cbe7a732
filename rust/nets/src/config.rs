//! What a network is: sizes, map view, graph thresholds, normalisation. Stored with the weights.

use crate::error::{ModelError, Result, require};
use ccdiff_sim::causal::graph::GraphThresholds;
use ccdiff_sim::options::{Range, Table, WEIGHT, within};
use ccdiff_sim::{choices, options};

/// The tables of networks.
pub const TABLES: &[&Table] = &[&ModelConfig::TABLE, &MapConfig::TABLE, &Normalisation::TABLE];

/// The network of files that name none.
fn ccdiff() -> String {
    "ccdiff".into()
}

choices! {
    /// Which neighbours an agent is joined with, and in which order they take its slots.
    #[derive(Clone, Copy, Eq, Default)]
    pub enum NeighbourOrder {
        /// Those of the decision causal graph, by time to contact or headway.
        Urgency = "urgency" default,
        /// All within the distance of the graph, nearest first.
        Distance = "distance",
    }
}

choices! {
    /// How an agent's history becomes tokens.
    #[derive(Clone, Copy, Eq)]
    pub enum HistoryTokens {
        /// One token per history step, by one linear layer (paper).
        PerStep = "per_step",
        /// One token for the whole history, by a two-layer perceptron.
        Summary = "summary",
    }
}

options! {
    /// The encoder of the map: a perceptron shared by the lines near the agent, one token per line of at most 5 m.
    ///
    /// Differs from the paper, whose ResNet-18 reads a raster.
    #[derive(Clone)]
    pub struct MapConfig {
        /// Width of the encoder's tokens.
        feature_width: i64 = 256, range within(1.0, 8192.0);
        /// Decoder rounds that attend to the map, at most 64.
        rounds: Vec<usize> = vec![1], range within(0.0, 64.0);
    }
}

/// Standard deviations.
const SPREAD: Range = within(0.0, 1e6).open_below();

options! {
    /// Means and standard deviations estimated from the training data; x_n = (x - mean) / std. The defaults are round numbers
    /// of the right size; `Dataset::estimate_normalisation` gives the real ones.
    ///
    /// Differs from the released code, which adds the mean instead of subtracting it (reference.md#normalisation).
    #[derive(Clone)]
    pub struct Normalisation {
        /// Mean of the future x, y, v, yaw, acceleration, yaw rate in the agent frame.
        trajectory_mean: [f64; 6] = [0.0; 6], unit "m, m, m/s, rad, m/s², rad/s", range WEIGHT;
        /// Their standard deviations.
        trajectory_std: [f64; 6] = [12.0, 1.5, 4.0, 0.2, 0.8, 0.07], unit "m, m, m/s, rad, m/s², rad/s", range SPREAD;
        /// Mean of the action knots: acceleration, yaw rate.
        action_mean: [f64; 2] = [0.0; 2], unit "m/s², rad/s", range WEIGHT;
        /// Their standard deviations.
        action_std: [f64; 2] = [0.8, 0.07], unit "m/s², rad/s", range SPREAD;
        /// Mean of the history's x, y, v, length, width in the agent frame.
        history_mean: [f64; 5] = [-6.0, 0.0, 4.0, 4.8, 2.0], unit "m, m, m/s, m, m", range WEIGHT;
        /// Their standard deviations.
        history_std: [f64; 5] = [7.0, 0.7, 4.0, 1.4, 0.4], unit "m, m, m/s, m, m", range SPREAD;
        /// Standard deviation of relative positions x, y of joined pairs.
        edge_position_std: [f64; 2] = [12.0, 8.0], unit "m", range SPREAD;
        /// Standard deviation of relative velocities of joined pairs.
        edge_velocity_std: f64 = 5.0, unit "m/s", range SPREAD;
    }
}

options! {
    /// Sizes and switches of a planning network; stored with its weights. The defaults are the sizes of the paper's table, the
    /// preset `"paper"`: 83 tokens of width 128.
    ///
    /// Differs from the released code: the map is attended to (reference.md#map), every social layer is masked by G.
    #[derive(Clone)]
    pub struct ModelConfig {
        /// Which network, by name.
        #[serde(default = "ccdiff")]
        kind: String = ccdiff();
        /// Name of the preset this came from.
        preset: String = "paper".into();
        /// History steps, the current one included.
        history_steps: usize = 31, range within(2.0, 1000.0);
        /// Future steps of a plan.
        horizon_steps: usize = 52, range within(1.0, 1000.0);
        /// Time between steps.
        dt_s: f64 = 0.1, unit "s", range within(0.0, 1.0).open_below();
        /// Steps between action knots, a divisor of the horizon; 1: every step is a knot (paper). Knots are joined linearly.
        knot_stride: usize = 1, range within(1.0, 1000.0);
        /// How histories become tokens.
        history: HistoryTokens = HistoryTokens::PerStep;
        /// Token width: an even multiple of the heads.
        width: i64 = 128, range within(2.0, 4096.0);
        /// Attention heads.
        heads: i64 = 16, range within(1.0, 4096.0);
        /// Hidden width of the temporal and plain social layers.
        feed_forward: i64 = 384, range within(1.0, 65_536.0);
        /// Hidden width of the edge-aware social layers.
        social_feed_forward: i64 = 512, range within(1.0, 65_536.0);
        /// Width of the edge features.
        edge_width: i64 = 64, range within(1.0, 4096.0);
        /// Temporal layers per decoder round.
        temporal_layers: usize = 2, range within(1.0, 64.0);
        /// Edge-aware social layers of the first round.
        edge_layers: usize = 4, range within(1.0, 64.0);
        /// Encoder of the map; `None`: the network is blind to the map.
        map: Option<MapConfig> = Some(MapConfig::default());
        /// Neighbours join the decision causal graph up to this time to contact.
        ttc_threshold_s: f32 = GraphThresholds::PAPER.ttc_s, unit "s", range within(0.0, 1000.0);
        /// An agent ahead in one's corridor also joins the graph up to this headway; 0: by time to contact alone.
        ///
        /// Differs from the paper where it is not 0: see `features::urgency`. Weights without the entry were trained with 0.
        #[serde(default)]
        headway_threshold_s: f32 = 0.0, unit "s", range within(0.0, 1000.0);
        /// Neighbours join the graph up to this distance.
        distance_threshold_m: f32 = GraphThresholds::PAPER.distance_m, unit "m", range within(0.0, 10_000.0);
        /// Which neighbours are joined, and their order.
        #[serde(default)]
        neighbour_order: NeighbourOrder = NeighbourOrder::Urgency;
        /// Places on an agent's route that CCDiff is told of, as distances ahead along it, at most 64; empty: it knows no route
        /// (paper).
        ///
        /// Differs from the paper where it is not empty: see `features::route_ahead`.
        #[serde(default)]
        route_points_m: Vec<f32> = Vec::new(), unit "m", range within(0.0, 1000.0);
        /// Most neighbours of an agent, the first in their order.
        max_neighbours: usize = 20, range within(0.0, 4096.0);
        /// Training samples hold the agents within this distance of the centre agent.
        agents_within_m: f32 = 50.0, unit "m", range within(0.0, 10_000.0).open_below();
        /// And at most so many, the nearest.
        max_agents: usize = 21, range within(1.0, 4096.0);
        /// Diffusion steps K.
        diffusion_steps: usize = 100, range within(2.0, 10_000.0);
        /// Weights of x, y, v, yaw, acceleration, yaw rate in the loss.
        loss_weights: [f64; 6] = [1.0; 6], range within(0.0, 1e6);
        /// Constants of the data.
        normalisation: Normalisation = Normalisation::default();
    }
}

/// The error for a preset that there is not.
pub fn unknown_preset(name: &str) -> ModelError {
    ModelError::Config { field: "preset", got: format!("{name:?}"), expected: "\"paper\" or \"fast\"" }
}

impl ModelConfig {
    /// The sizes of the paper's table, which are the defaults.
    pub fn paper() -> Self {
        Self::default()
    }

    /// Small enough to train on one core: 14 tokens of width 64, action knots every 0.4 s.
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
            map: Some(MapConfig { feature_width: 64, rounds: vec![0, 1] }),
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
            _ => Err(unknown_preset(name)),
        }
    }

    /// Checks every range, and that the sizes fit together.
    pub(crate) fn check_sizes(&self) -> Result<()> {
        options::check("model", self)?;
        let (width, heads, stride) = (self.width, self.heads, self.knot_stride);
        let (points, rounds) =
            (self.route_points_m.len(), self.map.as_ref().map_or(0, |map| map.rounds.len()));
        let (fits, got) = (width % heads == 0 && width % 2 == 0, format!("{width} for {heads} heads"));
        require(fits, "model.width", got, "an even multiple of heads")?;
        let fits = self.horizon_steps.is_multiple_of(stride);
        require(fits, "model.knot_stride", stride, "a divisor of horizon_steps")?;
        require(points <= 64, "model.route_points_m", format!("{points} points"), "at most 64")?;
        require(rounds <= 64, "model.map.rounds", format!("{rounds} rounds"), "at most 64")
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
    fn values_out_of_range_name_their_field_their_value_and_their_range() {
        let map = Some(MapConfig { rounds: vec![0; 65], ..MapConfig::default() });
        let normalisation = Normalisation { action_std: [1.0, 0.0], ..Normalisation::default() };
        for (config, message) in [
            (ModelConfig { map, ..ModelConfig::fast() }, "model.map.rounds is 65 rounds"),
            (
                ModelConfig { normalisation, ..ModelConfig::fast() },
                "model.normalisation.action_std is [1.0,0.0], expected 2 numbers in",
            ),
        ] {
            let error = config.validated().unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }

    #[test]
    fn a_header_with_a_list_of_another_length_or_without_a_field_is_refused() {
        let text = serde_json::to_string(&ModelConfig::paper()).unwrap();
        for (part, other) in [("\"width\":128,", ""), ("[1.0,1.0,1.0,1.0,1.0,1.0]", "[1.0]")] {
            let wrong = text.replace(part, other);
            assert!(wrong != text && serde_json::from_str::<ModelConfig>(&wrong).is_err(), "{part}");
        }
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
