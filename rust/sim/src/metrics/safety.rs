//! Surrogate safety measures of a recorded scene: least time to contact, over-speed.

use super::Trajectories;
use crate::causal::measures::TTC_CAP_S;
use crate::geom::Real;
use crate::state::AgentStates;

fn counts(mask: &[bool], agent_idx: usize) -> bool {
    mask.get(agent_idx).copied().unwrap_or(true)
}

/// Least time to contact of every agent with any other over all steps, seconds, capped at 20.
///
/// Boxes move on at the velocity of their last step. 0 from the first contact on; 20 for agents that meet nobody.
pub fn min_ttc_s(motion: &Trajectories<'_>) -> Vec<Real> {
    let num_agents = motion.num_agents();
    let mut least = vec![TTC_CAP_S; num_agents];
    let mut states = AgentStates::new(num_agents);
    for t in 0..motion.num_steps() {
        let moving: Vec<_> = (0..num_agents)
            .filter(|&a| motion.is_valid(a, t))
            .map(|a| (a, motion.footprints()[a].at(&motion.pose(a, t)), motion.velocity(a, t)))
            .collect();
        motion.states_at(t, &mut states);
        for (k, (a, box_a, velocity_a)) in moving.iter().enumerate() {
            for (b, box_b, velocity_b) in moving[..k].iter().filter(|(b, ..)| states.same_level(*a, *b)) {
                // contact later than both know of already is of no interest
                let horizon_s = least[*a].max(least[*b]);
                if let Some(t_s) = box_a.time_to_contact(*velocity_a, box_b, *velocity_b, horizon_s) {
                    least[*a] = least[*a].min(t_s);
                    least[*b] = least[*b].min(t_s);
                }
            }
        }
    }
    least
}

/// Whether every agent of a mask [A] (all, where it is shorter) drives faster than a limit for at least `at_least_s`
/// without a break.
///
/// The scene over-speed rate (SOR) is the share of scenes in which a controlled agent does.
///
/// Differs from the paper: it names the rate without a definition; this one is of reference.md#over-speed-rate.
pub fn over_speed(
    motion: &Trajectories<'_>,
    limit_mps: Real,
    at_least_s: Real,
    counted: &[bool],
) -> Vec<bool> {
    let needed = (at_least_s / motion.dt_s()).round().max(1.0) as usize;
    let of_agent = |agent: usize| {
        let mut run = 0;
        (0..motion.num_steps()).any(|t| {
            let fast = motion.is_valid(agent, t) && motion.velocity(agent, t).norm() > limit_mps;
            run = if fast { run + 1 } else { 0 };
            run >= needed
        })
    };
    (0..motion.num_agents()).map(|agent| counts(counted, agent) && of_agent(agent)).collect()
}
