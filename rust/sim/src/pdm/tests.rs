//! Rules of PDM-Closed by hand, on a straight two-way road along x: lanes of 3.5 m at y = -1.75 (ahead) and 1.75 (back).

use super::proposals::{OFFSETS_M, Rollout, SHARES};
use super::*;
use crate::geom::{Point2, Pose2, Vector2};
use crate::scene::synthetic::GridCity;
use crate::scene::{AgentKind, LaneKind};
use std::sync::Arc;

const DT_S: Real = 0.1;
/// Agents are put this far from the crossing.
const X_M: Real = 60.0;

/// One agent: place, heading, velocity, kind.
type At = (Real, Real, Real, [Real; 2], AgentKind);

/// The ego, 4 m by 2 m, in its lane.
fn ego(speed_mps: Real) -> At {
    (0.0, -1.75, 0.0, [speed_mps, 0.0], AgentKind::Vehicle)
}

fn car(x: Real, y: Real, speed_mps: Real) -> At {
    (x, y, 0.0, [speed_mps, 0.0], AgentKind::Vehicle)
}

/// A world with these agents, the ego first.
struct World {
    prepared: PreparedScene,
    states: AgentStates,
}

impl World {
    fn new(agents: &[At]) -> Self {
        Self::on(agents, LaneKind::Lane)
    }

    fn on(agents: &[At], kind: LaneKind) -> Self {
        let city =
            GridCity { num_agents: agents.len(), num_steps: 3, num_roads: 1, block_m: 400.0, gap_m: 9.0 };
        let mut scene = city.scene();
        let mut map = (*scene.map).clone();
        map.lanes.iter_mut().for_each(|lane| lane.kind = kind);
        scene.map = Arc::new(map);
        let mut states = AgentStates::new(agents.len());
        for (a, (x, y, heading_rad, [vx, vy], kind)) in agents.iter().enumerate() {
            let agent = &mut scene.agents[a];
            (agent.kind, agent.length_m, agent.width_m) = (*kind, 4.0, 2.0);
            for t in 0..3 {
                let at = scene.at(a, t);
                scene.tracks.position[at] = Point2::new(X_M + x + t as Real, *y);
                scene.tracks.heading_rad[at] = *heading_rad;
                scene.tracks.velocity[at] = Vector2::new(*vx, *vy);
            }
            states.set_pose(a, Pose2::new(X_M + x, *y, *heading_rad), Vector2::new(*vx, *vy));
            states.active[a] = true;
        }
        Self { prepared: PreparedScene::new(Arc::new(scene), None), states }
    }

    fn scene(&self) -> Scene<'_> {
        Scene::new(&self.prepared, &self.states, 0, DT_S, 15.0, 0)
    }

    /// The contacts of an ego that goes straight on at a speed.
    fn contacts(&self, speed_mps: Real, steps: usize) -> score::Contacts {
        let scene = self.scene();
        score::contacts(&scene, &Forecast::new(&scene), &straight(self, speed_mps, steps))
    }
}

/// The proposal at a share of the limit and a distance from the line.
fn rolled(world: &World, share: Real, offset_m: Real) -> Rollout {
    let scene = world.scene();
    let at = |of: &[Real], value: Real| of.iter().position(|x| *x == value).unwrap();
    let proposal = at(&OFFSETS_M, offset_m) * SHARES.len() + at(&SHARES, share);
    roll(&scene, &Forecast::new(&scene)).swap_remove(proposal)
}

/// A rollout with these accelerations and yaw rates from a speed, at the ego's place.
fn made(world: &World, speed_mps: Real, actions: Vec<[Real; 2]>) -> Rollout {
    let mut pose = world.states.pose(0);
    let (mut poses, mut speeds_mps) = (vec![pose], vec![speed_mps]);
    for [acceleration, yaw_rate] in &actions {
        let speed_mps = speeds_mps[speeds_mps.len() - 1];
        let place = pose.to_outer(Point2::new(DT_S * speed_mps, 0.0));
        pose = Pose2::new(place.x, place.y, pose.heading_rad + DT_S * yaw_rate);
        poses.push(pose);
        speeds_mps.push(speed_mps + DT_S * acceleration);
    }
    Rollout { poses, speeds_mps, actions, progress_m: 0.0, offset_m: 0.0 }
}

fn straight(world: &World, speed_mps: Real, steps: usize) -> Rollout {
    made(world, speed_mps, vec![[0.0, 0.0]; steps])
}

