//! Training samples from scenes: (scene, step) pairs whose features are built on demand, in parallel.

pub use ccdiff_nets::inputs::features::vehicles;
use ccdiff_nets::traffic::STATIONARY_REACH_M;

use crate::batch::{Batch, Targets};
use crate::config::{ModelConfig, Normalisation};
use crate::error::{ModelError, Result, require};
use crate::features::{self, EDGE_FEATURES, FIRST_STEP, Futures, HISTORY_FEATURES, SceneFeatures, Window};
use crate::noise::Noise;
use crate::perturbation::{ASIDE_S, Lateral, Longitudinal, Trail};
use crate::segments::MapLines;
use ccdiff_sim::geom::{Pose2, Region};
use ccdiff_sim::scene::{LaneIndex, Scene};
use ccdiff_sim::stage::Route;
use rayon::prelude::*;
use std::sync::Arc;
use tch::Device;

/// Seconds until a pushed vehicle is back on its log, for tokens.
const TOKEN_RECOVERY_S: f32 = 2.0;

/// A scene with what is computed once about it.
#[derive(Debug)]
struct Prepared {
    scene: Arc<Scene>,
    /// Indices of the vehicles; the ego (or else the first vehicle) comes first.
    vehicles: Vec<usize>,
    map: Option<MapLines>,
    /// The road, for a loss that asks for it.
    road: Option<Arc<Region>>,
    /// Routes of all agents; none for a network that knows no routes.
    routes: Vec<Route>,
}

/// Samples of a list of scenes.
#[derive(Debug)]
pub struct Dataset {
    config: ModelConfig,
    scenes: Vec<Prepared>,
    /// (scene, current step).
    samples: Vec<(u32, u32)>,
}

/// How an agent is taken off its log in training.
#[derive(Debug)]
enum Move {
    /// Sideways, off the path.
    Aside(Lateral),
    /// Along the path, with the poses after now.
    Along(Longitudinal, Trail, Vec<Pose2>),
}

impl Move {
    /// Draws a move for the agent of a slot; `trail` gives its path and the time step.
    fn draw(noise: &Noise, slot: u64, speed_mps: f32, trail: impl FnOnce() -> (Trail, f32)) -> Option<Self> {
        let Some(pace) = Longitudinal::draw(noise, slot, speed_mps) else {
            return Lateral::draw(noise, slot, speed_mps).map(Self::Aside);
        };
        let (trail, dt_s) = trail();
        let pace = pace.within(&trail, dt_s);
        let future = pace.future(&trail, dt_s);
        Some(Self::Along(pace, trail, future))
    }

    /// Moves the agent's history; `None`, and the history as it was, where it would then touch another's body.
    fn applied(self, window: &mut Window, agent: usize) -> Option<Self> {
        let kept = window.clone();
        match &self {
            Self::Aside(push) => push.move_history(window, agent),
            Self::Along(pace, trail, _) => pace.move_history(window, agent, trail),
        }
        if window.touches_now(agent) {
            *window = kept;
            return None;
        }
        Some(self)
    }
}

impl Dataset {
    /// Prepares scenes. Every `stride`-th step is a sample if some vehicle has its whole future logged then.
    ///
    /// # Errors
    /// [`ModelError::Config`] for another time step than the configuration's or a stride of 0;
    /// [`ModelError::NoSamples`] where no step qualifies.
    pub fn new(scenes: Vec<Arc<Scene>>, config: &ModelConfig, stride: usize) -> Result<Self> {
        let num_scenes = scenes.len();
        require(stride > 0, "stride", stride, "at least 1")?;
        for scene in &scenes {
            let fits = (f64::from(scene.dt_s) - config.dt_s).abs() <= 1e-6;
            let got = format!("{} s in scene {:?}", scene.dt_s, scene.name);
            require(fits, "dt_s", got, "the time step of the network")?;
        }
        let network = config.network()?;
        let scenes: Vec<Prepared> = scenes
            .into_par_iter()
            .map(|scene| Prepared {
                vehicles: vehicles(&scene),
                map: config.map.as_ref().map(|_| MapLines::from_scene(&scene)),
                road: network.road.then(|| Region::new(&scene.map.drivable_area)).flatten().map(Arc::new),
                routes: match config.route_points_m.is_empty() {
                    true => Vec::new(),
                    false => Route::of_all(&scene, LaneIndex::new(&scene.map).as_ref()),
                },
                scene,
            })
            .collect();
        let horizon = config.horizon_steps;
        let mut samples = Vec::new();
        for (index, prepared) in scenes.iter().enumerate() {
            let scene = &prepared.scene;
            for step in (FIRST_STEP..scene.num_steps.saturating_sub(horizon)).step_by(stride) {
                let whole = |a: &usize| (step..=step + horizon).all(|s| scene.is_valid(*a, s));
                if prepared.vehicles.iter().any(whole) {
                    samples.push((index as u32, step as u32));
                }
            }
        }
        if samples.is_empty() {
            return Err(ModelError::NoSamples {
                num_scenes,
                expected: format!("a vehicle logged for {horizon} steps after step {FIRST_STEP}"),
            });
        }
        Ok(Self { config: config.clone(), scenes, samples })
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.samples.len()
    }

