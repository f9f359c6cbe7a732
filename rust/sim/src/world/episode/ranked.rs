//! Vehicles of a scene by their importance where an episode starts.

use crate::causal::measures::{Moving, distance_m, normalised_distance, normalised_ttc, ttc_s};
use crate::causal::rank::{CliqueSettings, RankInput, Ranker};
use crate::geom::Vector2;
use crate::scene::{AgentKind, EGO_ID, Scene};
use crate::stage::apart_in_log;
use crate::state::Footprint;
use crate::world::config::VehicleRanking;

/// How far `cliques` look back, seconds.
const LOOK_BACK_S: f32 = 3.0;

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
    let apart = apart_in_log(log, step_idx, &(0..n).collect::<Vec<usize>>());
    let moving = |a: usize, t: usize| -> Moving {
        let (pose, at) = (log.pose(a, t), log.at(a, t));
        let body = Footprint::new(log.agents[a].length_m, log.agents[a].width_m).at(&pose);
        let velocity = pose.rotate(Vector2::new(log.tracks.velocity[at].norm(), 0.0));
        log.tracks.valid[at].then_some((body, velocity))
    };
    let agents_at = |t: usize| (0..n).map(|a| moving(a, t)).collect::<Vec<Moving>>();
    let (mut ttc, mut distance) = (Vec::new(), Vec::new());
    let ranker = match ranking {
        VehicleRanking::Cliques => {
            let back = (LOOK_BACK_S / log.dt_s).round() as usize;
            for agents in (step_idx.saturating_sub(back)..=step_idx).map(agents_at) {
                ttc.extend(ttc_s(&agents, &apart).into_iter().map(normalised_ttc));
                distance.extend(distance_m(&agents, &apart).into_iter().map(normalised_distance));
            }
            Ranker::CliqueOccurrence(CliqueSettings::REFERENCE_IMPL)
        }
        VehicleRanking::Random => Ranker::Random { seed: 0 },
        VehicleRanking::Nearest | VehicleRanking::Ttc | VehicleRanking::First => Ranker::FirstK,
    };
    let input = RankInput { valid: &vec![true; n], ttc: &ttc, distance: &distance, ..RankInput::default() };
    // the arrays are of one length
    let mut others = ranker.rank(&input, n).map_or_else(|_| Vec::new(), |found| found.agents);
    others.retain(|a| *a != ego && drives(a));
    let place = |a: usize| log.tracks.position[log.at(a, step_idx)];
    let away_m = |a: &usize| (place(*a) - place(ego)).norm();
    let nearer = |a: &usize, b: &usize| away_m(a).total_cmp(&away_m(b));
    if ranking == VehicleRanking::Nearest {
        others.sort_by(nearer);
    } else if ranking == VehicleRanking::Ttc {
        let of_ego = &ttc_s(&agents_at(step_idx), &apart)[ego * n..];
        others.sort_by(|a, b| of_ego[*a].total_cmp(&of_ego[*b]).then(nearer(a, b)));
    }
    std::iter::once(ego).chain(others).collect()
}
