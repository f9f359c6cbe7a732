//! What happens to a world whose episode has ended: Gymnasium's autoreset modes.

use crate::stage::PreparedScene;
use crate::world::buffers::StepBuffers;
use crate::world::config::Autoreset;
use crate::world::episode::Episode;
use crate::world::start::Wanted;
use crate::world::tick::{Shared, World};
use std::sync::Arc;

impl World {
    /// Begins the next episode: in NEXT_STEP mode the one that is pending since the last step, in SAME_STEP mode after
    /// the last observations of the present one, `since` the elapsed steps before the decision, are written aside.
    pub(super) fn autoreset(
        &mut self,
        reset_pending: bool,
        since: usize,
        shared: &Shared<'_>,
        next_scene: impl FnOnce(&mut Episode) -> (Arc<PreparedScene>, usize),
        out: &mut StepBuffers<'_>,
    ) {
        let ends_now = out.done[0] && shared.config.autoreset == Autoreset::SameStep;
        if ends_now {
            self.keep_earlier(shared.extent, since, out);
            self.observe(shared.config, shared.extent, since, out.final_obs, out.final_bev, false);
        }
        if reset_pending || ends_now {
            let (scene, scene_idx) = next_scene(&mut self.episode);
            self.begin(scene, scene_idx, shared, &Wanted::default());
            out.was_reset[0] = true;
        }
    }
}
