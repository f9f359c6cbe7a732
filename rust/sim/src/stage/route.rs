//! The path an agent is meant to drive: its log, then the lanes ahead, else straight on.

use crate::geom::{Point2, Polyline, Pose2, Real};
use crate::scene::{AgentKind, LaneIndex, LightAlong, Map, Scene, follow};
use crate::state::Height;
use std::ops::Range;

/// Distance between samples of a route, metres.
const SPACING_M: Real = 1.0;
/// Slopes are taken over this to either side, metres.
const GRADE_M: Real = 5.0;
/// Logged positions closer than this to the last kept one are jitter, metres.
const MIN_STEP_M: Real = 0.5;
/// A vehicle backs up where it is logged farther than this behind where it was, metres: boxes jitter.
const BACK_M: Real = 1.0;
/// How far a route goes on past the end of the log, metres.
const EXTENSION_M: Real = 80.0;
/// Lateral acceleration at which curves are taken, m/s².
pub(super) const CURVE_MPS2: Real = 3.0;
/// Braking assumed ahead of a curve, m/s².
pub(super) const APPROACH_MPS2: Real = 2.0;
/// How far along the route an agent is looked for from where it was, metres: more where it moves far in a step.
const REACH_M: Real = 8.0;
/// A vehicle whose log never exceeds this speed is parked, m/s.
const PARKED_MPS: Real = 0.5;
/// So is one that is never logged farther than this from where it is logged first, metres: boxes jitter.
const PARKED_REACH_M: Real = 1.0;

/// An agent's path with the speed its curves allow.
#[derive(Debug, Clone)]
pub struct Route {
    /// The path, from the first logged position on, sampled about every metre.
    pub path: Polyline,
    /// Elevation at each metre; empty where the scene is flat.
    elevation_m: Vec<Real>,
    /// Greatest speed the curves at and ahead of each metre allow, m/s.
    curve_speed_mps: Vec<Real>,
    /// Greatest logged speed, m/s.
    pub logged_speed_mps: Real,
    /// Greatest logged distance from the first logged position, metres.
    logged_reach_m: Real,
    /// Steps of the log at which the vehicle backs up, or stands before it does.
    backs: Vec<Range<usize>>,
    /// Lights along the path, nearest first.
    pub lights: Vec<LightAlong>,
}

impl Route {
    /// Routes of all agents of a scene.
    pub fn of_all(scene: &Scene, lanes: Option<&LaneIndex>) -> Vec<Self> {
        (0..scene.num_agents()).map(|a| Self::new(scene, a, lanes)).collect()
    }

    /// Route of one agent of a scene. What a vehicle backs up is taken off its route again.
    pub fn new(scene: &Scene, agent_idx: usize, lanes: Option<&LaneIndex>) -> Self {
        let steps = (0..scene.num_steps).filter(|t| scene.is_valid(agent_idx, *t));
        let mut points: Vec<Point2> = Vec::new();
        let mut heights: Vec<Real> = Vec::new();
        let mut pose = Pose2::new(0.0, 0.0, 0.0);
        let mut reversing = Reversing::default();
        let drives = scene.agents[agent_idx].kind != AgentKind::Pedestrian;
        let (mut logged_speed_mps, mut logged_reach_m): (Real, Real) = (0.0, 0.0);
        for t in steps {
            let at = scene.at(agent_idx, t);
            let before = std::mem::replace(&mut pose, scene.pose(agent_idx, t));
            if drives && reversing.goes_to(t, before, pose) {
                reversing.cut(&mut points, &mut heights);
            }
            logged_speed_mps = logged_speed_mps.max(scene.tracks.velocity[at].norm());
            logged_reach_m = points.first().map_or(0.0, |p| logged_reach_m.max((pose.position - p).norm()));
            let goes_on = points.last().is_none_or(|last| {
                let step = pose.position - last;
                // what is driven backwards is not part of the route
                step.norm() >= MIN_STEP_M && step.x * pose.cos + step.y * pose.sin > 0.0
            });
            if goes_on && !reversing.now {
                points.push(pose.position);
                heights.extend(scene.tracks.elevation_m.get(at));
                reversing.kept_m.push(reversing.along_m);
            }
        }
        if reversing.now {
            reversing.cut(&mut points, &mut heights);
            pose = reversing.low.1;
        }
        let level = heights.last().and_then(|z| LaneIndex::on_level(&scene.map, Some(*z)));
        let lanes = if scene.has_levels() { level.as_ref() } else { lanes };
        extend(&mut points, &mut heights, pose, &scene.map, lanes);
        let elevation_m = by_metre(&points, &heights);
        let straight = || Polyline::straight(&pose, EXTENSION_M);
        let path = Polyline::new(points).map_or_else(straight, |coarse| resampled(&coarse));
        let curve_speed_mps = curve_speeds(&path);
        let (backs, lights) = (reversing.steps, scene.map.lights_along(&path));
        Self { path, elevation_m, curve_speed_mps, logged_speed_mps, logged_reach_m, backs, lights }
    }

