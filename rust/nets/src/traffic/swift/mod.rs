//! Swift traffic: each vehicle drives by a small network that was taught what guided CCDiff does (`ccdiff-env distil`).
//!
//! Every half second each vehicle draws a change of speed and a yaw rate and holds them. With criticality the vehicles nearest to
//! the ego are told which agent it is, and how strongly to hinder it. Of the map the network sees its route alone; draws that leave
//! the road are passed over. Networks know no lights: in front of one that is red or yellow a vehicle brakes as IDM does.

mod network;
mod seen;
mod watch;

pub use seen::{EGO, NEIGHBOURS, OTHER, OWN, PLACES, Rows, SPACING_M, STATES};

use crate::compute::weights::File;
use crate::error::{Result, require};
use crate::guidance::LEAST_TARGET_MPS;
use crate::networks::ccdiff::CCDIFF;
use crate::networks::tokens::draw::{CAREFUL_DRAWS, bounded};
use crate::networks::tokens::grid::TOKEN_STEPS;
use crate::sampling::noise::Noise;
pub use crate::traffic::planned_agents::egos_of;
use crate::traffic::planned_agents::{history_of, select_guided};
use crate::traffic::{AdversaryPolicy, CcdiffConfig, followed, planning_pool, side_by_side};
use ccdiff_sim::SimError;
use ccdiff_sim::drivers::{
    AgentMotion, DriverModel, IdmConfig, Kind, PlanRecord, PlanRequest, PlanState, Replay, WorldView,
    braking_at_light,
};
use ccdiff_sim::dynamics::Dynamics;
use ccdiff_sim::geom::Real;
use ccdiff_sim::options;
use ccdiff_sim::scene::AgentKind;
use ccdiff_sim::stage::History;
use network::{Hidden, Network};
use rayon::ThreadPool;
use std::path::Path;
use watch::Watch;

/// The driver. Of the options of networks it takes [`TAKEN`]; it is careful and follows routes always.
pub const SWIFT: Kind = Kind {
    name: "swift",
    title: "swift traffic",
    style: CCDIFF.kind.style,
    options: Some(&CcdiffConfig::TABLE),
    always: false,
    make: None,
};

/// Options that mean something to it.
const TAKEN: [&str; 7] = [
    "weights",
    "num_guided",
    "criticality",
    "temperature",
    "adversary_policy",
    "guided_from_s",
    "guided_until_s",
];
/// Step of the worlds, seconds, as trained.
pub const DT_S: Real = 0.1;
/// Seconds for which a draw is held, and how a vehicle brakes that has no draw without a contact.
const HELD_S: Real = TOKEN_STEPS as Real * DT_S;
const BRAKING_MPS2: Real = 4.0;

/// Traffic of a batch of worlds.
#[derive(Debug)]
pub struct Swift {
    network: Network,
    config: CcdiffConfig,
    adversary_policy: Option<AdversaryPolicy>,
    /// Threads that plan; `None`: the caller's.
    pool: Option<ThreadPool>,
}

/// The memory of one thread.
#[derive(Debug, Default)]
struct Scratch {
    rows: Rows,
    strengths: Vec<Real>,
    hidden: Hidden,
    watch: Watch,
}

/// The vehicles of a world that decide, those of them that are guided, and how strongly.
struct Decides<'a> {
    request: &'a PlanRequest<'a>,
    history: &'a History,
    agents: Vec<usize>,
    egos: Vec<usize>,
    ranking: Vec<usize>,
    guided: Vec<usize>,
    criticality: Real,
}

impl Swift {
    /// From a file of weights, read or parsed, for worlds with a step; it plans on so many threads, which changes no bit.
    ///
    /// # Errors
    /// [`crate::ModelError::Checkpoint`] names the path, [`crate::ModelError::Config`] and [`crate::ModelError::Sim`] the option.
    pub fn new(
        config: CcdiffConfig,
        path: &Path,
        (header, tensors): File,
        dt_s: Real,
        num_threads: usize,
    ) -> Result<Self> {
        let network = Network::new(path, &header, tensors)?;
        options::check("ccdiff", &config)?;
        let expected = "0.1: what swift traffic was trained with";
        require((dt_s - DT_S).abs() <= 1e-6, "dt_s", dt_s, expected)?;
        let mut changed = serde_json::to_value(&config).unwrap_or_default();
        options::without_defaults(&CcdiffConfig::TABLE, &mut changed);
        let others =
            changed.as_object().into_iter().flatten().filter(|(name, _)| !TAKEN.contains(&name.as_str()));
        if let Some((name, value)) = others.into_iter().next() {
            let expected = format!("its default: swift traffic takes {} alone", TAKEN.join(", "));
            let field = format!("ccdiff.{name}").into();
            return Err(SimError::Config { field, got: value.to_string(), expected }.into());
        }
        let pool = (num_threads > 1).then(|| planning_pool(num_threads)).transpose()?;
        Ok(Self { network, adversary_policy: AdversaryPolicy::of(&config)?, config, pool })
    }

