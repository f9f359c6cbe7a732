//! A crossroads by hand.
#![allow(dead_code, reason = "each test file uses its part")]

use ccdiff_render::{AgentBox, DrawStyle};
use ccdiff_sim::geom::{Point2, Polygon, Pose2, Real};
use ccdiff_sim::scene::{AgentKind, Lane, LaneKind, Map};

pub(crate) fn points(xy: &[(Real, Real)]) -> Vec<Point2> {
    xy.iter().map(|(x, y)| Point2::new(*x, *y)).collect()
}

pub(crate) fn rectangle(x: (Real, Real), y: (Real, Real)) -> Polygon {
    Polygon { exterior: points(&[(x.0, y.0), (x.1, y.0), (x.1, y.1), (x.0, y.1)]), holes: vec![] }
}

/// Two roads, 14 m wide, that cross at the origin; a crossing and a stop area east of it.
pub(crate) fn crossroads() -> Map {
    let lane = |y: Real, towards: Real| Lane {
        id: format!("lane {y}"),
        kind: LaneKind::Lane,
        centreline: (0..=160).map(|i| Point2::new(towards * (i as Real - 80.0), y)).collect(),
        polygon: rectangle((-80.0, 80.0), (y - 1.75, y + 1.75)),
        successors: vec![],
        predecessors: vec![],
        speed_limit_mps: None,
        elevation_m: Vec::new(),
    };
    Map {
        drivable_area: vec![rectangle((-80.0, 80.0), (-7.0, 7.0)), rectangle((-7.0, 7.0), (-80.0, 80.0))],
        lanes: vec![lane(-5.2, 1.0), lane(-1.8, 1.0), lane(1.8, -1.0), lane(5.2, -1.0)],
        road_dividers: vec![points(&[(-80.0, 0.0), (-12.0, 0.0)]), points(&[(15.0, 0.0), (80.0, 0.0)])],
        lane_dividers: vec![points(&[(-80.0, -3.5), (-12.0, -3.5)]), points(&[(15.0, 3.5), (80.0, 3.5)])],
        ped_crossings: vec![rectangle((9.0, 12.0), (-7.0, 7.0))],
        walkways: vec![rectangle((-80.0, -7.0), (7.0, 10.5)), rectangle((7.0, 80.0), (7.0, 10.5))],
        stop_lines: vec![rectangle((13.0, 15.0), (0.0, 7.0))],
        carpark_areas: vec![rectangle((20.0, 45.0), (-20.0, -7.0))],
        ..Map::default()
    }
}

pub(crate) fn car(x: Real, y: Real, heading_rad: Real, driver: DrawStyle) -> AgentBox {
    AgentBox {
        pose: Pose2::new(x, y, heading_rad),
        length_m: 4.6,
        width_m: 1.9,
        kind: AgentKind::Vehicle,
        driver,
        collided: false,
        parked: false,
        arrived: false,
    }
}
