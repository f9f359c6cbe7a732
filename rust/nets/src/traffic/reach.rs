//! Who can bring about a contact: a ranking by what a vehicle can do, without a network.
//!
//! Differs from the paper: ours. Cliques say who was near whom in the past; this says whom a vehicle can still come near.

use crate::inputs::features::Window;
use crate::inputs::unicycle::rolled;
use ccdiff_sim::geom::{Point2, Pose2, Real, Vector2};

/// Manoeuvres: accelerations, m/s², each with yaw rates, rad/s, which are held for [`TURN_S`] and then taken back.
const ACCELERATIONS_MPS2: [Real; 5] = [-6.0, -4.0, -2.0, 0.0, 2.0];
const YAW_RATES_RADPS: [Real; 5] = [-0.3, -0.15, 0.0, 0.15, 0.3];
const TURN_S: Real = 1.0;
/// Steps of time and their number: 5 s.
const STEP_S: Real = 0.2;
const STEPS: usize = 25;
/// Distance beyond which nobody is nearer than anybody else, metres.
const FAR_M: Real = 60.0;

/// A body as three disks along its axis: radius and offsets.
struct Body {
    radius_m: Real,
    offset_m: Real,
}

impl Body {
    fn disks(&self, pose: &Pose2) -> [Vector2; 3] {
        let along = Vector2::new(pose.cos, pose.sin) * self.offset_m;
        [pose.position.coords - along, pose.position.coords, pose.position.coords + along]
    }
}

/// Minus the least distance to those that count, if they go on at their velocity, mean over the manoeuvres of each agent, [M].
pub(super) fn scores(window: &Window, collision_targets: &[bool]) -> Vec<Real> {
    let (m, now) = (window.num_agents(), window.num_steps - 1);
    let body = |a: usize| {
        let radius_m = 0.5 * window.width_m[a];
        Body { radius_m, offset_m: (0.5 * window.length_m[a] - radius_m).max(0.0) }
    };
    let steady: Vec<Vec<[Vector2; 3]>> = (0..m)
        .map(|a| {
            let (pose, velocity) = (window.pose(a, now), window.velocity(a, now));
            let at = |step: usize| velocity * (STEP_S * step as Real);
            (1..=STEPS).map(|step| body(a).disks(&pose).map(|place| place + at(step))).collect()
        })
        .collect();
    let least_m = |agent: usize, acceleration_mps2: Real, yaw_rate_radps: Real| {
        let (own, pose) = (body(agent), window.pose(agent, now));
        let speed_mps = window.speed_mps[agent * window.num_steps + now];
        let mut actions = Vec::with_capacity(2 * STEPS);
        for step in 0..STEPS {
            let time_s = STEP_S * step as Real;
            let sign = if time_s < TURN_S { 1.0 } else { -1.0 };
            let turns = Real::from(u8::from(time_s < 2.0 * TURN_S));
            // it brakes to a stand, not backwards
            let left_mps = (speed_mps + acceleration_mps2 * time_s).max(0.0);
            actions.extend([acceleration_mps2.max(-left_mps / STEP_S), turns * sign * yaw_rate_radps]);
        }
        let poses = rolled(pose, speed_mps, STEP_S, &actions);
        let mut least_m = FAR_M;
        for (step, moment) in poses.enumerate() {
            let at = Pose2 {
                position: Point2::new(moment.x_m, moment.y_m),
                cos: moment.cos,
                sin: moment.sin,
                ..pose
            };
            let disks = own.disks(&at);
            for other in
                (0..m).filter(|o| *o != agent && collision_targets[*o] && !window.is_apart(agent, *o))
            {
                let touch_m = own.radius_m + body(other).radius_m;
                for (one, two) in disks.iter().flat_map(|d| steady[other][step].iter().map(move |e| (d, e))) {
                    least_m = least_m.min((one - two).norm() - touch_m);
                }
            }
        }
        least_m.max(0.0)
    };
    let of_agent = |agent: usize| {
        let both = ACCELERATIONS_MPS2.iter().flat_map(|a| YAW_RATES_RADPS.iter().map(move |w| (*a, *w)));
        -both.map(|(a, w)| least_m(agent, a, w)).sum::<Real>()
    };
    (0..m).map(of_agent).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cars of 4 m by 2 m in steady motion: (x, y, heading, speed).
    fn window(cars: &[[Real; 4]]) -> Window {
        Window {
            num_steps: 1,
            poses: cars.iter().map(|c| Pose2::new(c[0], c[1], c[2])).collect(),
            speed_mps: cars.iter().map(|c| c[3]).collect(),
            valid: vec![true; cars.len()],
            length_m: vec![4.0; cars.len()],
            width_m: vec![2.0; cars.len()],
            ..Window::default()
        }
    }

    #[test]
    fn who_can_brake_into_a_follower_comes_before_who_drives_away() {
        let follower = [0.0, 0.0, 0.0, 10.0];
        let cars = [follower, [12.0, 0.0, 0.0, 10.0], [12.0, 3.5, 0.0, 10.0], [60.0, 0.0, 0.0, 20.0]];
        let found = scores(&window(&cars), &[true, false, false, false]);
        assert!(found[1] > found[2] && found[2] > found[3], "{found:?}");
    }

    #[test]
    fn distances_are_those_of_bodies_up_to_sixty_metres_and_to_targets_alone() {
        // nobody can leave 60 m of what is 200 m away; who touches a target at rest touches it in each of 25 manoeuvres
        let cars = [[0.0; 4], [200.0, 0.0, 0.0, 0.0], [200.0, 1.9, 0.0, 0.0]];
        assert_eq!(scores(&window(&cars), &[true, false, false])[1..], [-1500.0; 2]);
        assert_eq!(scores(&window(&cars), &[false, true, false])[2], 0.0);
        assert_eq!(scores(&window(&cars[..2]), &[false, true])[1], -1500.0);
        // at rest 5 m from bumper to bumper: 20 manoeuvres stay there, 5 drive on until they touch
        let near = scores(&window(&[[0.0; 4], [9.0, 0.0, 0.0, 0.0]]), &[false, true])[0];
        assert!((-125.1..=-99.9).contains(&near), "{near}");
    }
}
