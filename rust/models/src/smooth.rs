//! Smooth tracks for training.
//!
//! Logs made from 2 Hz key frames by straight lines have no acceleration but spikes at the key frames (reference.md#time-base).
//! Two passes of a 0.5 s moving average turn straight lines between key frames into the uniform cubic B-spline over
//! them: continuous acceleration, and a position error of at most a sixth of acceleration times 0.25 s².
//! Velocities become central differences, which do not lag as the data set's backward ones do.

use ccdiff_sim::geom::{Point2, Vector2};
use ccdiff_sim::scene::Scene;

/// Width of the moving average, seconds.
const WIDTH_S: f32 = 0.5;

/// The scene with smooth positions, headings and velocities.
pub(crate) fn smoothed(scene: &Scene) -> Scene {
    let mut scene = scene.clone();
    let half = (0.5 * WIDTH_S / scene.dt_s) as usize;
    let steps = scene.num_steps;
    for agent in 0..scene.num_agents() {
        let mut start = 0;
        while start < steps {
            let run = (start..steps).take_while(|s| scene.is_valid(agent, *s)).count();
            if run > 1 {
                let from = scene.at(agent, start);
                smooth_run(&mut scene, from..from + run, half);
            }
            start += run.max(1);
        }
    }
    scene
}

fn smooth_run(scene: &mut Scene, run: std::ops::Range<usize>, half: usize) {
    let twice = |values: Vec<f32>| moving_average(&moving_average(&values, half), half);
    let tracks = &mut scene.tracks;
    let x = twice(tracks.position[run.clone()].iter().map(|p| p.x).collect());
    let y = twice(tracks.position[run.clone()].iter().map(|p| p.y).collect());
    let heading = twice(tracks.heading_rad[run.clone()].to_vec());
    let last = x.len() - 1;
    for (i, at) in run.enumerate() {
        let (before, after) = (i.saturating_sub(1), (i + 1).min(last));
        let span_s = (after - before) as f32 * scene.dt_s;
        tracks.position[at] = Point2::new(x[i], y[i]);
        tracks.heading_rad[at] = heading[i];
        tracks.velocity[at] = Vector2::new((x[after] - x[before]) / span_s, (y[after] - y[before]) / span_s);
    }
}

/// Mean over 2 `half` + 1 entries; the ends are continued by point reflection, so that lines stay lines.
fn moving_average(values: &[f32], half: usize) -> Vec<f32> {
    let last = values.len() as i64 - 1;
    let reach = (half as i64).min(last);
    let at = |i: i64| {
        let inside = |k: i64| f64::from(values[k.clamp(0, last) as usize]);
        if i < 0 {
            2.0 * inside(0) - inside(-i)
        } else if i > last {
            2.0 * inside(last) - inside(2 * last - i)
        } else {
            inside(i)
        }
    };
    (0..=last)
        .map(|i| ((-reach..=reach).map(|k| at(i + k)).sum::<f64>() / (2 * reach + 1) as f64) as f32)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn straight_lines_stay_and_kinks_become_the_cubic_spline() {
        let line: Vec<f32> = (0..30).map(|i| 3.0 + 0.7 * i as f32).collect();
        let same = moving_average(&moving_average(&line, 2), 2);
        assert!(line.iter().zip(&same).all(|(a, b)| (a - b).abs() < 1e-4));
        // key frames 0, 0, 0, 6, 0, 0, 0 joined linearly: the spline's values at the key frames are 1, 4, 1
        let key = [0.0, 0.0, 0.0, 6.0, 0.0, 0.0, 0.0f32];
        let joined: Vec<f32> = (0..31)
            .map(|i| {
                let (k, u) = (i / 5, (i % 5) as f32 / 5.0);
                key[k] * (1.0 - u) + key[(k + 1).min(6)] * u
            })
            .collect();
        let spline = moving_average(&moving_average(&joined, 2), 2);
        for (at, want) in [(10, 1.0), (15, 4.0), (20, 1.0)] {
            assert!((spline[at] - want).abs() < 0.15, "{} for {want}", spline[at]);
        }
    }
}
