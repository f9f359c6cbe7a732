//! Lines and marks over the map: route, trails, planned samples, causal arrows, collisions.

use crate::camera::Bounds;
use crate::canvas::{Canvas, Outline};
use crate::palette::{self, DrawStyle};
use ccdiff_sim::geom::{Point2, Real};

/// Steps of fading along a trail.
const FADES: usize = 10;

/// A line that belongs to an agent: where it was, or where it may go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line<'a> {
    /// Points in the scene frame, metres, in order of time.
    pub points: &'a [Point2],
    /// Who moves the agent: sets the colour.
    pub driver: DrawStyle,
}

/// An edge of the causal graph: `from` influences `to`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrow {
    /// Centre of the agent that acts.
    pub from: Point2,
    /// Centre of the agent that is acted on.
    pub to: Point2,
    /// Strength; held to 0..1 when drawn.
    pub weight: Real,
}

/// A broad translucent band in the ego's colour.
pub(crate) fn route(canvas: &mut Canvas, points: &[Point2]) {
    let mut outline = Outline::new();
    outline.polyline(canvas.view, points);
    let width = canvas.px(1.3, 2.5);
    canvas.stroke(outline, DrawStyle::Ego.colour(), 0.2, width, true);
}

/// A line that fades towards its old end.
pub(crate) fn trail(canvas: &mut Canvas, line: &Line<'_>) {
    if !canvas.view.sees(&Bounds::of(line.points), 1.0) {
        return;
    }
    let segments = line.points.len().saturating_sub(1);
    let parts = FADES.min(segments);
    let width = canvas.px(0.35, 1.6).min(3.5);
    for part in 0..parts {
        let (from, to) = (part * segments / parts, (part + 1) * segments / parts);
        let mut outline = Outline::new();
        outline.polyline(canvas.view, &line.points[from..=to]);
        let alpha = 0.75 * (part + 1) as f32 / parts as f32;
        canvas.stroke(outline, line.driver.colour(), alpha, width, false);
    }
}

/// A thin line in its driver's colour.
pub(crate) fn sample(canvas: &mut Canvas, line: &Line<'_>) {
    if !canvas.view.sees(&Bounds::of(line.points), 1.0) {
        return;
    }
    let mut outline = Outline::new();
    outline.polyline(canvas.view, line.points);
    canvas.stroke(outline, line.driver.colour(), 0.55, 1.2, true);
}

/// A bent arrow; weight sets width and strength, so that i → j and j → i lie side by side.
pub(crate) fn arrow(canvas: &mut Canvas, arrow: &Arrow) {
    let (from, to) = (canvas.view.to_px(arrow.from), canvas.view.to_px(arrow.to));
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let length = (dx * dx + dy * dy).sqrt();
    if length < 6.0 {
        return;
    }
    let weight = arrow.weight.clamp(0.0, 1.0);
    let width = 1.2 + 2.4 * weight;
    let alpha = 0.35 + 0.6 * weight;
    // The bend: a control point beside the middle. Both ends are moved in along the curve's own directions, so
    // that shaft and head stay clear of the boxes they join.
    let bend = 0.14 * length;
    let control = (from.0 + 0.5 * dx + bend * dy / length, from.1 + 0.5 * dy - bend * dx / length);
    let trim = canvas.px(2.4, 3.0).min(0.3 * length);
    let (start, _) = moved_in(from, control, trim);
    let (tip, (ax, ay)) = moved_in(to, control, trim);
    let head = (5.0 + 2.6 * width).min(0.4 * length);
    let neck = (tip.0 + ax * head, tip.1 + ay * head);
    let mut shaft = Outline::new();
    shaft.move_to(start);
    shaft.curve_to(control, neck);
    let mut point = Outline::new();
    point.move_to(tip);
    point.line_to((neck.0 - 0.45 * head * ay, neck.1 + 0.45 * head * ax));
    point.line_to((neck.0 + 0.45 * head * ay, neck.1 - 0.45 * head * ax));
    point.close();
    let (Some(shaft), Some(point)) = (shaft.path(), point.path()) else { return };
    canvas.stroke_path(&shaft, palette::PAPER, 0.7, width + 2.0, true);
    canvas.stroke_path(&point, palette::PAPER, 0.7, 2.0, true);
    canvas.stroke_path(&shaft, palette::ARROW, alpha, width, false);
    canvas.fill_path(&point, palette::ARROW, alpha);
}

/// The pixel some way from an end towards another one, and the unit vector of that way.
fn moved_in(end: (f32, f32), towards: (f32, f32), by_px: f32) -> ((f32, f32), (f32, f32)) {
    let (dx, dy) = (towards.0 - end.0, towards.1 - end.1);
    let length = (dx * dx + dy * dy).sqrt().max(1e-6);
    let unit = (dx / length, dy / length);
    ((end.0 + unit.0 * by_px, end.1 + unit.1 * by_px), unit)
}

/// A ringed cross where agents met.
pub(crate) fn collision(canvas: &mut Canvas, at: Point2) {
    let (x, y) = canvas.view.to_px(at);
    let radius = canvas.px(1.1, 5.0).min(14.0);
    let mut ring = Outline::new();
    ring.circle((x, y), radius);
    let Some(ring) = ring.path() else { return };
    canvas.fill_path(&ring, palette::PAPER, 0.75);
    canvas.stroke_path(&ring, palette::COLLISION, 1.0, 0.28 * radius, true);
    let arm = 0.42 * radius;
    let mut cross = Outline::new();
    for side in [1.0, -1.0] {
        cross.move_to((x - arm, y - side * arm));
        cross.line_to((x + arm, y + side * arm));
    }
    canvas.stroke(cross, palette::COLLISION, 1.0, 0.28 * radius, true);
}
