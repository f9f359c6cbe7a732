//! Roles of several agents: an adversary is paid what the others lose, and plays only while one of them does.

use crate::geom::Real;
use crate::world::buffers::StepBuffers;
use crate::world::config::WorldConfig;
use crate::world::episode::{Phase, Slot};
use crate::world::reward_columns::{Col, NUM_COLUMNS};
use crate::world::tick::World;

impl World {
    /// Notes which slots hold adversaries in the present episode.
    pub(crate) fn cast(&mut self, config: &WorldConfig) {
        let log = &self.scene.scene;
        let ids = config.adversaries.get(&log.name);
        let plays = |a: usize| ids.is_some_and(|ids| ids.contains(&log.agents[a].id));
        self.adversaries.clear();
        let slots = self.episode.slots.iter().enumerate();
        let by_slot = |c: usize| (1..=config.num_adversaries).contains(&c);
        self.adversaries.extend(slots.map(|(c, s)| s.agent_idx.is_some_and(|a| by_slot(c) || plays(a))));
    }

    /// Sets the rewards of adversaries over a decision that began after `since` elapsed steps, and cuts off those that are
    /// left alone; returns whether the world's episode ends with that.
    pub(super) fn play_roles(
        &mut self,
        config: &WorldConfig,
        since: usize,
        out: &mut StepBuffers<'_>,
    ) -> bool {
        if config.num_adversaries == 0 && config.adversaries.is_empty() {
            return false;
        }
        let e = &mut self.episode;
        let played = |slot: &Slot| slot.agent_idx.is_some() && slot.ended_at.is_none_or(|at| at > since);
        let (mut sum, mut num_egos, mut num_adversaries) = (0.0, 0_u32, 0_u32);
        let cast = e.slots.iter().zip(&self.adversaries).zip(&*out.reward);
        for ((_, is_adversary), reward) in cast.filter(|((slot, _), _)| played(slot)) {
            if *is_adversary {
                num_adversaries += 1;
            } else {
                sum += *reward;
                num_egos += 1;
            }
        }
        if num_adversaries == 0 {
            return false;
        }
        let against = f64::from(sum) / f64::from(num_egos.max(1));
        let cast = e.slots.iter_mut().zip(&self.adversaries).enumerate();
        for (c, (slot, _)) in cast.filter(|(_, (slot, is))| **is && played(slot)) {
            let columns = &out.columns[c * NUM_COLUMNS..(c + 1) * NUM_COLUMNS];
            let own: Real = columns[Col::RewardOffRoad as usize] + columns[Col::RewardComfort as usize];
            let reward = (f64::from(own * config.adversary_shaping) - against) as Real;
            slot.statistics.pay_instead(out.reward[c], reward);
            out.reward[c] = reward;
        }
        if e.phase == Phase::Ended {
            self.end();
            return false;
        }
        let mut left = e.slots.iter().zip(&self.adversaries).filter(|(slot, _)| slot.alive).peekable();
        if left.peek().is_none() || !left.all(|(_, is_adversary)| *is_adversary) {
            return false;
        }
        for (slot, truncated) in e.slots.iter_mut().zip(out.truncated.iter_mut()).filter(|(s, _)| s.alive) {
            *truncated = true;
            slot.alive = false;
            slot.ended_at = Some(e.elapsed_steps);
            slot.stopped = true;
        }
        self.end();
        true
    }
}
