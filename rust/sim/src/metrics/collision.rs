//! Contacts of a recorded scene.

use super::Trajectories;
use crate::events::{Collisions, Contact, ContactKind};
use crate::scene::AgentKind;
use crate::state::AgentStates;

/// All contacts of one scene: step and the two agents, the smaller index first, in this order; and the side on which every
/// agent is hit at its first contact.
///
/// # Reference
/// reference.md#collisions.
pub fn contacts(motion: &Trajectories<'_>) -> (Vec<[u32; 3]>, Vec<Option<ContactKind>>) {
    let num_agents = motion.num_agents();
    let kinds = vec![AgentKind::Vehicle; num_agents];
    let (mut states, mut found) = (AgentStates::new(num_agents), Collisions::new());
    let (mut contacts, mut first_kind) = (Vec::new(), vec![None; num_agents]);
    for step_idx in 0..motion.num_steps() {
        motion.states_at(step_idx, &mut states);
        found.find(&states, motion.footprints(), &kinds);
        for &(a, b) in found.pairs() {
            for (agent, partner) in [(a as usize, b as usize), (b as usize, a as usize)] {
                let kind = || Contact::between(&states, motion.footprints(), agent, partner, || false).kind;
                first_kind[agent].get_or_insert_with(kind);
            }
            contacts.push([step_idx as u32, a.min(b), a.max(b)]);
        }
    }
    contacts.sort_unstable();
    (contacts, first_kind)
}
