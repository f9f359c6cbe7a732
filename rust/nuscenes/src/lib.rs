//! nuscenes
