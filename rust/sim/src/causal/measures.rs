//! Pairwise measures of agents: time to contact (TTC) and distance, as matrices [M, M].

use crate::geom::{OrientedBox, Real, Vector2, math};

/// Times to contact are capped here, seconds (reference.md#pairwise-features).
pub const TTC_CAP_S: Real = 20.0;
/// Distances beyond this are 0 in the normalised form, metres (reference.md#pairwise-features).
pub const DISTANCE_CAP_M: Real = 20.0;

/// Box and velocity of an agent at one step, all agents in one frame; `None` where it is absent.
pub type Moving = Option<(OrientedBox, Vector2)>;

/// Times to contact of M agents [M, M], seconds in [0, 20], by sweeping their boxes at constant velocity.
///
/// `apart` [M, M] marks pairs on different levels, and is empty where there are none. Such pairs, and those with an absent
/// agent, hold 20 s.
pub fn ttc_s(agents: &[Moving], apart: &[bool]) -> Vec<Real> {
    pairwise(agents, apart, TTC_CAP_S, |(one, velocity), (other, other_velocity)| {
        one.time_to_contact(*velocity, other, *other_velocity, TTC_CAP_S).unwrap_or(TTC_CAP_S)
    })
}

/// Distances of the centres of M agents [M, M], metres; infinite where [`ttc_s`] holds 20 s for want of an agent or level.
pub fn distance_m(agents: &[Moving], apart: &[bool]) -> Vec<Real> {
    pairwise(agents, apart, Real::INFINITY, |(one, _), (other, _)| {
        let d = one.centre - other.centre;
        math::hypot(d.x, d.y)
    })
}

/// A symmetric measure of all pairs, 0 of an agent with itself and `none` where a pair cannot meet.
fn pairwise(
    agents: &[Moving],
    apart: &[bool],
    none: Real,
    measure: impl Fn(&(OrientedBox, Vector2), &(OrientedBox, Vector2)) -> Real,
) -> Vec<Real> {
    let num_agents = agents.len();
    let mut out = vec![none; num_agents * num_agents];
    for (i, one) in agents.iter().enumerate() {
        let Some(one) = one else { continue };
        out[i * num_agents + i] = 0.0;
        for (j, other) in agents.iter().enumerate().skip(i + 1) {
            if let Some(other) = other
                && apart.get(i * num_agents + j) != Some(&true)
            {
                let value = measure(one, other);
                out[i * num_agents + j] = value;
                out[j * num_agents + i] = value;
            }
        }
    }
    out
}

/// 1 for contact now, 0 for contact in 20 s or later.
pub fn normalised_ttc(ttc_s: Real) -> Real {
    (TTC_CAP_S - ttc_s.clamp(0.0, TTC_CAP_S)) / TTC_CAP_S
}

/// 1 at distance 0, 0 at 20 m or beyond.
pub fn normalised_distance(distance_m: Real) -> Real {
    (DISTANCE_CAP_M - distance_m.clamp(0.0, DISTANCE_CAP_M)) / DISTANCE_CAP_M
}
