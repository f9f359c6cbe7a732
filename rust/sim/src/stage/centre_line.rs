//! The line to drive along: the lanes that the route goes by, joined through the lane graph.

use crate::geom::{Point2, Polyline, Projection, Real, Vector2, bounds, math};
use crate::scene::{LEVEL_M, LightAlong, Map};
use crate::stage::route::{APPROACH_MPS2, CURVE_MPS2, Route};

/// Spacing of what is tabulated along the line, metres.
const STEP_M: Real = 0.5;
/// Spacing at which lanes are looked for, metres.
const LOOK_M: Real = 2.0;
/// A lane farther from the route than this is not driven along, metres.
const REACH_M: Real = 2.5;
/// Cosine of the largest angle between route and lane.
const AGREE_COS: Real = 0.8;
/// Costs, square metres: of no lane, of leaving or entering the lanes, of a lane that does not follow the last one.
const NO_LANE_M2: Real = 6.0;
const LEAVE_M2: Real = 4.0;
const CHANGE_M2: Real = 12.0;
/// Samples to either side over which the way from one lane to the next is spread.
const SPREAD: usize = 4;

/// The line at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Position, scene frame.
    pub position: Point2,
    /// Heading, radians, not wrapped.
    pub heading_rad: Real,
    /// Its cosine and sine.
    pub direction: Vector2,
    /// Curvature, left positive.
    pub curvature_1pm: Real,
    /// Greatest speed that the curves here and ahead allow, m/s.
    pub curve_speed_mps: Real,
    /// Speed limit of the lane, m/s; infinite without one.
    pub limit_mps: Real,
}

/// Centre line of the lanes towards the route's end; the route itself where there are none.
#[derive(Debug, Clone, PartialEq)]
pub struct CentreLine {
    line: Polyline,
    places: Vec<Place>,
    /// Lights along the line, nearest first.
    pub(crate) lights: Vec<LightAlong>,
}

/// A lane near a sample of the route.
struct Candidate {
    lane: Option<usize>,
    s_m: Real,
    /// Distance of the lane from the route, left positive, metres.
    lateral_m: Real,
}

impl CentreLine {
    /// The line along a route.
    pub fn new(map: &Map, of_agent: &Route) -> Self {
        let route = &of_agent.path;
        let chosen = lanes_along(map, of_agent);
        let (laterals, limits): (Vec<Real>, Vec<Real>) = chosen
            .iter()
            .map(|c| {
                let limit = c.lane.and_then(|lane| map.lanes[lane].speed_limit_mps);
                (c.lateral_m, limit.unwrap_or(Real::INFINITY))
            })
            .unzip();
        let points = (0..=(route.length_m().ceil() as usize)).map(|i| {
            let s_m = (i as Real).min(route.length_m());
            let (at, k) = (route.at(s_m), (s_m / LOOK_M).round() as usize);
            let near = &laterals
                [k.saturating_sub(SPREAD).min(laterals.len() - 1)..(k + SPREAD + 1).min(laterals.len())];
            let lateral_m = near.iter().sum::<Real>() / near.len() as Real;
            at.position + Vector2::new(-at.sin, at.cos) * lateral_m
        });
        let line = Polyline::new(points.collect()).unwrap_or_else(|| route.clone());
        let places = places(&line, |s_m| limits[((s_m / LOOK_M).round() as usize).min(limits.len() - 1)]);
        Self { lights: map.lights_along(&line), line, places }
    }

    /// The line, points about a metre apart.
    pub fn polyline(&self) -> &Polyline {
        &self.line
    }

    /// The line at an arc length, between the two places nearest to it; clamped to the ends.
    #[inline]
    pub fn at(&self, s_m: Real) -> Place {
        let (a, b, w) = self.around(s_m);
        let mix = |a: Real, b: Real| a + w * (b - a);
        Place {
            position: a.position + (b.position - a.position) * w,
            heading_rad: mix(a.heading_rad, b.heading_rad),
            direction: math::turned(a.direction, w * (b.heading_rad - a.heading_rad)),
            curvature_1pm: mix(a.curvature_1pm, b.curvature_1pm),
            curve_speed_mps: mix(a.curve_speed_mps, b.curve_speed_mps),
            limit_mps: a.limit_mps,
        }
    }

    /// The two places nearest to an arc length, clamped to the ends, and the share of the second one there.
    #[inline(always)]
    pub(crate) fn around(&self, s_m: Real) -> (&Place, &Place, Real) {
        let f = (s_m / STEP_M).max(0.0).min((self.places.len() - 1) as Real);
        let i = (f as usize).min(self.places.len() - 2);
        (&self.places[i], &self.places[i + 1], f - i as Real)
    }

    /// Nearest place of the line to a point; near an arc length where one is given. Past the ends the arc length goes on.
    pub fn project(&self, point: Point2, hint_s_m: Option<Real>) -> Projection {
        let mut found = match hint_s_m {
            Some(hint_s_m) => self.line.project_near(point, hint_s_m, 6.0),
            None => self.line.project(point),
        };
        let length_m = self.line.length_m();
        if found.s_m <= 0.0 || found.s_m >= length_m {
            let end = self.line.at(found.s_m);
            let beyond = (point - end.position).dot(&Vector2::new(end.cos, end.sin));
            found.s_m += if found.s_m <= 0.0 { beyond.min(0.0) } else { beyond.max(0.0) };
        }
        found
    }
}

