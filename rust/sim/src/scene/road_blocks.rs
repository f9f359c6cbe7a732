//! Road blocks, which are lanes side by side in one direction or the connectors from one such block to another, and
//! progress along those that a log goes through, as nuPlan measures it.

use super::{LaneIndex, LaneKind, Map};
use crate::geom::{Point2, Real};

/// Distances of the centre lines of neighbouring lanes, metres.
const APART_M: std::ops::Range<Real> = 1.5..6.5;
/// How far the middle of a lane may lie past the end of its neighbour, metres.
const BEYOND_M: Real = 3.0;
/// Least cosine between the directions of neighbours.
const AGREE_COS: Real = 0.9;
/// A path that leaves a connector by less than this for another one is still in it, metres.
const STILL_IN_M: Real = 5.0;

/// How far two paths go along the road blocks of the second one, metres; `None` where that one is in no lane.
///
/// nuPlan's `ego_progress_along_expert_route`: within a block ways are differences along the centre line of the lane that
/// the log takes in it. Progress continues in the blocks that follow, nowhere else.
pub fn progress_along_log(
    lanes: &LaneIndex,
    map: &Map,
    path: &[Point2],
    log: &[Point2],
) -> Option<(Real, Real)> {
    let blocks = Blocks { lanes, map };
    let route = blocks.route(log);
    let along = |points| blocks.progress(&route, points);
    (!route.is_empty()).then(|| (along(path), along(log)))
}

struct Blocks<'a> {
    lanes: &'a LaneIndex,
    map: &'a Map,
}

struct Block {
    /// The lane or connector that the log takes.
    taken: usize,
    /// All that are side by side.
    all: Vec<usize>,
}

