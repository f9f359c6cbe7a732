//! The playground: a scene, its world, and the arrays that JavaScript reads.

use ccdiff_nets::compute::weights::{Entry, parse, tensors};
use ccdiff_nets::networks::trajectory_model::TrajectoryModel;
use ccdiff_nets::traffic::egos::NetworkOfEgo;
use ccdiff_nets::traffic::swift::{DT_S, SWIFT, Swift};
use ccdiff_nets::traffic::{CcdiffConfig, PlannedTraffic};
use ccdiff_nuscenes::decode_scene;
use ccdiff_sim::drivers::{Driver, DriverModel};
use ccdiff_sim::options::read;
use ccdiff_sim::scene::Scene;
use ccdiff_sim::world::{ResetRequest, StepBuffers, VecWorld, WorldConfig};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Numbers of a state.
const STATE: usize = 8;

macro_rules! arrays {
    ($($name:ident: $type:ty),+) => {
        /// The arrays of a step.
        #[derive(Default)]
        pub(crate) struct Arrays {
            $(pub(crate) $name: Vec<$type>),+
        }

        impl Arrays {
            /// Arrays of the sizes that a world asks for.
            fn of(world: &VecWorld) -> Self {
                let specs = world.extent().arrays(world.num_worlds());
                let size = |name: &str| {
                    let spec = specs.iter().find(|s| s.name == name && !s.shape.is_empty());
                    spec.map_or(0, |s| s.shape.iter().product())
                };
                Self { $($name: vec![<$type>::default(); size(stringify!($name))]),+ }
            }

            fn buffers(&mut self) -> StepBuffers<'_> {
                StepBuffers { $($name: &mut self.$name),+ }
            }
        }
    };
}

ccdiff_sim::with_step_arrays!(arrays);

/// What a page plays.
#[derive(Default)]
pub(crate) struct Playground {
    /// Bytes from JavaScript.
    pub(crate) given: Vec<u8>,
    /// Why the last call failed.
    pub(crate) message: String,
    /// Present states [A, 8].
    pub(crate) states: Vec<f32>,
    /// Output of the last step.
    pub(crate) out: Arrays,
    /// Bytes of the weights of networks, by the name of their kind.
    weights: Vec<(String, Vec<u8>)>,
    scene: Option<Arc<Scene>>,
    world: Option<VecWorld>,
    /// Weights of the trained ego by name: shape and numbers.
    tensors: BTreeMap<String, Entry>,
    /// The trained ego for what the world observes, once it was asked.
    trained: Option<NetworkOfEgo>,
    /// Its last action.
    pub(crate) action: Vec<f32>,
    /// The plan in force, see [`crate::plan`].
    pub(crate) plan: Vec<f32>,
}

/// Drivers by name.
type Drivers = Vec<(String, Box<dyn DriverModel>)>;

impl Playground {
    pub(crate) fn num_agents(&self) -> usize {
        self.states.len() / STATE
    }

    pub(crate) fn load(&mut self) -> Result<(), String> {
        let bytes = std::mem::take(&mut self.given);
        self.scene = Some(Arc::new(decode_scene(&bytes).map_err(|e| e.to_string())?));
        self.world = None;
        Ok(())
    }

    /// Keeps the weights of a network, checked.
    pub(crate) fn weights(&mut self) -> Result<(), String> {
        let bytes = std::mem::take(&mut self.given);
        let path = Path::new("weights");
        let file = parse(path, &bytes).map_err(|e| e.to_string())?;
        let kind = if Swift::new(CcdiffConfig::default(), path, file.clone(), DT_S, 1).is_ok() {
            SWIFT.name.into()
        } else {
            let model = TrajectoryModel::new(path, file).map_err(|e| e.to_string())?;
            model.config().kind.as_str().into()
        };
        self.weights.push((kind, bytes));
        Ok(())
    }

    /// Keeps the weights of the trained ego.
    pub(crate) fn ego(&mut self) -> Result<(), String> {
        let bytes = std::mem::take(&mut self.given);
        self.tensors.extend(tensors(Path::new("ego"), &bytes).map_err(|e| e.to_string())?);
        Ok(())
    }

    /// Lets the trained ego decide on what the world observes.
    pub(crate) fn decide(&mut self) -> Result<(), String> {
        let (world, observed) = (self.world.as_ref().ok_or("decide before reset")?, &self.out.obs);
        if self.trained.is_none() {
            let network = NetworkOfEgo::new(world.layout(), 2, self.tensors.clone());
            self.trained = Some(network.map_err(|e| e.to_string())?);
        }
        self.action = self.trained.as_mut().map(|network| network.act(observed)).unwrap_or_default();
        Ok(())
    }

