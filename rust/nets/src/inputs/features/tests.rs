use super::*;

/// Cars of 4 m by 2 m at rest or in steady motion: (x, y, heading, speed).
fn window(cars: &[[f32; 4]], config: &ModelConfig) -> Window {
    let steps = config.history_steps;
    let each = || cars.iter().flat_map(move |c| std::iter::repeat_n(c, steps));
    Window {
        num_steps: steps,
        poses: each().map(|c| Pose2::new(c[0], c[1], c[2])).collect(),
        speed_mps: each().map(|c| c[3]).collect(),
        valid: vec![true; cars.len() * steps],
        length_m: vec![4.0; cars.len()],
        width_m: vec![2.0; cars.len()],
        ..Window::default()
    }
}

#[test]
fn a_follower_sees_its_leader_by_headway_alone() {
    let with = ModelConfig { map: None, ..ModelConfig::fast() };
    let without = ModelConfig { headway_threshold_s: 0.0, ..with.clone() };
    let joined = |cars: &[[f32; 4]], config: &ModelConfig| {
        let features = build(&window(cars, config), None, config).unwrap();
        (features.graph.contains(0, 1), features.graph.contains(1, 0), features.is_edge.iter().any(|j| *j))
    };
    // 10 m/s, 26 m from bumper to bumper: 2.6 s
    let equal = [[0.0, 0.0, 0.0, 10.0], [30.0, 0.5, 0.05, 10.0]];
    assert_eq!(joined(&equal, &with), (true, false, true));
    assert_eq!(joined(&equal, &without), (false, false, false));
    // in the next lane, farther than 3 s, behind; at rest 5 m and 7 m behind a leader
    assert_eq!(joined(&[equal[0], [30.0, 3.5, 0.0, 10.0]], &with), (false, false, false));
    assert_eq!(joined(&[equal[0], [36.0, 0.0, 0.0, 10.0]], &with), (false, false, false));
    assert_eq!(joined(&[equal[0], [-30.0, 0.0, 0.0, 10.0]], &with), (false, true, true));
    assert_eq!(joined(&[[0.0; 4], [9.0, 0.0, 0.0, 0.0]], &with), (true, false, true));
    assert_eq!(joined(&[[0.0; 4], [11.0, 0.0, 0.0, 0.0]], &with), (false, false, false));
}

#[test]
fn the_graph_leaves_out_who_passes_by_in_the_next_lane() {
    let config = ModelConfig { map: None, ..ModelConfig::fast() };
    let of = |other: [f32; 4]| {
        let cars = [[0.0, 0.0, 0.0, 10.0], other];
        let features = build(&window(&cars, &config), None, &config).unwrap();
        (features.graph.contains(0, 1), features.is_edge.contains(&true))
    };
    let turned_rad = std::f32::consts::PI;
    // bodies miss each other by half a metre: no contact, though the networks were trained with the edge
    assert_eq!(of([25.0, 2.5, turned_rad, 10.0]), (false, true));
    assert_eq!(of([25.0, 2.5, 0.0, 10.0]), (true, true));
    // head on, in 1.05 s
    assert_eq!(of([25.0, 1.5, turned_rad, 10.0]), (true, true));
}

#[test]
fn by_distance_the_eight_nearest_take_the_slots_and_nobody_beyond_fifty_metres() {
    // rivals.md#ctg: eleven in a row, in any order
    let config = ModelConfig { map: None, ..ModelConfig::of("ctgpp", "fast").unwrap() };
    for places in [
        [0.0, 45.0, 40.0, 35.0, 30.0, 25.0, 20.0, 15.0, 10.0, 5.0, 50.1],
        [0.0, 50.1, 10.0, 5.0, 35.0, 30.0, 45.0, 20.0, 40.0, 25.0, 15.0],
    ] {
        let cars: Vec<[f32; 4]> = places.iter().map(|x| [*x, 0.0, 0.0, 7.0]).collect();
        let found = build(&window(&cars, &config), None, &config).unwrap();
        let slots: Vec<f32> = found.neighbours[..found.num_slots].iter().map(|j| places[*j]).collect();
        assert_eq!(slots, [0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0]);
        assert!(found.is_edge[1..found.num_slots].iter().all(|j| *j));
        let far = places.iter().position(|x| *x == 50.1).unwrap();
        assert!(!found.graph.contains(0, far) && !found.graph.contains(far, 0));
    }
}

#[test]
fn the_nearest_leader_takes_the_first_slot() {
    let config = ModelConfig { map: None, max_neighbours: 1, ..ModelConfig::fast() };
    let cars = [[0.0, 0.0, 0.0, 10.0], [28.0, 0.0, 0.0, 10.0], [14.0, 0.0, 0.0, 10.0]];
    let features = build(&window(&cars, &config), None, &config).unwrap();
    assert_eq!(features.neighbours[..2], [0, 2]);
}

#[test]
fn contacts_measured_for_a_ranking_are_those_that_features_measure() {
    let config = ModelConfig { map: None, ..ModelConfig::fast() };
    let cars = [[0.0, 0.0, 0.1, 10.0], [30.0, 0.5, 0.0, 2.0], [10.0, -9.0, 1.5, 4.0], [80.0, 3.0, 3.1, 9.0]];
    let mut window = window(&cars, &config);
    // the motion of the steps before now; one vehicle arrives late
    for agent in 0..cars.len() {
        for step in 0..config.history_steps {
            let back_m = (config.history_steps - 1 - step) as f32 * 0.1 * cars[agent][3];
            let at = agent * config.history_steps + step;
            window.poses[at].position.x -= back_m * cars[agent][2].cos();
            window.poses[at].position.y -= back_m * cars[agent][2].sin();
            window.valid[at] = agent != 2 || step > 4;
        }
    }
    let alone = build(&window, None, &config).unwrap();
    window.measure_contacts();
    assert_eq!(window.ttc_s.len(), config.history_steps * 16);
    assert_eq!(build(&window, None, &config).unwrap(), alone);
    // they are taken from there
    window.ttc_s.fill(20.0);
    assert_ne!(build(&window, None, &config).unwrap().ttc_s, alone.ttc_s);
}
