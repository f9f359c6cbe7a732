//! Traffic lights: the lane that each controls, the line where it is waited for, and its state at every step.

use super::road_area::HALF_LANE_M;
use super::{LEVEL_M, Map};
use crate::geom::{Point2, Polyline, Real, Vector2};
use crate::named::named;
use serde::{Deserialize, Serialize};

/// How far behind a stop line a route is compared with the controlled lane, and how far they may be apart, metres.
const ALONG_M: Real = 8.0;
const APART_M: Real = 1.75;

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

/// A light of a route: how far along it the stop line lies, metres, and which one of the map's lights it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightAlong {
    /// Place of the stop line.
    pub at_m: Real,
    /// Index into [`Map::lights`].
    pub light: u32,
}

impl Light {
    /// Whether its lane begins on the level of an elevation, metres; always where heights are not known.
    pub(crate) fn is_on_level(&self, map: &Map, elevation_m: Option<Real>) -> bool {
        let lane_m = map.lanes[self.lane as usize].elevation_m.first();
        elevation_m.zip(lane_m).is_none_or(|(own_m, lane_m)| (own_m - lane_m).abs() <= LEVEL_M)
    }

    /// Steps since it has shown what it shows at a step, or since the log began.
    pub(crate) fn steps_since_change(&self, step_idx: usize) -> usize {
        let shown = self.state(step_idx);
        (1..=step_idx).find(|k| self.state(step_idx - k) != shown).map_or(step_idx, |k| k - 1)
    }

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
    pub(crate) fn runs_red(
        &self,
        from: Point2,
        to: Point2,
        elevation_m: Option<Real>,
        step_idx: usize,
    ) -> bool {
        let mut states = self
            .lights
            .iter()
            .filter(|light| light.crossing(self, from, to).is_some() && light.is_on_level(self, elevation_m))
            .map(|light| light.state(step_idx) == LightState::Red)
            .peekable();
        states.peek().is_some() && states.all(|is_red| is_red)
    }

    /// The lights of a route, nearest first: those whose stop lines it passes and whose lanes it takes behind these.
    pub(crate) fn lights_along(&self, route: &Polyline) -> Vec<LightAlong> {
        let passes = |(light, of): (usize, &Light)| {
            let pieces = route.points().windows(2).zip(route.arc_lengths_m().windows(2));
            let places = pieces.filter_map(|(ends, s_m)| {
                let at_m = s_m[0] + of.crossing(self, ends[0], ends[1])? * (s_m[1] - s_m[0]);
                self.takes(of, route, at_m).then_some(LightAlong { at_m, light: light as u32 })
            });
            places.collect::<Vec<_>>()
        };
        let mut found: Vec<LightAlong> = self.lights.iter().enumerate().flat_map(passes).collect();
        found.sort_by(|a, b| a.at_m.total_cmp(&b.at_m));
        found
    }

    /// Where a front at `front_m` of a route waits: at the nearest stop line ahead whose light is red or yellow, if it can
    /// stop there with the braking for these, m/s².
    pub(crate) fn waits_at(
        &self,
        along: &[LightAlong],
        front_m: Real,
        speed_mps: Real,
        step_idx: usize,
        [red, yellow]: [Real; 2],
    ) -> Option<Real> {
        let end_m = (front_m + 20.0 + 4.0 * speed_mps).min(front_m + 70.0);
        let near = along.iter().filter(|l| l.at_m >= front_m).take_while(|l| l.at_m < end_m);
        let waits = |l: &&LightAlong| {
            let braking = match self.lights[l.light as usize].state(step_idx) {
                LightState::Red => red,
                LightState::Yellow => yellow,
                LightState::Green | LightState::Unknown => return false,
            };
            speed_mps * speed_mps <= 2.0 * braking * (l.at_m - front_m)
        };
        near.into_iter().find(waits).map(|l| l.at_m)
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
