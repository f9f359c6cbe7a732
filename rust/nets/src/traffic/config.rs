//! What can be chosen about the traffic of a planning network.

use crate::config::ModelConfig;
use crate::error::{Result, require};
use crate::guidance::{AgentCollision, GuidanceConfig, MapCollision, Objective};
use crate::networks::NETWORKS;
use crate::networks::kind::NetworkKind;
use crate::networks::planner::PlanOptions;
use crate::networks::tokens::draw::{CAREFUL_DRAWS, CAREFUL_STEPS, GUIDED_DRAWS};
use crate::sampling::sampler::SampleOptions;
use ccdiff_sim::causal::rank::{CliqueSettings, Ranker};
use ccdiff_sim::drivers::{Kind, WorldView};
use ccdiff_sim::geom::Real;
use ccdiff_sim::options::{CRITICALITY, Form, Setting, within};
use ccdiff_sim::{SimError, choices, options};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Discount of the losses that choose among samples that nothing guides (reference.md#sampling).
const RELEASED_DISCOUNT: f32 = 0.9;

/// Learning rate of what moves plans away from contacts and onto the road: on 28 scenes of `train_val` no centre leaves the road.
const CAREFUL_RATE: f32 = 0.15;

/// At this multiple of the learning rate IDM collides as often where targets that stand are spared as where they are run into.
const SPARING_SHARE: Real = 1.25;
/// With routes IDM collides as often as without them at this multiple.
const ROUTES_SHARE: Real = 1.8;

choices! {
    /// The driver of the vehicles outside the guided set.
    #[derive(Clone, Copy, Eq)]
    pub enum BackgroundDriver {
        /// The network, without guidance.
        Ccdiff = "ccdiff",
        /// The intelligent driver model along their routes.
        Idm = "idm",
        /// The log (paper, as released). A vehicle that was guided once never returns to its log.
        Replay = "replay",
    }
}

choices! {
    /// How the vehicles to be guided are chosen.
    #[derive(Clone)]
    pub enum Ranking {
        /// Occurrence in heavy cliques of the time-to-contact graph over the history (as the released lists).
        Cliques = "cliques",
        /// The paper's greedy cliques on G times attention.
        Greedy = "greedy",
        /// Occurrence in heavy cliques of the distance graph.
        DistanceCliques = "distance_cliques",
        /// Time to contact with the nearest in it of `collision_targets`, then distance from it.
        Ttc = "ttc",
        /// The order of the scene, the ego first: what the release calls random.
        First = "first",
        /// A shuffle from the world's own seed.
        Random = "random",
        /// Alignment of the gradients of realism and guidance (the paper's ideal definition).
        Gradient = "gradient",
        /// How near a vehicle comes to `collision_targets` that go on as they do, mean over manoeuvres that it can make (ours).
        Reach = "reach",
        /// Agent ids by scene name, most important first; scenes without a list are filled by nearness.
        List(BTreeMap<String, Vec<String>>) = "list",
    }
}

choices! {
    /// The decision causal graph that the network sees.
    #[derive(Clone, Copy, Eq)]
    pub enum GraphMode {
        /// Edges within the thresholds of the weights: 3 s to contact, 50 m.
        Causal = "causal",
        /// An edge between all pairs (ablation "Enc" off), as far as the network has slots.
        Full = "full",
    }
}

choices! {
    /// Agents with which contacts count in the collision objectives.
    #[derive(Clone, Copy, Eq)]
    pub enum CollisionTargets {
        /// The ego, and every vehicle that is driven from outside.
        Ego = "ego",
        /// Every vehicle (paper).
        All = "all",
    }
}

choices! {
    /// Position of a vehicle relative to the nearest target.
    #[derive(Clone, Copy, Eq)]
    pub enum Conflict {
        /// Headings within 45 degrees, beside each other by at most 2 m: one behind the other.
        RearEnd = "rear_end",
        /// Headings within 45 degrees, beside each other by more than 2 m: in another lane.
        CutIn = "cut_in",
        /// Headings apart by 45 to 135 degrees.
        Crossing = "crossing",
        /// Headings apart by more than 135 degrees.
        HeadOn = "head_on",
    }
}

choices! {
    /// Which vehicles stand still for the whole episode.
    #[derive(Clone, Copy, Eq)]
    pub enum ParkedRule {
        /// Those that never move in the log.
        Parked = "parked",
        /// Those slower than 0.5 m/s in the log at the start (as released).
        Standing = "standing",
        /// None: the logged future is not used.
        Nobody = "nobody",
    }
}

/// The device that needs no torch.
pub(crate) const CPU: &str = "cpu";

/// Guidance by the name of a preset, or as settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum GuidanceChoice {
    /// Name of a preset.
    Preset(String),
    /// Settings.
    Settings(Box<GuidanceConfig>),
}

