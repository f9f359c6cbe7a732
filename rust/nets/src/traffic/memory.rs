//! What a world remembers between the plans of a network, as the private bytes of its plan.

use ccdiff_sim::drivers::PlanState;
use ccdiff_sim::{Result, SimError};

const PARKED: u8 = 1;
const LEFT_LOG: u8 = 2;

/// What is remembered of an episode. As bytes: a byte of flags for each agent, the seed in 64 bits, then the
/// ranking, 32 bits each.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Memory {
    /// Agents of the scene that stand still for the whole episode, [A].
    pub(super) parked: Vec<bool>,
    /// Agents of the scene that have left their log by following a plan, [A].
    pub(super) left_log: Vec<bool>,
    /// Seed of the noise of the first plan.
    pub(super) noise_seed: u64,
    /// Ranking of the first plan.
    pub(super) first_ranking: Vec<usize>,
}

/// Whether an agent stands still for the whole episode.
pub(super) fn is_parked(memory: &[u8], agent_idx: usize) -> bool {
    memory.get(agent_idx).is_some_and(|flags| flags & PARKED != 0)
}

impl Memory {
    pub(super) fn to_bytes(&self) -> Vec<u8> {
        let flag = |on: bool, flag: u8| if on { flag } else { 0 };
        let flags = self.parked.iter().zip(&self.left_log);
        let flags = flags.map(|(parked, left)| flag(*parked, PARKED) | flag(*left, LEFT_LOG));
        let flags = flags.chain(self.noise_seed.to_le_bytes());
        flags.chain(self.first_ranking.iter().flat_map(|a| (*a as u32).to_le_bytes())).collect()
    }

    /// What the plan of a world with some agents remembers.
    pub(super) fn of(plan: &PlanState, num_agents: usize) -> Result<Self> {
        let whole = plan.memory.split_at_checked(num_agents).and_then(|(flags, rest)| {
            let (seed, ranking) = rest.split_first_chunk::<8>()?;
            (ranking.len() % 4 == 0).then_some((flags, *seed, ranking))
        });
        let read = whole.map(|(flags, seed, ranking)| Self {
            noise_seed: u64::from_le_bytes(seed),
            parked: flags.iter().map(|f| f & PARKED != 0).collect(),
            left_log: flags.iter().map(|f| f & LEFT_LOG != 0).collect(),
            first_ranking: ranking
                .chunks_exact(4)
                .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize)
                .collect(),
        });
        let sound = read.filter(|memory| memory.first_ranking.iter().all(|a| *a < num_agents));
        sound.ok_or_else(|| SimError::Snapshot("a plan whose memory does not fit its scene".into()))
    }
}