    /// The vehicles that decide now.
    fn decides<'a>(&self, request: &'a PlanRequest<'a>) -> ccdiff_sim::Result<Decides<'a>> {
        let (world, states) = (&request.world, request.world.states);
        let history = history_of(world, STATES, SWIFT.name)?;
        let there = |a: &usize| {
            request.drives(*a)
                && states.active[*a]
                && !world.halted[*a]
                && world.scene.kinds[*a] == AgentKind::Vehicle
                && !world.scene.routes[*a].is_parked()
                && !world.backs_up(*a)
        };
        let agents: Vec<usize> = (0..states.len()).filter(there).collect();
        let mut egos = egos_of(world);
        let is_target = |e: &usize| states.speed_mps[*e].abs() >= LEAST_TARGET_MPS;
        let targets: Vec<usize> = egos.iter().copied().filter(is_target).collect();
        let mut criticality = request.plan_override.criticality.unwrap_or(self.config.criticality);
        if !self.config.guides_at(world) || targets.is_empty() {
            criticality = 0.0;
        } else if criticality > 0.0 {
            egos = targets; // who stands is seen as any other, and not run into
        }
        let (mut ranking, mut guided) = (Vec::new(), Vec::new());
        if criticality > 0.0 {
            let to_ego = |a: usize| {
                let from = states.position(a);
                egos.iter()
                    .map(|e| (states.position(*e) - from).norm_squared())
                    .fold(Real::INFINITY, Real::min)
            };
            ranking.extend(agents.iter().copied().filter(|a| !egos.contains(a)));
            ranking.sort_by(|a, b| to_ego(*a).total_cmp(&to_ego(*b)));
            let policy = self.adversary_policy.as_ref();
            let strength;
            (guided, strength) = select_guided(request, &self.config, policy, &ranking, |_| true);
            criticality *= strength;
        }
        Ok(Decides { request, history, agents, egos, ranking, guided, criticality })
    }

