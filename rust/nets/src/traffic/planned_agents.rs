//! The vehicles of a world that are planned for, those of them that may be guided, and their ranking.

use super::AdversaryPolicy;
use super::config::{CcdiffConfig, Conflict, ParkedRule};
use crate::error::Result;
use crate::inputs::features::{Window, route_ahead};
use ccdiff_sim::causal::measures::{TTC_CAP_S, normalised_distance, normalised_ttc};
use ccdiff_sim::causal::rank::RankInput;
use ccdiff_sim::drivers::{Driver, PlanRequest, WorldView};
use ccdiff_sim::geom::{Pose2, Real};
use ccdiff_sim::scene::AgentKind;
use ccdiff_sim::stage::History;
use std::f32::consts::FRAC_1_SQRT_2;

/// Vehicles that stand still are seen by the network within this distance of one that moves, metres.
pub const STATIONARY_REACH_M: Real = 20.0;
/// Logged speed below which a vehicle counts as standing, m/s (reference.md#sampling).
const STATIONARY_MPS: Real = 0.5;
/// Vehicles beside each other by at most this are in one lane, metres.
const SAME_LANE_M: Real = 2.0;

/// The vehicles of a world at a moment.
pub(super) struct PlannedAgents {
    /// Agents of the scene, one per row of the window, in the scene's order.
    pub(super) agents: Vec<usize>,
    /// Whether the agent has this driver and is free to move, by row.
    pub(super) driven: Vec<bool>,
    /// Their states over the history.
    pub(super) window: Window,
}

/// What the network says about the importance of agents, where a ranking asks for it.
#[derive(Debug, Default)]
pub(super) struct RankingInputs {
    /// The decision causal graph G times attention [M, M].
    pub(super) weights: Option<Vec<Real>>,
    /// Alignment of the gradients of realism and guidance, or how soon there is contact, [M].
    pub(super) scores: Option<Vec<Real>>,
}

/// Whether an agent is the ego or driven from outside.
pub(crate) fn is_ego(world: &WorldView<'_>, agent_idx: usize) -> bool {
    world.drivers[agent_idx] == Driver::External || world.ego == Some(agent_idx)
}

/// The agents of a world that guided vehicles hinder: its ego, and all that are driven from outside.
pub fn egos_of(world: &WorldView<'_>) -> Vec<usize> {
    (0..world.states.len()).filter(|a| world.states.active[*a] && is_ego(world, *a)).collect()
}

/// The history of a world, of so many states at least.
pub(crate) fn history_of<'a>(
    world: &WorldView<'a>,
    states: usize,
    driver: &str,
) -> ccdiff_sim::Result<&'a History> {
    world.history.filter(|h| h.len() >= states).ok_or_else(|| {
        let message = "the world keeps too short a history".into();
        ccdiff_sim::SimError::Driver { driver: driver.into(), message }
    })
}

/// Which agents of a scene do not move in an episode.
pub(super) fn parked(world: &WorldView<'_>, rule: ParkedRule) -> Vec<bool> {
    let (scene, start) = (&world.scene.scene, world.step_idx - world.elapsed_steps);
    (0..world.states.len())
        .map(|a| match rule {
            ParkedRule::Parked => world.scene.routes[a].is_parked(),
            ParkedRule::Nobody => false,
            ParkedRule::Standing => {
                scene.is_valid(a, start) && scene.tracks.velocity[scene.at(a, start)].norm() <= STATIONARY_MPS
            }
        })
        .collect()
}

/// Agents of a ranking that are guided from the coming plan on, and how strongly: those asked for; else the choice of a
/// learned policy, else the first of those that `fits`.
pub(crate) fn select_guided(
    request: &PlanRequest<'_>,
    config: &CcdiffConfig,
    policy: Option<&AdversaryPolicy>,
    ranking: &[usize],
    fits: impl Fn(&usize) -> bool,
) -> (Vec<usize>, Real) {
    let ranked = ranking.iter().copied();
    match (&request.plan_override.guided, policy) {
        (Some(agents), _) => (agents.iter().copied().filter(|a| ranking.contains(a)).collect(), 1.0),
        (None, Some(policy)) => policy.guided(request, ranking),
        (None, None) => (ranked.filter(fits).take(config.num_guided.unwrap_or(usize::MAX)).collect(), 1.0),
    }
}

