//! Runs the worlds of a batch on the calling thread or on a pool that halves the batch. Worlds in the same scene follow
//! each other, so that what they share is still in the cache.

use crate::geom::Real;
use crate::world::buffers::{Extent, StepBuffers};
use crate::world::tick::World;

/// Batches smaller than this run on the calling thread: handing work to a pool costs more than it saves.
const MIN_PARALLEL_WORLDS: usize = 8;
/// Least number of worlds in one piece of parallel work, and pieces for each thread.
const GRAIN_WORLDS: usize = 4;
const PIECES: usize = 8;

/// Worlds of a batch that follow each other, with what they read and write.
pub(super) struct Part<'a> {
    pub(super) worlds: &'a mut [World],
    /// Their indices in the batch, in any order.
    pub(super) order: &'a mut [u32],
    /// Actions, `width` numbers for each world.
    pub(super) actions: &'a [Real],
    pub(super) width: usize,
    pub(super) out: StepBuffers<'a>,
    pub(super) extent: Extent,
}

/// Runs a job for every world, splitting worlds and buffers in halves over the pool. Allocates nothing.
pub(super) fn run<J>(pool: Option<&rayon::ThreadPool>, batch: Part<'_>, job: &J)
where
    J: Fn(usize, &mut World, &[Real], StepBuffers<'_>) + Sync,
{
    let num_worlds = batch.worlds.len();
    match pool {
        Some(pool) if num_worlds >= MIN_PARALLEL_WORLDS => {
            let grain = GRAIN_WORLDS.max(num_worlds / (PIECES * pool.current_num_threads()));
            pool.install(|| halve(batch, grain, job));
        }
        _ => each(batch, job),
    }
}

fn halve<J>(part: Part<'_>, grain: usize, job: &J)
where
    J: Fn(usize, &mut World, &[Real], StepBuffers<'_>) + Sync,
{
    if part.worlds.len() <= grain {
        return each(part, job);
    }
    let Part { worlds, order, actions, width, out, extent } = part;
    let middle = worlds.len() / 2;
    let (worlds, order) = (worlds.split_at_mut(middle), order.split_at_mut(middle));
    let (actions, out) = (actions.split_at(middle * width), out.split_at(middle, extent));
    let left = Part { worlds: worlds.0, order: order.0, actions: actions.0, width, out: out.0, extent };
    let right = Part { worlds: worlds.1, order: order.1, actions: actions.1, width, out: out.1, extent };
    rayon::join(|| halve(left, grain, job), || halve(right, grain, job));
}

fn each<J>(part: Part<'_>, job: &J)
where
    J: Fn(usize, &mut World, &[Real], StepBuffers<'_>) + Sync,
{
    let Part { worlds, order, actions, width, mut out, extent } = part;
    let Some(first) = worlds.first().map(|w| w.idx) else { return };
    order.sort_unstable_by_key(|i| (worlds[*i as usize - first].episode.scene_idx, *i));
    for i in order.iter().map(|i| *i as usize - first) {
        // each works in the memory of the first one, which is still in the cache
        lend(worlds, i);
        let world = &mut worlds[i];
        job(world.idx, world, &actions[i * width..(i + 1) * width], out.world(i, extent));
        lend(worlds, i);
    }
}

/// Exchanges what the first of some worlds and another one work in.
fn lend(worlds: &mut [World], to: usize) {
    if let Ok([first, other]) = worlds.get_disjoint_mut([0, to]) {
        std::mem::swap(&mut first.scratch, &mut other.scratch);
    }
}