impl Blocks<'_> {
    fn is_lane(&self, l: usize) -> bool {
        self.map.lanes[l].kind == LaneKind::Lane
    }

    fn s_m(&self, l: usize, point: Point2) -> Real {
        self.lanes.on_lane(l, point, 1.0, 0.0).map_or(0.0, |hit| hit.s_m)
    }

    fn end(&self, l: usize) -> Point2 {
        let line = &self.map.lanes[l].centreline;
        line[line.len() - 1]
    }

    /// The lane at a point; where there is none, all connectors.
    fn at(&self, point: Point2) -> Vec<usize> {
        let held: Vec<usize> = self.lanes.holding(self.map, point).collect();
        let distance = |l: usize| self.lanes.on_lane(l, point, 1.0, 0.0).map_or(Real::MAX, |h| h.distance_m);
        let lanes = held.iter().copied().filter(|l| self.is_lane(*l));
        match lanes.min_by(|a, b| distance(*a).total_cmp(&distance(*b))) {
            Some(lane) => vec![lane],
            None => held,
        }
    }

    /// Lanes and connectors at each point of a path, which stays in the former ones while it can.
    fn along(&self, path: &[Point2]) -> Vec<Vec<usize>> {
        let mut found: Vec<Vec<usize>> = Vec::with_capacity(path.len());
        for (i, point) in path.iter().enumerate() {
            let before = found.last().map_or(&[][..], |b| b);
            let held = |l: &usize| self.lanes.holds(self.map, *l, *point);
            let mut here: Vec<usize> = before.iter().copied().filter(held).collect();
            if let ([only], true) = (before, here.is_empty()) {
                here = self.map.lanes[*only].successors.iter().map(|l| *l as usize).filter(held).collect();
            }
            if here.is_empty() {
                here = self.at(*point);
                let from_connector = before.first().is_some_and(|l| !self.is_lane(*l));
                if i > 1 && from_connector && here.first().is_some_and(|l| !self.is_lane(*l)) {
                    let near = |l: &usize| self.lanes.surface_distance_m(self.map, *l, *point) < STILL_IN_M;
                    let still: Vec<usize> = before.iter().copied().filter(near).collect();
                    here = if still.is_empty() { here } else { still };
                }
            }
            found.push(here);
        }
        // of several connectors those count that the path turns out to take
        for i in (0..found.len().saturating_sub(1)).rev() {
            let (before, after) = found.split_at_mut(i + 1);
            let (here, next) = (&mut before[i], &after[0]);
            if here.len() < 2 {
                continue;
            }
            if here.len() > next.len() && next.iter().all(|l| here.contains(l)) {
                here.clone_from(next);
            } else if let Some(lane) = next.first().filter(|l| self.is_lane(**l)) {
                let leads = |l: &usize| self.map.lanes[*lane].predecessors.contains(&(*l as u32));
                if here.iter().any(leads) {
                    here.retain(leads);
                }
            }
        }
        found
    }

    /// The blocks that a path goes through, in order.
    fn route(&self, path: &[Point2]) -> Vec<Block> {
        let (mut route, mut last) = (Vec::<Block>::new(), Vec::new());
        for here in self.along(path) {
            let Some(taken) = here.first().copied() else { continue };
            if here.iter().any(|l| last.contains(l)) {
                continue;
            }
            if route.last().is_none_or(|block| !block.all.contains(&taken)) {
                route.push(Block { taken, all: self.block(taken) });
            }
            last = here;
        }
        route
    }

    /// All lanes of a lane's block, or all connectors of a connector's.
    fn block(&self, of: usize) -> Vec<usize> {
        let lanes = |wanted: bool| (0..self.map.lanes.len()).filter(move |l| self.is_lane(*l) == wanted);
        if self.is_lane(of) {
            let mut block = vec![of];
            let mut next = 0;
            while let Some(lane) = block.get(next).copied() {
                next += 1;
                let new = |l: &usize| !block.contains(l) && are_beside(self.lanes, self.map, lane, *l);
                let beside: Vec<usize> = lanes(true).filter(new).collect();
                block.extend(beside);
            }
            return block;
        }
        let ends = |l: usize| [&self.map.lanes[l].predecessors, &self.map.lanes[l].successors];
        let own = ends(of).map(|ends| {
            let lane = ends.iter().map(|l| *l as usize).find(|l| self.is_lane(*l));
            lane.map_or_else(Vec::new, |lane| self.block(lane))
        });
        let meets = |l: usize| {
            ends(l).iter().zip(&own).all(|(ends, own)| ends.iter().any(|e| own.contains(&(*e as usize))))
        };
        lanes(false).filter(|l| *l == of || meets(*l)).collect()
    }

    fn progress(&self, route: &[Block], path: &[Point2]) -> Real {
        let Some(first) = path.first() else { return 0.0 };
        let (mut at, mut before_m, mut total_m) = (0, self.s_m(route[0].taken, *first), 0.0);
        for point in &path[1..] {
            let inside = |b: &Block| b.all.iter().any(|l| self.lanes.holds(self.map, *l, *point));
            let Some(found) = (at..route.len()).find(|k| inside(&route[*k])) else { continue };
            let (mut end, mut skipped_m) = (self.end(route[at].taken), 0.0);
            if found > at {
                before_m -= self.s_m(route[at].taken, end);
                let last = end;
                for k in at + 1..found {
                    let start = self.map.lanes[route[k + 1].taken].centreline[0];
                    skipped_m += self.s_m(route[k].taken, start) - self.s_m(route[k].taken, end);
                    end = self.end(route[k].taken);
                }
                at = found;
                before_m += self.s_m(route[at].taken, last);
            }
            let along_m = self.s_m(route[at].taken, *point);
            total_m += skipped_m + along_m - before_m;
            before_m = along_m;
        }
        total_m
    }
}

/// Whether two lanes lie side by side in one direction.
fn are_beside(lanes: &LaneIndex, map: &Map, one: usize, other: usize) -> bool {
    one != other && (is_beside(lanes, map, one, other) || is_beside(lanes, map, other, one))
}

/// Whether the middle of a lane lies beside another one, with nothing between them.
fn is_beside(lanes: &LaneIndex, map: &Map, lane: usize, other: usize) -> bool {
    let line = &map.lanes[lane].centreline;
    let k = line.len() / 2;
    let (point, way) = (line[k], line[k] - line[k.saturating_sub(1)]);
    let unit = way / way.norm().max(Real::MIN_POSITIVE);
    lanes.on_lane(other, point, unit.x, unit.y).is_some_and(|hit| {
        let beyond_sq = hit.distance_m * hit.distance_m - hit.lateral_m * hit.lateral_m;
        let between = || {
            let foot = lanes.foot(other, point);
            [0.25, 0.5, 0.75].iter().all(|share| {
                let p = point + (foot - point) * *share;
                lanes.holds(map, lane, p) || lanes.holds(map, other, p)
            })
        };
        APART_M.contains(&hit.lateral_m.abs())
            && beyond_sq < BEYOND_M * BEYOND_M
            && hit.heading_cos() > AGREE_COS
            && between()
    })
}
