//! `VecWorld`: many worlds stepped as one batch, writing into the caller's arrays.

use crate::drivers;
use crate::enter::{check_process, enter, flags};
use crate::planner::PyPlanner;
use crate::scene::PyScene;
use crate::schemas::to_json;
use crate::step_arrays::{Outputs, elements, typed, writable};
use crate::swift;
use crate::world_plans;
use crate::world_state;
use ccdiff_bridge::errors::{from_sim, py};
use ccdiff_sim::drivers::PlanOverride;
use ccdiff_sim::geom::Point2;
use ccdiff_sim::world::{
    ArraySpec, CANDIDATE_FEATURES, COMPONENTS, NUM_METRICS, ResetRequest, Slot, VecWorld, Wanted, WorldConfig,
};
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyBytes, PyDict, PyTuple};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, TryLockError};

/// Ego (index), start (step) and style (factors by name) of an episode, where they are asked for.
type WantedEpisode = (Option<usize>, Option<usize>, BTreeMap<String, f32>);
/// Off the road with a corner [A], and with the centre [A].
type OffRoadArrays<'py> = (Bound<'py, PyArray1<bool>>, Bound<'py, PyArray1<bool>>);
/// Lane and position along it, and seconds to a contact.
type ScoreRow = (Option<(u32, f32)>, Option<f32>);

/// Worlds that play scenes. One thread at a time: a second one gets `ThreadError`.
#[pyclass(frozen, name = "VecWorld", module = "ccdiff_env._native")]
pub(crate) struct PyVecWorld {
    /// Process in which they were made.
    home: u32,
    held: Mutex<Held>,
}

/// What one thread at a time works with.
struct Held {
    world: VecWorld,
    /// Actions of the present step.
    actions: Vec<f32>,
    /// The arrays that a reset or step writes.
    arrays: Vec<ArraySpec>,
}

/// Where a world is.
#[pyclass(frozen, get_all, name = "WorldStatus", module = "ccdiff_env._native")]
pub(crate) struct PyWorldStatus {
    /// Index of the scene.
    scene_idx: usize,
    /// Seed that the world's generator was last started from.
    seed: u64,
    /// Episodes begun since that seed.
    episode: u64,
    /// Step of the log that the states stand at.
    step_idx: usize,
    /// Steps since the episode began.
    elapsed_steps: usize,
    /// Index of the ego; `None` in a scene without one.
    ego_idx: Option<usize>,
}

#[pymethods]
impl PyWorldStatus {
    fn __repr__(&self) -> String {
        let ego = self.ego_idx.map_or_else(|| "None".to_owned(), |ego| ego.to_string());
        format!(
            "WorldStatus(scene_idx={}, seed={}, episode={}, step_idx={}, elapsed_steps={}, ego_idx={ego})",
            self.scene_idx, self.seed, self.episode, self.step_idx, self.elapsed_steps
        )
    }
}

impl PyVecWorld {
    /// The worlds, for the calling thread alone.
    fn lock(&self) -> PyResult<MutexGuard<'_, Held>> {
        match self.held.try_lock() {
            Ok(held) => Ok(held),
            Err(TryLockError::Poisoned(held)) => Ok(held.into_inner()),
            Err(TryLockError::WouldBlock) => Err(py::ThreadError::new_err(
                "another thread is at work in these worlds: give each thread an environment of its own, such as a \
                 copy, or take turns with a threading.Lock",
            )),
        }
    }

    /// The same in the process in which the worlds were made.
    fn here(&self) -> PyResult<MutexGuard<'_, Held>> {
        check_process(self.home)?;
        self.lock()
    }
}

#[pymethods]
impl PyVecWorld {
    /// Worlds over scenes; `hand` as [`drivers::make_drivers`] calls it.
    #[new]
    #[pyo3(signature = (scenes, config, num_worlds, num_threads, hand=None))]
    fn new(
        py: Python<'_>,
        scenes: Vec<PyRef<'_, PyScene>>,
        config: &str,
        num_worlds: usize,
        num_threads: usize,
        hand: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let scenes: Vec<_> = scenes.iter().map(|s| Arc::clone(&s.scene)).collect();
        let config = WorldConfig::from_json(config).map_err(from_sim)?;
        let made = drivers::make_drivers(&config, &scenes, num_threads, hand.as_ref())?;
        let world = enter(py, || {
            VecWorld::new(scenes, drivers::without_defaults(config), num_worlds, num_threads, made)
                .map_err(from_sim)
        })?;
        let arrays = world.extent().arrays(num_worlds);
        let held = Held { world, actions: Vec::new(), arrays };
        Ok(Self { home: std::process::id(), held: Mutex::new(held) })
    }

