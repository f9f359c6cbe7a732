//! Contacts and leaving the road, against the `geo` crate and hand-made situations.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use ccdiff_sim::events::{
    Collisions, ContactKind, Leader, LeastTimes, OffRoad, leader, off_road, time_to_contact,
};
use ccdiff_sim::geom::{Point2, Polygon, Polyline, Pose2, Region, Vector2};
use ccdiff_sim::scene::AgentKind;
use ccdiff_sim::state::{AgentStates, Footprint};
use geo::{Area, BooleanOps};
use proptest::prelude::*;
use std::f32::consts::{FRAC_PI_2, PI};

/// x, y, heading, speed of cars of 4 m x 2 m.
fn cars(cars: &[(f32, f32, f32, f32)]) -> (AgentStates, Vec<Footprint>, Vec<AgentKind>) {
    let mut states = AgentStates::new(cars.len());
    for (i, (x, y, heading, speed)) in cars.iter().enumerate() {
        let pose = Pose2::new(*x, *y, *heading);
        states.set_pose(i, pose, pose.rotate(Vector2::new(*speed, 0.0)));
        states.active[i] = true;
    }
    (states, vec![Footprint::new(4.0, 2.0); cars.len()], vec![AgentKind::Vehicle; cars.len()])
}

fn detect(agents: &[(f32, f32, f32, f32)]) -> Collisions {
    let (states, footprints, kinds) = cars(agents);
    let mut collisions = Collisions::new();
    collisions.detect(&states, &footprints, &kinds);
    collisions
}

#[test]
fn rear_end_collisions_are_the_fault_of_the_one_behind() {
    let collisions = detect(&[(0.0, 0.0, 0.0, 8.0), (3.9, 0.2, 0.0, 3.0)]);
    assert_eq!(collisions.pairs(), [(0, 1)]);
    let (behind, ahead) = (collisions.first_partner(0).unwrap(), collisions.first_partner(1).unwrap());
    assert_eq!((behind.partner, behind.kind), (1, ContactKind::Front));
    assert_eq!((ahead.partner, ahead.kind), (0, ContactKind::Rear));
    assert!((behind.closing_speed_mps - 5.0).abs() < 1e-5 && (ahead.closing_speed_mps - 5.0).abs() < 1e-5);
    assert!(collisions.at_fault(0) && !collisions.at_fault(1));
}

#[test]
fn boxes_that_only_touch_are_in_contact() {
    let collisions = detect(&[(0.0, 0.0, 0.0, 1.0), (4.0, 0.0, 0.0, 0.0)]);
    assert_eq!(collisions.first_partner(0).unwrap().kind, ContactKind::Front);
    assert_eq!(collisions.first_partner(1).unwrap().kind, ContactKind::Rear);
    assert!(detect(&[(0.0, 0.0, 0.0, 1.0), (4.01, 0.0, 0.0, 0.0)]).pairs().is_empty());
}

#[test]
fn crossing_traffic_hits_with_the_front_and_is_hit_on_the_side() {
    // agent 1 drives north into the right side of agent 0
    let collisions = detect(&[(0.0, 0.0, 0.0, 5.0), (0.5, -2.8, FRAC_PI_2, 5.0)]);
    assert_eq!(collisions.first_partner(0).unwrap().kind, ContactKind::Side);
    assert_eq!(collisions.first_partner(1).unwrap().kind, ContactKind::Front);
    assert!(!collisions.at_fault(0) && collisions.at_fault(1));
}

#[test]
fn head_on_collisions_are_the_fault_of_both_unless_one_stands() {
    let moving = detect(&[(0.0, 0.0, 0.0, 5.0), (3.8, 0.0, PI, 5.0)]);
    assert!(moving.at_fault(0) && moving.at_fault(1));
    let standing = detect(&[(0.0, 0.0, 0.0, 5.0), (3.8, 0.0, PI, 0.0)]);
    assert!(standing.at_fault(0) && !standing.at_fault(1));
}

