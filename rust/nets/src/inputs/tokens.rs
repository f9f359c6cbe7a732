//! What a row of the network sees beside the lines of the map: own motion and route, and the nearest vehicles.

use crate::config::ModelConfig;
use crate::error::Result;
use crate::inputs::features::{self, SceneFeatures, TokenInputs, Window};
use crate::inputs::segments::MapLines;
use ccdiff_sim::geom::math::{exp, hypot, wrap_angle};
use ccdiff_sim::geom::{Point2, Vector2};

/// Moments of own motion, steps before now; the last is now.
const PAST: [usize; 10] = [60, 50, 40, 30, 25, 20, 15, 10, 5, 0];
/// History that the moments need: yaw rates are those of the step before.
pub const HISTORY_STEPS: usize = PAST[0] + 2;
/// Neighbours of a row, the nearest.
pub const NEAR: usize = 12;
/// Numbers per neighbour.
pub const NEAR_NUMBERS: usize = 25;
/// Numbers of a row before its route.
const OWN_NUMBERS: usize = 4 * PAST.len() + 2;
/// Of a neighbour: numbers that change sign in a mirror, and those that come from the route.
const NEAR_ODD: [usize; 5] = [1, 3, 6, 10, 24];
const NEAR_TOLD: [usize; 6] = [9, 10, 11, 12, 16, 17];

/// Columns of own numbers: whether one changes sign in a mirror, whether it comes from the route of so many places. They are
/// speeds, yaw rates, whether known, changes of speed at [`PAST`]; length, width,
/// logarithm of the speed; whether the route is told, and its places x, y.
pub fn own_columns(num_points: usize) -> impl Iterator<Item = (bool, bool)> {
    let motion = (0..OWN_NUMBERS).map(|at| (at / PAST.len() == 1, false));
    motion.chain(std::iter::once((false, true))).chain((0..2 * num_points).map(|at| (at % 2 == 1, true)))
}

/// Columns of a neighbour's numbers, likewise.
pub fn near_columns() -> impl Iterator<Item = (bool, bool)> {
    (0..NEAR_NUMBERS).map(|at| (NEAR_ODD.contains(&at), NEAR_TOLD.contains(&at)))
}

/// Speeds and yaw rates of an agent of a window at [`PAST`]; `None` where not known.
fn motion(window: &Window, agent: usize, dt_s: f32) -> [Option<[f32; 2]>; PAST.len()] {
    let steps = window.num_steps;
    PAST.map(|back| {
        let step = (steps - 1).checked_sub(back).filter(|s| *s > 0)?;
        let at = agent * steps + step;
        (window.valid[at] && window.valid[at - 1]).then(|| {
            let turn = wrap_angle(window.poses[at].heading_rad - window.poses[at - 1].heading_rad);
            [window.speed_mps[at], turn / dt_s]
        })
    })
}

/// Change of speed over the last half second; 0 where not known.
fn change(motion: &[Option<[f32; 2]>; PAST.len()]) -> f32 {
    let [.., before, now] = motion;
    now.zip(*before).map_or(0.0, |(now, before)| now[0] - before[0])
}

/// As [`features::build`], with the inputs of tokens.
///
/// # Errors
/// As there.
pub fn build(window: &Window, map: Option<&MapLines>, config: &ModelConfig) -> Result<SceneFeatures> {
    let mut built = features::build(window, map, config)?;
    built.tokens = inputs(window, &built, config);
    Ok(built)
}

/// Inputs of the rows of a scene, whose neighbours are those in the slots of its features.
fn inputs(window: &Window, features: &SceneFeatures, config: &ModelConfig) -> TokenInputs {
    let agents = &features.agents;
    let motions: Vec<_> = agents.iter().map(|a| motion(window, *a, config.dt_s as f32)).collect();
    let mut out = TokenInputs::default();
    for (row, past) in motions.iter().enumerate() {
        let agent = agents[row];
        let [.., now] = past;
        let [speed, yaw_rate] = now.unwrap_or_default();
        out.known.push(now.is_some());
        out.yaw_rate_radps.push(yaw_rate);
        let known = |of: &dyn Fn([f32; 2]) -> f32| past.iter().map(|m| m.map_or(0.0, of)).collect::<Vec<_>>();
        out.own.extend(known(&|m| 0.1 * m[0]));
        out.own.extend(known(&|m| 3.0 * m[1]));
        out.own.extend(known(&|_| 1.0));
        out.own.extend(past.windows(2).map(|m| m[0].zip(m[1]).map_or(0.0, |(a, b)| b[0] - a[0])));
        let (length, width) = (window.length_m[agent], window.width_m[agent]);
        out.own.extend([0.2 * length, 0.5 * width, libm::log1pf(speed.abs())]);
        let places = 1 + 2 * config.route_points_m.len();
        let route = &features.route[row * places..][..places];
        out.own.push(route[0]);
        out.own.extend(route[1..].iter().map(|v| 0.05 * v));
        let path = window.routes.get(agent).filter(|path| path.len() > 1);
        let path = path.map(|points| (points.as_slice(), config.route_points_m.as_slice()));
        let first = row * features.num_slots;
        let slots = (1..features.num_slots).filter(|s| features.is_edge[first + s]).take(NEAR);
        let from = out.near.len();
        for other in slots.map(|s| features.neighbours[first + s]) {
            out.near.extend(neighbour(window, features, (row, other), &motions[other], speed, path));
        }
        out.near.resize(from + NEAR * NEAR_NUMBERS, 0.0);
    }
    out
}

