//! A scene made by hand: vehicles on a straight road, close enough to matter to each other.

pub(crate) mod runs;
pub(crate) mod toy;

use ccdiff_sim::geom::{Point2, Polygon, Vector2};
use ccdiff_sim::scene::{Agent, AgentKind, Map, Scene, Tracks};
use std::sync::{Arc, Mutex, PoisonError};

/// Fresh weights from a seed: torch has one generator for all threads, and tests run side by side.
#[allow(dead_code, reason = "not every test file makes networks")]
pub(crate) fn seeded<T>(make: impl FnOnce() -> T) -> T {
    static ALONE: Mutex<()> = Mutex::new(());
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    tch::manual_seed(11);
    make()
}

/// A road along x, 8 m to each side.
pub(crate) fn road() -> Polygon {
    let corners = [(-100.0, -8.0), (300.0, -8.0), (300.0, 8.0), (-100.0, 8.0)];
    Polygon::from_exterior(corners.map(|(x, y)| Point2::new(x, y)).to_vec())
}

/// `vehicles` are (x, y, heading, speed, acceleration) at step 0; all live for `num_steps`.
pub(crate) fn scene(vehicles: &[[f32; 5]], num_steps: usize) -> Arc<Scene> {
    let mut tracks = Tracks::default();
    for [x, y, heading, speed, acceleration] in vehicles {
        for step in 0..num_steps {
            let t = step as f32 * 0.1;
            let (v, s) = (speed + acceleration * t, speed * t + 0.5 * acceleration * t * t);
            tracks.position.push(Point2::new(x + s * heading.cos(), y + s * heading.sin()));
            tracks.heading_rad.push(*heading);
            tracks.velocity.push(Vector2::new(v * heading.cos(), v * heading.sin()));
            tracks.valid.push(true);
        }
    }
    let agents = (0..vehicles.len())
        .map(|i| Agent {
            id: if i == 0 { "ego".into() } else { format!("car-{i}") },
            kind: AgentKind::Vehicle,
            category: "vehicle.car".into(),
            length_m: 4.5,
            width_m: 2.0,
            height_m: 1.5,
        })
        .collect();
    let map = Map { drivable_area: vec![road()], ..Map::default() };
    let scene = Scene {
        name: "road".into(),
        token: "road".into(),
        location: "nowhere".into(),
        source: "test".into(),
        origin: [0.0; 2],
        dt_s: 0.1,
        num_steps,
        agents,
        tracks,
        map: Arc::new(map),
    };
    Arc::new(scene.validated().unwrap())
}

#[allow(dead_code, reason = "not every test file uses it")]
/// A follower closing in on a braking leader, and a third car far off.
pub(crate) fn closing_pair() -> Arc<Scene> {
    scene(&[[0.0, 0.0, 0.0, 12.0, -0.5], [30.0, 0.5, 0.0, 4.0, 0.3], [150.0, -4.0, 3.1, 6.0, 0.0]], 110)
}