impl Setting for GuidanceChoice {
    const FORM: Form = Form::Named(&GuidanceConfig::FORM);
}

options! {
    /// CCDiff as a driver: of the traffic (`traffic="ccdiff"`), or of the controlled agents.
    ///
    /// The options of its rivals as well, `ccdiff_env.traffic.NETWORKS` (`traffic="ctg"`, docs/rivals.md): options that
    /// a network does not use must have their defaults. Plans are made for all worlds of a batch at once, every
    /// `replan_steps`, and followed in between.
    #[derive(Clone)]
    #[serde(deny_unknown_fields, default)]
    pub struct CcdiffConfig {
        /// Weights: `"fast"` (the shipped ones of the network), or a safetensors file.
        weights: String = "fast".into();
        /// Where the network runs: `"cpu"`, `"cuda"`, or `"cuda:N"`, one of several graphics cards.
        device: String = CPU.into();
        /// Distance from the ego, or from any vehicle driven from outside, beyond which IDM drives along the routes, unseen by
        /// the network. `None`: all are planned for.
        plan_radius_m: Option<Real> = None, unit "m", range within(0.0, 10_000.0);
        /// Steps from one plan to the next n, at most the horizon of the plans.
        replan_steps: usize = 5, range within(1.0, 1000.0);
        /// Network evaluations of the DDIM sampler (one: guidance moves its only step); `None`: DDPM with all 100 steps.
        denoising_steps: Option<usize> = Some(5), range within(1.0, 1000.0);
        /// Samples per plan N.
        num_samples: usize = 1, range within(1.0, 1024.0);
        /// Weight w of the conditional branch in classifier-free guidance.
        cfg_weight: f64 = 1.0, range within(1.0, 2.0).open_above();
        /// Standard deviation of the noise that is denoised, or what logits of tokens are divided by; 1 for other networks.
        /// Below 1 likely plans are drawn more often.
        temperature: f64 = 1.0, range within(0.0, 100.0).open_below();
        /// Correlate the noise of successive plans of a vehicle (0.5; tokens reuse it), so that speeds after 3 s spread as
        /// those of the log (docs/results.md#likelihood-of-the-log).
        keep_noise: bool = false;
        /// Whether the network gets the routes of its vehicles: the path of the log, then the lanes ahead. It needs
        /// weights trained with routes. Who backs up in the log goes with it, or waits.
        follow_route: bool = false;
        /// The decision causal graph G that the network sees.
        graph: GraphMode = GraphMode::Causal;
        /// Vehicles that are guided K; `None`: all.
        num_guided: Option<usize> = Some(5), range within(0.0, 512.0);
        /// How they are chosen; ids by the name of the scene choose them directly.
        ranking: Ranking = Ranking::Cliques;
        /// A policy that chooses, in place of the ranking, which vehicle is guided at every plan and how strongly, or none: `"learned"`,
        /// the shipped one, or a file (examples/train_adversary_selection.py). `criticality` scales its strengths. It was trained
        /// with `replan_steps` of 20.
        adversary_policy: Option<String> = None;
        /// Whether they are chosen again at every plan, not only at the first one.
        rerank: bool = true;
        /// The driver of the vehicles that are not guided.
        background_driver: BackgroundDriver = BackgroundDriver::Ccdiff;
        /// Scale of the guidance: 0 is realistic traffic, 1 the guidance as configured; the learning rate grows with its power of 1.5
        /// (routes: 1.8 times that, so that an ego collides as often). Of tokens, a guided vehicle takes the best of
        /// 1 + criticality² samples. Worlds can change it at any time.
        criticality: Real = 0.0, range CRITICALITY;
        /// Guidance: a preset (`"rl"`, `"paper"`) or settings.
        guidance: GuidanceChoice = GuidanceChoice::Preset("rl".into());
        /// Push unguided plans away from contacts and back onto the road, which costs the gradients of each plan. Tokens take
        /// the first of 8 samples without a contact or a step off the road in 1.5 s.
        careful: bool = false;
        /// Agents with which contacts count in the collision objectives.
        collision_targets: CollisionTargets = CollisionTargets::Ego;
        /// Agents that guidance aims at, by id; empty: those of `collision_targets`.
        targets: Vec<String> = Vec::new();
        /// Kinds of conflict: only vehicles in such a position to the nearest target are guided; empty: all.
        conflicts: Vec<Conflict> = Vec::new();
        /// Whether guided plans that the ego cannot evade are replaced by unguided ones. It evades by steady
        /// accelerations (−8 to 3 m/s²) on the route and up to 2.5 m beside it, between the guided vehicles.
        avoidable_only: bool = false;
        /// Time of the episode from which plans are guided.
        guided_from_s: Real = 0.0, unit "s", range within(0.0, 10_000.0);
        /// Time of the episode until which plans are guided; `None`: to its end.
        guided_until_s: Option<Real> = None, unit "s", range within(0.0, 10_000.0);
        /// Whether plans keep attention and gradient statistics, at some cost.
        explain: bool = false;
        /// Vehicles that stand still for the whole episode.
        parked_rule: ParkedRule = ParkedRule::Parked;
    }
}

