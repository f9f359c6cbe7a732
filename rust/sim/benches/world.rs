//! What a step costs: `cargo bench -p ccdiff-sim --bench world`.
//!
//! Definitions. A scene-step is one step of one world. An agent-step is one step of one controlled agent: it is moved,
//! checked for collisions and road departures, rewarded and observed. Background agents are moved, too, but not
//! counted. Resets of ended episodes are included (SAME_STEP). Figures are per second of processor time of one thread
//! (Linux; of the wall clock elsewhere, and for two threads), best of several rounds.
//!
//! *default*: one controlled ego, the default observation, horizon 100 steps. *equal work*: all 64 agents controlled,
//! 7 + 63 x 7 + 200 x 7 = 1,848 floats each, horizon 91 steps: the work that other simulators' figures are quoted for.
//! The floor is filling the same observation buffer with a constant.

#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]

use ccdiff_sim::Result;
use ccdiff_sim::observe::ObservationConfig;
use ccdiff_sim::scene::Scene;
use ccdiff_sim::scene::synthetic::GridCity;
use ccdiff_sim::world::{
    Autoreset, Consequence, Controlled, NUM_COLUMNS, ResetRequest, StepBuffers, TickPhase, VecWorld,
    WorldConfig,
};
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

const ROUNDS: usize = 24;
const SECONDS_PER_ROUND: f64 = 0.15;

/// Seconds of processor time of this thread, or of the wall clock where that is not to be had.
fn now_s(start: Instant) -> f64 {
    let stat = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let cpu_ns = stat.and_then(|s| s.split_whitespace().next()?.parse::<f64>().ok());
    cpu_ns.map_or_else(|| start.elapsed().as_secs_f64(), |ns| ns * 1e-9)
}

/// Resident memory of this process, bytes; 0 where that is not to be had.
fn resident_bytes() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/statm").ok();
    let pages = stat.and_then(|s| s.split_whitespace().nth(1)?.parse::<f64>().ok());
    pages.unwrap_or(0.0) * 4096.0
}

/// Best seconds per call of a piece of work, by a clock.
fn best_s(clock: impl Fn() -> f64, mut work: impl FnMut() -> Result<()>) -> Result<f64> {
    let mut best = f64::MAX;
    for _ in 0..ROUNDS {
        let (wall, start, mut calls) = (Instant::now(), clock(), 0);
        while wall.elapsed().as_secs_f64() < SECONDS_PER_ROUND {
            for _ in 0..4 {
                work()?;
            }
            calls += 4;
        }
        best = best.min((clock() - start) / f64::from(calls));
    }
    Ok(best)
}

struct Bench {
    world: VecWorld,
    obs: Vec<f32>,
    final_obs: Vec<f32>,
    reward: Vec<f32>,
    columns: Vec<f32>,
    flags: [Vec<bool>; 5],
    actions: Vec<f32>,
    /// What the worlds added to the resident memory, without the buffers, bytes.
    world_bytes: f64,
}

impl Bench {
    fn new(scene: &Arc<Scene>, config: WorldConfig, envs: usize, threads: usize) -> Result<Self> {
        let slots = envs * config.num_slots;
        let world = VecWorld::new(vec![Arc::clone(scene)], config, envs, threads, Vec::new())?;
        let row = world.layout().size;
        let flags = [slots, slots, slots, envs, envs].map(|n| vec![false; n]);
        let mut bench = Self {
            obs: vec![1.0; slots * row],
            final_obs: vec![1.0; slots * row],
            reward: vec![0.0; slots],
            columns: vec![1.0; slots * NUM_COLUMNS],
            flags,
            // gentle actions, different for every agent
            actions: (0..2 * slots).map(|i| ((i * 37 % 101) as f32 / 101.0 - 0.5) * 0.2).collect(),
            world,
            world_bytes: 0.0,
        };
        let seeds: Vec<_> = (0..envs as u64).map(Some).collect();
        let none = vec![None; envs];
        let before = resident_bytes();
        let (world, out, _) = bench.parts();
        world.reset(&ResetRequest { seeds: &seeds, scenes: &none, ..ResetRequest::default() }, out)?;
        bench.world_bytes = resident_bytes() - before;
        Ok(bench)
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
            bev: &mut [],
            final_bev: &mut [],
        };
        (&mut self.world, out, &self.actions)
    }

    fn step(&mut self) -> Result<()> {
        let (world, out, actions) = self.parts();
        world.step(actions, None, out)
    }

    /// Shares of the phases in the time of a step, percent.
    fn phases(&mut self, steps: usize) -> Result<[f64; TickPhase::ALL.len()]> {
        let mut sums = [0.0; TickPhase::ALL.len()];
        for _ in 0..steps {
            let mut last = Instant::now();
            let (world, out, actions) = self.parts();
            let mut on_phase_end = |phase: TickPhase| {
                let now = Instant::now();
                sums[phase as usize] += (now - last).as_secs_f64();
                last = now;
            };
            world.step_in_phases(actions, out, &mut on_phase_end)?;
        }
        let total: f64 = sums.iter().sum();
        Ok(sums.map(|s| 100.0 * s / total))
    }
}

fn default_config(traffic: &str) -> WorldConfig {
    WorldConfig { traffic: traffic.into(), autoreset: Autoreset::SameStep, ..WorldConfig::default() }
}