    /// Draws the scenes of later episodes by weights [S]; all alike for `None`.
    fn set_scene_weights(&self, weights: Option<Vec<f64>>) -> PyResult<()> {
        self.here()?.world.set_scene_weights(weights.as_deref()).map_err(from_sim)
    }

    /// Takes the autoreset mode of a configuration (JSON), before the first reset.
    fn set_autoreset(&self, config: &str) -> PyResult<()> {
        let mut me = self.here()?;
        let config = WorldConfig::from_json(config).map_err(from_sim)?;
        me.world.set_autoreset(config.autoreset).map_err(from_sim)?;
        me.arrays = me.world.extent().arrays(me.world.num_worlds());
        Ok(())
    }

    /// Begins new episodes in all worlds, or in those of `mask`, and writes into the arrays of `out`; `wanted` are egos
    /// (indices), starts (steps) and styles (factors by name).
    #[pyo3(signature = (seeds, scenes, mask, out, wanted=Vec::new()))]
    fn reset<'py>(
        &self,
        py: Python<'py>,
        seeds: Vec<Option<u64>>,
        scenes: Vec<Option<usize>>,
        mask: Option<Vec<bool>>,
        out: &Bound<'py, PyTuple>,
        wanted: Vec<WantedEpisode>,
    ) -> PyResult<()> {
        let mut me = self.here()?;
        let me = &mut *me;
        let mut outputs = Outputs::check(out, &me.arrays)?;
        let buffers = outputs.buffers()?;
        let world = &mut me.world;
        let wanted: Vec<_> =
            wanted.into_iter().map(|(ego, start, style)| Wanted { ego, start, style }).collect();
        let request = ResetRequest { seeds: &seeds, scenes: &scenes, wanted: &wanted, mask: mask.as_deref() };
        enter(py, || world.reset(&request, buffers).map_err(from_sim))
    }

    /// One step of all worlds, or of those of `active` [E]; actions [E, C, W] float32.
    #[pyo3(signature = (actions, out, active=None))]
    fn step<'py>(
        &self,
        py: Python<'py>,
        actions: &Bound<'py, PyAny>,
        out: &Bound<'py, PyTuple>,
        active: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<()> {
        let mut me = self.here()?;
        let me = &mut *me;
        let shape = [me.world.num_worlds(), me.world.config().num_slots, me.world.decoder().width()];
        // copied, so that no other thread changes them while the GIL is released
        me.actions.clear();
        me.actions.extend_from_slice(typed::<f32>("actions", actions, &shape)?.try_readonly()?.as_slice()?);
        let active = match active {
            Some(mask) => Some(flags(&typed::<bool>("active", mask, &shape[..1])?.try_readonly()?)?),
            None => None,
        };
        let active = active.as_deref();
        let mut outputs = Outputs::check(out, &me.arrays)?;
        let (world, actions, buffers) = (&mut me.world, &me.actions, outputs.buffers()?);
        enter(py, || world.step(actions, active, buffers).map_err(from_sim))
    }

    /// Writes the present observations [C, D] and rasters [C, P, S, S] of one world.
    #[pyo3(signature = (world_idx, obs, bev=None))]
    fn observe<'py>(
        &self,
        world_idx: usize,
        obs: &Bound<'py, PyAny>,
        bev: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<()> {
        let mut me = self.here()?;
        let shape = [me.world.config().num_slots, me.world.layout().size];
        let mut obs = writable::<f32>("obs", obs, &shape)?;
        let raster = me.world.extent().raster;
        let shape = [shape[0], raster[0], raster[1], raster[2]];
        let mut bev = bev.map(|a| writable::<u8>("bev", a, &shape)).transpose()?;
        me.world.observe(world_idx, obs.as_slice_mut()?, elements(&mut bev)?).map_err(from_sim)
    }

    /// The schema of the observation row as JSON.
    #[getter]
    fn layout_json(&self) -> PyResult<String> {
        let me = self.lock()?;
        to_json(me.world.layout())
    }

    #[getter]
    fn num_worlds(&self) -> PyResult<usize> {
        Ok(self.lock()?.world.num_worlds())
    }

    /// Numbers per action.
    #[getter]
    fn action_width(&self) -> PyResult<usize> {
        Ok(self.lock()?.world.decoder().width())
    }

    /// Number of discrete actions, `None` for continuous ones.
    #[getter]
    fn num_actions(&self) -> PyResult<Option<usize>> {
        Ok(self.lock()?.world.decoder().num_actions())
    }

    /// Names and units of the physical quantities of an action, and their values at -1 and +1.
    #[getter]
    fn action_bounds(&self) -> PyResult<Vec<(&'static str, f32, f32)>> {
        let me = self.lock()?;
        let decoder = me.world.decoder();
        let (low, high) = decoder.physical_bounds();
        let names = decoder.dynamics().columns().iter();
        Ok(names.zip(low.into_iter().zip(high)).map(|(name, (low, high))| (*name, low, high)).collect())
    }

    /// Everything that the future of a world depends on.
    fn snapshot<'py>(&self, py: Python<'py>, world_idx: usize) -> PyResult<Bound<'py, PyBytes>> {
        let me = self.here()?;
        Ok(PyBytes::new(py, &me.world.snapshot(world_idx).map_err(from_sim)?))
    }

    /// Puts a world into the state of a snapshot.
    fn restore(&self, py: Python<'_>, world_idx: usize, snapshot: &[u8]) -> PyResult<()> {
        let mut me = self.here()?;
        let world = &mut me.world;
        enter(py, || world.restore(world_idx, snapshot).map_err(from_sim))
    }

    /// Lets a world go on with the random numbers of another seed.
    fn reseed(&self, world_idx: usize, seed: u64) -> PyResult<()> {
        self.here()?.world.reseed(world_idx, seed).map_err(from_sim)
    }

    /// Digest of everything that the future of a world depends on, its place in the batch
    /// included: digests are compared of one place.
    fn digest(&self, world_idx: usize) -> PyResult<u64> {
        self.here()?.world.digest(world_idx).map_err(from_sim)
    }

    /// Whether a world was ever reset.
    fn begun(&self, world_idx: usize) -> PyResult<bool> {
        Ok(self.lock()?.world.status(world_idx).is_ok())
    }

    /// Where a world is.
    fn status(&self, world_idx: usize) -> PyResult<PyWorldStatus> {
        let me = self.lock()?;
        let s = me.world.status(world_idx).map_err(from_sim)?;
        Ok(PyWorldStatus {
            scene_idx: s.scene_idx,
            seed: s.seed,
            episode: s.episode,
            step_idx: s.step_idx,
            elapsed_steps: s.elapsed_steps,
            ego_idx: s.ego,
        })
    }

    /// Name, dtype and shape of the arrays that a reset or step writes; no shape where there is no such array.
    fn step_arrays(&self) -> PyResult<Vec<(&'static str, &'static str, Vec<usize>)>> {
        Ok(self.lock()?.arrays.iter().map(|a| (a.name, a.dtype, a.shape.clone())).collect())
    }

    /// Present states of the agents as new arrays; entries of agents that are not active are zero.
    fn states<'py>(&self, py: Python<'py>, world_idx: usize) -> PyResult<Bound<'py, PyDict>> {
        let me = self.lock()?;
        world_state::states(py, &me.world.status(world_idx).map_err(from_sim)?)
    }

    /// Metrics [N, C, K] of the last episodes that ended in some worlds.
    fn ended_metrics<'py>(&self, py: Python<'py>, worlds: Vec<usize>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let me = self.lock()?;
        let mut flat = Vec::new();
        for world_idx in &worlds {
            flat.extend(me.world.ended_metrics(*world_idx).map_err(from_sim)?.iter().flatten());
        }
        let shape = [worlds.len(), me.world.config().num_slots, NUM_METRICS];
        PyArray1::from_vec(py, flat).reshape(shape)
    }

    /// Metrics [C, K] of a world's present episode so far.
    fn metrics<'py>(&self, py: Python<'py>, world_idx: usize) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let me = self.lock()?;
        let slots = me.world.status(world_idx).map_err(from_sim)?.slots;
        let metrics = slots.iter().flat_map(|slot| slot.metrics()).collect();
        PyArray1::from_vec(py, metrics).reshape([slots.len(), NUM_METRICS])
    }

    /// Puts a driver into vehicles of a world.
    fn assign(&self, world_idx: usize, agents: Vec<usize>, driver: &str) -> PyResult<()> {
        self.here()?.world.assign(world_idx, &agents, driver).map_err(from_sim)
    }

    /// What is asked of a world's next plans: agents to be guided, strength of the guidance.
    #[pyo3(signature = (world_idx, *, guided, criticality))]
    fn override_plan(
        &self,
        world_idx: usize,
        guided: Option<Vec<usize>>,
        criticality: Option<f32>,
    ) -> PyResult<()> {
        self.here()?.world.override_plan(world_idx, PlanOverride { guided, criticality }).map_err(from_sim)
    }

    /// The plan of a driver (the first that plans, by default) that a world follows as a dictionary of new arrays;
    /// `None` before the first one of its episode.
    #[pyo3(signature = (world_idx, driver=None))]
    fn explain<'py>(
        &self,
        py: Python<'py>,
        world_idx: usize,
        driver: Option<&str>,
    ) -> PyResult<Option<Bound<'py, PyDict>>> {
        let me = self.here()?;
        let plan = me.world.explain(world_idx, driver).map_err(from_sim)?;
        plan.map(|plan| world_plans::dict(py, plan)).transpose()
    }

    /// What swift traffic would see of vehicles of a world, rows [n, F] (`ccdiff_env.training.distil`).
    fn swift_rows<'py>(
        &self,
        py: Python<'py>,
        world_idx: usize,
        agents: Vec<usize>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let me = self.lock()?;
        let status = me.world.status(world_idx).map_err(from_sim)?;
        swift::rows(py, &status, &agents)
    }

    /// The vehicles that the latest plan guides, and the sum of their `moved_m`, NaN where it is not kept;
    /// `None` where it guides none.
    fn guidance(&self, world_idx: usize) -> PyResult<Option<(Vec<usize>, f32)>> {
        let me = self.lock()?;
        let Some(plan) = me.world.explain(world_idx, None).map_err(from_sim)? else { return Ok(None) };
        let rows = || (0..plan.agents.len()).filter(|row| plan.guided[*row]);
        let moved_m = rows().map(|row| plan.moved_m.get(row).copied().unwrap_or(f32::NAN)).sum();
        let agents: Vec<usize> = rows().map(|row| plan.agents[row]).collect();
        Ok((!agents.is_empty()).then_some((agents, moved_m)))
    }

    /// Name of the driver of each agent.
    fn drivers(&self, world_idx: usize) -> PyResult<Vec<String>> {
        let me = self.lock()?;
        let status = me.world.status(world_idx).map_err(from_sim)?;
        Ok(status.drivers.iter().map(|d| me.world.driver_name(*d).0.to_owned()).collect())
    }

    /// Names of the drivers of this batch, each with its kind.
    #[getter]
    fn driver_table(&self) -> PyResult<Vec<(String, String)>> {
        let me = self.lock()?;
        Ok(me.world.driver_table().map(|(name, kind)| (name.to_owned(), kind.to_owned())).collect())
    }

    /// Names of the drivers that plan.
    #[getter]
    fn planners(&self) -> PyResult<Vec<String>> {
        Ok(self.lock()?.world.planner_names().map(str::to_owned).collect())
    }

    /// Agent of each slot.
    fn slot_agents(&self, world_idx: usize) -> PyResult<Vec<Option<usize>>> {
        Ok(self.lock()?.world.status(world_idx).map_err(from_sim)?.slot_agents())
    }

    /// What was drawn for each slot: factors by name, steps of delay, and factors of weights as `style`.
    fn drawn<'py>(&self, py: Python<'py>, world_idx: usize) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let me = self.lock()?;
        let style = &me.world.config().style;
        let slots = me.world.status(world_idx).map_err(from_sim)?.slots;
        let dict = |Slot { drawn, .. }: &Slot| {
            let factors =
                COMPONENTS.into_iter().zip(drawn.style).filter(|(name, _)| style.contains_key(*name));
            let slot = PyDict::new(py);
            slot.set_item("acceleration_gain", drawn.gains[0])?;
            slot.set_item("yaw_gain", drawn.gains[1])?;
            slot.set_item("delay_steps", drawn.pending.len())?;
            slot.set_item("size", drawn.size)?;
            slot.set_item("style", factors.into_py_dict(py)?)?;
            Ok(slot)
        };
        slots.iter().map(dict).collect()
    }

    /// Whether each slot's agent goes on.
    fn slot_alive(&self, world_idx: usize) -> PyResult<Vec<bool>> {
        let me = self.lock()?;
        Ok(me.world.status(world_idx).map_err(from_sim)?.slots.iter().map(|slot| slot.alive).collect())
    }

    /// Route [P, 2] of a slot's agent and its goal [2].
    fn route<'py>(
        &self,
        py: Python<'py>,
        world_idx: usize,
        slot_idx: usize,
    ) -> PyResult<world_state::Route<'py>> {
        let me = self.lock()?;
        world_state::route(py, me.world.status(world_idx).map_err(from_sim)?.slot_route(slot_idx))
    }

    /// Actions [E, W] of a planner in the first slots; zeros in worlds that are not `active` [E].
    #[pyo3(signature = (planner, active=None))]
    fn planner_actions<'py>(
        &self,
        py: Python<'py>,
        planner: &mut PyPlanner,
        active: Option<Vec<bool>>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let me = self.here()?;
        planner.actions(py, &me.world, active)
    }

    /// Pairs of agents that touch: (agent, partner, side of the agent that is hit, closing speed m/s, at fault).
    fn contacts(&self, world_idx: usize) -> PyResult<Vec<world_state::ContactRow>> {
        let me = self.lock()?;
        Ok(world_state::contacts(&me.world.status(world_idx).map_err(from_sim)?.contacts()))
    }

    /// Agents with a corner, and with the centre, off the road [A] each.
    fn off_road<'py>(&self, py: Python<'py>, world_idx: usize) -> PyResult<OffRoadArrays<'py>> {
        let facts = self.lock()?.world.status(world_idx).map_err(from_sim)?.off_road();
        let (corner, centre) = facts.iter().map(|f| (f.corner, f.centroid)).unzip();
        Ok((PyArray1::from_vec(py, corner), PyArray1::from_vec(py, centre)))
    }

    /// Metres by which the farthest corner of each slot's agent is off the road.
    fn off_road_m(&self, world_idx: usize) -> PyResult<Vec<f32>> {
        Ok(self.lock()?.world.status(world_idx).map_err(from_sim)?.off_road_m())
    }

    /// How far a path of points [N, 2] and the log of the first slot go along the road blocks of the log; `None` where that
    /// is in no lane.
    fn progress_along_log(&self, world_idx: usize, path: Vec<[f32; 2]>) -> PyResult<Option<(f32, f32)>> {
        let path: Vec<Point2> = path.into_iter().map(|[x, y]| Point2::new(x, y)).collect();
        Ok(self.lock()?.world.status(world_idx).map_err(from_sim)?.progress_along_log(&path))
    }

    /// What the closed-loop score looks at in the present state of the first slot, which was in `lane_before`: its lane
    /// and the position along it, and time to the contact to expect with agents that are not `ignored`.
    #[pyo3(signature = (world_idx, lane_before, ignored, horizon_s))]
    fn score_facts(
        &self,
        world_idx: usize,
        lane_before: Option<usize>,
        ignored: Vec<usize>,
        horizon_s: f32,
    ) -> PyResult<ScoreRow> {
        let me = self.lock()?;
        let status = me.world.status(world_idx).map_err(from_sim)?;
        let facts = status.score_facts(lane_before, &ignored, horizon_s);
        Ok((facts.lane.map(|lane| (lane.lane_idx, lane.s_m)), facts.contact_s))
    }

    /// Vehicles of a world that may become adversaries, nearest to the ego first, at most R of them; their features [R, F].
    fn candidates<'py>(
        &self,
        py: Python<'py>,
        world_idx: usize,
        num_rows: usize,
    ) -> PyResult<(Vec<usize>, Bound<'py, PyArray2<f32>>)> {
        let found = self.lock()?.world.candidates(world_idx, num_rows).map_err(from_sim)?;
        let shape = [num_rows, CANDIDATE_FEATURES.len()];
        Ok((found.agents, PyArray1::from_vec(py, found.features).reshape(shape)?))
    }

    /// Actions [C, W] that bring each slot's agent towards its next logged state.
    fn expert_actions<'py>(&self, py: Python<'py>, world_idx: usize) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let me = self.lock()?;
        let (actions, width) =
            (me.world.expert_actions(world_idx).map_err(from_sim)?, me.world.decoder().width());
        let flat = actions.iter().flat_map(|action| action.iter().take(width).copied()).collect();
        PyArray1::from_vec(py, flat).reshape([actions.len(), width])
    }
}
