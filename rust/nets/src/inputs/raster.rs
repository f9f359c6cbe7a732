//! Agent-centred map rasters, cut from a bitmap of the scene that is drawn once (reference.md#rasters).
//!
//! Layers: drivable area, lines between lanes and directions, pedestrian areas; then, if asked for, cosine and sine of
//! the lane direction against the agent's heading. Bytes code numbers in [-1, 1] as 128 + 127 v; the network decodes
//! them with (byte - 128) / 127. Outside of the bitmap everything is 0.
//!
//! Differs from the released code: history pixels of others are drawn for neighbours in G alone, so that G = identity
//! hides the others from this input too; dropping G is then a clamp of these channels at 0.

use crate::config::{MapConfig, MapEncoder};
use crate::error::Result;
use crate::inputs::features::scene::SceneFeatures;
use crate::inputs::features::window::Window;
use crate::inputs::segments;
use crate::kernels::{self, Checked};
use ccdiff_sim::geom::{Point2, Polygon, Pose2};
use ccdiff_sim::observe::Segment;
use ccdiff_sim::scene::{Map, Scene};

/// Byte of the number 0.
pub const ZERO: u8 = 128;
const ONE: u8 = 255;
const MINUS_ONE: u8 = 1;

const DRIVABLE: u8 = 1;
const DIVIDER: u8 = 2;
const PEDESTRIAN: u8 = 4;
/// The layers of each set of flags.
static LAYERS: [[u8; 3]; 8] = {
    let mut layers = [[ZERO; 3]; 8];
    let mut flags = 0;
    while flags < 8 {
        let mut layer = 0;
        while layer < 3 {
            if flags >> layer & 1 == 1 {
                layers[flags][layer] = ONE;
            }
            layer += 1;
        }
        flags += 1;
    }
    layers
};
/// Most pixels of a bitmap, 2^27: 11 km square at 1 px/m. They take two bytes each.
const MOST_PX: f64 = 134_217_728.0;
/// Half the width of the painted lane direction, metres.
const LANE_HALF_WIDTH_M: f32 = 1.5;

/// Beyond the logged positions a map is taken to reach at least so far, metres: a vehicle that only leaves its road
/// sideways does not leave the map.
const LOG_MARGIN_M: f32 = 10.0;

/// Corners of the box of all that a map holds but its lanes, which loaders do not cut; `None` without any.
fn extent(map: &Map) -> Option<[Point2; 2]> {
    let areas = [&map.drivable_area, &map.ped_crossings, &map.walkways, &map.carpark_areas];
    let lines = map.road_dividers.iter().chain(&map.lane_dividers).flatten();
    let points = areas.into_iter().flatten().flat_map(|p| &p.exterior).chain(lines);
    points.fold(None, |found, p| {
        let [low, high] = found.unwrap_or([*p; 2]);
        Some([Point2::new(low.x.min(p.x), low.y.min(p.y)), Point2::new(high.x.max(p.x), high.y.max(p.y))])
    })
}

/// The map round a scene as bits and lane directions, one byte each per pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct MapBitmap {
    min: Point2,
    px_per_m: f32,
    width: usize,
    height: usize,
    /// Flags of the layers and, of a lane, 1 + 254 × (direction / 2π), else 0.
    pixels: Vec<[u8; 2]>,
    /// Corners of the part that has a map.
    known: [Point2; 2],
    /// Lines of the map, in place of pixels, for an encoder of polylines.
    segments: Vec<Segment>,
}

impl MapBitmap {
    /// Draws the map over the box of all logged positions, grown by the raster's reach and 50 m. The part that has a map
    /// ends where its areas and lines end, a loader's crop included, but no nearer than [`LOG_MARGIN_M`] to that box.
    ///
    /// # Errors
    /// [`SimError::Scene`] where that box has more than [`MOST_PX`] pixels.
    pub fn from_scene(scene: &Scene, config: &MapConfig) -> Result<Self> {
        let (log, margin, [width, height]) = Self::frame(scene, config)?;
        let [min, max] = log;
        let near = |low: f32, high: f32, from: f32, to: f32| {
            [low.min(from - LOG_MARGIN_M), high.max(to + LOG_MARGIN_M)]
        };
        let known = extent(&scene.map).map(|[low, high]| {
            let (x, y) = (near(low.x, high.x, min.x, max.x), near(low.y, high.y, min.y, max.y));
            [Point2::new(x[0], y[0]), Point2::new(x[1], y[1])]
        });
        let first = Point2::new(min.x - margin, min.y - margin);
        let nothing = Map::default();
        let (drawn, segments) = match config.encoder {
            MapEncoder::Polylines => (&nothing, segments::of_map(&scene.map)),
            MapEncoder::ResNet18 | MapEncoder::Light => (scene.map.as_ref(), Vec::new()),
        };
        let bitmap = Self::draw(drawn, first, config.bitmap_px_per_m, width, height);
        Ok(Self { known: known.unwrap_or(bitmap.known), segments, ..bitmap })
    }

