//! One world in a web page: plain functions over linear memory, called from JavaScript.
//!
//! Texts and bytes come in by [`room`]: it makes room, JavaScript writes there, the next call reads it. Calls that may fail
//! return 1, and [`message`] says why. Log replay, constant velocity and IDM drive; there is one thread.
#![allow(unsafe_code, reason = "names that JavaScript finds; there is no unsafe block")]

mod game;

use game::Game;
use std::cell::RefCell;

thread_local! {
    static GAME: RefCell<Game> = RefCell::default();
}

/// Runs a call on the one game; 1 where it fails.
fn attempt(call: impl FnOnce(&mut Game) -> Result<(), String>) -> u32 {
    GAME.with_borrow_mut(|game| match call(game) {
        Ok(()) => 0,
        Err(message) => {
            game.message = message;
            1
        }
    })
}

/// Room for bytes that the next call reads.
#[unsafe(no_mangle)]
pub extern "C" fn room(length: usize) -> *mut u8 {
    GAME.with_borrow_mut(|game| {
        game.given = vec![0; length];
        game.given.as_mut_ptr()
    })
}

/// Takes the scene whose bytes were given, as `Scene.to_bytes` in Python writes them.
#[unsafe(no_mangle)]
pub extern "C" fn load() -> u32 {
    attempt(Game::load)
}

/// Begins an episode of the scene with the configuration that was given, as `WorldConfig.to_json` in Python writes it.
#[unsafe(no_mangle)]
pub extern "C" fn reset(seed: u32) -> u32 {
    attempt(|game| game.reset(seed.into()))
}

/// One step with a normalised action.
#[unsafe(no_mangle)]
pub extern "C" fn step(first: f32, second: f32) -> u32 {
    attempt(|game| game.step([first, second]))
}

/// Number of agents A.
#[unsafe(no_mangle)]
pub extern "C" fn num_agents() -> usize {
    GAME.with_borrow(Game::num_agents)
}

/// Present states [A, 7]: x, y in metres, heading in radians, velocity x, y in metres per second, 1 where the agent is
/// there, and its driver: -1 for actions from outside, else its place in the table of policies.
#[unsafe(no_mangle)]
pub extern "C" fn states() -> *const f32 {
    GAME.with_borrow(|game| game.states.as_ptr())
}

/// Figures of the last step [M], in the order of the columns of worlds.
#[unsafe(no_mangle)]
pub extern "C" fn columns() -> *const f32 {
    GAME.with_borrow(|game| game.out.columns.as_ptr())
}

/// 1 where the episode has ended.
#[unsafe(no_mangle)]
pub extern "C" fn done() -> u32 {
    GAME.with_borrow(|game| u32::from(game.out.done.first() == Some(&true)))
}

/// Why the last call failed: the text in UTF-8.
#[unsafe(no_mangle)]
pub extern "C" fn message() -> *const u8 {
    GAME.with_borrow(|game| game.message.as_ptr())
}

/// Bytes of the message.
#[unsafe(no_mangle)]
pub extern "C" fn message_length() -> usize {
    GAME.with_borrow(|game| game.message.len())
}