#[test]
fn a_free_road_is_driven_with_exponent_ten() {
    let mut world = World::new(&[ego(12.0)]);
    world.states.acceleration_mps2[0] = 1.0;
    let ahead = (0..10).fold(12.0, |v: Real, _| v + DT_S * 1.5 * (1.0 - (v / 15.0).powi(10)));
    // nuPlan's LQR towards the speed in a second, weights 10 and 1; its lag makes a third of the change in a step
    let wanted = (ahead - 12.0) * 10.0 / 11.0;
    assert!((rolled(&world, 1.0, 0.0).actions[0][0] - (1.0 + (wanted - 1.0) / 3.0)).abs() < 1e-3);
}

#[test]
fn proposals_brake_at_most_at_three() {
    let world = World::new(&[ego(12.0), car(14.0, -1.75, 0.0)]);
    let rollout = rolled(&world, 1.0, 0.0);
    let hardest = rollout.actions.iter().map(|a| a[0]).fold(0.0, Real::min);
    // 10/11 of a plan that brakes at 3 m/s², and more to catch up with it
    assert!((-3.5..=-2.7).contains(&hardest), "{hardest}");
    // from 0 by a third of the way in each step
    let ways: Vec<Real> = rollout.actions[..4].iter().map(|a| a[0]).collect();
    assert!((ways[0] + 10.0 / 11.0).abs() < 1e-3, "{ways:?}");
    assert!(ways.is_sorted_by(|a, b| a > b));
}

#[test]
fn others_go_on_along_their_headings_at_the_size_of_their_velocity() {
    let askew = |heading_rad: Real, v: [Real; 2]| (30.0, 10.0, heading_rad, v, AgentKind::Vehicle);
    for (agent, expected) in [
        (askew(0.0, [4.0, 3.0]), [5.0, 0.0]),
        // backwards where the velocity points back
        (askew(0.0, [-4.0, 3.0]), [-5.0, 0.0]),
        (askew(std::f32::consts::FRAC_PI_2, [3.0, 4.0]), [0.0, 5.0]),
        // obstacles stay
        ((30.0, 10.0, 0.0, [4.0, 3.0], AgentKind::Static), [0.0, 0.0]),
    ] {
        let world = World::new(&[ego(10.0), agent]);
        let moved = Forecast::new(&world.scene()).others[0].centre(1.0) - Point2::new(X_M + 30.0, 10.0);
        assert!((moved - Vector2::new(expected[0], expected[1])).norm() < 1e-4, "{moved:?}");
    }
}

#[test]
fn leaders_may_come_the_other_way() {
    let oncoming = (40.0, -1.75, std::f32::consts::PI, [-6.0, 0.0], AgentKind::Vehicle);
    let world = World::new(&[ego(8.0), oncoming]);
    assert!((Forecast::new(&world.scene()).beside(0)[0].speed_mps + 6.0).abs() < 1e-4);
    let standing = World::new(&[ego(8.0), car(40.0, -1.75, 0.0)]);
    let first = |world: &World| rolled(world, 1.0, 0.0).actions[0][0];
    assert!(first(&world) < first(&standing));
}

#[test]
fn who_touches_the_ego_already_is_no_matter() {
    let world = World::new(&[ego(3.0), car(3.9, -1.75, 0.0), car(4.1, 10.0, 0.0)]);
    let scene = world.scene();
    assert_eq!(Forecast::new(&scene).others.len(), 1);
    assert!(plan(&scene).acceleration_mps2 > 0.0);
}

#[test]
fn static_obstacles_cost_half_and_agents_all() {
    for (kind, left) in [(AgentKind::Static, 0.5), (AgentKind::Pedestrian, 0.0), (AgentKind::Vehicle, 0.0)] {
        let world = World::new(&[ego(10.0), (20.0, -1.75, 0.0, [0.0, 0.0], kind)]);
        // bumper to bumper 16 m, 10 m/s: the boxes touch at step 16
        assert_eq!(world.contacts(10.0, 40), score::Contacts { left, first: Some(16), close: true });
    }
}

#[test]
fn the_ego_is_to_blame_for_a_side_between_lanes_and_never_while_it_stands() {
    let fault = |own: At, other: At| World::new(&[own, other]).contacts(own.3[0], 40).first;
    // hit from behind at 6 m/s more, and the other way round
    assert_eq!(fault(ego(6.0), car(-10.0, -1.75, 12.0)), None);
    assert_eq!(fault(ego(12.0), car(10.3, -1.75, 6.0)), Some(11));
    assert_eq!(fault(ego(0.0), car(-10.0, -1.75, 12.0)), None);
    // from the side, 1 m/s: the gap of 1.2 m closes while both drive at 10 m/s
    let from_side = |y: Real| (-1.0, y + 3.2, -0.1, [9.95, -1.0], AgentKind::Vehicle);
    assert_eq!(fault(ego(10.0), from_side(-1.75)), None);
    let astride = (0.0, -0.3, 0.0, [10.0, 0.0], AgentKind::Vehicle);
    assert!(fault(astride, from_side(-0.3)).is_some());
}

