//! Snapshots of running worlds, bit for bit, and digests of their states.

use crate::error::{Result, SimError};
use crate::state::Height;
use crate::world::VecWorld;
use crate::world::episode::Episode;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::sync::Arc;

/// Layout of the bytes; other layouts are refused, not guessed.
const VERSION: u32 = 8;

#[derive(Serialize, Deserialize)]
struct Snapshot {
    version: u32,
    config: String,
    scene: String,
    episode: Episode,
    heights: Vec<Height>,
}

fn damaged(e: postcard::Error) -> SimError {
    SimError::Snapshot(format!("damaged bytes ({e})"))
}

/// Name of the first field that two fingerprints do not share.
fn different(then: &Value, now: &Value) -> Option<String> {
    let names = [then, now].into_iter().filter_map(Value::as_object).flat_map(|fields| fields.keys());
    names.into_iter().find(|name| then.get(name) != now.get(name)).cloned()
}

impl VecWorld {
    /// Everything that the future of a world depends on: states, generator, clocks, plan.
    ///
    /// # Errors
    /// [`SimError::Unknown`] for a world that does not exist.
    pub fn snapshot(&self, world_idx: usize) -> Result<Vec<u8>> {
        let world = self.world(world_idx)?;
        let snapshot = Snapshot {
            version: VERSION,
            config: self.config_fingerprint().to_string(),
            scene: self.scene_name(world.episode.scene_idx).to_owned(),
            episode: world.episode.clone(),
            heights: world.episode.states.heights.clone(),
        };
        postcard::to_stdvec(&snapshot).map_err(damaged)
    }

    /// Puts a world into the state of a snapshot, its own or another world's of a batch of the same configuration
    /// and scenes: `restore(j, snapshot(i))` forks world i into world j.
    ///
    /// # Errors
    /// [`SimError::Snapshot`] for damaged bytes, another layout, configuration or scene list; the world is unchanged.
    pub fn restore(&mut self, world_idx: usize, bytes: &[u8]) -> Result<()> {
        self.world(world_idx)?;
        let refuse = |what: String| Err(SimError::Snapshot(what));
        let (version, _) = postcard::take_from_bytes::<u32>(bytes).map_err(damaged)?;
        if version != VERSION {
            return refuse(format!("layout {version} of another release, this one reads {VERSION}"));
        }
        let (snapshot, rest) = postcard::take_from_bytes::<Snapshot>(bytes).map_err(damaged)?;
        if !rest.is_empty() {
            return refuse(format!("damaged bytes ({} after the end)", rest.len()));
        }
        let (then, now) = (serde_json::from_str(&snapshot.config), self.config_fingerprint());
        if let Some(name) = then.map_or(Some("fingerprint".into()), |then| different(&then, &now)) {
            return refuse(format!("taken under another configuration: another {name}"));
        }
        let mut episode = snapshot.episode;
        episode.states.heights = snapshot.heights;
        let name =
            (episode.scene_idx < self.num_scenes()).then(|| self.scene_name(episode.scene_idx).to_owned());
        if name.as_deref() != Some(&snapshot.scene) {
            return refuse(format!("scene {:?} is not number {} here", snapshot.scene, episode.scene_idx));
        }
        if episode.next_scene_idx >= self.num_scenes() {
            return refuse(format!("its next scene is number {}", episode.next_scene_idx));
        }
        let scene = self.prepared(episode.scene_idx)?;
        if !episode.fits(&scene, self.config.num_slots, &self.drivers) {
            return refuse("its arrays or numbers do not fit the scene".into());
        }
        let world = &mut self.worlds[world_idx];
        world.enter(Arc::clone(&scene));
        world.episode = episode;
        world.resize();
        world.cast(&self.config);
        Ok(())
    }

    /// Lets a world go on from where it is with the random numbers of another seed: plans made from here on differ, and
    /// its next episode is the first of that seed. What was drawn before, such as drivers and the present plan, stays.
    ///
    /// # Errors
    /// [`SimError::Unknown`] for a world that does not exist, [`SimError::ResetNeeded`] before its first reset.
    pub fn reseed(&mut self, world_idx: usize, seed: u64) -> Result<()> {
        self.status(world_idx)?;
        let episode = &mut self.worlds[world_idx].episode;
        episode.reseed(seed, episode.next_scene_idx);
        Ok(())
    }

    /// FNV-1a digest of the bits of a world's states, its clock, its generator and its plans: equal digests, equal worlds.
    ///
    /// # Errors
    /// [`SimError::Unknown`] for a world that does not exist.
    pub fn digest(&self, world_idx: usize) -> Result<u64> {
        let episode = &self.world(world_idx)?.episode;
        let mut bytes = postcard::to_stdvec(episode).map_err(damaged)?;
        if !episode.states.heights.is_empty() {
            bytes.extend(postcard::to_stdvec(&episode.states.heights).map_err(damaged)?);
        }
        Ok(bytes.iter().fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x100_0000_01b3)))
    }
}
