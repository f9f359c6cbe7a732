//! Phase "decide" of a tick: the physical actions of the agents driven from outside, and what drivers do with theirs.

use crate::drivers::{Driver, DriverModel, Idm};
use crate::dynamics::Dynamics;
use crate::geom::Real;
use crate::scene::AgentKind;
use crate::world::tick::assist;
use crate::world::tick::{Shared, World};

impl World {
    pub(super) fn decide(&mut self, actions: &[Real], shared: &Shared<'_>) {
        let width = shared.decoder.width();
        self.scratch.actions.clear();
        for (c, slot) in self.episode.slots.iter_mut().enumerate() {
            let external = slot.agent_idx.is_some_and(|a| self.episode.drivers[a] == Driver::External);
            let mut physical = [0.0; 3];
            if external && slot.alive {
                physical = shared.decoder.decode(&actions[c * width..(c + 1) * width]);
                slot.last_action = shared.decoder.normalise(&physical);
            }
            self.scratch.actions.push(slot.drawn.delayed(physical, self.episode.elapsed_steps));
        }
        self.episode.find_followers(&self.scene.kinds, &mut self.scratch.follow_log);
        let mut motions = std::mem::take(&mut self.scratch.motions);
        motions.clear();
        let mut own = std::mem::take(&mut self.scratch.actions);
        let view = self.view(shared.config);
        if let Dynamics::Assisted(limits) = shared.decoder.dynamics() {
            for (slot, action) in self.episode.slots.iter().zip(&mut own) {
                if let Some(a) = slot.agent_idx.filter(|a| view.drivers[*a] == Driver::External) {
                    *action = assist::assisted_action(limits, &view, a, *action);
                }
            }
        }
        for (slot, action) in self.episode.slots.iter().zip(&mut own) {
            *action = slot.drawn.times_gains(*action);
        }
        for a in (0..view.states.len()).filter(|a| !self.scratch.follow_log[*a]) {
            let Driver::Model(driver_idx) = view.drivers[a] else { continue };
            // obstacles do not move
            if view.states.active[a] && view.scene.kinds[a] != AgentKind::Static {
                let plan = self.episode.plans[usize::from(driver_idx)].as_ref();
                let driver = shared.drivers.get(driver_idx);
                let motion = match driver.follows_route(plan, a) && view.backed_up_since(plan, a) {
                    true => Idm { config: *view.idm }.act(&view, None, a),
                    false => driver.act(&view, plan, a),
                };
                motions.push((a as u32, motion));
            }
        }
        (self.scratch.motions, self.scratch.actions) = (motions, own);
    }
}