    /// Corners of the box of all logged positions, how far the bitmap reaches beyond it, and its width and height.
    ///
    /// # Errors
    /// As [`Self::from_scene`].
    pub fn frame(scene: &Scene, config: &MapConfig) -> Result<([Point2; 2], f32, [usize; 2])> {
        let margin = config.reach_m() + 50.0;
        let valid = scene.tracks.position.iter().zip(&scene.tracks.valid).filter(|(_, ok)| **ok);
        let (mut min, mut max) = (Point2::new(f32::MAX, f32::MAX), Point2::new(f32::MIN, f32::MIN));
        for (p, _) in valid {
            (min.x, min.y) = (min.x.min(p.x), min.y.min(p.y));
            (max.x, max.y) = (max.x.max(p.x), max.y.max(p.y));
        }
        if min.x > max.x {
            (min, max) = (Point2::origin(), Point2::origin());
        }
        let px = |a: f32, b: f32| ((b - a + 2.0 * margin) * config.bitmap_px_per_m).ceil();
        let [width, height] = [px(min.x, max.x), px(min.y, max.y)];
        let fits = f64::from(width) * f64::from(height) <= MOST_PX;
        if !fits {
            return Err(ccdiff_sim::SimError::Scene {
                scene: scene.name.clone(),
                field: "tracks".into(),
                got: format!("{width:.0} x {height:.0} pixels of the network's map"),
                expected: "at most 2^27 pixels: agents far from each other cannot be planned for".into(),
            }
            .into());
        }
        Ok(([min, max], margin, [width as usize + 1, height as usize + 1]))
    }

    /// Draws a map into `width` x `height` pixels whose first corner is `min`.
    pub fn draw(map: &Map, min: Point2, px_per_m: f32, width: usize, height: usize) -> Self {
        let whole = [Point2::new(f32::MIN, f32::MIN), Point2::new(f32::MAX, f32::MAX)];
        let mut bitmap = Self {
            known: whole,
            min,
            px_per_m,
            width,
            height,
            pixels: vec![[0; 2]; width * height],
            segments: Vec::new(),
        };
        for polygon in &map.drivable_area {
            bitmap.fill(polygon, DRIVABLE);
        }
        for polygon in map.ped_crossings.iter().chain(&map.walkways) {
            bitmap.fill(polygon, PEDESTRIAN);
        }
        for line in map.road_dividers.iter().chain(&map.lane_dividers) {
            bitmap.stroke(line, 0.0, |b, at, _| b.pixels[at][0] |= DIVIDER);
        }
        for lane in &map.lanes {
            bitmap.stroke(&lane.centreline, LANE_HALF_WIDTH_M, |b, at, code| b.pixels[at][1] = code);
        }
        bitmap
    }

    fn to_px(&self, p: Point2) -> (f32, f32) {
        ((p.x - self.min.x) * self.px_per_m, (p.y - self.min.y) * self.px_per_m)
    }

    fn index(&self, x: f32, y: f32) -> Option<usize> {
        (x >= 0.0 && y >= 0.0 && x < self.width as f32 && y < self.height as f32)
            .then(|| y as usize * self.width + x as usize)
    }

    /// Sets a flag at every pixel whose centre lies in the polygon (even-odd over all rings).
    fn fill(&mut self, polygon: &Polygon, flag: u8) {
        let rings: Vec<Vec<(f32, f32)>> = std::iter::once(&polygon.exterior)
            .chain(&polygon.holes)
            .map(|ring| ring.iter().map(|p| self.to_px(*p)).collect())
            .collect();
        let Some(outer) = rings.first() else { return };
        let low = outer.iter().fold(f32::MAX, |m, p| m.min(p.1)).max(0.0) as usize;
        let high = outer.iter().fold(0.0f32, |m, p| m.max(p.1)).min(self.height as f32 - 1.0).max(0.0);
        let mut crossings: Vec<f32> = Vec::new();
        for row in low..=high as usize {
            let y = row as f32 + 0.5;
            crossings.clear();
            for ring in rings.iter().filter(|r| r.len() > 2) {
                for (k, a) in ring.iter().enumerate() {
                    let b = ring[(k + 1) % ring.len()];
                    if (a.1 > y) != (b.1 > y) {
                        crossings.push(a.0 + (y - a.1) / (b.1 - a.1) * (b.0 - a.0));
                    }
                }
            }
            crossings.sort_by(f32::total_cmp);
            for span in crossings.chunks_exact(2) {
                let from = (span[0] - 0.5).ceil().max(0.0) as usize;
                let to = (span[1] - 0.5).floor().min(self.width as f32 - 1.0);
                if to >= 0.0 {
                    for col in from..=(to as usize) {
                        self.pixels[row * self.width + col][0] |= flag;
                    }
                }
            }
        }
    }

