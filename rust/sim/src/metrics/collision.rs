//! Collisions of a recorded scene, in the variants that a collision rate can mean.

use super::Trajectories;
use crate::error::Result;
use crate::events::{Collisions, Contact, ContactKind};
use crate::scene::AgentKind;
use crate::state::AgentStates;

/// Which contacts count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum CollisionVariant {
    /// Every contact, as the release counts.
    All = 0,
    /// Contacts that involve a controlled agent.
    Controlled = 1,
    /// Contacts of pairs that do not touch at the first step, nor in the log at the same step.
    New = 2,
    /// Both.
    ControlledNew = 3,
}

impl CollisionVariant {
    /// All variants in the order of their numbers.
    pub const ALL: [Self; 4] = [Self::All, Self::Controlled, Self::New, Self::ControlledNew];
}

/// One pair of agents in contact at one step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PairContact {
    /// Step index.
    pub step_idx: u32,
    /// The two agents, the smaller index first.
    pub agents: (u32, u32),
    /// Whether one of them is controlled.
    pub controlled: bool,
    /// Whether the pair touched neither at the first step nor in the log at this step.
    pub new: bool,
}

impl PairContact {
    fn counts_in(&self, variant: CollisionVariant) -> bool {
        match variant {
            CollisionVariant::All => true,
            CollisionVariant::Controlled => self.controlled,
            CollisionVariant::New => self.new,
            CollisionVariant::ControlledNew => self.controlled && self.new,
        }
    }
}

/// All contacts of one scene.
#[derive(Debug, Clone, PartialEq)]
pub struct CollisionReport {
    /// By step, then agents.
    pub contacts: Vec<PairContact>,
    /// Side on which every agent is hit at its first contact.
    pub first_kind: Vec<Option<ContactKind>>,
    present: Vec<bool>,
}

impl CollisionReport {
    /// Finds the contacts of a rollout. `log` is the recorded traffic of the same agents and steps.
    ///
    /// # Errors
    /// [`crate::SimError::Length`] where `controlled` or `log` do not fit the rollout.
    ///
    /// # Reference
    /// reference.md#collisions.
    pub fn new(
        motion: &Trajectories<'_>,
        controlled: &[bool],
        log: Option<&Trajectories<'_>>,
    ) -> Result<Self> {
        motion.check_same(log, controlled)?;
        let num_agents = motion.num_agents();
        let kinds = vec![AgentKind::Vehicle; num_agents];
        let (mut states, mut found) = (AgentStates::new(num_agents), Collisions::new());
        let (mut log_states, mut log_found) = (AgentStates::new(num_agents), Collisions::new());
        let mut report = Self {
            contacts: Vec::new(),
            first_kind: vec![None; num_agents],
            present: (0..num_agents)
                .map(|a| (0..motion.num_steps()).any(|t| motion.is_valid(a, t)))
                .collect(),
        };
        let mut at_start: Vec<(u32, u32)> = Vec::new();
        for step_idx in 0..motion.num_steps() {
            motion.states_at(step_idx, &mut states);
            found.find(&states, motion.footprints(), &kinds);
            if step_idx == 0 {
                at_start = found.pairs().to_vec();
            }
            if let Some(log) = log {
                log.states_at(step_idx, &mut log_states);
                log_found.find(&log_states, log.footprints(), &kinds);
            }
            for &(a, b) in found.pairs() {
                for (agent, partner) in [(a as usize, b as usize), (b as usize, a as usize)] {
                    let kind =
                        || Contact::between(&states, motion.footprints(), agent, partner, || false).kind;
                    report.first_kind[agent].get_or_insert_with(kind);
                }
                let pair = (a.min(b), a.max(b));
                let among = |pairs: &[(u32, u32)]| pairs.iter().any(|&(c, d)| pair == (c.min(d), c.max(d)));
                report.contacts.push(PairContact {
                    step_idx: step_idx as u32,
                    agents: pair,
                    controlled: controlled[a as usize] || controlled[b as usize],
                    new: !among(&at_start) && !among(log_found.pairs()),
                });
            }
        }
        report.contacts.sort_by_key(|c| (c.step_idx, c.agents));
        Ok(report)
    }

    /// Whether every agent is ever in a contact that counts.
    pub fn agents(&self, variant: CollisionVariant) -> Vec<bool> {
        let mut collided = vec![false; self.present.len()];
        for contact in self.contacts.iter().filter(|c| c.counts_in(variant)) {
            collided[contact.agents.0 as usize] = true;
            collided[contact.agents.1 as usize] = true;
        }
        collided
    }

    /// Share of the agents that are ever there that are ever in a contact that counts; 0 without agents.
    pub fn agent_rate(&self, variant: CollisionVariant) -> f64 {
        let present = self.present.iter().filter(|&&p| p).count();
        let collided = self.agents(variant).iter().filter(|&&c| c).count();
        if present == 0 { 0.0 } else { collided as f64 / present as f64 }
    }
}
