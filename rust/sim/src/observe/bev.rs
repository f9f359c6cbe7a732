//! A bird's-eye raster round the observing agent: bytes [channels, S, S], ahead is up.
//!
//! What does not move (drivable area, lines) is drawn once per scene into a bitmap with two pixels to one of the
//! raster, and cut out of it turned; the rest is drawn for each raster.

use super::view::View;
use crate::geom::{Bitmap, Point2, Pose2, Real, bounds, visit_band};
use crate::options;
use crate::options::within;
use crate::scene::{AgentKind, LightState, Map};
use serde::Serialize;

options! {
    /// Choice of the bird's-eye raster, uint8 [channels, S, S].
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct BevConfig {
        /// Rows and columns S.
        size_px: usize = 84, range within(8.0, 1024.0);
        /// Side of a pixel.
        metres_per_px: Real = 0.6, unit "m", range within(0.05, 10.0);
        /// Whether there is a channel of traffic lights.
        lights: bool = false;
    }
}

/// A channel of the raster.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BevChannel {
    /// Name.
    pub name: &'static str,
    /// What its bytes mean; 0 is nothing.
    pub doc: &'static str,
}

const fn channel(name: &'static str, doc: &'static str) -> BevChannel {
    BevChannel { name, doc }
}

/// The channels in order; the last one on request.
pub const BEV_CHANNELS: [BevChannel; 6] = [
    channel("drivable", "255: drivable area (of the lanes where the map has none)"),
    channel("lines", "255: dividers; 128: centre lines of lanes and connectors"),
    channel("route", "the way ahead; 255 up to the goal, 128 beyond"),
    channel(
        "agents",
        "boxes of others; 255: vehicles, motorcycles; 170: pedestrians, cyclists; 85: obstacles",
    ),
    channel("ego", "255: box of the observing agent"),
    channel("lights", "with `lights`, stop lines; 255: red, 170: yellow, 85: green"),
];

/// Share of the rows that lies behind the observing agent's centre.
const BEHIND_SHARE: Real = 0.25;
/// Flags of the bitmap of a scene.
const DRIVABLE: u8 = 1;
const LANE: u8 = 2;
const DIVIDER: u8 = 4;
/// Byte of the channel of lines for the flags [`LANE`] and [`DIVIDER`], in units of the first.
const LINES: [u8; 4] = [0, 128, 255, 255];
/// Half the width of the route, metres.
const ROUTE_HALF_WIDTH_M: Real = 1.0;