    /// Visits the pixels within `half_width_m` of a line, in steps of half a pixel, with its direction code.
    fn stroke(&mut self, line: &[Point2], half_width_m: f32, paint: impl Fn(&mut Self, usize, u8)) {
        let across = (half_width_m * self.px_per_m * 2.0) as i32;
        for ends in line.windows(2) {
            let ((x0, y0), (x1, y1)) = (self.to_px(ends[0]), self.to_px(ends[1]));
            let (dx, dy) = (x1 - x0, y1 - y0);
            let length = (dx * dx + dy * dy).sqrt();
            if length < 1e-6 {
                continue;
            }
            let (ux, uy) = (dx / length, dy / length);
            let turn = libm::atan2f(dy, dx).rem_euclid(std::f32::consts::TAU) / std::f32::consts::TAU;
            let code = 1 + ((turn * 254.0) as u8).min(253);
            for along in 0..=(length * 2.0) as i32 {
                let s = (along as f32 * 0.5).min(length);
                for side in -across..=across {
                    let o = side as f32 * 0.5;
                    if let Some(at) = self.index(x0 + s * ux - o * uy, y0 + s * uy + o * ux) {
                        paint(self, at, code);
                    }
                }
            }
        }
    }

    /// Lines of the map; none for an encoder of rasters.
    pub(crate) fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// Whether a point lies where there is a map: on the bitmap, and within the edge of the map.
    pub fn covers(&self, point: Point2) -> bool {
        let ((x, y), [low, high]) = (self.to_px(point), self.known);
        let within = low.x <= point.x && point.x <= high.x && low.y <= point.y && point.y <= high.y;
        within && self.index(x, y).is_some()
    }

    /// Cuts the layers round a pose into the last channels of `out` [size, size, channels].
    pub fn crop_into(&self, pose: &Pose2, config: &MapConfig, out: &mut [u8]) {
        let size = config.size_px;
        let channels = out.len() / (size * size);
        let first = channels - config.num_layers();
        let step = config.metres_per_px * self.px_per_m;
        // steps in bitmap pixels along a column (agent x) and along a row (agent y)
        let (cx, cy, rx, ry) = (pose.cos * step, pose.sin * step, -pose.sin * step, pose.cos * step);
        let (x0, y0) = self.to_px(pose.position);
        let turn = libm::atan2f(pose.sin, pose.cos);
        // most directions do not occur
        let mut directions: [Option<[u8; 2]>; 256] = [None; 256];
        directions[0] = Some([ZERO; 2]);
        let direction_of = |code: u8| {
            let angle = (f32::from(code) - 0.5) / 254.0 * std::f32::consts::TAU;
            let (s, c) = libm::sincosf(angle - turn);
            [c, s].map(|v| (128.0 + 127.0 * v) as u8)
        };
        let (start, size_px) = ([x0, y0], [self.width as u32, self.height as u32]);
        let (agent, mut places) = (config.agent_column_px as f32, vec![0; size]);
        for (row, line) in out.chunks_exact_mut(size * channels).enumerate() {
            let down = row as f32 - (size / 2) as f32 + 0.5;
            let by = [down * rx, down * ry];
            kernels::pixels_under(Checked::now(), start, agent, [cx, cy], by, size_px, &mut places);
            for (place, pixel) in places.iter().zip(line.chunks_exact_mut(channels)) {
                let Some([flags, code]) = self.pixels.get(*place as usize) else { continue };
                pixel[first..first + 3].copy_from_slice(&LAYERS[usize::from(*flags)]);
                if config.lane_direction {
                    let direction = directions[usize::from(*code)].get_or_insert_with(|| direction_of(*code));
                    pixel[first + 3..first + 5].copy_from_slice(direction);
                }
            }
        }
    }
}

