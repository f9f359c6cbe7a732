//! Phase "observe" of a tick: rows and rasters of the slots.

use crate::geom::Real;
use crate::observe::{EgoFacts, View};
use crate::world::buffers::{Extent, StepBuffers};
use crate::world::config::{WorldConfig, styled};
use crate::world::rng::Rng;
use crate::world::tick::World;

impl World {
    /// Writes the rows of agents that go on or ended in this step; earlier ones of the decision stay, the others are zero.
    pub(crate) fn observe(
        &mut self,
        config: &WorldConfig,
        extent: Extent,
        since: usize,
        obs: &mut [Real],
        bev: &mut [u8],
    ) {
        let e = &self.episode;
        self.observer.prepare(&e.states, e.slots.iter().filter(|s| s.alive).count());
        let bytes = extent.raster.iter().product::<usize>();
        let left_steps = e.steps_left(&self.scene, config);
        let time_left_s = left_steps as Real * config.dt_s;
        for (c, slot) in e.slots.iter().enumerate() {
            let out = &mut obs[c * extent.row..(c + 1) * extent.row];
            let raster = &mut bev[c * bytes..(c + 1) * bytes];
            if slot.ended_earlier(since, e.elapsed_steps) {
                continue;
            }
            let shown = slot.alive || slot.ended_at == Some(e.elapsed_steps);
            let Some(a) = slot.agent_idx.filter(|_| shown) else {
                out.fill(0.0);
                raster.fill(0);
                continue;
            };
            let route = &self.scene.routes[a].path;
            let facts = EgoFacts {
                last_action: [slot.last_action[0], slot.last_action[1]],
                place: slot.place,
                off_road: slot.off_road,
                collided: e.contacts.iter().any(|(of, _)| *of as usize == c),
                route_remaining_m: slot.progress.remaining_m(e.route_s_m[a]),
                goal_ahead_m: slot.progress.ahead_m(e.route_s_m[a]),
                time_remaining: left_steps as Real / (e.elapsed_steps + left_steps).max(1) as Real,
                time_left_s,
                goal_speed_mps: slot.progress.goal_speed_mps(),
            };
            let at = self.scene.at(e.states.elevation_m(a));
            let view = View {
                states: &e.states,
                footprints: &self.scene.footprints,
                kinds: &self.scene.kinds,
                segments: &at.segments,
                map: &self.scene.scene.map,
                road: at.road.as_ref(),
                lights: &self.scene.routes[a].lights,
                step_idx: e.step_idx,
                dt_s: config.dt_s,
                route,
                route_s_m: e.route_s_m[a],
                agent_idx: a,
                facts,
            };
            let (row, style) = out.split_at_mut(extent.row - config.style.len());
            self.observer.write(&view, row);
            for (to, i) in style.iter_mut().zip(styled(&config.style)) {
                *to = slot.drawn.style[i];
            }
            if config.randomization.noise > 0.0 {
                let mut rng = Rng::new(e.noise_seed()).split(c as u64);
                self.observer.disturb(row, || config.randomization.noise * rng.normal());
            }
            if let (Some(bev), Some(ground)) = (&config.observation.bev, &at.raster) {
                bev.draw(&view, ground, raster);
            }
        }
    }

    /// Copies to the last observations of an episode the rows that [`World::observe`] leaves as they are.
    pub(super) fn keep_earlier(&self, extent: Extent, since: usize, out: &mut StepBuffers<'_>) {
        let e = &self.episode;
        let bytes = extent.raster.iter().product::<usize>();
        for (c, _) in e.slots.iter().enumerate().filter(|(_, s)| s.ended_earlier(since, e.elapsed_steps)) {
            let (row, raster) = (c * extent.row..(c + 1) * extent.row, c * bytes..(c + 1) * bytes);
            out.final_obs[row.clone()].copy_from_slice(&out.obs[row]);
            out.final_bev[raster.clone()].copy_from_slice(&out.bev[raster]);
        }
    }
}
