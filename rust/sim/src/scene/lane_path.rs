//! The way along lanes: a centre line, then those of the lanes that follow.

use super::map::{Lane, Map};
use crate::geom::{Point2, Real};

/// Most of one straight segment of a lane that a way follows, metres.
const LONGEST_STEP_M: Real = 1000.0;
/// Most lanes that a way follows: lines of no length may follow each other in a circle.
const MOST_LANES: usize = 1000;

/// Calls with points and elevations of a lane and its first followers for a length; returns what is left of the length.
pub(crate) fn follow(
    map: &Map,
    lane_idx: u32,
    from_s_m: Real,
    length_m: Real,
    mut call: impl FnMut(Point2, Option<Real>),
) -> Real {
    let (mut lane, mut from_s_m, mut left_m) = (lane_idx as usize, from_s_m, length_m);
    for _ in 0..MOST_LANES {
        let mut s = 0.0;
        let Lane { centreline, elevation_m, .. } = &map.lanes[lane];
        for (i, pair) in centreline.windows(2).enumerate() {
            s += (pair[1] - pair[0]).norm();
            if s >= from_s_m && left_m > 0.0 {
                let step = pair[1] - pair[0];
                // a metre where the loaders made the line, but a file can say anything
                let share = (LONGEST_STEP_M / step.norm()).min(1.0);
                left_m -= step.norm();
                let point = if share < 1.0 { pair[0] + step * share } else { pair[1] };
                call(point, elevation_m.get(i + 1).copied());
            }
        }
        from_s_m = 0.0;
        let Some(next) = map.lanes[lane].successors.first() else { break };
        if left_m <= 0.0 {
            break;
        }
        lane = *next as usize;
    }
    left_m
}
