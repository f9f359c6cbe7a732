//! Traffic lights: the lane that each controls, the line where it is waited for, and its state at every step.

use super::Map;
use crate::geom::{Point2, Polyline, Real, Vector2};
use crate::named::named;
use serde::{Deserialize, Serialize};

/// How far behind a stop line a route is compared with the controlled lane, and how far they may be apart, metres.
const ALONG_M: Real = 8.0;
const APART_M: Real = 1.75;
/// Half the width of a lane, metres.
const HALF_LANE_M: Real = 1.75;

named! {
    /// State of a light.
    #[derive(Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum LightState {
        /// Off, or not seen.
        Unknown = "unknown",
        /// Go.
        Green = "green",
        /// Red follows.
        Yellow = "yellow",
        /// Stop.
        Red = "red",
    }
}

/// A light of one lane or connector.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Light {
    /// Index (into [`Map::lanes`]) of the lane behind the stop line.
    pub lane: u32,
    /// Ends of the stop line.
    pub stop_line: [Point2; 2],
    /// State at each logged step [T].
    pub states: Vec<LightState>,
}

impl Light {
    /// The state at a step; past the end of the log the last one holds.
    pub fn state(&self, step_idx: usize) -> LightState {
        self.states.get(step_idx).or(self.states.last()).copied().unwrap_or(LightState::Unknown)
    }

    /// Where a way from one point to another crosses the stop line in the direction of the lane: share of the way, 0 excluded.
    fn crossing(&self, map: &Map, from: Point2, to: Point2) -> Option<Real> {
        let cross = |a: Vector2, b: Vector2| a.x * b.y - a.y * b.x;
        let ([a, b], line) = (self.stop_line, &map.lanes[self.lane as usize].centreline);
        let (bar, way) = (b - a, to - from);
        let ahead = cross(bar, line[1] - line[0]).signum();
        let (before, after) = (ahead * cross(bar, from - a), ahead * cross(bar, to - a));
        if !(before < 0.0 && after >= 0.0) {
            return None;
        }
        let share = before / (before - after);
        let along = (from + way * share - a).dot(&bar);
        (along >= 0.0 && along <= bar.norm_squared()).then_some(share)
    }
}

impl Map {
    /// The line across a lane at a point beside it, as wide as a lane.
    pub fn stop_line(&self, lane: usize, at: Point2) -> [Point2; 2] {
        let line = &self.lanes[lane].centreline;
        let apart = |k: &usize| (line[*k] - at).norm_squared();
        let nearest = (0..line.len() - 1).min_by(|a, b| apart(a).total_cmp(&apart(b))).unwrap_or(0);
        let along = (line[nearest + 1] - line[nearest]).normalize();
        let across = Vector2::new(-along.y, along.x) * HALF_LANE_M;
        [at + across, at - across]
    }

    /// Whether a front that moves from one point to another passes a stop line at whose lights no state but red is shown.
    pub(crate) fn runs_red(&self, from: Point2, to: Point2, step_idx: usize) -> bool {
        let mut states = self
            .lights
            .iter()
            .filter(|light| light.crossing(self, from, to).is_some())
            .map(|light| light.state(step_idx) == LightState::Red)
            .peekable();
        states.peek().is_some() && states.all(|is_red| is_red)
    }

    /// Where along a route a front at `front_m` waits: at the nearest stop line ahead whose light is red or yellow for the lane
    /// that the route takes behind it, if it can stop there with the braking for these, m/s².
    pub(crate) fn waits_at(
        &self,
        route: &Polyline,
        front_m: Real,
        speed_mps: Real,
        step_idx: usize,
        [red, yellow]: [Real; 2],
    ) -> Option<Real> {
        let end_m = (front_m + 20.0 + 4.0 * speed_mps).min(front_m + 70.0).min(route.length_m());
        let mut nearest: Option<Real> = None;
        for light in &self.lights {
            let braking = match light.state(step_idx) {
                LightState::Red => red,
                LightState::Yellow => yellow,
                LightState::Green | LightState::Unknown => continue,
            };
            let mut s_m = front_m;
            while s_m < nearest.unwrap_or(end_m) {
                let step_m = (end_m - s_m).min(1.0);
                let (here, next) = (route.at(s_m).position, route.at(s_m + step_m).position);
                if let Some(at_m) = light.crossing(self, here, next).map(|share| s_m + share * step_m)
                    && self.takes(light, route, at_m)
                {
                    if speed_mps * speed_mps <= 2.0 * braking * (at_m - front_m) {
                        nearest = Some(nearest.map_or(at_m, |other_m| other_m.min(at_m)));
                    }
                    break;
                }
                s_m += 1.0;
            }
        }
        nearest
    }

    /// Whether a route follows the lane of a light behind its stop line, at `s_m`.
    fn takes(&self, light: &Light, route: &Polyline, s_m: Real) -> bool {
        let line = &self.lanes[light.lane as usize].centreline;
        let mut along_m = 0.0;
        let end = line.windows(2).find_map(|pair| {
            along_m += (pair[1] - pair[0]).norm();
            (along_m >= ALONG_M).then_some(pair[1])
        });
        let end = end.unwrap_or(line[line.len() - 1]);
        let to = route.at(s_m + along_m.min(ALONG_M)).position;
        let place = route.at(s_m + (end - route.at(s_m).position).norm()).position;
        (place - end).norm().min((to - end).norm()) <= APART_M
    }
}
