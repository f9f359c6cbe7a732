//! Contacts against the `geo` crate and hand-made situations.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use ccdiff_sim::events::{
    Collisions, Contact, ContactKind, Leader, LeastTimes, expected_contact_s, leader, time_to_contact,
};
use ccdiff_sim::geom::{Point2, Polyline, Pose2, Vector2};
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

fn found(states: &AgentStates, footprints: &[Footprint], kinds: &[AgentKind]) -> Vec<(u32, u32)> {
    let mut collisions = Collisions::new();
    collisions.find(states, footprints, kinds);
    collisions.pairs().to_vec()
}

fn touch(agents: &[(f32, f32, f32, f32)]) -> bool {
    let (states, footprints, kinds) = cars(agents);
    !found(&states, &footprints, &kinds).is_empty()
}

/// The contact of two cars as each of them sees it.
fn contacts(agents: [(f32, f32, f32, f32); 2]) -> [Contact; 2] {
    let (states, footprints, _) = cars(&agents);
    assert!(touch(&agents));
    [(0, 1), (1, 0)].map(|(i, j)| Contact::between(&states, &footprints, i, j, || false))
}

#[test]
fn rear_end_collisions_are_the_fault_of_the_one_behind() {
    let [behind, ahead] = contacts([(0.0, 0.0, 0.0, 8.0), (3.9, 0.2, 0.0, 3.0)]);
    assert_eq!((behind.partner, behind.kind), (1, ContactKind::Front));
    assert_eq!((ahead.partner, ahead.kind), (0, ContactKind::Rear));
    assert!((behind.closing_speed_mps - 5.0).abs() < 1e-5 && (ahead.closing_speed_mps - 5.0).abs() < 1e-5);
    assert!(behind.at_fault && !ahead.at_fault);
}

#[test]
fn crossing_traffic_hits_with_the_front_and_is_hit_on_the_side() {
    // agent 1 drives north into the right side of agent 0
    let [hit, hitting] = contacts([(0.0, 0.0, 0.0, 5.0), (0.5, -2.8, FRAC_PI_2, 5.0)]);
    assert_eq!((hit.kind, hitting.kind), (ContactKind::Side, ContactKind::Front));
    assert!(!hit.at_fault && hitting.at_fault);
}

#[test]
fn head_on_collisions_are_the_fault_of_both_unless_one_stands() {
    let blame = |speed| contacts([(0.0, 0.0, 0.0, 5.0), (3.8, 0.0, PI, speed)]).map(|c| c.at_fault);
    assert_eq!((blame(5.0), blame(0.0)), ([true, true], [true, false]));
}

#[test]
fn a_side_contact_counts_where_lanes_are_straddled_one_from_behind_never() {
    let blame = |agents: &[(f32, f32, f32, f32)], straddles: bool| {
        let (states, footprints, _) = cars(agents);
        Contact::between(&states, &footprints, 0, 1, || straddles).at_fault
    };
    // alongside, both moving: the corners of the fronts do not meet
    let beside = [(0.0, 0.0, 0.0, 8.0), (-1.0, 1.9, 0.0, 8.0)];
    assert!(blame(&beside, true) && !blame(&beside, false));
    // a standing ego is not to blame; one that hits a standing agent always is
    assert!(!blame(&[(0.0, 0.0, 0.0, 0.05), (-1.0, 1.9, 0.0, 8.0)], true));
    assert!(blame(&[(0.0, 0.0, 0.0, 8.0), (-1.0, 1.9, 0.0, 0.05)], false));
    // from behind: the rear axle of 4 m lies 1.36 m behind the middle, the other's centre 2.5 m further back and 0.9 m aside
    // is 160 degrees off, at 1.6 m aside 147 degrees
    assert!(!blame(&[(0.0, 0.0, 0.0, 5.0), (-3.86, 0.9, 0.0, 8.0)], true));
    assert!(blame(&[(0.0, 0.0, 0.0, 5.0), (-3.86, 1.6, 0.0, 8.0)], true));
}

