//! What a step costs: `cargo bench -p ccdiff-sim --bench world`.
//!
//! Definitions. A scene-step is one step of one world. An agent-step is one step of one controlled agent: it is moved,
//! checked for collisions and road departures, rewarded and observed. Background agents are not counted. Resets of
//! ended episodes are included (SAME_STEP). One thread.

use ccdiff_sim::observe::ObservationConfig;
use ccdiff_sim::scene::Scene;
use ccdiff_sim::scene::synthetic::GridCity;
use ccdiff_sim::world::{
    Autoreset, Consequence, Controlled, Driver, NUM_COLUMNS, ResetRequest, StepBuffers, TickPhase, VecWorld,
    WorldConfig,
};
use std::sync::Arc;
use std::time::Instant;

struct Bench {
    world: VecWorld,
    obs: Vec<f32>,
    final_obs: Vec<f32>,
    reward: Vec<f32>,
    columns: Vec<f32>,
    flags: [Vec<bool>; 5],
    actions: Vec<f32>,
}

impl Bench {
    fn new(scene: &Arc<Scene>, config: WorldConfig, envs: usize) -> Self {
        let slots = envs * config.num_slots;
        let world = VecWorld::new(vec![Arc::clone(scene)], config, envs, 1, None).expect("a legal bench");
        let row = world.layout().size;
        let flags = [slots, slots, slots, envs, envs].map(|n| vec![false; n]);
        let mut bench = Self {
            obs: vec![0.0; slots * row],
            final_obs: vec![0.0; slots * row],
            reward: vec![0.0; slots],
            columns: vec![0.0; slots * NUM_COLUMNS],
            flags,
            // gentle actions, different for every agent
            actions: (0..2 * slots).map(|i| ((i * 37 % 101) as f32 / 101.0 - 0.5) * 0.2).collect(),
            world,
        };
        let seeds: Vec<_> = (0..envs as u64).map(Some).collect();
        let none = vec![None; envs];
        let (world, out, _) = bench.parts();
        world.reset(&ResetRequest { seeds: &seeds, scenes: &none, mask: None }, out).expect("reset");
        bench
    }

    fn parts(&mut self) -> (&mut VecWorld, StepBuffers<'_>, &[f32]) {
        let [terminated, truncated, alive, done, was_reset] = &mut self.flags;
        let out = StepBuffers {
            obs: &mut self.obs,
            reward: &mut self.reward,
            terminated,
            truncated,
            alive,
            columns: &mut self.columns,
            done,
            was_reset,
            final_obs: &mut self.final_obs,
        };
        (&mut self.world, out, &self.actions)
    }

    /// Seconds per step of the whole batch, best of a few rounds.
    fn seconds_per_step(&mut self) -> f64 {
        let mut best = f64::MAX;
        for round in 0..6 {
            let (start, mut steps) = (Instant::now(), 0);
            while start.elapsed().as_secs_f64() < 0.25 {
                for _ in 0..4 {
                    let (world, out, actions) = self.parts();
                    world.step(actions, out).expect("step");
                    steps += 1;
                }
            }
            if round > 0 {
                best = best.min(start.elapsed().as_secs_f64() / f64::from(steps));
            }
        }
        best
    }

    fn phases(&mut self) -> [f64; TickPhase::ALL.len()] {
        let mut sums = [0.0; TickPhase::ALL.len()];
        for _ in 0..200 {
            let mut last = Instant::now();
            let (world, out, actions) = self.parts();
            let mut lap = |phase: TickPhase| {
                let now = Instant::now();
                sums[phase as usize] += (now - last).as_secs_f64();
                last = now;
            };
            world.step_in_phases(actions, out, &mut lap).expect("step");
        }
        let total: f64 = sums.iter().sum();
        sums.map(|s| 100.0 * s / total)
    }
}

fn default_config(traffic: Driver) -> WorldConfig {
    WorldConfig { traffic, autoreset: Autoreset::SameStep, ..WorldConfig::default() }
}

fn comparison_row() -> ObservationConfig {
    let names = |n: &[&str]| Some(n.iter().map(|s| (*s).to_owned()).collect());
    ObservationConfig {
        num_agents: 63,
        num_route_points: 0,
        num_map_pieces: 200,
        radius_m: 200.0,
        masks: false,
        ego_columns: names(&["speed", "acceleration", "yaw_rate", "length", "width", "off_road", "collided"]),
        agent_columns: names(&["x", "y", "cos", "sin", "speed", "length", "width"]),
        map_columns: names(&["x", "y", "cos", "sin", "half_length", "is_lane", "is_road_edge"]),
        ..ObservationConfig::default()
    }
}

/// All agents controlled, observations of 7 + 63 x 7 + 200 x 7 = 1,848 floats, nothing ends but by the horizon.
fn equal_work(num_agents: usize) -> WorldConfig {
    WorldConfig {
        controlled: Controlled::Vehicles,
        num_slots: num_agents,
        on_collision: Consequence::Ignore,
        on_off_road: Consequence::Ignore,
        terminate_at_goal: false,
        horizon_steps: 91,
        observation: comparison_row(),
        ..default_config(Driver::Replay)
    }
}

fn report(name: &str, scene: &Arc<Scene>, config: &WorldConfig, envs: usize) {
    let mut bench = Bench::new(scene, config.clone(), envs);
    let seconds = bench.seconds_per_step();
    let scene_steps = envs as f64 / seconds;
    let agent_steps = scene_steps * config.num_slots as f64;
    let row = bench.world.layout().size;
    let start = Instant::now();
    for i in 0..50 {
        bench.obs.fill(i as f32);
        std::hint::black_box(&bench.obs);
    }
    let fill = start.elapsed().as_secs_f64() / 50.0;
    let split = bench.phases().map(|p| format!("{p:.0}")).join(" ");
    println!(
        "{name:29} E={envs:<4} A={:<3} C={:<3} D={row:<4} {scene_steps:>9.0} scene-steps/s {agent_steps:>9.0} agent-steps/s \
         {:>5.1} x fill [{split}] %",
        scene.num_agents(),
        config.num_slots,
        seconds / fill,
    );
}

fn main() {
    println!("phases: {}", VecWorld::phase_names().join(", "));
    let city = |num_agents, num_roads| {
        let city = GridCity { num_agents, num_roads, ..GridCity::default() };
        Arc::new(city.scene().validated().expect("a legal city"))
    };
    for envs in [1, 64, 1024] {
        report("ego in replay traffic", &city(32, 3), &default_config(Driver::Replay), envs);
    }
    for envs in [1, 64, 1024] {
        report("ego in IDM traffic", &city(32, 3), &default_config(Driver::Idm), envs);
    }
    for envs in [1, 16, 64] {
        report("all controlled, 1,848 floats", &city(64, 3), &equal_work(64), envs);
    }
    for agents in [8, 64, 256] {
        report("agents per scene", &city(agents, 5), &equal_work(agents), 4);
    }
    for roads in [1, 3, 9, 15] {
        report("size of the map", &city(32, roads), &equal_work(32), 4);
    }
}
