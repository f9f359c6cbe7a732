//! What a vehicle of swift traffic sees: itself, its route, the ego and the nearest agents, all in its own frame.

use ccdiff_sim::drivers::WorldView;
use ccdiff_sim::geom::{Point2, Pose2, Real, Vector2, math};
use ccdiff_sim::scene::AgentKind;
use ccdiff_sim::stage::History;

/// States that it looks back at, the present one included.
pub const STATES: usize = 11;
/// Nearest agents that it sees, and how far it sees, metres.
pub const NEIGHBOURS: usize = 8;
const REACH_M: Real = 50.0;
/// Numbers about itself and its route.
pub const OWN: usize = 13 + 4 * PLACES.len();
/// Numbers about another agent.
pub const OTHER: usize = 15;
/// Numbers about the ego; the last one says that there is one.
pub const EGO: usize = 14;
/// The number of another agent that says what it is: 1 for the ego, 0 for vehicles, -1 for all others.
pub(super) const WHO: usize = OTHER - 1;

/// Distance between places on the route, metres.
pub const SPACING_M: Real = 2.0;
const NUM_PLACES: usize = 41;
/// Places that are told, by index.
pub const PLACES: [usize; 13] = [0, 1, 2, 4, 6, 8, 10, 13, 16, 20, 25, 30, 40];
/// Numbers are clipped here.
const CLIP: Real = 6.0;

/// What some vehicles see, one row after another.
#[derive(Debug, Default)]
pub struct Rows {
    /// [n, [`OWN`]].
    pub own: Vec<Real>,
    /// [n, [`EGO`]]; zeros where there is no ego.
    pub ego: Vec<Real>,
    /// The agents that each vehicle sees, nearest first, [sum of `seen`, [`OTHER`]].
    pub others: Vec<Real>,
    /// How many these are, [n].
    pub seen: Vec<usize>,
}

/// A vehicle and the places on its route.
struct Own<'a> {
    world: &'a WorldView<'a>,
    agent_idx: usize,
    pose: Pose2,
    velocity: Vector2,
    places: [Point2; NUM_PLACES],
    num_places: usize,
}

impl Rows {
    /// Forgets all rows.
    pub(super) fn clear(&mut self) {
        self.own.clear();
        self.ego.clear();
        self.others.clear();
        self.seen.clear();
    }

    /// Adds what an active vehicle sees; `egos` are those that it may be told to hinder. The history holds [`STATES`] at least.
    pub fn add(&mut self, world: &WorldView<'_>, history: &History, agent_idx: usize, egos: &[usize]) {
        let states = world.states;
        let (path, s_m) = (&world.scene.routes[agent_idx].path, world.route_s_m[agent_idx].max(0.0));
        let left_m = (path.length_m() - s_m).max(0.0);
        let pose = states.pose(agent_idx);
        let mut own = Own {
            world,
            agent_idx,
            pose,
            velocity: states.velocity(agent_idx),
            places: [Point2::origin(); NUM_PLACES],
            num_places: ((left_m / SPACING_M) as usize + 1).min(NUM_PLACES),
        };
        for (k, place) in own.places[..own.num_places].iter_mut().enumerate() {
            *place = path.at(s_m + k as Real * SPACING_M).position;
        }
        self.add_own(&own, history);
        let distance = |j: usize| (states.position(j) - pose.position).norm_squared();
        let nearest = |best: Option<usize>, j: &usize| match best {
            Some(b) if distance(b) <= distance(*j) => Some(b),
            _ => Some(*j),
        };
        let ego = egos.iter().filter(|j| **j != agent_idx).fold(None, nearest);
        match ego.map(|j| own.other(j, distance(j), true)) {
            Some(numbers) => {
                self.ego.extend_from_slice(&numbers[..EGO - 1]);
                self.ego.push(1.0);
            }
            None => self.ego.extend([0.0; EGO]),
        }
        let mut found = [(REACH_M * REACH_M, usize::MAX); NEIGHBOURS];
        for j in (0..states.len()).filter(|j| states.active[*j] && *j != agent_idx) {
            let new = (distance(j), j);
            if new.0 < found[NEIGHBOURS - 1].0 && states.same_level(agent_idx, j) {
                let at = found.partition_point(|f| f.0 <= new.0);
                found.copy_within(at..NEIGHBOURS - 1, at + 1);
                found[at] = new;
            }
        }
        let seen = found.iter().filter(|f| f.1 != usize::MAX);
        self.seen.push(seen.clone().count());
        seen.for_each(|(d2, j)| self.others.extend(own.other(*j, *d2, egos.contains(j))));
    }

