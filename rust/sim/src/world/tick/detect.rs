//! Phase "events" of a tick: contacts of the agents with slots, and where these are beside road, route and lane.

use crate::drivers::Driver;
use crate::events::Contact;
use crate::geom::Real;
use crate::world::config::WorldConfig;
use crate::world::episode::Slot;
use crate::world::tick::World;
use crate::world::tick::surroundings::{leave_road, place_on_route, straddles_lanes};
use crate::world::tick::sweep::{parts, states_between};

impl World {
    /// Finds out what happened to the agents with slots. At the start of an episode contacts are taken as given.
    pub(super) fn find_events(&mut self, config: &WorldConfig, at_start: bool) {
        self.look_between(at_start, config.dt_s);
        let e = &mut self.episode;
        self.scratch.from_route_m.resize(e.slots.len(), 0.0);
        for (slot, from_route_m) in e.slots.iter_mut().zip(&mut self.scratch.from_route_m) {
            if let Some(a) = slot.agent_idx.filter(|a| e.states.active[*a]) {
                leave_road(&e.states, &self.scene, a, slot);
                (slot.place, *from_route_m) =
                    place_on_route(&e.states, &self.scene, a, e.route_s_m[a], config.speed_limit_mps);
            }
        }
    }

    /// Finds the first new contact of each slot in the step and departures from the road between its ends.
    fn look_between(&mut self, at_start: bool, dt_s: Real) {
        let (e, scene) = (&mut self.episode, &*self.scene);
        self.scratch.contacts.clear();
        self.scratch.contacts.resize(e.slots.len(), None);
        self.scratch.touched.clear();
        let there = |s: &&mut Slot| s.agent_idx.is_some_and(|a| e.states.active[a]);
        for slot in e.slots.iter_mut().filter(there) {
            (slot.off_road, slot.off_road_centroid) = (false, false);
        }
        let present = |a: &usize| e.states.active[*a];
        self.scratch.present.clear();
        self.scratch
            .present
            .extend(e.slots.iter().filter_map(|s| s.agent_idx.filter(present)).map(|a| a as u32));
        // contacts of what a slot's agent tows are its own
        let is_towed = |a: usize| e.drivers[a] == Driver::Towed;
        for a in scene.hitches.iter().map(|(a, _)| *a).filter(|a| is_towed(*a) && present(a)) {
            let tows = |s: &Slot| s.agent_idx.is_some_and(|leader| e.states.hitched(leader, a));
            self.scratch.present.extend(e.slots.iter().any(tows).then_some(a as u32));
        }
        let parts = if at_start { 1 } else { parts(dt_s) };
        for part in 1..=parts {
            let (before, was_active) = (&self.scratch.before, &self.active_before);
            let between = (part < parts)
                .then(|| states_between(&e.states, before, was_active, part as Real / parts as Real));
            let states = between.as_ref().unwrap_or(&e.states);
            let pairs = self.scratch.collisions.pairs_of(
                states,
                &scene.footprints,
                &scene.kinds,
                &self.scratch.present,
            );
            let touch = |i: u32, j: u32| pairs.contains(&(i.min(j), i.max(j)));
            let both_there = |i: u32, j: u32| states.active[i as usize] && states.active[j as usize];
            e.initial_contacts.retain(|(i, j)| touch(*i, *j) || !both_there(*i, *j));
            let found = self.scratch.contacts.iter_mut();
            for (c, (slot, contact)) in e.slots.iter_mut().zip(found).enumerate() {
                let Some(a) = slot.agent_idx.filter(|a| states.active[*a]) else { continue };
                if part < parts {
                    leave_road(states, scene, a, slot);
                }
                let is_own = |i: usize| i == a || states.hitched(i, a) && is_towed(i);
                for &(i, j) in pairs {
                    let (own, other) = match (i as usize, j as usize) {
                        (i, j) if is_own(i) => (i, j),
                        (i, j) if is_own(j) => (j, i),
                        _ => continue,
                    };
                    let pair = (own as u32, other as u32);
                    if at_start {
                        e.initial_contacts.push(pair);
                    } else if !e.initial_contacts.contains(&pair) {
                        let partner = (c as u32, other as u32);
                        if contact.is_none() && !e.contacts.contains(&partner) {
                            let straddles = || straddles_lanes(states, scene, own);
                            *contact =
                                Some(Contact::between(states, &scene.footprints, own, other, straddles));
                        }
                        if !self.scratch.touched.contains(&partner) {
                            self.scratch.touched.push(partner);
                        }
                    }
                }
            }
        }
    }
}