    /// Whether there are none; never so.
    pub fn is_empty(&self) -> bool {
        self.samples.is_empty()
    }

    /// Number of scenes.
    pub fn num_scenes(&self) -> usize {
        self.scenes.len()
    }

    /// Changes the normalisation constants.
    pub fn set_normalisation(&mut self, normalisation: &Normalisation) {
        self.config.normalisation = normalisation.clone();
    }

    /// Features and futures of a sample (index below [`Self::len`]).
    ///
    /// The agents are the vehicles within `agents_within_m` of the ego, nearest first, at most `max_agents`. Differs from
    /// the released code, which truncates the list before it filters by distance (reference.md#training-samples).
    ///
    /// `noise` pushes some agents off their path (ours); `None` leaves the log as it is.
    ///
    /// # Errors
    /// [`ModelError::Shape`] for an index out of range.
    pub fn sample(&self, index: usize, noise: Option<Noise>) -> Result<(SceneFeatures, Futures)> {
        let Some(&(scene_idx, step)) = self.samples.get(index) else {
            return Err(ModelError::Shape {
                what: "sample index",
                got: index.to_string(),
                expected: format!("below {}", self.samples.len()),
            });
        };
        let (prepared, step) = (&self.scenes[scene_idx as usize], step as usize);
        let scene = &prepared.scene;
        let at = |a: usize| scene.tracks.position[scene.at(a, step)];
        let network = self.config.network()?;
        let tokens = network.samples_tokens;
        let parked = |a: usize| prepared.routes.get(a).is_some_and(Route::is_parked);
        let mut present: Vec<usize> =
            prepared.vehicles.iter().copied().filter(|a| scene.is_valid(*a, step)).collect();
        if let Some(&centre) = present.first() {
            let distance = |a: usize| (at(a) - at(centre)).norm();
            present.retain(|a| distance(*a) <= self.config.agents_within_m);
            present.sort_by(|a, b| distance(*a).total_cmp(&distance(*b)).then(a.cmp(b)));
            if tokens {
                // as worlds are planned for: parked vehicles are seen near those that move
                let moving: Vec<usize> = present.iter().copied().filter(|a| !parked(*a)).collect();
                let near = |a: usize| moving.iter().any(|b| (at(a) - at(*b)).norm() < STATIONARY_REACH_M);
                present.retain(|a| !parked(*a) || near(*a));
            }
            present.truncate(self.config.max_agents);
        }
        let mut window = Window::from_scene(scene, step, &present, self.config.history_steps);
        let speeds: Vec<f32> = (0..present.len()).map(|a| window.speed_now_mps(a)).collect();
        let first = index as u64 * self.config.max_agents as u64;
        let moves: Vec<Option<Move>> = (0..present.len())
            .zip(first..)
            .map(|(row, slot)| {
                if tokens {
                    // changes of speed are what is learned
                    let push = Lateral::draw(&noise?, slot, speeds[row])?;
                    return Move::Aside(push).applied(&mut window, row);
                }
                let drawn = Move::draw(&noise?, slot, speeds[row], || {
                    let (back, ahead) = (self.config.history_steps, self.config.horizon_steps);
                    (Trail::new(scene, present[row], step, back, ahead), self.config.dt_s as f32)
                })?;
                drawn.applied(&mut window, row)
            })
            .collect();
        if !prepared.routes.is_empty() {
            let routes = present.iter().map(|agent| &prepared.routes[*agent]);
            window.tell_routes(routes, &self.config.route_points_m);
        }
        let features = (network.features)(&window, prepared.map.as_ref(), &self.config)?;
        let recovery_s = if tokens { TOKEN_RECOVERY_S } else { ASIDE_S };
        let adapt = |row: usize, ahead: usize, pose: Pose2| match &moves[row] {
            Some(Move::Aside(push)) => {
                push.recover(pose, ahead as f32 * self.config.dt_s as f32, speeds[row], recovery_s)
            }
            Some(Move::Along(_, _, future)) => future.get(ahead - 1).copied().unwrap_or(pose),
            None => pose,
        };
        let mut futures = features::futures(scene, step, &present, &features, &self.config, adapt);
        if tokens {
            // an agent that never moves has no token
            let steps = self.config.horizon_steps;
            for (agent, valid) in features.agents.iter().zip(futures.valid.chunks_exact_mut(steps)) {
                if parked(present[*agent]) {
                    valid.fill(false);
                }
            }
        }
        Ok((features, futures))
    }

