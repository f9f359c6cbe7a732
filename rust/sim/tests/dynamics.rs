//! Motion models against test vectors, closed forms and their inverses.

use ccdiff_sim::dynamics::{ActionGrid, BicycleLimits, DeltaPoseLimits, Dynamics, KinState, UnicycleLimits};
use ccdiff_sim::geom::{Pose2, Vector2};
use ccdiff_sim::state::{AgentStates, Footprint};
use proptest::prelude::*;

const DT_S: f32 = 0.1;

fn car() -> Footprint {
    Footprint::new(4.6, 1.9)
}

fn models() -> [Dynamics; 3] {
    [
        Dynamics::Unicycle(UnicycleLimits::default()),
        Dynamics::Bicycle(BicycleLimits::default()),
        Dynamics::DeltaPose(DeltaPoseLimits::default()),
    ]
}

fn at_rest_or_moving(speed_mps: f32) -> KinState {
    KinState { speed_mps, ..KinState::default() }
}

/// Start speed, actions, states x y v ψ.
type Vectors = (f32, Vec<[f32; 2]>, Vec<[f32; 4]>);

/// Measured on the released CCDiff unicycle.
fn released_vectors() -> Vec<Vectors> {
    vec![
        (
            5.0,
            vec![[2.0, 0.1], [2.0, 0.3], [-12.0, 0.3], [0.0, 5.0], [1.0, -1.0]],
            vec![
                [0.51, 0.0, 5.2, 0.01],
                [1.039974, 0.0053, 5.4, 0.04],
                [1.529582, 0.024895, 4.4, 0.07],
                [1.968504, 0.05567, 4.4, 0.2128],
                [2.403466, 0.149652, 4.5, 0.1128],
            ],
        ),
        (
            0.0,
            vec![[9.0, 0.5], [9.0, 0.5], [0.0, 0.01]],
            vec![[0.04, 0.0, 0.8, 0.01], [0.159994, 0.0012, 1.6, 0.05], [0.319794, 0.009197, 1.6, 0.051]],
        ),
    ]
}

fn assert_near(state: KinState, [x, y, v, heading]: [f32; 4]) {
    let got = [state.x, state.y, state.speed_mps, state.heading_rad];
    for (got, want) in got.iter().zip([x, y, v, heading]) {
        assert!((got - want).abs() < 2e-5, "{state:?} is not {:?}", [x, y, v, heading]);
    }
}

#[test]
fn stepwise_unicycle_follows_the_released_vectors() {
    let unicycle = Dynamics::default();
    for (speed, actions, expected) in released_vectors() {
        let mut state = at_rest_or_moving(speed);
        for (action, want) in actions.iter().zip(expected) {
            unicycle.step(&mut state, [action[0], action[1], 0.0], DT_S, &car());
            assert_near(state, want);
        }
    }
}

#[test]
fn bicycle_drives_the_circle_of_its_steering_angle() {
    let limits = BicycleLimits::default();
    let footprint = car();
    let wheelbase = f64::from(limits.wheelbase_m(&footprint));
    let steering = 0.3_f64;
    // the rear axle runs on a circle of radius L / tan δ, the centre of the box on one through half the wheelbase
    let rear_radius = wheelbase / steering.tan();
    let radius = rear_radius.hypot(0.5 * wheelbase);
    let mut state = at_rest_or_moving(4.0);
    let centre = (-0.5 * wheelbase, rear_radius);
    let bicycle = Dynamics::Bicycle(limits);
    for _ in 0..100 {
        bicycle.step(&mut state, [0.0, steering as f32, 0.0], DT_S, &footprint);
        let distance = (f64::from(state.x) - centre.0).hypot(f64::from(state.y) - centre.1);
        assert!((distance - radius).abs() < 0.02, "{distance} m from the centre of a circle of {radius} m");
    }
    let turned = 4.0 * 10.0 / rear_radius;
    assert!((f64::from(state.heading_rad) - turned).abs() < 1e-3);
}

/// Where on the long axis of a body, ahead of its centre, a turning step moves nothing sideways, metres.
fn point_without_slip_m(model: &Dynamics, turning: f32) -> f32 {
    let start = at_rest_or_moving(5.0);
    let mut state = start;
    model.step(&mut state, [0.0, turning, 0.0], 0.01, &car());
    let turned = state.heading_rad - start.heading_rad;
    let (sin, cos) = (0.5 * turned).sin_cos();
    // sideways way of the centre, seen along the heading midway, over the turn
    -(cos * state.y - sin * state.x) / turned
}

#[test]
fn the_rear_axle_of_the_bicycle_and_the_centre_of_the_unicycle_move_along_the_heading() {
    let [unicycle, bicycle, _] = models();
    assert!(point_without_slip_m(&unicycle, 0.5).abs() < 0.03);
    assert!((point_without_slip_m(&bicycle, 0.3) - -0.3 * 4.6).abs() < 0.01);
}