impl BevConfig {
    /// The channels that are asked for.
    pub fn channels(&self) -> &'static [BevChannel] {
        &BEV_CHANNELS[..BEV_CHANNELS.len() - usize::from(!self.lights)]
    }

    /// What does not move on a map; of lanes what is on the level of an elevation.
    pub(crate) fn ground(&self, map: &Map, elevation_m: Option<Real>) -> Bitmap {
        let areas = map.road();
        let dividers = || map.road_dividers.iter().chain(&map.lane_dividers).map(Vec::as_slice);
        let centrelines =
            || map.lanes.iter().flat_map(|l| l.on_level(elevation_m).map(|run| &l.centreline[run]));
        let points = areas.iter().flat_map(|p| &p.exterior).chain(dividers().chain(centrelines()).flatten());
        let (min, max) = bounds(points.copied()).unwrap_or((Point2::origin(), Point2::origin()));
        let mut ground = Bitmap::new(min, max, 2.0 / self.metres_per_px);
        areas.iter().for_each(|area| ground.fill(area, DRIVABLE));
        // no sample of the raster falls between two sides of a line
        let half_width_m = (0.5 * self.metres_per_px).max(1.0 / ground.px_per_m());
        centrelines().for_each(|line| ground.stroke(line, half_width_m, LANE));
        dividers().for_each(|line| ground.stroke(line, half_width_m, DIVIDER));
        ground
    }

    /// Row of the observing agent's centre, in pixels from the top.
    fn ego_row(&self) -> Real {
        self.size_px as Real * (1.0 - BEHIND_SHARE)
    }

    /// Column and row of a point in the frame of the observing agent.
    fn to_px(self, local: Point2) -> [Real; 2] {
        [
            0.5 * self.size_px as Real - local.y / self.metres_per_px,
            self.ego_row() - local.x / self.metres_per_px,
        ]
    }

    /// Draws the raster of one agent [channels, S, S].
    pub(crate) fn draw(&self, view: &View<'_>, ground: &Bitmap, out: &mut [u8]) {
        let frame = view.states.pose(view.agent_idx);
        let plane = self.size_px * self.size_px;
        let (drivable, out) = out.split_at_mut(plane);
        let (lines, out) = out.split_at_mut(plane);
        self.cut(&frame, ground, drivable, lines);
        out.fill(0);
        let (route, out) = out.split_at_mut(plane);
        self.draw_route(view, &frame, route);
        let (agents, out) = out.split_at_mut(plane);
        let (ego, lights) = out.split_at_mut(plane);
        if self.lights {
            self.draw_lights(view, &frame, lights);
        }
        let is_seen = |j: &usize| {
            *j != view.agent_idx && view.states.active[*j] && view.states.same_level(view.agent_idx, *j)
        };
        for j in (0..view.states.len()).filter(is_seen) {
            self.draw_box(view, &frame, j, agents);
        }
        self.draw_box(view, &frame, view.agent_idx, ego);
    }

    /// Cuts the channels that do not move out of the ground.
    fn cut(&self, frame: &Pose2, ground: &Bitmap, drivable: &mut [u8], lines: &mut [u8]) {
        let step = self.metres_per_px * ground.px_per_m();
        let (cos, sin) = (frame.cos * step, frame.sin * step);
        let [x0, y0] = ground.to_px(frame.position);
        let rows = drivable.chunks_exact_mut(self.size_px).zip(lines.chunks_exact_mut(self.size_px));
        for (row, (drivable, lines)) in rows.enumerate() {
            let ahead = self.ego_row() - row as Real - 0.5;
            let (x, y) = (x0 + ahead * cos, y0 + ahead * sin);
            for (column, (drivable, line)) in drivable.iter_mut().zip(lines).enumerate() {
                let left = 0.5 * self.size_px as Real - column as Real - 0.5;
                let flags = ground.at_px(x - left * sin, y + left * cos);
                *drivable = if flags & DRIVABLE == 0 { 0 } else { 255 };
                *line = LINES[usize::from((flags & (LANE | DIVIDER)) / LANE)];
            }
        }
    }

    fn draw_route(&self, view: &View<'_>, frame: &Pose2, out: &mut [u8]) {
        let goal_s = view.route_s_m + view.facts.route_remaining_m;
        let reach_m = 2.0 * self.size_px as Real * self.metres_per_px;
        let half_width = (ROUTE_HALF_WIDTH_M / self.metres_per_px).max(0.5);
        let points = view.route.points().iter().zip(view.route.arc_lengths_m());
        let mut from = view.route.at(view.route_s_m).position;
        for (to, s) in points.skip_while(|(_, s)| **s <= view.route_s_m) {
            if *s > view.route_s_m + reach_m {
                break;
            }
            self.draw_band(frame, [from, *to], half_width, if *s <= goal_s + 0.5 { 255 } else { 128 }, out);
            from = *to;
        }
    }

    fn draw_lights(&self, view: &View<'_>, frame: &Pose2, out: &mut [u8]) {
        let elevation_m = view.states.elevation_m(view.agent_idx);
        for light in view.map.lights.iter().filter(|l| l.is_on_level(view.map, elevation_m)) {
            let byte = match light.state(view.step_idx) {
                LightState::Red => 255,
                LightState::Yellow => 170,
                LightState::Green => 85,
                LightState::Unknown => continue,
            };
            self.draw_band(frame, light.stop_line, 0.5, byte, out);
        }
    }

    /// Raises what a band round a segment covers to a byte; half its width in pixels.
    fn draw_band(&self, frame: &Pose2, ends: [Point2; 2], half_width: Real, byte: u8, out: &mut [u8]) {
        let [a, b] = ends.map(|p| self.to_px(frame.to_local(p)));
        visit_band(a, b, half_width, [self.size_px as Real; 2], |x, y| {
            let at = y as usize * self.size_px + x as usize;
            out[at] = out[at].max(byte);
        });
    }

    /// Draws the box of an agent, a pixel wide at least.
    fn draw_box(&self, view: &View<'_>, frame: &Pose2, agent_idx: usize, out: &mut [u8]) {
        let byte = match view.kinds[agent_idx] {
            _ if agent_idx == view.agent_idx => 255,
            AgentKind::Vehicle | AgentKind::Motorcycle => 255,
            AgentKind::Pedestrian | AgentKind::Cyclist => 170,
            AgentKind::Static => 85,
        };
        let (pose, footprint) = (view.states.pose(agent_idx), &view.footprints[agent_idx]);
        let size = self.size_px as Real;
        let [u, v] = self.to_px(frame.to_local(pose.position));
        let px = |metres: Real| (metres / self.metres_per_px).max(0.5);
        let (half_length, half_width) = (px(footprint.half_length_m), px(footprint.half_width_m));
        // the heading in columns and rows
        let cos = pose.cos * frame.cos + pose.sin * frame.sin;
        let sin = pose.sin * frame.cos - pose.cos * frame.sin;
        let (hu, hv) = (-sin, -cos);
        let reach_u = half_length * hu.abs() + half_width * hv.abs();
        let reach_v = half_length * hv.abs() + half_width * hu.abs();
        if u + reach_u < 0.0 || v + reach_v < 0.0 || u - reach_u >= size || v - reach_v >= size {
            return;
        }
        let span = |middle: Real, reach: Real| {
            let last = ((middle + reach) as usize).min(self.size_px - 1);
            (middle - reach) as usize..last + 1
        };
        for row in span(v, reach_v) {
            for column in span(u, reach_u) {
                let (du, dv) = (column as Real + 0.5 - u, row as Real + 0.5 - v);
                if (du * hu + dv * hv).abs() <= half_length && (dv * hu - du * hv).abs() <= half_width {
                    out[row * self.size_px + column] = byte;
                }
            }
        }
        // what is small may hold no centre of a pixel
        if u >= 0.0 && v >= 0.0 && u < size && v < size {
            out[v as usize * self.size_px + u as usize] = byte;
        }
    }
}