#[test]
fn an_agent_inside_another_is_placed_by_its_centre() {
    let (states, mut footprints, kinds) = cars(&[(0.0, 0.0, 0.0, 0.0), (3.0, 0.0, 0.0, 0.0)]);
    footprints[0] = Footprint::new(10.0, 3.0);
    footprints[1] = Footprint::new(0.4, 0.4);
    let mut collisions = Collisions::new();
    collisions.detect(&states, &footprints, &kinds);
    assert_eq!(collisions.first_partner(0).unwrap().kind, ContactKind::Front);
}

#[test]
fn absent_agents_and_pairs_of_static_agents_do_not_collide() {
    let (mut states, footprints, mut kinds) =
        cars(&[(0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0)]);
    let mut collisions = Collisions::new();
    collisions.detect(&states, &footprints, &kinds);
    assert_eq!(collisions.pairs(), [(0, 1), (0, 2), (1, 2)]);
    kinds[0] = AgentKind::Static;
    kinds[1] = AgentKind::Static;
    collisions.detect(&states, &footprints, &kinds);
    assert_eq!(collisions.pairs(), [(0, 2), (1, 2)]);
    assert_eq!(collisions.first_partner(2).unwrap().partner, 0);
    states.active[0] = false;
    collisions.detect(&states, &footprints, &kinds);
    assert_eq!(collisions.pairs(), [(1, 2)]);
    assert_eq!(collisions.first_partner(0), None);
    assert_eq!(collisions.first_partner(99), None);
}