impl PlannedAgents {
    /// Vehicles that are there now, within a distance from the ego if one is given: all that move, and the standing ones
    /// near them.
    pub(super) fn new(
        request: &PlanRequest<'_>,
        parked: &[bool],
        num_steps: usize,
        radius_m: Option<Real>,
    ) -> Result<Self> {
        let (world, states) = (&request.world, request.world.states);
        let egos = egos_of(world);
        let in_radius = |a: usize| match radius_m {
            Some(radius_m) if !egos.is_empty() => {
                let p = states.position(a);
                egos.iter().any(|ego| (states.position(*ego) - p).norm() <= radius_m)
            }
            _ => true,
        };
        let is_there =
            |a: &usize| states.active[*a] && world.scene.kinds[*a] == AgentKind::Vehicle && in_radius(*a);
        let there: Vec<usize> = (0..states.len()).filter(is_there).collect();
        let near_moving = |a: usize| {
            let p = states.position(a);
            let mut moving = there.iter().filter(|b| !parked[**b]);
            moving.any(|b| (states.position(*b) - p).norm() < STATIONARY_REACH_M)
        };
        let agents: Vec<usize> = there.iter().copied().filter(|a| !parked[*a] || near_moving(*a)).collect();
        let driven = agents.iter().map(|a| request.drives(*a) && !parked[*a]).collect();
        let history = history_of(world, num_steps, "planned traffic")?;
        let window = Window::from_history(history, &world.scene.scene, &agents, num_steps);
        let window = Window { apart: states.apart(&agents), ..window };
        Ok(Self { agents, driven, window })
    }

    /// How an agent of the scene stands to the nearest of `collision_targets`, itself not among them; `None` without any.
    pub(super) fn conflict(&self, agent_idx: usize, collision_targets: &[bool]) -> Option<Conflict> {
        let (window, now) = (&self.window, self.window.num_steps - 1);
        let row = self.agents.iter().position(|a| *a == agent_idx)?;
        let pose = window.pose(row, now);
        let others = (0..self.agents.len())
            .filter(|r| *r != row && collision_targets[*r] && !window.is_apart(row, *r))
            .map(|r| window.pose(r, now));
        let distance = |other: &Pose2| (other.position - pose.position).norm();
        let target = others.min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        let beside_m = target.to_local(pose.position).y.abs();
        let cos = target.cos * pose.cos + target.sin * pose.sin;
        Some(match cos {
            c if c < -FRAC_1_SQRT_2 => Conflict::HeadOn,
            c if c < FRAC_1_SQRT_2 => Conflict::Crossing,
            _ if beside_m > SAME_LANE_M => Conflict::CutIn,
            _ => Conflict::RearEnd,
        })
    }

    /// How soon each agent meets one of `collision_targets`, [M]; the greater the sooner; those that meet none come last.
    pub(super) fn contact_scores(&self, collision_targets: &[bool]) -> Vec<Real> {
        let m = self.agents.len();
        let now = (self.window.num_steps - 1) * m * m;
        let distance_m = self.window.distance_m();
        let least = |of: &[Real], row: usize| {
            let targets = (0..m).filter(|t| *t != row && collision_targets[*t]);
            targets.map(|t| of[now + row * m + t]).fold(Real::INFINITY, Real::min)
        };
        let score = |row| match least(&self.window.ttc_s, row) {
            ttc_s if ttc_s < TTC_CAP_S => 1.0 / (1.0 + ttc_s),
            _ => -least(&distance_m, row),
        };
        (0..m).map(score).collect()
    }

    /// Tells the network the routes of the vehicles that this driver drives.
    pub(super) fn tell_routes(&mut self, world: &WorldView<'_>, points_m: &[Real]) {
        let told = |(agent, controlled): (&usize, &bool)| match controlled {
            true => route_ahead(&world.scene.routes[*agent], world.route_s_m[*agent], points_m),
            false => Vec::new(),
        };
        self.window.routes = self.agents.iter().zip(&self.driven).map(told).collect();
    }

    /// Agents of the scene that may be guided, by falling importance, from the times to contact in the window.
    pub(super) fn ranking(
        &self,
        world: &WorldView<'_>,
        config: &CcdiffConfig,
        ranking_inputs: &RankingInputs,
    ) -> Result<Vec<usize>> {
        let ttc: Vec<Real> = self.window.ttc_s.iter().copied().map(normalised_ttc).collect();
        let distance: Vec<Real> = self.window.distance_m().into_iter().map(normalised_distance).collect();
        let m = self.agents.len();
        let now = vec![true; m];
        let input = RankInput {
            valid: &now,
            ttc: &ttc,
            distance: &distance,
            weights: ranking_inputs.weights.as_deref(),
            scores: ranking_inputs.scores.as_deref(),
        };
        let ids: Vec<&str> = self.agents.iter().map(|a| world.scene.scene.agents[*a].id.as_str()).collect();
        let ranker = config.ranker(&world.scene.scene.name, &ids, world.noise_seed);
        let ranked = ranker.rank(&input, m)?;
        Ok(ranked.agents.into_iter().filter(|row| self.driven[*row]).map(|row| self.agents[row]).collect())
    }
}
