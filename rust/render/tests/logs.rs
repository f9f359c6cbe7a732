//! Images of a logged scene.

mod common;

use ccdiff_render::{
    Camera, Centre, DrawStyle, LogView, MapLayers, RenderError, Theme, logged_trail, palette, render_log,
};
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

fn log_view(step_idx: usize, centre: Centre) -> LogView {
    LogView {
        step_idx,
        centre,
        span_m: 60.0,
        width: 300,
        height: 300,
        heading_up: false,
        trails: true,
        route: true,
        labels: false,
        theme: Theme::Light,
    }
}

#[test]
fn the_agent_in_the_middle_is_followed_and_those_ahead_of_it_are_above_when_its_heading_is_up() {
    let scene = scene();
    let map = MapLayers::new(&scene.map).unwrap();
    for step in [5, 10, 20] {
        let image = render_log(&scene, &map, &log_view(step, Centre::Agent(0))).unwrap();
        assert_eq!(image.pixel(150, 150), Some(DrawStyle::Ego.colour(Theme::Light)));
        assert_eq!(image.pixel(200, 150), Some(DrawStyle::Replay.colour(Theme::Light)));
        let turned = LogView { heading_up: true, ..log_view(step, Centre::Agent(0)) };
        let image = render_log(&scene, &map, &turned).unwrap();
        assert_eq!(image.pixel(150, 100), Some(DrawStyle::Replay.colour(Theme::Light)));
    }
}

#[test]
fn an_agent_that_is_not_there_yet_is_not_drawn_but_can_be_waited_for() {
    let scene = scene();
    let map = MapLayers::new(&scene.map).unwrap();
    let bare = LogView { trails: false, route: false, ..log_view(4, Centre::Agent(1)) };
    // Middle: where the car will be at step 5, 11 m ahead of the ego at step 4.
    let image = render_log(&scene, &map, &bare).unwrap();
    assert_eq!(image.pixel(150, 157), Some(palette::LIGHT.drivable));
    assert_eq!(image.pixel(150 - 55, 150), Some(DrawStyle::Ego.colour(Theme::Light)));
    let image = render_log(&scene, &map, &LogView { step_idx: 5, ..bare }).unwrap();
    assert_eq!(image.pixel(150, 150), Some(DrawStyle::Replay.colour(Theme::Light)));
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
fn a_step_past_the_end_and_a_middle_that_does_not_exist_are_refused() {
    let scene = scene();
    let map = MapLayers::new(&scene.map).unwrap();
    let ask = |s: LogView| render_log(&scene, &map, &s).unwrap_err();
    assert_eq!(ask(log_view(STEPS, Centre::Agent(0))), RenderError::Step { got: STEPS, num_steps: STEPS });
    assert!(matches!(ask(log_view(0, Centre::Agent(2))), RenderError::Centre { .. }));
    let point = Centre::Point(Point2::new(0.0, 0.0));
    assert!(matches!(ask(LogView { heading_up: true, ..log_view(0, point) }), RenderError::Centre { .. }));
    assert!(matches!(ask(LogView { span_m: f32::NAN, ..log_view(0, point) }), RenderError::Camera { .. }));
    assert!(matches!(ask(LogView { width: 0, ..log_view(0, point) }), RenderError::Size { .. }));
}

#[test]
fn the_span_is_the_width_whatever_the_height() {
    let camera = Camera::over(Point2::new(0.0, 0.0), 60.0, 300, 100);
    assert_eq!(camera.metres_per_pixel, 0.2);
}
