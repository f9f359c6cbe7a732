//! Where the agents of a world will be in the next 1.5 s, deciding vehicles as drawn, all others as they brake and turn now, and
//! which of them come into contact.

use ccdiff_sim::drivers::WorldView;
use ccdiff_sim::geom::{OrientedBox, Point2, Real, math};

/// Moments that are looked at, seconds apart; how many hold a drawn motion. Then speeds are kept, and half of the yaw rate.
const APART_S: Real = 0.25;
const MOMENTS: usize = 6;
const HELD: usize = 2;
const KEPT: Real = 0.5;
/// Room that a vehicle wants on every side, metres.
const ROOM_M: Real = 0.15;

/// Boxes of the agents now and at the moments to come, and a circle round them.
#[derive(Debug, Default)]
pub(super) struct Watch {
    ways: Vec<Way>,
    active: Vec<usize>,
}

#[derive(Debug, Clone)]
struct Way {
    boxes: [OrientedBox; MOMENTS + 1],
    middle: Point2,
    radius_m: Real,
}

impl Way {
    fn of(world: &WorldView<'_>, a: usize, [acceleration, yaw_rate]: [Real; 2], held: usize) -> Self {
        let (states, footprint) = (world.states, &world.scene.footprints[a]);
        let now = states.oriented_box(a, footprint);
        let (mut boxes, mut last) = ([now; MOMENTS + 1], now);
        let (mut speed, mut heading) = (states.speed_mps[a], states.heading_rad[a]);
        for (k, at) in boxes[1..].iter_mut().enumerate() {
            let (acceleration, turn) =
                if k < held { (acceleration, yaw_rate * APART_S) } else { (0.0, KEPT * yaw_rate * APART_S) };
            let after = (speed + acceleration * APART_S).max(0.0);
            let way_m = 0.5 * (speed + after) * APART_S;
            let (mut sin, mut cos) = (last.sin, last.cos);
            if turn != 0.0 {
                heading += turn;
                (sin, cos) = math::sin_cos(heading);
            }
            last.centre.x += 0.5 * (last.cos + cos) * way_m;
            last.centre.y += 0.5 * (last.sin + sin) * way_m;
            (last.sin, last.cos, speed) = (sin, cos, after);
            *at = last;
        }
        let middle = Point2::from((now.centre.coords + last.centre.coords) * 0.5);
        let reach_m = boxes.iter().map(|b| (b.centre - middle).norm_squared()).fold(0.0, Real::max).sqrt();
        Self { boxes, middle, radius_m: reach_m + footprint.radius_m + ROOM_M }
    }
}

impl Watch {
    /// Takes the agents of a world, some of them with drawn accelerations and yaw rates.
    pub(super) fn enter(&mut self, world: &WorldView<'_>, agents: &[usize], motions: &[[Real; 2]]) {
        let states = world.states;
        self.active.clear();
        self.active.extend((0..states.len()).filter(|a| states.active[*a]));
        self.ways.clear();
        if agents.is_empty() {
            return;
        }
        let mut drawn = agents.iter().zip(motions).peekable();
        for a in 0..states.len() {
            self.ways.push(match drawn.next_if(|(agent, _)| **agent == a) {
                Some((_, motion)) => Way::of(world, a, *motion, HELD),
                None => {
                    let braking = states.acceleration_mps2[a].min(0.0);
                    Way::of(world, a, [braking, states.yaw_rate_radps[a]], MOMENTS)
                }
            });
        }
    }

    /// Gives an agent another acceleration and yaw rate.
    pub(super) fn put(&mut self, world: &WorldView<'_>, a: usize, motion: [Real; 2]) {
        self.ways[a] = Way::of(world, a, motion, HELD);
    }

    /// Whether an agent that is on the road leaves it.
    pub(super) fn leaves_road(&self, world: &WorldView<'_>, a: usize) -> bool {
        let own = &self.ways[a];
        let Some(road) = &world.scene.at(world.states.elevation_m(a)).road else { return false };
        let holds = |body: &OrientedBox| road.holds_box(body);
        !road.holds_square(own.middle, own.radius_m)
            && holds(&own.boxes[0])
            && !own.boxes[1..].iter().all(holds)
    }

    /// Whether an agent comes close to one that it minds. Those that touch it already or come from behind do not count.
    pub(super) fn touches(&self, world: &WorldView<'_>, a: usize, minds: impl Fn(usize) -> bool) -> bool {
        let own = &self.ways[a];
        let wide = |b: &OrientedBox| OrientedBox {
            half_length_m: b.half_length_m + ROOM_M,
            half_width_m: b.half_width_m + ROOM_M,
            ..*b
        };
        self.active.iter().any(|j| {
            let other = &self.ways[*j];
            let reach_m = own.radius_m + other.radius_m;
            let is_near = (other.middle - own.middle).norm_squared() < reach_m * reach_m;
            let is_behind = || {
                let (to, now) = (other.boxes[0].centre - own.boxes[0].centre, &own.boxes[0]);
                to.x * now.cos + to.y * now.sin < -now.half_length_m
            };
            let meet = || world.states.same_level(a, *j) && !world.states.hitched(a, *j) && minds(*j);
            if *j == a || !is_near || is_behind() || !meet() {
                return false;
            }
            let pairs = own.boxes.iter().zip(&other.boxes);
            if own.boxes[0].overlaps(&other.boxes[0]) {
                false
            } else if wide(&own.boxes[0]).overlaps(&other.boxes[0]) {
                pairs.skip(1).any(|(own, other)| own.overlaps(other))
            } else {
                pairs.skip(1).any(|(own, other)| wide(own).overlaps(other))
            }
        })
    }
}
