//! Who runs the worlds of a batch: the calling thread, or a pool that halves the batch.

use crate::geom::Real;
use crate::world::buffers::{Extent, StepBuffers};
use crate::world::tick::World;

/// Batches smaller than this run on the calling thread: handing work to a pool costs more than it saves.
const MIN_PARALLEL_WORLDS: usize = 8;
/// Worlds in one piece of parallel work.
const GRAIN_WORLDS: usize = 4;

/// Runs a job for every world, splitting worlds and buffers in halves over the pool. Allocates nothing.
pub(super) fn run<J>(
    pool: Option<&rayon::ThreadPool>,
    worlds: &mut [World],
    actions: &[Real],
    width: usize,
    out: StepBuffers<'_>,
    extent: Extent,
    job: &J,
) where
    J: Fn(usize, &mut World, &[Real], StepBuffers<'_>) + Sync,
{
    match pool {
        Some(pool) if worlds.len() >= MIN_PARALLEL_WORLDS => {
            pool.install(|| halve(worlds, actions, width, out, extent, job));
        }
        _ => each(worlds, actions, width, out, extent, job),
    }
}

fn halve<J>(
    worlds: &mut [World],
    actions: &[Real],
    width: usize,
    out: StepBuffers<'_>,
    extent: Extent,
    job: &J,
) where
    J: Fn(usize, &mut World, &[Real], StepBuffers<'_>) + Sync,
{
    if worlds.len() <= GRAIN_WORLDS {
        return each(worlds, actions, width, out, extent, job);
    }
    let middle = worlds.len() / 2;
    let (left, right) = worlds.split_at_mut(middle);
    let (left_actions, right_actions) = actions.split_at(middle * width);
    let (left_out, right_out) = out.split_at(middle, extent);
    rayon::join(
        || halve(left, left_actions, width, left_out, extent, job),
        || halve(right, right_actions, width, right_out, extent, job),
    );
}

fn each<J>(
    worlds: &mut [World],
    actions: &[Real],
    width: usize,
    mut out: StepBuffers<'_>,
    extent: Extent,
    job: &J,
) where
    J: Fn(usize, &mut World, &[Real], StepBuffers<'_>) + Sync,
{
    for (i, world) in worlds.iter_mut().enumerate() {
        let actions = &actions[i * width..(i + 1) * width];
        job(world.idx, world, actions, out.world(i, extent));
    }
}
