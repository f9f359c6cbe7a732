//! Where a step writes: memory of the caller, E worlds x C slots, row-major.

use crate::error::{Result, SimError};
use crate::world::columns::NUM_COLUMNS;
use crate::world::config::Autoreset;

/// Sizes that every world's part of the buffers has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Extent {
    /// Slots C.
    pub slots: usize,
    /// Floats of an observation row D.
    pub row: usize,
    /// Bytes of a raster B, 0 without rasters.
    pub raster: usize,
}

/// Output of a reset or a step. D is the size of the observation row, M the number of columns,
/// B the size of the raster (0 without one).
#[derive(Debug)]
pub struct StepBuffers<'a> {
    /// Observations [E, C, D]; zero for slots without a living agent.
    pub obs: &'a mut [f32],
    /// Rewards [E, C].
    pub reward: &'a mut [f32],
    /// Whether an agent's episode ended in this step by what happened in it [E, C].
    pub terminated: &'a mut [bool],
    /// Whether it was cut off in this step [E, C].
    pub truncated: &'a mut [bool],
    /// Whether the slot's agent goes on after this step [E, C].
    pub alive: &'a mut [bool],
    /// Figures of the step [E, C, M], see [`super::COLUMNS`].
    pub columns: &'a mut [f32],
    /// Whether the world's episode ended in this step [E].
    pub done: &'a mut [bool],
    /// Whether the observation is the first of a new episode [E].
    pub was_reset: &'a mut [bool],
    /// In SAME_STEP mode the last observation of an ended episode [E, C, D]; empty in the other modes.
    pub final_obs: &'a mut [f32],
    /// Rasters [E, C, B]; zero where `obs` is.
    pub bev: &'a mut [u8],
    /// Rasters beside `final_obs` [E, C, B].
    pub final_bev: &'a mut [u8],
}

/// The part of [`StepBuffers`] that belongs to one world.
pub(crate) struct WorldOut<'a> {
    pub(crate) obs: &'a mut [f32],
    pub(crate) reward: &'a mut [f32],
    pub(crate) terminated: &'a mut [bool],
    pub(crate) truncated: &'a mut [bool],
    pub(crate) alive: &'a mut [bool],
    pub(crate) columns: &'a mut [f32],
    pub(crate) done: &'a mut bool,
    pub(crate) was_reset: &'a mut bool,
    pub(crate) final_obs: &'a mut [f32],
    pub(crate) bev: &'a mut [u8],
    pub(crate) final_bev: &'a mut [u8],
}

impl WorldOut<'_> {
    /// Rewards, endings and figures of a step in which nothing happened.
    pub(crate) fn clear_step(&mut self) {
        self.reward.fill(0.0);
        self.terminated.fill(false);
        self.truncated.fill(false);
        self.columns.fill(0.0);
        *self.done = false;
    }
}

impl<'a> StepBuffers<'a> {
    /// Checks every length before anything is written.
    ///
    /// # Errors
    /// [`SimError::Length`] names the first array that does not fit.
    pub fn check(&self, num_envs: usize, extent: Extent, autoreset: Autoreset) -> Result<()> {
        let Extent { row, raster, .. } = extent;
        let slots = num_envs * extent.slots;
        let final_slots = if autoreset == Autoreset::SameStep { slots } else { 0 };
        let lengths = [
            ("obs", self.obs.len(), slots * row),
            ("reward", self.reward.len(), slots),
            ("terminated", self.terminated.len(), slots),
            ("truncated", self.truncated.len(), slots),
            ("alive", self.alive.len(), slots),
            ("columns", self.columns.len(), slots * NUM_COLUMNS),
            ("done", self.done.len(), num_envs),
            ("was_reset", self.was_reset.len(), num_envs),
            ("final_obs", self.final_obs.len(), final_slots * row),
            ("bev", self.bev.len(), slots * raster),
            ("final_bev", self.final_bev.len(), final_slots * raster),
        ];
        for (what, got, expected) in lengths {
            if got != expected {
                return Err(SimError::Length { what, got, expected });
            }
        }
        Ok(())
    }

    /// The same buffers for a call that takes them by value.
    pub(crate) fn reborrow(&mut self) -> StepBuffers<'_> {
        StepBuffers {
            obs: self.obs,
            reward: self.reward,
            terminated: self.terminated,
            truncated: self.truncated,
            alive: self.alive,
            columns: self.columns,
            done: self.done,
            was_reset: self.was_reset,
            final_obs: self.final_obs,
            bev: self.bev,
            final_bev: self.final_bev,
        }
    }

    /// The buffers of the first `worlds` worlds, and those of the rest.
    pub(crate) fn split_at(self, worlds: usize, extent: Extent) -> (Self, Self) {
        let Extent { row, raster, .. } = extent;
        let slots = worlds * extent.slots;
        let (obs, obs_rest) = self.obs.split_at_mut(slots * row);
        let (reward, reward_rest) = self.reward.split_at_mut(slots);
        let (terminated, terminated_rest) = self.terminated.split_at_mut(slots);
        let (truncated, truncated_rest) = self.truncated.split_at_mut(slots);
        let (alive, alive_rest) = self.alive.split_at_mut(slots);
        let (columns, columns_rest) = self.columns.split_at_mut(slots * NUM_COLUMNS);
        let (done, done_rest) = self.done.split_at_mut(worlds);
        let (was_reset, was_reset_rest) = self.was_reset.split_at_mut(worlds);
        let middle = (slots * row).min(self.final_obs.len());
        let (final_obs, final_obs_rest) = self.final_obs.split_at_mut(middle);
        let (bev, bev_rest) = self.bev.split_at_mut(slots * raster);
        let middle = (slots * raster).min(self.final_bev.len());
        let (final_bev, final_bev_rest) = self.final_bev.split_at_mut(middle);
        (
            Self {
                obs,
                reward,
                terminated,
                truncated,
                alive,
                columns,
                done,
                was_reset,
                final_obs,
                bev,
                final_bev,
            },
            Self {
                obs: obs_rest,
                reward: reward_rest,
                terminated: terminated_rest,
                truncated: truncated_rest,
                alive: alive_rest,
                columns: columns_rest,
                done: done_rest,
                was_reset: was_reset_rest,
                final_obs: final_obs_rest,
                bev: bev_rest,
                final_bev: final_bev_rest,
            },
        )
    }

    /// The buffers of one world.
    pub(crate) fn world(&mut self, i: usize, extent: Extent) -> WorldOut<'_> {
        let slots = i * extent.slots..(i + 1) * extent.slots;
        let rows = slots.start * extent.row..slots.end * extent.row;
        let rasters = slots.start * extent.raster..slots.end * extent.raster;
        let final_rows = if self.final_obs.is_empty() { 0..0 } else { rows.clone() };
        let final_rasters = if self.final_bev.is_empty() { 0..0 } else { rasters.clone() };
        WorldOut {
            obs: &mut self.obs[rows],
            reward: &mut self.reward[slots.clone()],
            terminated: &mut self.terminated[slots.clone()],
            truncated: &mut self.truncated[slots.clone()],
            alive: &mut self.alive[slots.clone()],
            columns: &mut self.columns[slots.start * NUM_COLUMNS..slots.end * NUM_COLUMNS],
            done: &mut self.done[i],
            was_reset: &mut self.was_reset[i],
            final_obs: &mut self.final_obs[final_rows],
            bev: &mut self.bev[rasters],
            final_bev: &mut self.final_bev[final_rasters],
        }
    }
}
