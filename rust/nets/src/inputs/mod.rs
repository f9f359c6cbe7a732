//! What networks see: windows of states, features, lines of the map, and the unicycle in which plans are told.

pub mod features;
pub mod segments;
pub mod tokens;
pub mod unicycle;
