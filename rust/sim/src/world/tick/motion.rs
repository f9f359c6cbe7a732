//! Phase "move" of a tick: agents move, stop where they touch, go along their routes, enter and leave.

use crate::drivers::{AgentMotion, Driver};
use crate::geom::Vector2;
use crate::world::config::TrafficCollision;
use crate::world::tick::arrival;
use crate::world::tick::halt;
use crate::world::tick::sweep::parts;
use crate::world::tick::tow;
use crate::world::tick::{Shared, World};

impl World {
    pub(super) fn move_agents(&mut self, shared: &Shared<'_>) {
        let config = shared.config;
        let e = &mut self.episode;
        e.step_idx += 1;
        e.elapsed_steps += 1;
        let stops = config.on_traffic_collision == TrafficCollision::Stop
            && e.drivers.iter().any(|d| !matches!(*d, Driver::External | Driver::REPLAY | Driver::Towed));
        self.scratch.before.clear();
        let looks_back = !self.scene.hitches.is_empty() || !self.scene.scene.map.lights.is_empty();
        if stops || looks_back || parts(config.dt_s) > 1 {
            self.scratch.before.extend((0..e.states.len()).map(|a| e.states.pose(a)));
            self.active_before.clone_from(&e.states.active);
        }
        for (c, slot) in e.slots.iter().enumerate() {
            let Some(a) = slot.agent_idx.filter(|a| e.states.active[*a]) else { continue };
            if slot.stopped {
                let pose = e.states.pose(a);
                e.states.set_pose(a, pose, Vector2::zeros());
            } else if e.drivers[a] == Driver::External {
                let footprint = &self.scene.footprints[a];
                shared.decoder.dynamics().step_agent(
                    &mut e.states,
                    a,
                    self.scratch.actions[c],
                    config.dt_s,
                    footprint,
                );
            }
        }
        self.scene.log.follow(
            e.step_idx,
            &self.scratch.follow_log,
            &mut e.states,
            &mut self.scratch.masks,
            config.dt_s,
        );
        self.scratch.slot_of.clear();
        self.scratch.slot_of.resize(e.states.len(), None);
        for (c, slot) in e.slots.iter().enumerate() {
            if let Some(a) = slot.agent_idx {
                self.scratch.slot_of[a] = Some(c as u32);
            }
        }
        for (a, motion) in self.scratch.motions.drain(..) {
            let a = a as usize;
            let slot = self.scratch.slot_of[a].map(|c| &e.slots[c as usize]);
            let log_ended = config.vanish_with_log && !self.scene.log.goes_on(a, e.step_idx);
            match (motion, slot) {
                (_, Some(slot)) if slot.stopped => {}
                (AgentMotion::Place(pose, velocity), Some(_)) => {
                    e.place(&self.scene, a, pose, velocity, config.dt_s)
                }
                // an agent with a slot waits where its driver has no more way for it
                (AgentMotion::Leave, Some(_)) => {
                    let pose = e.states.pose(a);
                    e.states.set_pose(a, pose, Vector2::zeros());
                }
                (_, None) if e.halted[a] && !log_ended => {
                    let pose = e.states.pose(a);
                    e.set_pose(a, pose, Vector2::zeros(), config.dt_s);
                }
                (AgentMotion::Place(pose, velocity), None) if !log_ended => {
                    e.place(&self.scene, a, pose, velocity, config.dt_s);
                }
                _ => e.states.active[a] = false,
            }
        }
        tow::tow(e, &self.scene, &self.scratch.before, config.dt_s);
        if stops {
            let was = (&self.scratch.before[..], &self.active_before[..]);
            halt::halt(e, &self.scene, &mut self.scratch.collisions, was, config.dt_s);
        }
        for a in 0..e.states.len() {
            let follows_route = e.drivers[a] != Driver::REPLAY || self.scratch.slot_of[a].is_some();
            if e.states.active[a] && follows_route {
                let moved_m = e.states.velocity(a).norm() * config.dt_s;
                e.route_s_m[a] = self.scene.routes[a].advance(e.states.position(a), e.route_s_m[a], moved_m);
                if let Some(before) = e.states.heights.get(a).copied() {
                    e.states.heights[a] = self.scene.height(a, &e.states.pose(a), e.route_s_m[a], before);
                }
            }
        }
        arrival::let_in(e, &self.scene, config);
        tow::find_towed(e, &self.scene);
        if let Some(history) = &mut e.history {
            history.push(&e.states);
        }
    }
}
