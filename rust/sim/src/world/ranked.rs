//! Vehicles of a scene by their importance where an episode starts.

use crate::causal::measures::{AgentFrame, AgentHistory, Ttc, normalised_distance, normalised_ttc};
use crate::causal::rank::{CliqueSettings, RankInput, Ranker};
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
    let back = match ranking {
        VehicleRanking::Cliques => (LOOK_BACK_S / log.dt_s).round() as usize,
        _ => 0,
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
    let place = |a: usize| tracks.position[log.at(a, step_idx)];
    let distance_m = |a: usize| (place(a) - place(ego)).norm();
    let ranked = AgentHistory::new(frame).and_then(|history| {
        let mut agents: Vec<usize> = match ranking {
            VehicleRanking::Cliques => {
                let valid: Vec<bool> = (0..n).map(|a| log.is_valid(a, step_idx)).collect();
                let ttc: Vec<Real> = history.ttc_s(Ttc::Oriented).into_iter().map(normalised_ttc).collect();
                let distance: Vec<Real> =
                    history.distance_m()?.into_iter().map(normalised_distance).collect();
                let input =
                    RankInput { valid: &valid, ttc: &ttc, distance: &distance, ..RankInput::default() };
                Ranker::CliqueOccurrence(CliqueSettings::REFERENCE_IMPL).rank(&input, n)?.agents
            }
            VehicleRanking::Random => {
                let input = RankInput { valid: &vec![true; n], ..RankInput::default() };
                Ranker::Random { seed: 0 }.rank(&input, n)?.agents
            }
            VehicleRanking::Nearest | VehicleRanking::Ttc | VehicleRanking::First => (0..n).collect(),
        };
        agents.retain(|a| *a != ego && drives(a));
        if ranking == VehicleRanking::Nearest {
            agents.sort_by(|a, b| distance_m(*a).total_cmp(&distance_m(*b)));
        } else if ranking == VehicleRanking::Ttc {
            let ttc_s = history.ttc_s(Ttc::Oriented);
            let of_ego = &ttc_s[ego * n..];
            let nearer = |a: &usize, b: &usize| distance_m(*a).total_cmp(&distance_m(*b));
            agents.sort_by(|a, b| of_ego[*a].total_cmp(&of_ego[*b]).then(nearer(a, b)));
        }
        Ok(agents)
    });
    // the arrays are of one length
    std::iter::once(ego).chain(ranked.unwrap_or_default()).collect()
}
