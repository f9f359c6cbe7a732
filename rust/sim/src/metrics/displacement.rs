//! Distance of a rollout from the log.

use super::Trajectories;
use crate::error::Result;

/// Displacement errors of one scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Displacement {
    /// Mean error of every agent over the steps where both are there, metres; `None` where there are none.
    pub ade_m: Vec<Option<f64>>,
    /// Error of every agent at the last such step, metres.
    pub fde_m: Vec<Option<f64>>,
}

/// Compares a rollout with the log of the same agents and steps.
///
/// # Errors
/// [`crate::SimError::Length`] where the log has other agents or steps.
///
/// # Reference
/// reference.md#displacement.
pub fn displacement(motion: &Trajectories<'_>, log: &Trajectories<'_>) -> Result<Displacement> {
    motion.check_same(Some(log), &vec![false; motion.num_agents()])?;
    let mut result = Displacement { ade_m: Vec::new(), fde_m: Vec::new() };
    for agent in 0..motion.num_agents() {
        let errors: Vec<f64> = (0..motion.num_steps())
            .filter(|&t| motion.is_valid(agent, t) && log.is_valid(agent, t))
            .map(|t| f64::from((motion.position(agent, t) - log.position(agent, t)).norm()))
            .collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        result.ade_m.push(if errors.is_empty() { None } else { Some(mean) });
        result.fde_m.push(errors.last().copied());
    }
    Ok(result)
}