    /// The networks that a configuration of worlds has.
    fn traffic(&self, options: &str, scene: &Arc<Scene>) -> Result<Drivers, String> {
        let options: serde_json::Value = serde_json::from_str(options).map_err(|e| e.to_string())?;
        let mut drivers = Drivers::new();
        for (kind, bytes) in &self.weights {
            let Some(asked) = options["named_drivers"][kind].get(kind) else { continue };
            let config: CcdiffConfig = read(kind, &asked.to_string()).map_err(|e| e.to_string())?;
            let dt_s = options["dt_s"].as_f64().ok_or("no dt_s")? as f32;
            let path = Path::new(kind);
            let file = parse(path, bytes).map_err(|e| e.to_string())?;
            if kind == SWIFT.name {
                let driver = Swift::new(config, path, file, dt_s, 1).map_err(|e| e.to_string())?;
                drivers.push((kind.clone(), Box::new(driver)));
                continue;
            }
            let model = TrajectoryModel::new(path, file).map_err(|e| e.to_string())?;
            let driver = PlannedTraffic::of(config, vec![model], None).map_err(|e| e.to_string())?;
            driver.check(dt_s, std::slice::from_ref(scene)).map_err(|e| e.to_string())?;
            drivers.push((kind.clone(), Box::new(driver)));
        }
        Ok(drivers)
    }

    pub(crate) fn reset(&mut self, seed: u64) -> Result<(), String> {
        let text = String::from_utf8(std::mem::take(&mut self.given)).map_err(|e| e.to_string())?;
        let config = WorldConfig::from_json(&text).map_err(|e| e.to_string())?;
        let scene = self.scene.clone().ok_or("reset before load")?;
        let drivers = self.traffic(&text, &scene)?;
        let mut world = VecWorld::new(vec![scene], config, 1, 1, drivers).map_err(|e| e.to_string())?;
        self.out = Arrays::of(&world);
        self.trained = None;
        let request = ResetRequest { seeds: &[Some(seed)], scenes: &[Some(0)], ..ResetRequest::default() };
        world.reset(&request, self.out.buffers()).map_err(|e| e.to_string())?;
        self.world = Some(world);
        self.keep()
    }

    pub(crate) fn step(&mut self, action: [f32; 2]) -> Result<(), String> {
        let world = self.world.as_mut().ok_or("step before reset")?;
        world.step(&action, None, self.out.buffers()).map_err(|e| e.to_string())?;
        self.keep()
    }

    /// Writes the present states.
    fn keep(&mut self) -> Result<(), String> {
        let world = self.world.as_ref().ok_or("no world")?;
        let status = world.status(0).map_err(|e| e.to_string())?;
        let s = status.states;
        let mut plans =
            self.weights.iter().filter_map(|(kind, _)| world.explain(0, Some(kind)).ok().flatten());
        let plan = plans.next();
        let flag = |on: bool| if on { 1.0 } else { 0.0 };
        let guided =
            |agent| plan.is_some_and(|p| p.agents.iter().zip(&p.guided).any(|(a, on)| *on && *a == agent));
        self.plan.clear();
        if let Some(p) = plan {
            let rows = p.agents.len();
            self.plan.extend([p.made_at as f32, rows as f32, p.num_steps as f32]);
            for (row, agent) in p.agents.iter().enumerate() {
                self.plan.extend([*agent as f32, flag(p.guided[row]), flag(p.follows_plan[row])]);
                let begin = 3 * (p.selected_sample[row] * rows + row) * p.num_steps;
                let way = p.samples[begin..begin + 3 * p.num_steps].chunks_exact(3);
                self.plan.extend(way.flat_map(|pose| [pose[0], pose[1]]));
            }
            self.plan.extend(p.graph.iter().map(|edge| flag(*edge)));
        }
        self.states.clear();
        for a in 0..s.len() {
            let driver = match status.drivers[a] {
                Driver::External | Driver::Towed => -1.0,
                Driver::Model(place) => f32::from(place),
            };
            let there = flag(s.active[a]);
            let [vx, vy] = [s.velocity_x_mps[a], s.velocity_y_mps[a]];
            self.states.extend([s.x[a], s.y[a], s.heading_rad[a], vx, vy, there, driver, flag(guided(a))]);
        }
        Ok(())
    }
}
