//! After warm-up a step allocates nothing, resets of ended episodes included.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use ccdiff_sim::world::{Autoreset, Controlled, WorldConfig};
use common::{Batch, actions, city};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    /// Allocations of this thread; the test harness has threads of its own.
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

struct Counting;

fn count() {
    // nothing is counted while a thread ends
    let _ = COUNT.try_with(|c| c.set(c.get() + 1));
}

#[allow(unsafe_code, reason = "an allocator can only be replaced by implementing this unsafe trait")]
// SAFETY: every call goes to the system's allocator as it came; the counter allocates nothing.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        unsafe { System.dealloc(block, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Allocations of the steps of two episodes that have been played once before.
fn allocations(config: WorldConfig) -> usize {
    let (envs, steps) = (3, 2 * config.horizon_steps);
    let width = 2 * envs * config.num_slots;
    let config = WorldConfig { autoreset: Autoreset::SameStep, ..config };
    let mut batch = Batch::new(vec![city(12), city(30)], config, envs, 1);
    let all_actions: Vec<Vec<f32>> = (0..steps).map(|t| actions(t, width)).collect();
    let mut ended = 0;
    let mut play = |batch: &mut Batch| {
        batch.reset_all(3);
        let before = COUNT.get();
        for actions in &all_actions {
            batch.step(actions).unwrap();
            ended += batch.done.iter().filter(|d| **d).count();
        }
        COUNT.get() - before
    };
    play(&mut batch);
    let count = play(&mut batch);
    assert!(ended >= 2 * envs, "{ended} episodes ended");
    count
}

#[test]
fn a_step_allocates_nothing_in_traffic_of_rules_and_with_many_controlled_agents() {
    for (traffic, controlled, num_slots) in
        [("replay", Controlled::Ego, 1), ("idm", Controlled::Ego, 1), ("idm", Controlled::Vehicles, 20)]
    {
        let traffic = traffic.into();
        let config =
            WorldConfig { traffic, controlled, num_slots, horizon_steps: 60, ..WorldConfig::default() };
        assert_eq!(allocations(config), 0);
    }
}

#[test]
fn the_counter_counts() {
    let before = COUNT.get();
    std::hint::black_box(Vec::<u8>::with_capacity(std::hint::black_box(100)));
    assert_eq!(COUNT.get() - before, 1);
}