#[test]
fn corners_leave_the_road_before_the_centre_does() {
    let square = [(0.0, -50.0), (50.0, -50.0), (50.0, 50.0), (0.0, 50.0)].map(|(x, y)| Point2::new(x, y));
    let region = Region::new(&[Polygon::from_exterior(square.to_vec())]).unwrap();
    let (states, footprints, _) = cars(&[(25.0, 0.0, 1.0, 0.0), (1.5, 0.0, 0.0, 0.0), (-0.5, 0.0, 0.0, 0.0)]);
    let flags = [0, 1, 2].map(|agent| off_road(&states, agent, &footprints[agent], &region));
    let flag = |corner, centroid| OffRoad { corner, centroid };
    assert_eq!(flags, [flag(false, false), flag(true, false), flag(true, true)]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn pairs_are_those_of_all_polygon_intersections_in_order(
        agents in prop::collection::vec((-40f32..40.0, -40f32..40.0, -4f32..4.0, 0.5f32..12.0, 0.5f32..3.0), 1..80),
        absent in prop::collection::vec(0usize..80, 0..8),
    ) {
        let poses: Vec<_> = agents.iter().map(|(x, y, h, ..)| (*x, *y, *h, 0.0)).collect();
        let (mut states, mut footprints, kinds) = cars(&poses);
        for (footprint, (.., length, width)) in footprints.iter_mut().zip(&agents) {
            *footprint = Footprint::new(*length, *width);
        }
        for i in absent {
            states.active[i % agents.len()] = false;
        }
        let (mut circles, mut sweep) = (Collisions::new(), Collisions::new());
        circles.detect_by_circles(&states, &footprints, &kinds);
        sweep.detect_by_sweep(&states, &footprints, &kinds);
        prop_assert_eq!(circles.pairs(), sweep.pairs());
        prop_assert!(circles.pairs().is_sorted());
        let polygon = |i: usize| {
            let corners = states.oriented_box(i, &footprints[i]).corners();
            let ring = corners.iter().map(|c| (f64::from(c.x), f64::from(c.y))).collect::<Vec<_>>();
            geo::Polygon::new(ring.into(), vec![])
        };
        for i in 0..agents.len() {
            prop_assert_eq!(circles.first_partner(i), sweep.first_partner(i));
            for j in i + 1..agents.len() {
                let both = states.active[i] && states.active[j];
                let area = if both { polygon(i).intersection(&polygon(j)).unsigned_area() } else { 0.0 };
                let found = circles.pairs().contains(&(i as u32, j as u32));
                prop_assert!(both || !found);
                prop_assert!(found || area < 1e-3);
                if found && area == 0.0 {
                    let gap = geo::Distance::distance(&geo::Euclidean, &polygon(i), &polygon(j));
                    prop_assert!(gap < 1e-3);
                }
            }
        }
        let in_pairs = |i: usize| circles.pairs().iter().any(|(a, b)| *a as usize == i || *b as usize == i);
        for i in 0..agents.len() {
            prop_assert_eq!(circles.first_partner(i).is_some(), in_pairs(i));
        }
        // asked for few agents, the pairs that hold them; asked for many, all
        let present: Vec<u32> = (0..agents.len() as u32).filter(|a| states.active[*a as usize]).collect();
        for asked in [&present[..present.len().min(2)], &present[..]] {
            let of = |pair: &&(u32, u32)| asked.contains(&pair.0) || asked.contains(&pair.1);
            let wanted: Vec<_> = circles.pairs().iter().filter(of).copied().collect();
            let found = Collisions::new().pairs_of(&states, &footprints, &kinds, asked).to_vec();
            prop_assert_eq!(found.iter().filter(of).copied().collect::<Vec<_>>(), wanted);
        }
    }
}

proptest! {
    #[test]
    fn the_least_time_to_contact_is_the_least_over_all_pairs(
        agents in prop::collection::vec((-60f32..60.0, -60f32..60.0, -4f32..4.0, -2f32..15.0), 1..40),
        away in prop::collection::vec(prop::bool::weighted(0.3), 40),
        asked in prop::collection::vec(any::<bool>(), 40),
    ) {
        let (mut states, footprints, _) = cars(&agents);
        for a in 0..agents.len() {
            states.active[a] = !away[a];
        }
        let asked = (0..agents.len()).filter(|a| asked[*a]);
        let mut times = LeastTimes::default();
        times.find(&states, &footprints, asked.clone(), 10.0);
        for a in asked {
            let of_pair = |j: usize| time_to_contact(&states, &footprints, a, j, 10.0).unwrap_or(10.0);
            let others = (0..agents.len()).filter(|j| *j != a && states.active[*j]);
            let expected = others.map(of_pair).fold(10.0, f32::min);
            prop_assert_eq!(times.of(a).to_bits(), expected.to_bits());
        }
    }
}

/// The leader of the first car on a straight route along x from −10 to 100 m, the car 10 m along it.
fn ahead(agents: &[(f32, f32, f32, f32)]) -> Option<Leader> {
    let (states, footprints, _) = cars(agents);
    let route = Polyline::new((-10..=100).map(|x| Point2::new(x as f32, 0.0)).collect()).unwrap();
    leader(&states, &footprints, &route, 10.0, 0, 1.0)
}

#[test]
fn the_leader_is_the_nearest_agent_that_leaves_too_little_room() {
    let own = (0.0, 0.0, 0.0, 10.0);
    let gap = |agents: &[_]| ahead(agents).map(|l| (l.gap_m.round(), l.speed_mps.round()));
    assert_eq!(gap(&[own, (30.0, 0.5, 0.0, 6.0), (20.0, 0.0, 0.0, 3.0)]), Some((16.0, 3.0)));
    // beside the route, behind, beyond what is looked at
    assert_eq!(gap(&[own, (30.0, 3.0, 0.0, 6.0), (-20.0, 0.0, 0.0, 3.0), (75.0, 0.0, 0.0, 0.0)]), None);
    // a moving car needs more room beside it than a parked one
    assert_eq!(gap(&[own, (30.0, 2.2, 0.0, 6.0)]), Some((26.0, 6.0)));
    assert_eq!(gap(&[own, (30.0, 2.2, 0.0, 0.0)]), None);
    // oncoming cars count as standing; a crossing one counts where it will be in a second
    assert_eq!(gap(&[own, (30.0, 0.0, PI, 6.0)]), Some((26.0, 0.0)));
    assert_eq!(gap(&[own, (30.0, -8.0, FRAC_PI_2, 8.0)]), Some((27.0, 0.0)));
    assert_eq!(gap(&[own, (30.0, -8.0, FRAC_PI_2, 2.0)]), None);
}