/// The lanes that the samples of a route lie on: the cheapest path through all samples.
fn lanes_along(map: &Map, of_agent: &Route) -> Vec<Candidate> {
    let route = &of_agent.path;
    let samples = (route.length_m() / LOOK_M).ceil() as usize + 1;
    let lines: Vec<_> = map.lanes.iter().map(|lane| Polyline::new(lane.centreline.clone())).collect();
    let bounds = |line: &Polyline| bounds(line.points().iter().copied());
    let boxes: Vec<_> = lines.iter().map(|line| line.as_ref().and_then(bounds)).collect();
    let mut steps: Vec<Vec<Candidate>> = Vec::with_capacity(samples);
    let mut from: Vec<Vec<usize>> = Vec::with_capacity(samples);
    let mut costs: Vec<Real> = Vec::new();
    for k in 0..samples {
        let at = route.at(k as Real * LOOK_M);
        let mut here = vec![Candidate { lane: None, s_m: 0.0, lateral_m: 0.0 }];
        for (lane, (line, bounds)) in lines.iter().zip(&boxes).enumerate() {
            let (Some(line), Some((lo, hi))) = (line, bounds) else { continue };
            let p = at.position;
            if p.x < lo.x - REACH_M || p.y < lo.y - REACH_M || p.x > hi.x + REACH_M || p.y > hi.y + REACH_M {
                continue;
            }
            let found = line.project(p);
            let there = line.at(found.s_m);
            if found.distance_m > REACH_M || there.cos * at.cos + there.sin * at.sin < AGREE_COS {
                continue;
            }
            let level = of_agent.height(k as Real * LOOK_M).zip(map.lanes[lane].height(found.s_m));
            if level.is_some_and(|(own, z)| (own.elevation_m - z).abs() > LEVEL_M) {
                continue;
            }
            let offset = there.position - p;
            let lateral_m = offset.y * at.cos - offset.x * at.sin;
            here.push(Candidate { lane: Some(lane), s_m: found.s_m, lateral_m });
        }
        let own = |c: &Candidate| if c.lane.is_some() { c.lateral_m * c.lateral_m } else { NO_LANE_M2 };
        let (mut next, mut back) = (Vec::with_capacity(here.len()), Vec::with_capacity(here.len()));
        for candidate in &here {
            let before = steps.last().map_or(&[][..], |step: &Vec<Candidate>| step);
            let best = before.iter().zip(&costs).map(|(last, cost)| cost + transition(map, last, candidate));
            let best = best.enumerate().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0));
            back.push(best.0);
            next.push(best.1 + own(candidate));
        }
        costs = next;
        steps.push(here);
        from.push(back);
    }
    let cheapest = costs.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1));
    let mut choice = cheapest.map_or(0, |(i, _)| i);
    let mut chosen = Vec::with_capacity(samples);
    while let (Some(mut step), Some(back)) = (steps.pop(), from.pop()) {
        chosen.push(step.swap_remove(choice));
        choice = back[choice];
    }
    chosen.reverse();
    chosen
}

fn transition(map: &Map, last: &Candidate, next: &Candidate) -> Real {
    match (last.lane, next.lane) {
        (None, None) => 0.0,
        (Some(a), Some(b)) if a == b && next.s_m >= last.s_m - 0.5 => 0.0,
        (Some(a), Some(b)) if map.lanes[a].successors.contains(&(b as u32)) => 0.0,
        (Some(_), Some(_)) => CHANGE_M2,
        _ => LEAVE_M2,
    }
}

/// What is tabulated, every [`STEP_M`]: headings over two metres, curvatures over three.
fn places(line: &Polyline, limit: impl Fn(Real) -> Real) -> Vec<Place> {
    let n = (line.length_m() / STEP_M).ceil().max(2.0) as usize + 1;
    let length_m = line.length_m();
    let s_of = |i: usize| (i as Real * STEP_M).min(length_m);
    let points: Vec<Point2> = (0..n).map(|i| line.at(s_of(i)).position).collect();
    let mut headings: Vec<Real> = Vec::with_capacity(n);
    for i in 0..n {
        let d = points[(i + 2).min(n - 1)] - points[i.saturating_sub(2)];
        let heading = math::atan2(d.y, d.x);
        let last = headings.last().copied().unwrap_or(heading);
        headings.push(last + math::wrap_angle(heading - last));
    }
    let mut places: Vec<Place> = (0..n)
        .map(|i| {
            let (a, b) = (i.saturating_sub(3), (i + 3).min(n - 1));
            let curvature_1pm = (headings[b] - headings[a]) / (s_of(b) - s_of(a)).max(STEP_M);
            let (sin, cos) = math::sin_cos(headings[i]);
            Place {
                position: points[i],
                heading_rad: headings[i],
                direction: Vector2::new(cos, sin),
                curvature_1pm,
                curve_speed_mps: (CURVE_MPS2 / curvature_1pm.abs().max(1e-4)).sqrt().max(2.0),
                limit_mps: limit(s_of(i)),
            }
        })
        .collect();
    for i in (0..n - 1).rev() {
        let ahead = places[i + 1].curve_speed_mps;
        let reached = (ahead * ahead + 2.0 * APPROACH_MPS2 * STEP_M).sqrt();
        places[i].curve_speed_mps = places[i].curve_speed_mps.min(reached);
    }
    places
}
