//! One world in a web page: plain functions over linear memory, called from JavaScript.
//!
//! Texts and bytes come in by [`room`]: it makes room, JavaScript writes there, the next call reads it. Calls that may fail
//! return 1, and [`message`] says why. Log replay, constant velocity, IDM and networks whose weights were given drive; there is one thread.
#![allow(unsafe_code, reason = "names that JavaScript finds; there is no unsafe block")]

mod playground;

use playground::Playground;
use std::cell::RefCell;

thread_local! {
    static PLAYGROUND: RefCell<Playground> = RefCell::default();
}

/// Runs a call on the one playground; 1 where it fails.
fn attempt(call: impl FnOnce(&mut Playground) -> Result<(), String>) -> u32 {
    PLAYGROUND.with_borrow_mut(|playground| match call(playground) {
        Ok(()) => 0,
        Err(message) => {
            playground.message = message;
            1
        }
    })
}

/// Room for bytes that the next call reads.
#[unsafe(no_mangle)]
pub extern "C" fn room(length: usize) -> *mut u8 {
    PLAYGROUND.with_borrow_mut(|playground| {
        playground.given = vec![0; length];
        playground.given.as_mut_ptr()
    })
}

/// Takes the scene whose bytes were given, as `Scene.to_bytes` in Python writes them.
#[unsafe(no_mangle)]
pub extern "C" fn load() -> u32 {
    attempt(Playground::load)
}

/// Takes the weights of one more network: the bytes of their file.
#[unsafe(no_mangle)]
pub extern "C" fn weights() -> u32 {
    attempt(Playground::weights)
}

/// Takes the weights of a trained ego: the bytes of its safetensors file.
#[unsafe(no_mangle)]
pub extern "C" fn ego() -> u32 {
    attempt(Playground::ego)
}

/// Asks the trained ego for its action in the present state of a world that observes as it does: [`action`] has it.
#[unsafe(no_mangle)]
pub extern "C" fn decide() -> u32 {
    attempt(Playground::decide)
}

/// Begins an episode of the scene with the configuration that was given, as `WorldConfig.to_json` in Python writes it.
#[unsafe(no_mangle)]
pub extern "C" fn reset(seed: u32) -> u32 {
    attempt(|playground| playground.reset(seed.into()))
}

/// One step with a normalised action.
#[unsafe(no_mangle)]
pub extern "C" fn step(first: f32, second: f32) -> u32 {
    attempt(|playground| playground.step([first, second]))
}

/// Number of agents A.
#[unsafe(no_mangle)]
pub extern "C" fn num_agents() -> usize {
    PLAYGROUND.with_borrow(Playground::num_agents)
}

/// Present states [A, 8]: x, y in metres, heading in radians, velocity x, y in metres per second, 1 where the agent is
/// there, its driver (-1 for actions from outside, else its place in the table of drivers), and 1 where a plan guides it.
#[unsafe(no_mangle)]
pub extern "C" fn states() -> *const f32 {
    PLAYGROUND.with_borrow(|playground| playground.states.as_ptr())
}

/// Figures of the last step [M], in the order of the columns of worlds.
#[unsafe(no_mangle)]
pub extern "C" fn columns() -> *const f32 {
    PLAYGROUND.with_borrow(|playground| playground.out.columns.as_ptr())
}

/// The action of the last decision [2], normalised.
#[unsafe(no_mangle)]
pub extern "C" fn action() -> *const f32 {
    PLAYGROUND.with_borrow(|playground| playground.action.as_ptr())
}

/// The plan in force: the step at which it was made, agents M and steps T, then of each agent its place in the scene,
/// 1 where it is guided, 1 where it follows the plan, and x, y in metres after each step of the sample that it follows;
/// last the causal graph [M, M]. Empty without a plan.
#[unsafe(no_mangle)]
pub extern "C" fn plan() -> *const f32 {
    PLAYGROUND.with_borrow(|playground| playground.plan.as_ptr())
}

/// Numbers of the plan in force.
#[unsafe(no_mangle)]
pub extern "C" fn plan_length() -> usize {
    PLAYGROUND.with_borrow(|playground| playground.plan.len())
}

/// 1 where the episode has ended.
#[unsafe(no_mangle)]
pub extern "C" fn done() -> u32 {
    PLAYGROUND.with_borrow(|playground| u32::from(playground.out.done.first() == Some(&true)))
}

/// Why the last call failed: the text in UTF-8.
#[unsafe(no_mangle)]
pub extern "C" fn message() -> *const u8 {
    PLAYGROUND.with_borrow(|playground| playground.message.as_ptr())
}

/// Bytes of the message.
#[unsafe(no_mangle)]
pub extern "C" fn message_length() -> usize {
    PLAYGROUND.with_borrow(|playground| playground.message.len())
}