/// The networks as drivers, all with these options.
pub static DRIVERS: [Kind; NETWORKS.len()] = {
    let mut kinds = [NETWORKS[0].kind; NETWORKS.len()];
    let mut i = 0;
    while i < kinds.len() {
        kinds[i] = Kind { options: Some(&CcdiffConfig::TABLE), ..NETWORKS[i].kind };
        i += 1;
    }
    kinds
};

impl CcdiffConfig {
    /// Checks every range, and that all of it means something to a network with weights.
    ///
    /// # Errors
    /// [`crate::ModelError::Config`] and [`crate::ModelError::Sim`] name the field.
    pub(super) fn check(&self, network: &NetworkKind, model: &ModelConfig) -> Result<()> {
        options::check("ccdiff", self)?;
        if self.replan_steps > model.horizon_steps {
            let expected = format!("1 to {}, the steps of a plan", model.horizon_steps);
            return Err(SimError::config("ccdiff.replan_steps", self.replan_steps, expected).into());
        }
        self.guided(network)?.validated()?;
        self.unguided(network).validated()?;
        let fits = self.graph == GraphMode::Causal || network.causal;
        require(fits, "ccdiff.graph", "full", "causal: this network sees neighbours by distance")?;
        let fits = self.ranking != Ranking::Greedy || network.attends;
        require(fits, "ccdiff.ranking", "greedy", "one without attention: this network has none")?;
        let fits = self.ranking != Ranking::Gradient || network.denoises;
        let expected = "one without scores: this network does not denoise";
        require(fits, "ccdiff.ranking", "gradient", expected)?;
        network.options(self.guided(network)?)?;
        let knows = !self.follow_route || !model.route_points_m.is_empty();
        require(knows, "ccdiff.follow_route", "true", "false: these weights were trained without routes")
    }

    /// Whether guidance aims at some agents, such as the ego, not at everybody: those that stand are spared.
    pub(crate) fn names_targets(&self) -> bool {
        self.collision_targets == CollisionTargets::Ego || !self.targets.is_empty()
    }

    /// Whether plans made now may be guided.
    pub(crate) fn guides_at(&self, world: &WorldView<'_>) -> bool {
        let time_s = world.elapsed_steps as Real * world.dt_s;
        time_s >= self.guided_from_s && self.guided_until_s.is_none_or(|until_s| time_s <= until_s)
    }

