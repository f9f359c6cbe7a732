//! The scenes of a batch: which of them is played next, and whether it can be played.

use crate::error::{Result, SimError, check_length};
use crate::observe::BevConfig;
use crate::scene::Scene;
use crate::stage::PreparedScene;
use crate::world::config::{Controlled, SceneOrder, WorldConfig};
use crate::world::episode::{Episode, Start, Wanted};
use crate::world::rng::Rng;
use std::borrow::Cow;
use std::sync::{Arc, OnceLock};

/// The scenes of a batch, each prepared when it is first played.
pub(super) struct Scenes {
    pub(super) list: Vec<(Arc<Scene>, OnceLock<Arc<PreparedScene>>)>,
    bev: Option<BevConfig>,
    /// Running sums of the weights by which scenes are drawn; all alike without.
    sums: Option<Vec<f64>>,
}

impl Scenes {
    pub(super) fn new(scenes: Vec<Arc<Scene>>, bev: Option<BevConfig>) -> Self {
        Self { list: scenes.into_iter().map(|s| (s, OnceLock::new())).collect(), bev, sums: None }
    }

    /// Scenes of episodes that begin later are drawn by these weights; all alike without.
    pub(super) fn weigh(&mut self, weights: Option<&[f64]>) -> Result<()> {
        let Some(weights) = weights else {
            self.sums = None;
            return Ok(());
        };
        check_length("scene weights", weights.len(), self.list.len())?;
        let fine = |w: &f64| (0.0..=1e100).contains(w);
        if let Some(bad) = weights.iter().find(|w| !fine(w)) {
            return Err(SimError::config("scene weights", bad, "finite weights, not negative"));
        }
        let sum = |sum: &mut f64, w: &f64| {
            *sum += w;
            Some(*sum)
        };
        let sums: Vec<f64> = weights.iter().scan(0.0, sum).collect();
        if sums.last().is_none_or(|total| *total <= 0.0) {
            return Err(SimError::config("scene weights", "only 0", "one above 0"));
        }
        self.sums = Some(sums);
        Ok(())
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
            SceneOrder::Random => match &self.sums {
                Some(sums) => episode.rng.pick(sums),
                None => episode.rng.below(n),
            },
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
    let fail = |field: &str, got: String, expected: Cow<'static, str>| {
        Err(SimError::Scene { scene: scene.name.clone(), field: field.into(), got, expected })
    };
    if (scene.dt_s - config.dt_s).abs() > 1e-6 {
        return fail("dt_s", scene.dt_s.to_string(), "the world's own step".into());
    }
    let (has, history) = (scene.num_steps, config.history_steps);
    if has < history.saturating_add(2) {
        let expected = match has.checked_sub(2) {
            Some(fits) => format!(
                "at least history_steps + 2 = {}: history_steps of at most {fits} fits",
                history.saturating_add(2)
            ),
            None => "at least 2: a start and a step".into(),
        };
        return fail("num_steps", has.to_string(), expected.into());
    }
    if Start::draw(scene, None, config, &Wanted::default(), Rng::new(0)).is_some() {
        return Ok(());
    }
    let ids = scene.agents.iter().map(|a| &*a.id).take(9).collect::<Vec<_>>();
    let whom = if config.controlled == Controlled::Ego {
        "an agent \"ego\" (see Scene.with_ego)"
    } else {
        "one to control"
    };
    fail("agents", format!("{ids:?}"), format!("{whom} that is there at step {history}").into())
}