    fn samples(&self, indices: &[usize], noise: Option<Noise>) -> Result<Vec<(SceneFeatures, Futures)>> {
        indices.par_iter().map(|i| self.sample(*i, noise)).collect()
    }

    /// Tensors of some samples, with agents pushed off their path by `noise`.
    ///
    /// # Errors
    /// [`ModelError::Shape`] for an index out of range.
    pub fn batch(&self, indices: &[usize], noise: Option<Noise>, device: Device) -> Result<(Batch, Targets)> {
        let (features, futures): (Vec<_>, Vec<_>) = self.samples(indices, noise)?.into_iter().unzip();
        let mut batch = Batch::new(features, device)?;
        if self.config.network()?.road {
            let road = |at: &usize| self.scenes[self.samples[*at].0 as usize].road.clone();
            batch.roads = indices.iter().map(road).collect();
        }
        Ok((batch, Targets::new(&futures, &self.config, device)))
    }

    /// Samples of a training step: `count` at a time from one permutation per epoch, a function of seed and step alone.
    pub fn indices_of_step(&self, seed: u64, step: u64, count: usize) -> Vec<usize> {
        let len = self.samples.len() as u64;
        let (start, mut order, mut epoch) = (step * count as u64, Vec::new(), u64::MAX);
        (start..start + count as u64)
            .map(|at| {
                if at / len != epoch {
                    epoch = at / len;
                    order = Noise::new(seed, u64::MAX - epoch).permutation(self.samples.len());
                }
                order[(at % len) as usize]
            })
            .collect()
    }

    /// Estimates means and standard deviations from `count` samples drawn by a seed.
    ///
    /// # Errors
    /// What building the samples' features returns.
    pub fn estimate_normalisation(&self, count: usize, seed: u64) -> Result<Normalisation> {
        let mut order = Noise::new(seed, u64::MAX / 2).permutation(self.samples.len());
        order.truncate(count.max(1));
        let samples = self.samples(&order, None)?;
        let mut trajectory = [[0.0; 3]; 6];
        let mut history = [[0.0; 3]; 5];
        let mut edges = [[0.0; 3]; 4];
        let per_edge = self.config.history_token_steps().len() * EDGE_FEATURES;
        for (features, futures) in &samples {
            for (state, valid) in futures.states.chunks_exact(6).zip(&futures.valid) {
                if *valid {
                    trajectory.iter_mut().zip(state).for_each(|(m, v)| add(m, *v));
                }
            }
            for step in features.history.chunks_exact(HISTORY_FEATURES).filter(|s| s[7] > 0.5) {
                let picked = [step[0], step[1], step[4], step[5], step[6]];
                history.iter_mut().zip(picked).for_each(|(m, v)| add(m, v));
            }
            for (edge, is_edge) in features.edges.chunks_exact(per_edge).zip(&features.is_edge) {
                if *is_edge {
                    let now = &edge[per_edge - EDGE_FEATURES..];
                    let picked = [now[0], now[1], now[4], now[5]];
                    edges.iter_mut().zip(picked).for_each(|(m, v)| add(m, v));
                }
            }
        }
        let mut found = Normalisation {
            trajectory_mean: trajectory.each_ref().map(mean),
            trajectory_std: trajectory.each_ref().map(std),
            action_mean: [mean(&trajectory[4]), mean(&trajectory[5])],
            action_std: [std(&trajectory[4]), std(&trajectory[5])],
            history_mean: history.each_ref().map(mean),
            history_std: history.each_ref().map(std),
            ..Normalisation::default()
        };
        if edges[0][0] > 100.0 {
            // about zero, since the direction of an offset carries meaning
            let spread = |m: &[f64; 3]| (m[2] / m[0]).sqrt().max(0.1);
            found.edge_position_std = [spread(&edges[0]), spread(&edges[1])];
            found.edge_velocity_std = spread(&edges[2]).max(spread(&edges[3]));
        }
        Ok(found)
    }
}

/// Adds a number to count, sum and sum of squares.
fn add(moments: &mut [f64; 3], value: f32) {
    let v = f64::from(value);
    moments.iter_mut().zip([1.0, v, v * v]).for_each(|(m, v)| *m += v);
}

fn mean([count, sum, _]: &[f64; 3]) -> f64 {
    sum / count.max(1.0)
}

/// Standard deviation, at least 1e-3.
fn std(moments: &[f64; 3]) -> f64 {
    (moments[2] / moments[0].max(1.0) - mean(moments).powi(2)).max(0.0).sqrt().max(1e-3)
}
