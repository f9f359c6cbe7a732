//! What networks see: windows of states, features, map crops, lines, and the unicycle in which plans are told.

pub mod features;
pub mod raster;
pub mod segments;
pub mod tokens;
pub mod unicycle;