    /// How high the route is at a position and how steep over the metres round it, in a scene with levels.
    pub(crate) fn height(&self, s_m: Real) -> Option<Height> {
        let last = self.elevation_m.len().checked_sub(1)?;
        let at = |s_m: Real| {
            let s = (s_m / SPACING_M).clamp(0.0, last as Real);
            let i = (s as usize).min(last.saturating_sub(1));
            let (a, b) = (self.elevation_m[i], self.elevation_m[(i + 1).min(last)]);
            a + (b - a) * (s - i as Real)
        };
        let grade = (at(s_m + GRADE_M) - at(s_m - GRADE_M)) / (2.0 * GRADE_M);
        Some(Height { elevation_m: at(s_m), grade })
    }

    /// Position along the route of an agent at a point that was at a position and has moved by a distance, metres. Where a
    /// route crosses itself it stays on its branch.
    #[inline]
    pub fn advance(&self, point: Point2, s_m: Real, moved_m: Real) -> Real {
        self.path.project_near(point, s_m, REACH_M.max(2.0 * moved_m)).s_m
    }

    /// Whether the vehicle never moves in the log.
    pub fn is_parked(&self) -> bool {
        self.logged_speed_mps <= PARKED_MPS || self.logged_reach_m <= PARKED_REACH_M
    }

    /// Whether the vehicle backs up in the log at a step, or stands before it does.
    pub fn backs_up(&self, step_idx: usize) -> bool {
        self.backs.iter().any(|steps| steps.contains(&step_idx))
    }

    /// Greatest speed the curves at and ahead of a position allow, m/s.
    #[inline]
    pub fn curve_speed_mps(&self, s_m: Real) -> Real {
        let i = (s_m.max(0.0) / SPACING_M) as usize;
        self.curve_speed_mps.get(i).or(self.curve_speed_mps.last()).copied().unwrap_or(Real::MAX)
    }
}

/// Finds where a log backs up, and how much of its route it takes off.
struct Reversing {
    /// Way along the headings so far, and at each point of the route, metres.
    along_m: Real,
    kept_m: Vec<Real>,
    /// The farthest of it since it last drove on, and the step of it; the least since it backs up, and where that was.
    high: (Real, usize),
    low: (Real, Pose2, usize),
    now: bool,
    steps: Vec<Range<usize>>,
}

impl Default for Reversing {
    fn default() -> Self {
        let low = (0.0, Pose2::new(0.0, 0.0, 0.0), 0);
        Self { along_m: 0.0, kept_m: Vec::new(), high: (Real::MIN, 0), low, now: false, steps: Vec::new() }
    }
}

impl Reversing {
    /// Takes account of a step; tells whether the vehicle drives on since then, having backed up before.
    fn goes_to(&mut self, step_idx: usize, before: Pose2, pose: Pose2) -> bool {
        if self.high.0 > Real::MIN {
            let moved = pose.position - before.position;
            self.along_m += moved.x * pose.cos + moved.y * pose.sin;
        }
        if !self.now && self.along_m > self.high.0 {
            self.high = (self.along_m, step_idx);
        }
        if !self.now && self.along_m < self.high.0 - BACK_M {
            self.now = true;
            self.low.0 = Real::MAX;
            self.steps.push(self.high.1..usize::MAX);
        }
        if self.now && self.along_m < self.low.0 {
            self.low = (self.along_m, pose, step_idx);
        }
        let drives_on = self.now && self.along_m > self.low.0 + BACK_M;
        if drives_on {
            self.now = false;
            self.high = (self.along_m, step_idx);
            if let Some(steps) = self.steps.last_mut() {
                steps.end = self.low.2;
            }
        }
        drives_on
    }

