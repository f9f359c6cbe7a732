//! What the numbers of a row are taken from: one kind of source for each part of the row.

use super::column::{Axis, clip};
use super::map_segments::SegmentKind;
use super::view::View;
use crate::events::{ANTICIPATION_S, Leader, leader};
use crate::geom::{Projection, Real, Vector2, math};
use crate::scene::{AgentKind, LightState};
use crate::state::{AgentStates, Footprint};
use std::cell::OnceCell;

pub(super) struct Ego<'a> {
    pub(super) view: &'a View<'a>,
    leader: OnceCell<Option<Leader>>,
    route_turn: OnceCell<(Real, Real)>,
    light: OnceCell<Option<NextLight>>,
}

/// How far the end of the road is looked for, metres.
pub(super) const ROAD_REACH_M: Real = 20.0;

/// The next light along the observer's route.
#[derive(Debug, Clone, Copy)]
pub(super) struct NextLight {
    pub(super) state: LightState,
    /// From the front to the stop line, metres.
    pub(super) gap_m: Real,
    /// Since its last change, or the begin of the log, seconds.
    pub(super) since_s: Real,
}

/// A number about the observing agent.
pub(super) type OfEgo = fn(&Ego<'_>) -> Real;

impl<'a> Ego<'a> {
    pub(super) fn new(view: &'a View<'a>) -> Self {
        Self { view, leader: OnceCell::new(), route_turn: OnceCell::new(), light: OnceCell::new() }
    }

    /// The agent's number in one of the arrays of the states.
    pub(super) fn state(&self, of: impl Fn(&AgentStates) -> &[Real]) -> Real {
        of(self.view.states)[self.view.agent_idx]
    }

    pub(super) fn footprint(&self) -> &Footprint {
        &self.view.footprints[self.view.agent_idx]
    }

    /// Sine and cosine of its heading against the route.
    pub(super) fn route_turn(&self) -> (Real, Real) {
        *self.route_turn.get_or_init(|| math::sin_cos(self.view.facts.place.heading_error_rad))
    }

    pub(super) fn light(&self) -> Option<NextLight> {
        let v = self.view;
        let find = || {
            let front_m = v.route_s_m + self.footprint().half_length_m;
            let next = v.lights.iter().find(|l| l.at_m > front_m)?;
            let light = &v.map.lights[next.light as usize];
            let since_s = light.steps_since_change(v.step_idx) as Real * v.dt_s;
            Some(NextLight { state: light.state(v.step_idx), gap_m: next.at_m - front_m, since_s })
        };
        *self.light.get_or_init(find)
    }

    /// Way from the centre to the end of the drivable area, metres, at a bearing from the heading, radians, to an
    /// eighth of a metre; gaps of less than a metre count as road. [`ROAD_REACH_M`] at most, and where the map has no road.
    pub(super) fn road_m(&self, bearing_rad: Real) -> Real {
        let (states, a) = (self.view.states, self.view.agent_idx);
        let Some(road) = self.view.road else { return ROAD_REACH_M };
        let (sin, cos) = math::sin_cos(bearing_rad);
        let (x, y) = (states.cos[a], states.sin[a]);
        let way = Vector2::new(x * cos - y * sin, y * cos + x * sin);
        let is_road = |m: Real| road.contains(states.position(a) + way * m);
        let mut free = (0..=ROAD_REACH_M as usize).take_while(|m| is_road(*m as Real)).count() as Real - 1.0;
        if (0.0..ROAD_REACH_M).contains(&free) {
            for half in [0.5, 0.25, 0.125] {
                free += if is_road(free + half) { half } else { 0.0 };
            }
        }
        free.max(0.0)
    }

    /// 1 where the next light shows a state.
    pub(super) fn shows(&self, state: LightState) -> Real {
        Real::from(self.light().is_some_and(|l| l.state == state))
    }

    pub(super) fn leader(&self) -> Option<Leader> {
        let v = self.view;
        let find = || leader(v.states, v.footprints, v.route, v.route_s_m, v.agent_idx, ANTICIPATION_S);
        *self.leader.get_or_init(find)
    }
}

/// Where a number about another agent comes from.
#[derive(Debug, Clone, Copy)]
pub(super) enum OfAgent {
    /// A component of its place, from the observer's.
    Place(Axis),
    Direction(Axis),
    /// A component of its velocity, less the observer's.
    Velocity(Axis),
    Speed,
    /// A number that stays what it is in a scene.
    Fixed(fn(&Footprint, AgentKind) -> Real),
    /// Any number of the agent and its observer: fills a column by [`Pairs::each`].
    Pair(fn(&Pairs<'_>, Target<'_>)),
    /// The same of the agent's place along the observer's route: fills a column by [`Pairs::each_on_route`].
    OnRoute(fn(&Pairs<'_>, Target<'_>)),
}

/// The agents that an observer sees, nearest first.
pub(super) struct Pairs<'a> {
    pub(super) view: &'a View<'a>,
    pub(super) agents: &'a [u32],
    /// Their places along the observer's route, where they are asked for.
    pub(super) on_route: &'a [Projection],
}

#[derive(Clone, Copy)]
pub(super) struct Pair<'a> {
    pub(super) view: &'a View<'a>,
    pub(super) other: usize,
}

/// A column in rows of numbers: value = clip(quantity · factor, low, high).
pub(super) struct Target<'a> {
    pub(super) rows: &'a mut [Real],
    pub(super) width: usize,
    pub(super) at: usize,
    pub(super) factor: Real,
    pub(super) low: Real,
    pub(super) high: Real,
}

impl<'a> Pairs<'a> {
    /// Fills a column with a number of each pair.
    #[inline(always)]
    pub(super) fn each(&self, to: Target<'_>, quantity: impl Fn(Pair<'a>) -> Real) {
        for (row, other) in to.rows.chunks_exact_mut(to.width).zip(self.agents) {
            let number = quantity(Pair { view: self.view, other: *other as usize });
            row[to.at] = clip(number * to.factor, to.low, to.high);
        }
    }

    /// The same of numbers of the agent's place along the route.
    #[inline(always)]
    pub(super) fn each_on_route(&self, to: Target<'_>, quantity: impl Fn(Pair<'a>, &Projection) -> Real) {
        let agents = self.agents.iter().zip(self.on_route);
        for (row, (other, place)) in to.rows.chunks_exact_mut(to.width).zip(agents) {
            let number = quantity(Pair { view: self.view, other: *other as usize }, place);
            row[to.at] = clip(number * to.factor, to.low, to.high);
        }
    }
}

impl Pair<'_> {
    #[inline(always)]
    pub(super) fn distance_m(&self) -> Real {
        (self.view.states.position(self.other) - self.view.states.position(self.view.agent_idx))
            .norm_squared()
            .sqrt()
    }

    #[inline(always)]
    pub(super) fn velocity(&self) -> Vector2 {
        self.view.states.velocity(self.other)
    }
}

/// Where a number about a segment of the map comes from.
#[derive(Debug, Clone, Copy)]
pub(super) enum OfSegment {
    /// A component of its middle.
    Place(Axis),
    Direction(Axis),
    HalfLength,
    /// 1 for segments of a kind.
    Is(SegmentKind),
}