    fn add_own(&mut self, own: &Own<'_>, history: &History) {
        let (world, a) = (own.world, own.agent_idx);
        let before = |steps: usize| history.at(a, history.len() - 1 - steps);
        let (now, dt_s) = (before(0), world.dt_s);
        let change = |steps: usize| {
            let past = before(steps);
            let turn = math::wrap_angle(now.heading_rad - past.heading_rad);
            if past.valid { [now.speed_mps - past.speed_mps, turn] } else { [0.0; 2] }
        };
        let [one, half, whole] = [1, 5, 10].map(change);
        let (footprint, path) = (&world.scene.footprints[a], &world.scene.routes[a].path);
        let s_m = world.route_s_m[a];
        let way = path.tangent_at(s_m);
        let off = own.pose.position - own.places[0];
        let numbers = [
            now.speed_mps / 10.0,
            one[0] / dt_s / 4.0,
            half[0] / 4.0,
            whole[0] / 4.0,
            one[1] / dt_s / 0.5,
            half[1] / (5.0 * dt_s) / 0.5,
            footprint.half_length_m / 3.0,
            footprint.half_width_m / 1.5,
            Real::from(before(10).valid),
            way.x * own.pose.cos + way.y * own.pose.sin,
            way.y * own.pose.cos - way.x * own.pose.sin,
            (way.x * off.y - way.y * off.x) / 3.0,
            own.num_places as Real / NUM_PLACES as Real,
        ];
        self.own.extend(numbers.map(|x| x.clamp(-CLIP, CLIP)));
        for k in PLACES {
            let numbers = if k < own.num_places {
                let (at, way) = (
                    own.local(own.places[k] - own.pose.position),
                    path.tangent_at(s_m + k as Real * SPACING_M),
                );
                [at.x / 30.0, at.y / 30.0, 1.0, way.y * own.pose.cos - way.x * own.pose.sin]
            } else {
                [0.0; 4]
            };
            self.own.extend(numbers.map(|x| x.clamp(-CLIP, CLIP)));
        }
    }
}

impl Own<'_> {
    /// A vector of the scene in the frame of the vehicle.
    fn local(&self, v: Vector2) -> Vector2 {
        Vector2::new(v.x * self.pose.cos + v.y * self.pose.sin, v.y * self.pose.cos - v.x * self.pose.sin)
    }

    /// Another agent at a squared distance.
    fn other(&self, j: usize, distance_sq: Real, is_ego: bool) -> [Real; OTHER] {
        let (states, pose) = (self.world.states, &self.pose);
        let place = states.position(j);
        let (at, velocity) =
            (self.local(place - pose.position), self.local(states.velocity(j) - self.velocity));
        let (mut nearest_sq, mut nearest) = (1e4, NUM_PLACES - 1);
        for (k, on_route) in self.places[..self.num_places].iter().enumerate() {
            let d = (place - on_route).norm_squared();
            if d < nearest_sq {
                (nearest_sq, nearest) = (d, k);
            }
        }
        // of the closest approach: when, and how close
        let closing = velocity.norm_squared().max(1e-2);
        let time_s = (-at.dot(&velocity) / closing).clamp(0.0, 8.0);
        let miss_m = (at + velocity * time_s).norm();
        let footprint = &self.world.scene.footprints[j];
        let who = match self.world.scene.kinds[j] {
            _ if is_ego => 1.0,
            AgentKind::Vehicle => 0.0,
            _ => -1.0,
        };
        let numbers = [
            at.x / 30.0,
            at.y / 30.0,
            states.cos[j] * pose.cos + states.sin[j] * pose.sin,
            states.sin[j] * pose.cos - states.cos[j] * pose.sin,
            velocity.x / 10.0,
            velocity.y / 10.0,
            states.speed_mps[j] / 10.0,
            footprint.half_length_m / 3.0,
            footprint.half_width_m / 1.5,
            distance_sq.sqrt() / 30.0,
            nearest as Real * SPACING_M / 30.0,
            nearest_sq.sqrt().min(15.0) / 5.0,
            time_s / 4.0,
            miss_m.min(30.0) / 10.0,
            who,
        ];
        numbers.map(|x| x.clamp(-CLIP, CLIP))
    }
}