    /// Plans of some worlds.
    fn planned(&self, due: &[&PlanRequest<'_>], scratch: &mut Scratch) -> ccdiff_sim::Result<Vec<PlanState>> {
        let worlds: Vec<Decides<'_>> =
            due.iter().map(|r| self.decides(r)).collect::<ccdiff_sim::Result<_>>()?;
        scratch.rows.clear();
        scratch.strengths.clear();
        for d in &worlds {
            let strength = self.network.strength(d.criticality);
            for a in &d.agents {
                scratch.rows.add(&d.request.world, d.history, *a, &d.egos);
                scratch.strengths.push(if d.guided.contains(a) { strength } else { 0.0 });
            }
        }
        self.network.see(&mut scratch.rows, &scratch.strengths, &mut scratch.hidden);
        let mut first = 0;
        let plans = worlds.into_iter().map(|d| {
            let plan = self.draw(&d, first, scratch);
            first += d.agents.len();
            plan_of(d, plan)
        });
        Ok(plans.collect())
    }

    /// Acceleration and yaw rate of the vehicles of a world: the first of some draws that neither touches anybody in the next 1.5 s,
    /// while all others do as they have drawn, nor leaves the road; else the first that touches nobody; else it brakes. Guided
    /// vehicles ignore contacts with the ego.
    fn draw(&self, d: &Decides<'_>, first: usize, scratch: &mut Scratch) -> Vec<[Real; 2]> {
        let (network, hidden, watch) = (&self.network, &mut scratch.hidden, &mut scratch.watch);
        let (world, temperature) = (&d.request.world, self.config.temperature as Real);
        // in sight of a light that holds it, a vehicle is no faster than IDM
        let idm = IdmConfig::default();
        let hold = |a: &usize| braking_at_light(world, *a, Real::MAX, &idm, BRAKING_MPS2);
        let waits: Vec<Option<Real>> = d.agents.iter().map(hold).collect();
        let mut drawn = |i: usize, draw: usize| {
            let (a, speed) = (d.agents[i], world.states.speed_mps[d.agents[i]]);
            let noise = Noise::new(world.noise_seed, a as u64);
            let [change, yaw_rate] = network.draw(first + i, noise, draw, temperature, hidden);
            let change = if draw < CAREFUL_DRAWS { change } else { -BRAKING_MPS2 * HELD_S };
            let change = waits[i].map_or(change, |braking| change.min(braking * HELD_S));
            let [end, yaw_rate] = bounded(speed, change, yaw_rate);
            [(end - speed) / HELD_S, yaw_rate]
        };
        let mut motions: Vec<[Real; 2]> = (0..d.agents.len()).map(|i| drawn(i, 0)).collect();
        watch.enter(world, &d.agents, &motions);
        for (i, a) in d.agents.iter().enumerate() {
            let minds = |j: usize| !(d.guided.contains(a) && d.egos.contains(&j));
            let mut off_road = None;
            for draw in 1..=CAREFUL_DRAWS {
                if !watch.touches(world, *a, minds) {
                    if !watch.leaves_road(world, *a) {
                        off_road = None;
                        break;
                    }
                    off_road.get_or_insert(motions[i]);
                }
                motions[i] = drawn(i, draw);
                watch.put(world, *a, motions[i]);
            }
            if let Some(motion) = off_road {
                motions[i] = motion;
                watch.put(world, *a, motion);
            }
        }
        motions
    }
}

/// The plan of a world in which agents do as drawn.
fn plan_of(d: Decides<'_>, motions: Vec<[Real; 2]>) -> PlanState {
    let world = &d.request.world;
    let dynamics = Dynamics::default();
    let mut plan = PlanState::default();
    for (a, [acceleration, yaw_rate]) in d.agents.iter().zip(motions) {
        let mut state = world.states.kin_state(*a);
        for _ in 0..TOKEN_STEPS {
            dynamics.step(&mut state, [acceleration, yaw_rate, 0.0], world.dt_s, &world.scene.footprints[*a]);
            plan.record.samples.extend([state.x, state.y, state.heading_rad]);
            plan.speed_mps.push(state.speed_mps);
        }
    }
    let is_guided = |a: &usize| d.criticality > 0.0 && d.guided.contains(a);
    plan.record = PlanRecord {
        guided: d.agents.iter().map(is_guided).collect(),
        ranking: d.ranking,
        samples: plan.record.samples,
        ..PlanRecord::of_one_sample(world.elapsed_steps, d.agents, TOKEN_STEPS)
    };
    plan
}

impl DriverModel for Swift {
    fn name(&self) -> &str {
        SWIFT.name
    }

    fn history_states(&self) -> usize {
        STATES
    }

    fn follows_route(&self, _: Option<&PlanState>, _: usize) -> bool {
        true
    }

    fn plan(&mut self, requests: &[PlanRequest<'_>]) -> ccdiff_sim::Result<Vec<Option<PlanState>>> {
        let is_due = |r: &&PlanRequest<'_>| r.is_due(TOKEN_STEPS);
        let due: Vec<&PlanRequest<'_>> = requests.iter().filter(is_due).collect();
        if due.is_empty() {
            return Ok(vec![None; requests.len()]);
        }
        let this = &*self;
        let threads = this.pool.as_ref().map_or(1, ThreadPool::current_num_threads);
        let parts = due.chunks(due.len().div_ceil(threads).max(1)).collect();
        let plan = |part: &[&PlanRequest<'_>]| this.planned(part, &mut Scratch::default());
        let parts = side_by_side(this.pool.as_ref(), parts, plan).into_iter();
        let mut plans = parts.collect::<ccdiff_sim::Result<Vec<_>>>()?.into_iter().flatten();
        Ok(requests.iter().map(|r| if is_due(&r) { plans.next() } else { None }).collect())
    }

    fn act(&self, world: &WorldView<'_>, plan: Option<&PlanState>, agent_idx: usize) -> AgentMotion {
        // who came after the decision follows the log until the next one
        followed(world, plan, agent_idx).unwrap_or_else(|| Replay.act(world, None, agent_idx))
    }
}
