//! Time to contact of two agents of a world.

use crate::geom::Real;
use crate::state::{AgentStates, Body};

/// First time at which two agents touch when both keep their velocities, seconds; `None` beyond the horizon.
///
/// The circles round the boxes are asked first: most pairs never come near.
#[inline]
pub fn time_to_contact(
    states: &AgentStates,
    bodies: &[Body],
    i: usize,
    j: usize,
    horizon_s: Real,
) -> Option<Real> {
    let d = states.position(j) - states.position(i);
    let w = states.velocity(j) - states.velocity(i);
    let reach = bodies[i].radius_m + bodies[j].radius_m;
    // the circles touch when |d + w t| = reach
    let (dw, ww) = (d.dot(&w), w.norm_squared());
    let gap = d.norm_squared() - reach * reach;
    if gap > 0.0 {
        let discriminant = dw * dw - ww * gap;
        if dw >= 0.0 || discriminant < 0.0 || -dw - discriminant.sqrt() > horizon_s * ww {
            return None;
        }
    }
    let (a, b) = (states.oriented_box(i, &bodies[i]), states.oriented_box(j, &bodies[j]));
    a.time_to_contact(states.velocity(i), &b, states.velocity(j), horizon_s)
}