/// Rasters of all agents of a scene, [M, size, size, channels]: history channels first, then the map's layers.
pub(crate) fn images(
    features: &SceneFeatures,
    window: &Window,
    bitmap: Option<&MapBitmap>,
    config: &MapConfig,
) -> Vec<u8> {
    let per_agent = config.size_px * config.size_px * config.num_channels(window.num_steps);
    let mut images = vec![ZERO; features.agents.len() * per_agent];
    for (row, image) in images.chunks_exact_mut(per_agent).enumerate() {
        if config.history_channels {
            draw_histories(features, window, row, config, image);
        }
        if let Some(bitmap) = bitmap {
            bitmap.crop_into(&features.poses[row], config, image);
        }
    }
    images
}

/// One pixel per agent and history step: the row's own +1, its neighbours' in G -1.
fn draw_histories(
    features: &SceneFeatures,
    window: &Window,
    row: usize,
    config: &MapConfig,
    image: &mut [u8],
) {
    let (size, slots) = (config.size_px, features.num_slots);
    let channels = config.num_channels(window.num_steps);
    let frame = &features.poses[row];
    for slot in (0..slots).rev() {
        let at = row * slots + slot;
        if slot > 0 && !features.is_edge[at] {
            continue;
        }
        let agent = features.agents[features.neighbours[at]];
        for step in 0..window.num_steps {
            if !window.valid[agent * window.num_steps + step] {
                continue;
            }
            let local = frame.to_local(window.pose(agent, step).position);
            let col = local.x / config.metres_per_px + config.agent_column_px as f32;
            let line = local.y / config.metres_per_px + (size / 2) as f32;
            if col >= 0.0 && line >= 0.0 && col < size as f32 && line < size as f32 {
                image[(line as usize * size + col as usize) * channels + step] =
                    if slot == 0 { ONE } else { MINUS_ONE };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ModelConfig;
    use ccdiff_sim::scene::{Lane, LaneKind};

    fn square(x0: f32, y0: f32, x1: f32, y1: f32) -> Vec<Point2> {
        vec![Point2::new(x0, y0), Point2::new(x1, y0), Point2::new(x1, y1), Point2::new(x0, y1)]
    }

    fn bitmap() -> MapBitmap {
        let map = Map {
            drivable_area: vec![Polygon {
                exterior: square(0.0, 0.0, 100.0, 20.0),
                holes: vec![square(40.0, 5.0, 50.0, 15.0)],
            }],
            lane_dividers: vec![vec![Point2::new(0.0, 10.0), Point2::new(30.0, 10.0)]],
            lanes: vec![Lane {
                id: "lane".into(),
                kind: LaneKind::Lane,
                centreline: vec![Point2::new(0.0, 3.0), Point2::new(100.0, 3.0)],
                polygon: Polygon::default(),
                successors: Vec::new(),
                predecessors: Vec::new(),
                speed_limit_mps: None,
                elevation_m: Vec::new(),
            }],
            ..Map::default()
        };
        MapBitmap::draw(&map, Point2::new(-20.0, -40.0), 1.0, 160, 100)
    }

    #[test]
    fn a_crop_shows_what_lies_ahead_in_the_agents_own_frame() {
        let bitmap = bitmap();
        let config = ModelConfig::fast().map.unwrap();
        let size = config.size_px;
        let mut out = vec![ZERO; 5 * size * size];
        // on the road's west part, facing north: the road's far edge is 17 m ahead
        bitmap.crop_into(&Pose2::new(20.0, 3.0, std::f32::consts::FRAC_PI_2), &config, &mut out);
        let at = |layer: usize, ahead: f32, left: f32| {
            let col = (ahead + config.agent_column_px as f32) as usize;
            out[((left + size as f32 / 2.0) as usize * size + col) * 5 + layer]
        };
        assert_eq!((at(0, 15.5, 0.5), at(0, 18.5, 0.5), at(0, -4.5, 0.5)), (ONE, ZERO, ZERO));
        // the hole is 20 to 30 m to the right (east), 2 to 12 m ahead
        assert_eq!((at(0, 6.5, -25.5), at(0, 6.5, -15.5)), (ZERO, ONE));
        assert_eq!(at(1, 7.4, 5.5), ONE);
        // the lane runs east: to the right of the agent, so its direction is -90 degrees
        let (cos, sin) = (i32::from(at(3, 0.5, 0.5)) - 128, i32::from(at(4, 0.5, 0.5)) - 128);
        assert!(cos.abs() < 6 && sin < -120, "{cos} {sin}");
    }

    #[test]
    fn a_pose_off_the_bitmap_sees_nothing() {
        let config = ModelConfig::fast().map.unwrap();
        let mut out = vec![ZERO; 5 * 64 * 64];
        bitmap().crop_into(&Pose2::new(1e5, -1e5, 1.0), &config, &mut out);
        assert!(out.iter().all(|v| *v == ZERO));
    }
}