#[test]
fn contacts_are_expected_at_tenths_of_a_second_with_who_is_ahead() {
    let expected = |agents: &[(f32, f32, f32, f32)], from_sides: bool| {
        let (states, footprints, kinds) = cars(agents);
        expected_contact_s(&states, &footprints, &kinds, 0, from_sides, |_| false, 0.95)
    };
    let is = |found: Option<f32>, s: f32| assert!((found.unwrap() - s).abs() < 1e-6, "{found:?}");
    // 10 m/s and a gap of 8.5 m: contact after 0.85 s, seen at 0.9 s; of 9.4 m after 0.94 s, not seen by 0.9 s
    is(expected(&[(0.0, 0.0, 0.0, 10.0), (12.5, 0.0, 0.0, 0.0)], false), 0.9);
    assert_eq!(expected(&[(0.0, 0.0, 0.0, 10.0), (13.4, 0.0, 0.0, 0.0)], false), None);
    // a standing agent has no contact, and none is expected from behind
    assert_eq!(expected(&[(0.0, 0.0, 0.0, 0.005), (7.0, 0.0, PI, 10.0)], true), None);
    assert_eq!(expected(&[(0.0, 0.0, 0.0, 1.0), (-6.0, 0.0, 0.0, 10.0)], true), None);
    // from the side it is met in intersections and between lanes alone
    let side = [(0.0, 0.0, 0.0, 5.0), (2.0, -6.0, FRAC_PI_2, 8.0)];
    assert_eq!(expected(&side, false), None);
    // 3.0 m to go at 8 m/s after half the width and half the length: 0.375 s
    is(expected(&side, true), 0.4);
    // an agent goes along its heading, whatever its velocity
    let (mut states, footprints, kinds) = cars(&[(0.0, 0.0, 0.0, 5.0), (9.0, 5.0, 0.0, 0.0)]);
    states.velocity_y_mps[1] = -5.0;
    assert_eq!(expected_contact_s(&states, &footprints, &kinds, 0, true, |_| false, 0.95), None);
    // static obstacles stay, and ignored agents do not count
    let (states, footprints, mut kinds) = cars(&[(0.0, 0.0, 0.0, 10.0), (10.0, 0.0, 0.0, 9.0)]);
    assert_eq!(expected_contact_s(&states, &footprints, &kinds, 0, false, |_| false, 0.95), None);
    kinds[1] = AgentKind::Static;
    let meets =
        |ignored: usize| expected_contact_s(&states, &footprints, &kinds, 0, false, |a| a == ignored, 0.95);
    is(meets(9), 0.6);
    assert_eq!(meets(1), None);
}

#[test]
fn an_agent_inside_another_is_placed_by_its_centre() {
    let (states, _, _) = cars(&[(0.0, 0.0, 0.0, 0.0), (3.0, 0.0, 0.0, 0.0)]);
    let footprints = [Footprint::new(10.0, 3.0), Footprint::new(0.4, 0.4)];
    let contact = Contact::between(&states, &footprints, 0, 1, || false);
    assert_eq!(contact.kind, ContactKind::Front);
}

#[test]
fn absent_agents_and_pairs_of_static_agents_do_not_collide() {
    let (mut states, footprints, mut kinds) =
        cars(&[(0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0)]);
    assert_eq!(found(&states, &footprints, &kinds), [(0, 1), (0, 2), (1, 2)]);
    kinds[0] = AgentKind::Static;
    kinds[1] = AgentKind::Static;
    assert_eq!(found(&states, &footprints, &kinds), [(0, 2), (1, 2)]);
    states.active[0] = false;
    assert_eq!(found(&states, &footprints, &kinds), [(1, 2)]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn pairs_are_those_of_all_polygon_intersections_in_order(
        agents in prop::collection::vec((-40f32..40.0, -40f32..40.0, -4f32..4.0, 0.5f32..12.0, 0.5f32..3.0), 1..120),
        absent in prop::collection::vec(0usize..120, 0..8),
    ) {
        let poses: Vec<_> = agents.iter().map(|(x, y, h, ..)| (*x, *y, *h, 0.0)).collect();
        let (mut states, mut footprints, kinds) = cars(&poses);
        for (footprint, (.., length, width)) in footprints.iter_mut().zip(&agents) {
            *footprint = Footprint::new(*length, *width);
        }
        for i in absent {
            states.active[i % agents.len()] = false;
        }
        let pairs = found(&states, &footprints, &kinds);
        prop_assert!(pairs.is_sorted());
        let polygon = |i: usize| {
            let corners = states.oriented_box(i, &footprints[i]).corners();
            let ring = corners.iter().map(|c| (f64::from(c.x), f64::from(c.y))).collect::<Vec<_>>();
            geo::Polygon::new(ring.into(), vec![])
        };
        for i in 0..agents.len() {
            for j in i + 1..agents.len() {
                let both = states.active[i] && states.active[j];
                let area = if both { polygon(i).intersection(&polygon(j)).unsigned_area() } else { 0.0 };
                let found = pairs.contains(&(i as u32, j as u32));
                prop_assert!(both || !found);
                prop_assert!(found || area < 1e-3);
                if found && area == 0.0 {
                    let gap = geo::Distance::distance(&geo::Euclidean, &polygon(i), &polygon(j));
                    prop_assert!(gap < 1e-3);
                }
            }
        }
        // asked for few agents, the pairs that hold them; asked for many, all
        let present: Vec<u32> = (0..agents.len() as u32).filter(|a| states.active[*a as usize]).collect();
        for asked in [&present[..present.len().min(2)], &present[..]] {
            let of = |pair: &&(u32, u32)| asked.contains(&pair.0) || asked.contains(&pair.1);
            let wanted: Vec<_> = pairs.iter().filter(of).copied().collect();
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
