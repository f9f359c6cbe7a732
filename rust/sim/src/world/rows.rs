//! Phase "observe" of a tick: rows and rasters of the slots.

use crate::geom::Real;
use crate::observe::{EgoFacts, View};
use crate::world::buffers::Extent;
use crate::world::config::WorldConfig;
use crate::world::tick::World;

impl World {
    /// Writes the observations of all slots: of agents that go on, and of those whose episode ended in this very
    /// step. Those of agents whose episode ended after `since` elapsed steps are there already. Rows and rasters of
    /// the others are zero.
    pub(crate) fn observe(
        &mut self,
        config: &WorldConfig,
        extent: Extent,
        since: usize,
        obs: &mut [Real],
        bev: &mut [u8],
    ) {
        let e = &self.episode;
        self.observer.prepare(&e.states);
        let bytes = extent.raster.iter().product::<usize>();
        for (c, slot) in e.slots.iter().enumerate() {
            let out = &mut obs[c * extent.row..(c + 1) * extent.row];
            let raster = &mut bev[c * bytes..(c + 1) * bytes];
            if slot.ended_at.is_some_and(|at| since < at && at < e.elapsed_steps) {
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
                speed_limit_mps: slot.speed_limit_mps,
                lane_distance_m: slot.lane_distance_m,
                lateral_m: slot.route_distance_m,
                heading_error_rad: slot.route_heading_error_rad,
                off_road: slot.off_road,
                collided: slot.in_contact,
                route_remaining_m: (slot.goal_s_m - e.route_s_m[a]).max(0.0),
                time_remaining: 1.0 - e.elapsed_steps as Real / config.horizon_steps as Real,
            };
            let view = View {
                states: &e.states,
                footprints: &self.scene.footprints,
                kinds: &self.scene.kinds,
                segments: &self.scene.segments,
                route,
                route_s_m: e.route_s_m[a],
                agent_idx: a,
                anticipation_s: config.idm.anticipation_s,
                facts,
            };
            self.observer.write(&view, out);
            if let (Some(bev), Some(ground)) = (&config.observation.bev, &self.scene.ground) {
                bev.draw(&view, ground, raster);
            }
        }
    }
}