    /// Takes what was backed up off a route, which then goes on from where the vehicle turned.
    fn cut(&mut self, points: &mut Vec<Point2>, heights: &mut Vec<Real>) {
        let kept = self.kept_m.iter().take_while(|m| **m < self.low.0).count();
        let height = heights.get(kept).copied();
        points.truncate(kept);
        heights.truncate(kept);
        self.kept_m.truncate(kept);
        points.push(self.low.1.position);
        heights.extend(height);
        self.kept_m.push(self.low.0);
    }
}

/// Appends the lanes that follow the last pose, else a straight line.
fn extend(
    points: &mut Vec<Point2>,
    heights: &mut Vec<Real>,
    pose: Pose2,
    map: &Map,
    lanes: Option<&LaneIndex>,
) {
    let last = heights.last().copied();
    let hit = lanes.and_then(|l| l.nearest(pose.position, pose.cos, pose.sin, 3.0));
    let hit = hit.filter(|h| h.heading_error_rad().abs() < 0.6);
    let Some(hit) = hit else {
        points.push(pose.to_outer(Point2::new(EXTENSION_M, 0.0)));
        return;
    };
    let left_m = follow(map, hit.lane_idx, hit.s_m + 4.0, EXTENSION_M, |point, height| {
        points.push(point);
        heights.extend(last.map(|last| height.unwrap_or(last)));
    });
    if left_m > 0.0 && points.len() >= 2 {
        let (a, b) = (points[points.len() - 2], points[points.len() - 1]);
        let d = b - a;
        if d.norm() > 1e-3 {
            points.push(b + d * (left_m / d.norm()));
        }
    }
}

/// Heights of points at each metre along them, the last one beyond those that have none; nothing without heights.
fn by_metre(points: &[Point2], heights: &[Real]) -> Vec<Real> {
    let Some(first) = heights.first() else { return Vec::new() };
    let (mut out, mut s_m) = (vec![*first], 0.0);
    for (i, ends) in points.windows(2).enumerate() {
        let length_m = (ends[1] - ends[0]).norm();
        let [from, to] = [i, i + 1].map(|i| heights[i.min(heights.len() - 1)]);
        while out.len() as Real * SPACING_M <= s_m + length_m {
            let share = (out.len() as Real * SPACING_M - s_m) / length_m;
            out.push(from + (to - from) * share);
        }
        s_m += length_m;
    }
    out
}

fn resampled(path: &Polyline) -> Polyline {
    let n = (path.length_m() / SPACING_M).ceil().max(1.0) as usize;
    let points = (0..=n).map(|i| path.at((i as Real * SPACING_M).min(path.length_m())).position).collect();
    Polyline::new(points).unwrap_or_else(|| path.clone())
}

/// Speeds from the curvature of each metre, limited so that braking at [`APPROACH_MPS2`] reaches them in time.
fn curve_speeds(path: &Polyline) -> Vec<Real> {
    let n = path.length_m().ceil().max(1.0) as usize + 1;
    let tangents: Vec<(Real, Real)> = (0..n + 3)
        .map(|i| {
            let at = path.at(i as Real * SPACING_M);
            (at.cos, at.sin)
        })
        .collect();
    let mut speeds: Vec<Real> = (0..n)
        .map(|i| {
            // turn over three metres, so that kinks of the sampling do not count as curves
            let ((c0, s0), (c1, s1)) = (tangents[i], tangents[i + 3]);
            let turn = (c0 * s1 - s0 * c1).abs().max(1e-4);
            (CURVE_MPS2 * 3.0 * SPACING_M / turn).sqrt().max(2.0)
        })
        .collect();
    for i in (0..n.saturating_sub(1)).rev() {
        let ahead = speeds[i + 1];
        speeds[i] = speeds[i].min((ahead * ahead + 2.0 * APPROACH_MPS2 * SPACING_M).sqrt());
    }
    speeds
}