#[test]
fn time_to_contact_looks_thirty_degrees_ahead_and_aside_in_intersections_alone() {
    let close = |other: At, kind: LaneKind| World::on(&[ego(10.0), other], kind).contacts(10.0, 5).close;
    // 11 m from centre to centre, both straight on: contact in 0.9 s if the other drives 2 m/s
    assert!(close(car(11.0, -1.75, 2.0), LaneKind::Lane));
    assert!(!close(car(15.5, -1.75, 2.0), LaneKind::Lane));
    // from behind
    assert!(!close(car(-9.0, -1.75, 18.0), LaneKind::Connector));
    // from the right, 4 m aside and 1 m ahead: 50 degrees from the rear axle 1.36 m behind the centre
    let crossing = (1.0, -5.25, std::f32::consts::FRAC_PI_2, [0.0, 5.0], AgentKind::Vehicle);
    assert!(!close(crossing, LaneKind::Lane));
    assert!(close(crossing, LaneKind::Connector));
    // a standing ego has none
    assert!(!World::new(&[ego(0.0), car(4.1, -1.75, -3.0)]).contacts(0.0, 9).close);
}

#[test]
fn comfort_has_six_limits() {
    let calm = |before: Real, speed: Real, action: &dyn Fn(Real) -> [Real; 2]| {
        let world = World::new(&[ego(speed)]);
        comfort::is_calm(
            &made(&world, speed, (1..=40).map(|t| action(t as Real * DT_S)).collect()),
            before,
            DT_S,
        )
    };
    for (acceleration, expected) in [(2.39, true), (2.41, false), (-4.04, true), (-4.06, false)] {
        assert_eq!(calm(acceleration, 20.0, &|_| [acceleration, 0.0]), expected, "{acceleration}");
    }
    // a steady change of acceleration; its parabola is a straight line
    for (jerk, expected) in [(1.5, true), (1.6, false)] {
        // 4 s at 1.5 m/s³ from -4 m/s²: 2.0 m/s²; at 1.6: 2.4
        assert_eq!(calm(-4.0, 20.0, &|t| [-4.0 + jerk * t, 0.0]), expected, "{jerk}");
    }
    // a parabola between -3 and 1.2 m/s², whose slope ends at 4.1 or 4.2 m/s³
    for (jerk, expected) in [(4.1, true), (4.2, false)] {
        let parabola = |t: Real| -3.0 + 0.25 * jerk * (t - 2.0).powi(2);
        assert_eq!(calm(parabola(0.0), 20.0, &|t| [parabola(t), 0.0]), expected, "{jerk}");
    }
    for (yaw_rate, expected) in [(0.94, true), (0.96, false)] {
        assert_eq!(calm(0.0, 3.0, &|_| [0.0, yaw_rate]), expected, "{yaw_rate}");
    }
    for (lateral, expected) in [(4.88, true), (4.9, false)] {
        assert_eq!(calm(0.0, 10.0, &|_| [0.0, lateral / 10.0]), expected, "{lateral}");
    }
    for (yaw_acceleration, expected) in [(1.9, true), (1.96, false)] {
        let rate = |t: Real| yaw_acceleration * t.min(0.4);
        assert_eq!(calm(0.0, 3.0, &|t| [0.0, rate(t)]), expected, "{yaw_acceleration}");
    }
}

#[test]
fn metres_against_traffic_cost_half_then_all() {
    for (speed, left) in [(0.4, 1.0), (1.0, 0.5), (2.0, 0.0)] {
        // in the lane that leads back, for 4 s: 1.6, 4 and 8 m
        let world = World::new(&[(0.0, 1.75, 0.0, [speed, 0.0], AgentKind::Vehicle)]);
        assert_eq!(score::direction(&world.scene(), &straight(&world, speed, 40)), left, "{speed}");
    }
    let world = World::on(&[(0.0, 1.75, 0.0, [2.0, 0.0], AgentKind::Vehicle)], LaneKind::Connector);
    assert_eq!(score::direction(&world.scene(), &straight(&world, 2.0, 40)), 1.0);
}