fn comparison_row() -> ObservationConfig {
    let names = |n: &[&str]| Some(n.iter().map(|s| (*s).to_owned()).collect());
    ObservationConfig {
        num_neighbors: 63,
        num_route_points: 0,
        num_map_segments: 200,
        radius_m: 200.0,
        masks: false,
        ego_columns: names(&["speed", "acceleration", "yaw_rate", "length", "width", "off_road", "collided"]),
        agent_columns: names(&["x", "y", "cos", "sin", "speed", "length", "width"]),
        map_columns: names(&["x", "y", "cos", "sin", "half_length", "is_lane", "is_road_edge"]),
        ..ObservationConfig::default()
    }
}

/// All agents controlled, nothing ends but by the horizon.
fn equal_work(num_agents: usize) -> WorldConfig {
    WorldConfig {
        controlled: Controlled::Vehicles,
        num_slots: num_agents,
        on_collision: Consequence::Ignore,
        on_off_road: Consequence::Ignore,
        terminate_at_goal: false,
        horizon_steps: 91,
        observation: comparison_row(),
        ..default_config("replay")
    }
}

fn city(num_agents: usize, num_roads: usize) -> Result<Arc<Scene>> {
    let city = GridCity { num_agents, num_roads, ..GridCity::default() };
    Ok(Arc::new(city.scene().validated()?))
}

fn report(name: &str, scene: &Arc<Scene>, config: &WorldConfig, envs: usize, threads: usize) -> Result<()> {
    let mut bench = Bench::new(scene, config.clone(), envs, threads)?;
    let start = Instant::now();
    let wall = || start.elapsed().as_secs_f64();
    let cpu = || now_s(start);
    let seconds = if threads == 1 { best_s(cpu, || bench.step())? } else { best_s(wall, || bench.step())? };
    let scene_steps = envs as f64 / seconds;
    let agent_steps = scene_steps * config.num_slots as f64;
    let fill = best_s(cpu, || {
        bench.obs.fill(black_box(0.5));
        black_box(&bench.obs);
        Ok(())
    })?;
    let slots = (envs * config.num_slots) as f64;
    let (step_ns, fill_ns) = (seconds * 1e9 / slots, fill * 1e9 / slots);
    let phases = (256 / envs).clamp(4, 100);
    let split = bench.phases(phases)?.map(|p| format!("{p:>3.0}")).join(" ");
    let kib = bench.world_bytes / 1024.0 / envs as f64;
    // one world's memory is lost in the noise of the pages
    let kib = if envs >= 64 { format!("{kib:.0}") } else { "-".into() };
    println!(
        "{name:22} {envs:>5} {threads:>2} {:>4} {:>4} {:>5} {scene_steps:>9.0} {agent_steps:>9.0} {step_ns:>6.0} \
         {fill_ns:>5.0} {:>5.1} {kib:>5}  [{split}]",
        scene.num_agents(),
        config.num_slots,
        bench.world.layout().size,
        step_ns / fill_ns,
    );
    Ok(())
}

/// One row of the table: name, agents and roads of the city, configuration, worlds, threads.
type Row = (String, usize, usize, WorldConfig, usize, usize);

fn rows() -> Vec<Row> {
    let mut rows = Vec::new();
    for (name, traffic) in [("default, replay", "replay"), ("default, IDM", "idm")] {
        for (envs, threads) in [(1, 1), (64, 1), (1024, 1), (1024, 2)] {
            rows.push((name.to_owned(), 32, 3, default_config(traffic), envs, threads));
        }
    }
    for (envs, threads) in [(1, 1), (64, 1), (1024, 1), (1024, 2)] {
        rows.push(("equal work".to_owned(), 64, 3, equal_work(64), envs, threads));
    }
    for agents in [8, 32, 64, 128, 256] {
        rows.push(("agents per scene".to_owned(), agents, 5, equal_work(agents), 4, 1));
    }
    for roads in [1, 3, 9, 15] {
        rows.push((format!("map of {roads} x {roads} roads"), 32, roads, equal_work(32), 4, 1));
    }
    rows
}

/// Prints the table. Every row is measured in a process of its own, called with the row's number: memory that another
/// row has left behind makes the pages of the buffers smaller.
fn main() -> std::result::Result<(), Box<dyn std::error::Error>> {
    let rows = rows();
    let chosen = std::env::args().find_map(|a| a.strip_prefix("row=").and_then(|k| k.parse::<usize>().ok()));
    if let Some((name, agents, roads, config, envs, threads)) = chosen.and_then(|k| rows.get(k)) {
        return Ok(report(name, &city(*agents, *roads)?, config, *envs, *threads)?);
    }
    println!(
        "E worlds, n threads, A agents in the scene, C of them controlled, D floats of observation each;"
    );
    println!(
        "ns/as: nanoseconds per agent-step; fill: of filling its D floats alone; KiB: memory of one more world;"
    );
    println!("last: percent of the time in {}.", VecWorld::phase_names().join(", "));
    println!("{:22}     E  n    A    C     D scene-st/s agent-st/s ns/as  fill ratio   KiB", "");
    let this = std::env::current_exe()?;
    for k in 0..rows.len() {
        std::process::Command::new(&this).arg(format!("row={k}")).status()?;
    }
    Ok(())
}
