//! PDM-Closed: proposals along the centre line are rolled out and scored, and the best one's first action is driven.
//!
//! Dauner, Hallgarten, Geiger, Chitta: "Parting with Misconceptions about Learning-based Vehicle Motion Planning", CoRL 2023.

mod comfort;
mod forecast;
mod proposals;
mod score;
#[cfg(test)]
mod tests;

use crate::dynamics::{KinState, UnicycleLimits};
use crate::geom::{Point2, Projection, Real, Vector2, math};
use crate::stage::{CentreLine, Ground, PreparedScene};
use crate::state::{AgentStates, Footprint};
use forecast::Forecast;
use proposals::{BesideLine, near, roll};

pub(crate) use proposals::steering;

/// Braking with which it stops for a red and for a yellow light, m/s².
const BRAKING_MPS2: [Real; 2] = [8.0, 2.0];
/// How far before a stop line it wants to stand beside the gap that it keeps: the tracker overshoots, metres.
const BEFORE_LINE_M: Real = 1.0;

/// What is known of one world.
pub(crate) struct Scene<'a> {
    pub prepared: &'a PreparedScene,
    pub states: &'a AgentStates,
    pub ego: usize,
    pub dt_s: Real,
    /// Limit of the world, m/s.
    pub speed_limit_mps: Real,
    pub line: &'a CentreLine,
    /// Where the ego is beside the line.
    pub place: Projection,
    /// Where along the line its front waits for a light.
    pub stop_m: Option<Real>,
}

impl<'a> Scene<'a> {
    pub(crate) fn new(
        prepared: &'a PreparedScene,
        states: &'a AgentStates,
        ego: usize,
        dt_s: Real,
        speed_limit_mps: Real,
        step_idx: usize,
    ) -> Self {
        let line = prepared.centre_line(ego);
        let place = line.project(states.position(ego), None);
        let front_m = place.s_m + prepared.footprints[ego].half_length_m;
        let speed = states.speed_mps[ego].max(0.0);
        let map = &prepared.scene.map;
        let stop_m = map.waits_at(&line.lights, front_m, speed, step_idx, BRAKING_MPS2);
        Self { prepared, states, ego, dt_s, speed_limit_mps, line, place, stop_m }
    }

    /// The nearer one of a leader, gap and speed, and the stop line at which a front waits.
    fn held(&self, leader: Option<(Real, Real)>, front_m: Real) -> Option<(Real, Real)> {
        let stop = self.stop_m.map(|at_m| (at_m - BEFORE_LINE_M - front_m, 0.0));
        let nearer = |a: (Real, Real), b: (Real, Real)| if b.0 < a.0 { b } else { a };
        leader.map(|leader| stop.map_or(leader, |stop| nearer(leader, stop))).or(stop)
    }

    /// Yaw rate of the ego now on its way to a distance from the centre line.
    pub(crate) fn yaw_rate(&self, offset_m: Real) -> Real {
        let state = self.present();
        let before_radps = self.states.yaw_rate_radps[self.ego];
        let near = near(self.line, self.place.s_m);
        let beside = BesideLine::new(near, &state, self.heading(), math::turned);
        beside.yaw_rate(&UnicycleLimits::default(), state.speed_mps, offset_m, before_radps, self.dt_s)
    }

    /// The ground of the ego's road where it passes a place.
    pub(crate) fn ground(&self, place: Point2) -> &Ground {
        let route = &self.prepared.routes[self.ego];
        let elevation_m = self.states.elevation_m(self.ego).and_then(|own_m| {
            let there = route.height(route.path.project(place).s_m);
            there.map_or(Some(own_m), |there| Some(there.elevation_m))
        });
        self.prepared.at(elevation_m)
    }

    pub(crate) fn footprint(&self, agent_idx: usize) -> &Footprint {
        &self.prepared.footprints[agent_idx]
    }

    /// Cosine and sine of the ego's heading now.
    fn heading(&self) -> Vector2 {
        Vector2::new(self.states.cos[self.ego], self.states.sin[self.ego])
    }

    /// State of the unicycle at the ego's present.
    pub(crate) fn present(&self) -> KinState {
        let mut state = self.states.kin_state(self.ego);
        state.speed_mps = state.speed_mps.max(0.0);
        state
    }
}

/// What the best proposal does.
#[derive(Debug)]
pub(crate) struct Plan {
    /// Distance from the centre line, left positive, metres.
    pub offset_m: Real,
    /// Acceleration now, m/s².
    pub acceleration_mps2: Real,
}

/// The plan of the best proposal.
pub(crate) fn plan(scene: &Scene<'_>) -> Plan {
    let forecast = Forecast::new(scene);
    score::best(scene, &forecast, &roll(scene, &forecast))
}
