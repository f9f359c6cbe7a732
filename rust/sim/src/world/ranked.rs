//! Vehicles of a scene by their importance where an episode starts.

use crate::causal::measures::{AgentFrame, AgentHistory};
use crate::causal::rank::KeyRanking;
use crate::geom::Real;
use crate::scene::{AgentKind, EGO_ID, Scene};
use crate::stage::apart_in_log;
use crate::world::config::VehicleRanking;

/// How far `cliques` look back, seconds.
const LOOK_BACK_S: Real = 3.0;

/// Vehicles that the log has at a step, those that others tow left out: the ego, else the first of them, then the others by
/// a ranking.
pub fn ranked_vehicles(
    log: &Scene,
    towed: &[(usize, usize)],
    step_idx: usize,
    ranking: VehicleRanking,
) -> Vec<usize> {
    let n = log.num_agents();
    let drives = |a: &usize| {
        log.agents[*a].kind == AgentKind::Vehicle
            && towed.iter().all(|(towed, _)| towed != a)
            && log.is_valid(*a, step_idx)
    };
    let Some(ego) = log.agent_index(EGO_ID).filter(drives).or_else(|| (0..n).find(drives)) else {
        return Vec::new();
    };
    let (kind, back) = match ranking {
        VehicleRanking::Cliques => (KeyRanking::Cliques, (LOOK_BACK_S / log.dt_s).round() as usize),
        VehicleRanking::Nearest => (KeyRanking::Nearest, 0),
        VehicleRanking::Ttc => (KeyRanking::Ttc, 0),
        VehicleRanking::First => (KeyRanking::First, 0),
        VehicleRanking::Random => (KeyRanking::Random { seed: 0 }, 0),
    };
    let steps = step_idx.saturating_sub(back)..=step_idx;
    let places: Vec<usize> = steps.flat_map(|t| (0..n).map(move |a| log.at(a, t))).collect();
    let column = |of: &dyn Fn(usize) -> Real| places.iter().map(|at| of(*at)).collect::<Vec<Real>>();
    let tracks = &log.tracks;
    let frame = AgentFrame {
        x_m: &column(&|at| tracks.position[at].x),
        y_m: &column(&|at| tracks.position[at].y),
        heading_rad: &column(&|at| tracks.heading_rad[at]),
        speed_mps: &column(&|at| tracks.velocity[at].norm()),
        length_m: &log.agents.iter().map(|a| a.length_m).collect::<Vec<Real>>(),
        width_m: &log.agents.iter().map(|a| a.width_m).collect::<Vec<Real>>(),
        valid: &places.iter().map(|at| tracks.valid[*at]).collect::<Vec<bool>>(),
        apart: &apart_in_log(log, step_idx, &(0..n).collect::<Vec<usize>>()),
    };
    let candidates: Vec<bool> = (0..n).map(|a| drives(&a)).collect();
    let others = AgentHistory::new(frame).and_then(|history| kind.rank(&history, &candidates, ego));
    // the arrays are of one length
    std::iter::once(ego).chain(others.unwrap_or_default()).collect()
}