    /// Share of the learning rate, or of the draws of tokens, at a criticality. With the power of 1.5 IDM collides at criticality 2
    /// three times as often as at 1 (docs/results.md#equal-criticality).
    pub(crate) fn guidance_scale(&self, tokens: bool, criticality: Real) -> Real {
        match tokens {
            true => criticality * criticality / (GUIDED_DRAWS - 1) as Real,
            false => {
                let spares = if self.names_targets() { SPARING_SHARE } else { 1.0 };
                let routes = if self.follow_route { ROUTES_SHARE } else { 1.0 };
                spares * routes * criticality * criticality.sqrt()
            }
        }
    }

    fn guidance_config(&self) -> Result<GuidanceConfig> {
        match &self.guidance {
            GuidanceChoice::Preset(name) => GuidanceConfig::preset(name),
            GuidanceChoice::Settings(settings) => Ok((**settings).clone()),
        }
    }

    /// How the plans of worlds with guidance are drawn. Those of tokens are the best of as many draws as the criticality asks for.
    ///
    /// # Errors
    /// [`crate::ModelError::Config`] for an unknown preset or settings of another form.
    pub fn guided(&self, network: &NetworkKind) -> Result<PlanOptions> {
        Ok(PlanOptions {
            sampling: if network.samples_tokens {
                self.sampling(self.num_samples.max(1 + self.criticality.max(2.0).powi(2).ceil() as usize))
            } else {
                self.sampling(self.num_samples)
            },
            guidance: Some(self.guidance_config()?),
            attention: self.explain,
            gradient_statistics: self.explain,
        })
    }

    /// How the plans of worlds without guidance are drawn: of several samples the one that touches least and stays on
    /// the road is taken, as in the released code (reference.md#sampling). [`Self::careful`] moves them as well; those of tokens
    /// are the first that does neither in [`CAREFUL_STEPS`].
    pub fn unguided(&self, network: &NetworkKind) -> PlanOptions {
        let collision = if self.careful { -AgentCollision::default().weight } else { 1.0 };
        let objectives = vec![
            Objective::AgentCollision(AgentCollision { weight: collision, ..AgentCollision::default() }),
            Objective::MapCollision(MapCollision { weight: 1.0 }),
        ];
        let mut filter = GuidanceConfig { objectives, ..GuidanceConfig::default() };
        if self.careful {
            filter.learning_rate = CAREFUL_RATE;
        } else {
            filter.discount = RELEASED_DISCOUNT;
        }
        let mut num_samples = self.num_samples;
        if !self.careful || network.samples_tokens {
            filter.gradient_steps = 0;
        }
        if self.careful && network.samples_tokens {
            filter.seen_steps = Some(CAREFUL_STEPS);
            num_samples = num_samples.max(CAREFUL_DRAWS);
        }
        PlanOptions {
            sampling: self.sampling(num_samples),
            guidance: (self.careful || self.num_samples > 1).then_some(filter),
            attention: self.explain,
            gradient_statistics: false,
        }
    }

    /// Options of the sampler.
    pub fn sampling(&self, num_samples: usize) -> SampleOptions {
        SampleOptions {
            solver_steps: self.denoising_steps,
            num_samples,
            guidance_weight: self.cfg_weight,
            temperature: self.temperature,
        }
    }

    /// The ranker of a plan of a scene; `ids` are those of the planned agents.
    pub(crate) fn ranker(&self, scene: &str, ids: &[&str], seed: u64) -> Ranker {
        match &self.ranking {
            Ranking::Cliques => Ranker::CliqueOccurrence(CliqueSettings::REFERENCE_IMPL),
            Ranking::DistanceCliques => Ranker::DistanceCliques(CliqueSettings::REFERENCE_IMPL),
            Ranking::Greedy => Ranker::Greedy,
            Ranking::First => Ranker::FirstK,
            Ranking::Random => Ranker::Random { seed },
            Ranking::Ttc | Ranking::Gradient | Ranking::Reach => Ranker::Scores,
            Ranking::List(lists) => {
                let listed = lists.get(scene).into_iter().flatten();
                Ranker::Listed(listed.filter_map(|id| ids.iter().position(|i| i == id)).collect())
            }
        }
    }
}
