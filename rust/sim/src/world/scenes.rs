//! The scenes of a batch: which of them is played next, and whether it can be played.

use crate::error::{Result, SimError};
use crate::observe::BevConfig;
use crate::scene::Scene;
use crate::world::config::{SceneOrder, WorldConfig};
use crate::world::episode::Episode;
use crate::world::prepared::PreparedScene;
use std::sync::{Arc, OnceLock};

/// The scenes of a batch, each prepared when it is first played.
pub(super) struct Scenes {
    pub(super) list: Vec<(Arc<Scene>, OnceLock<Arc<PreparedScene>>)>,
    bev: Option<BevConfig>,
}

impl Scenes {
    pub(super) fn new(scenes: Vec<Arc<Scene>>, bev: Option<BevConfig>) -> Self {
        Self { list: scenes.into_iter().map(|s| (s, OnceLock::new())).collect(), bev }
    }

    /// The scene of an index, prepared at the first call.
    pub(super) fn prepared(&self, scene_idx: usize) -> Arc<PreparedScene> {
        let (scene, slot) = &self.list[scene_idx];
        let prepare = || Arc::new(PreparedScene::new(Arc::clone(scene), self.bev.as_ref()));
        Arc::clone(slot.get_or_init(prepare))
    }

    /// Scene of a world's next episode, by the configured order.
    pub(super) fn next(
        &self,
        episode: &mut Episode,
        order: SceneOrder,
        num_worlds: usize,
    ) -> (Arc<PreparedScene>, usize) {
        let n = self.list.len();
        let scene_idx = match order {
            SceneOrder::Random => episode.rng.below(n),
            SceneOrder::Sequential => {
                let idx = episode.next_scene_idx;
                episode.next_scene_idx = (idx + num_worlds) % n;
                idx
            }
        };
        (self.prepared(scene_idx), scene_idx)
    }
}

/// Refuses a scene that worlds of a configuration cannot play.
pub(super) fn check_scene(scene: &Scene, config: &WorldConfig) -> Result<()> {
    let fail = |field: &str, got: String, expected| {
        Err(SimError::Scene { scene: scene.name.clone(), field: field.into(), got, expected })
    };
    if (scene.dt_s - config.dt_s).abs() > 1e-6 {
        return fail("dt_s", scene.dt_s.to_string(), "the world's own step");
    }
    if scene.num_steps < config.history_steps + 2 {
        return fail("num_steps", scene.num_steps.to_string(), "more steps than the history and one");
    }
    if config.controlled.anyone_at(scene, config.history_steps) {
        Ok(())
    } else {
        fail("agents", "nobody to control".into(), "a controlled agent present at the start")
    }
}