#[test]
fn default_grids_have_63_distinct_actions_within_the_bounds_and_straight_on_in_the_middle() {
    for model in models() {
        let grid = ActionGrid::default_for(&model);
        assert_eq!(grid.num_actions(), 63);
        for index in 0..grid.num_actions() {
            let action = grid.action(&model, index).unwrap();
            assert_eq!(model.clip(action), action);
        }
        let straight = grid.action(&model, 31).unwrap();
        assert_eq!(straight[1..], [0.0, 0.0]);
        assert_eq!(grid.action(&model, 63), None);
    }
}

fn kin_state() -> impl Strategy<Value = KinState> {
    (-50f32..50.0, -50f32..50.0, -7f32..7.0, -9f32..29.0)
        .prop_map(|(x, y, heading_rad, speed_mps)| KinState { x, y, heading_rad, speed_mps })
}

proptest! {
    #[test]
    fn inverse_models_recover_actions_within_the_limits(
        start in kin_state(), u in prop::array::uniform3(0f32..1.0),
    ) {
        for model in models() {
            let (low, high) = model.action_bounds();
            let wanted: [f32; 3] = std::array::from_fn(|i| low[i] + u[i] * (high[i] - low[i]));
            let mut next = start;
            model.step(&mut next, wanted, DT_S, &car());
            let action = model.inverse(&start, &next, DT_S, &car());
            // what the limits changed must come back as the changed action: apply it again
            let mut again = start;
            model.step(&mut again, action, DT_S, &car());
            prop_assert!((again.x - next.x).abs() < 2e-3 && (again.y - next.y).abs() < 2e-3, "{}", model.name());
            prop_assert!((again.heading_rad - next.heading_rad).abs() < 2e-3);
            if !matches!(model, Dynamics::DeltaPose(_)) {
                prop_assert!((again.speed_mps - next.speed_mps).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn speeds_and_yaw_rates_stay_within_the_limits(
        start in kin_state(), actions in prop::collection::vec(prop::array::uniform2(-50f32..50.0), 20),
    ) {
        let limits = UnicycleLimits::default();
        let unicycle = Dynamics::Unicycle(limits);
        let mut state = start;
        for [a, w] in actions {
            let before = state;
            unicycle.step(&mut state, [a, w, 0.0], DT_S, &car());
            prop_assert!(state.speed_mps >= 0.0 && state.speed_mps <= 30.0);
            let yaw_rate = (state.heading_rad - before.heading_rad).abs() / DT_S;
            prop_assert!(yaw_rate <= limits.yaw_rate_bound(before.speed_mps) + 1e-4);
        }
    }

    #[test]
    fn rates_of_agents_change_no_faster_than_the_limits(
        speed in 0f32..20.0, actions in prop::collection::vec(prop::array::uniform2(-9f32..9.0), 20),
    ) {
        let limits = UnicycleLimits {
            max_jerk_mps3: 6.0,
            max_yaw_acceleration_radps2: 1.5,
            ..UnicycleLimits::default()
        };
        let unicycle = Dynamics::Unicycle(limits);
        let mut states = AgentStates::new(1);
        states.set_pose(0, Pose2::new(0.0, 0.0, 0.0), Vector2::new(speed, 0.0));
        for [a, w] in actions {
            let (speed, before) = (states.speed_mps[0], [states.acceleration_mps2[0], states.yaw_rate_radps[0]]);
            unicycle.step_agent(&mut states, 0, [a, w, 0.0], DT_S, &car());
            let [jerk, bend] = [states.acceleration_mps2[0] - before[0], states.yaw_rate_radps[0] - before[1]];
            let stops = states.speed_mps[0] == 0.0 || states.speed_mps[0] == limits.speed_mps[1];
            prop_assert!(stops || jerk.abs() <= 6.0 * DT_S + 1e-3, "{jerk}");
            let is_bound = states.yaw_rate_radps[0].abs() >= limits.yaw_rate_bound(speed) - 1e-3;
            prop_assert!(is_bound || bend.abs() <= 1.5 * DT_S + 1e-3, "{bend}");
        }
    }

    #[test]
    fn agents_of_a_world_move_like_their_kinematic_state(
        start in kin_state(), u in prop::array::uniform3(-1f32..1.0),
    ) {
        for model in models() {
            let mut states = AgentStates::new(2);
            let pose = Pose2::new(start.x, start.y, start.heading_rad);
            states.set_pose(1, pose, pose.rotate(Vector2::new(start.speed_mps, 0.0)));
            states.speed_mps[1] = start.speed_mps;
            let mut state = start;
            model.step(&mut state, u, DT_S, &car());
            model.step_agent(&mut states, 1, u, DT_S, &car());
            prop_assert_eq!(states.kin_state(1), state);
            prop_assert_eq!(states.pose(1), Pose2::new(state.x, state.y, state.heading_rad));
            let along = states.velocity(1).dot(&Vector2::new(states.cos[1], states.sin[1]));
            prop_assert!((along - state.speed_mps).abs() < 1e-4);
            if matches!(model, Dynamics::DeltaPose(_)) {
                let moved = Vector2::new(state.x - start.x, state.y - start.y);
                prop_assert!((states.velocity(1) * DT_S - moved).norm() < 1e-3);
            }
        }
    }
}
