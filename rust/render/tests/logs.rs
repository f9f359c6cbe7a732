//! Trails of a logged scene.

mod common;

use ccdiff_render::{Camera, logged_trail};
use ccdiff_sim::geom::{Point2, Vector2};
use ccdiff_sim::scene::{Agent, AgentKind, EGO_ID, Scene, Tracks};
use common::crossroads;
use std::sync::Arc;

const STEPS: usize = 21;

/// The ego drives west to east on y = -1.8, 1 m a step; another car, 10 m ahead, appears at step 5.
fn scene() -> Scene {
    let agent = |id: &str| Agent {
        id: id.into(),
        kind: AgentKind::Vehicle,
        category: "vehicle.car".into(),
        length_m: 4.6,
        width_m: 1.9,
        height_m: 1.5,
    };
    let entries = [0.0, 10.0].into_iter().flat_map(|ahead| (0..STEPS).map(move |t| t as f32 + ahead - 10.0));
    let tracks = Tracks {
        position: entries.map(|x| Point2::new(x, -1.8)).collect(),
        heading_rad: vec![0.0; 2 * STEPS],
        velocity: vec![Vector2::new(10.0, 0.0); 2 * STEPS],
        valid: (0..2 * STEPS).map(|i| !(STEPS..STEPS + 5).contains(&i)).collect(),
        elevation_m: Vec::new(),
    };
    Scene {
        name: "scene-1".into(),
        token: "t".into(),
        location: "l".into(),
        source: "s".into(),
        origin: [0.0, 0.0],
        dt_s: 0.1,
        num_steps: STEPS,
        agents: vec![agent(EGO_ID), agent("other")],
        tracks,
        map: Arc::new(crossroads()),
    }
}

#[test]
fn trails_reach_back_from_the_step_and_stop_at_a_gap() {
    let mut scene = scene();
    let x = |scene: &Scene, agent, step, back| -> Vec<f32> {
        logged_trail(scene, agent, step, back).iter().map(|p| p.x).collect()
    };
    assert_eq!(x(&scene, 0, 3, 10), [-10.0, -9.0, -8.0, -7.0]);
    assert_eq!(x(&scene, 0, 3, 2), [-8.0, -7.0]);
    assert_eq!(x(&scene, 1, 6, 10), [5.0, 6.0]);
    assert!(x(&scene, 1, 3, 10).is_empty());
    scene.tracks.valid[8] = false;
    assert_eq!(x(&scene, 0, 10, 10), [-1.0, 0.0]);
}

#[test]
fn the_span_is_the_width_whatever_the_height() {
    let camera = Camera::over(Point2::new(0.0, 0.0), 60.0, 300, 100);
    assert_eq!(camera.metres_per_pixel, 0.2);
}