/// What a row sees of another.
fn neighbour(
    window: &Window,
    features: &SceneFeatures,
    (row, other): (usize, usize),
    past: &[Option<[f32; 2]>; PAST.len()],
    own_speed: f32,
    path: Option<(&[Point2], &[f32])>,
) -> [f32; NEAR_NUMBERS] {
    let (frame, pose) = (&features.poses[row], &features.poses[other]);
    let of = |row: usize| (window.length_m[features.agents[row]], window.width_m[features.agents[row]]);
    let ((length, width), (own_length, _)) = (of(other), of(row));
    let at = frame.to_local(pose.position);
    let turned = frame.rotate_inverse(Vector2::new(pose.cos, pose.sin));
    let seen = pose.to_local(frame.position);
    let [.., now] = past;
    let [speed, yaw_rate] = now.unwrap_or([features.speed_mps[other], 0.0]);
    let bodies = 0.5 * (length + own_length);
    let closing = speed * turned.x - own_speed;
    let far = hypot(at.x, at.y);
    // straight ahead
    let gap = at.x - bodies;
    let rate = |gap: f32| (closing / gap.abs().max(2.0)).clamp(-2.0, 2.0);
    let mut out = [0.0; NEAR_NUMBERS];
    out[..9].copy_from_slice(&[
        0.05 * at.x,
        0.05 * at.y,
        turned.x,
        turned.y,
        0.1 * speed,
        change(past),
        3.0 * yaw_rate,
        0.2 * length,
        0.5 * width,
    ]);
    if let Some((points, places_m)) = path {
        let (along, beside) = on_path(points, places_m, pose.position);
        let ahead = along - bodies;
        out[9] = 0.05 * along;
        out[10] = 0.05 * beside;
        out[11] = 0.1 * ahead.clamp(-10.0, 30.0);
        out[12] = f32::from(u8::from(beside.abs() < 1.5 && ahead > -2.0));
        out[16] = exp(-0.2 * ahead.abs());
        out[17] = rate(ahead);
    }
    out[13] = 0.2 * closing;
    out[14] = exp(-0.1 * far);
    out[15] = exp(-far / 3.0);
    out[18] = libm::log1pf(speed.abs());
    out[19] = 1.0;
    out[20] = 0.1 * gap.clamp(-10.0, 30.0);
    out[21] = exp(-(at.y * at.y) / 2.25);
    out[22] = rate(gap);
    out[23] = 0.05 * seen.x;
    out[24] = 0.05 * seen.y;
    out
}

/// Place of a point along a path and beside it, metres, left positive. Its first part goes on backwards, its last one forwards;
/// `places_m` are those of its points.
fn on_path(points: &[Point2], places_m: &[f32], at: Point2) -> (f32, f32) {
    let mut best = (f32::INFINITY, 0.0, 0.0);
    for (k, ends) in points.windows(2).enumerate() {
        let d = ends[1] - ends[0];
        let length = d.norm();
        if length < 1e-3 {
            continue;
        }
        let (way, off) = (d / length, at - ends[0]);
        let low = if k == 0 { f32::NEG_INFINITY } else { 0.0 };
        let high = if k + 2 == points.len() { f32::INFINITY } else { length };
        let along = off.dot(&way).clamp(low, high);
        let away = (off - way * along).norm_squared();
        if away < best.0 {
            best = (away, places_m[k] + along, way.x * off.y - way.y * off.x);
        }
    }
    (best.1.clamp(-40.0, 99.0), best.2.clamp(-40.0, 40.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_on_a_bent_path_are_those_of_its_arc() {
        let points = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)].map(|(x, y)| Point2::new(x, y));
        let places = [0.0, 10.0, 20.0];
        for (at, want) in [
            ((4.0, 1.0), (4.0, 1.0)),
            ((-7.0, -2.0), (-7.0, -2.0)),
            ((12.0, 5.0), (15.0, -2.0)),
            ((9.0, 25.0), (35.0, 1.0)),
            ((500.0, 3.0), (13.0, -40.0)),
        ] {
            let (along, beside) = on_path(&points, &places, Point2::new(at.0, at.1));
            assert!(
                (along - want.0).abs() < 1e-4 && (beside - want.1).abs() < 1e-4,
                "{at:?}: {along} {beside}"
            );
        }
    }
}
