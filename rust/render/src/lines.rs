//! Lines and marks over the map: route, trails, planned samples, causal arrows, collisions.

use crate::camera::Bounds;
use crate::canvas::{Canvas, Outline};
use crate::look::{MARK_M, MARK_PX, PATH_ALPHA, PLAN_PARTS, TRAIL_PARTS};
use crate::palette::DrawStyle;
use ccdiff_sim::geom::{Point2, Real};

/// A line that belongs to an agent: where it was, or where it may go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line<'a> {
    /// Points in the scene frame, metres, in order of time.
    pub points: &'a [Point2],
    /// The agent's driver: sets the colour.
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
    let width = canvas.px(1.6, 3.0);
    canvas.stroke(outline, DrawStyle::Ego.colour(canvas.theme), PATH_ALPHA, width, true);
}

/// A line that fades towards its old end.
pub(crate) fn trail(canvas: &mut Canvas, line: &Line<'_>) {
    fading(canvas, line, TRAIL_PARTS, canvas.px(0.35, 1.6), |share| 0.08 + 0.42 * share);
}

/// A thin line in its driver's colour that fades towards its end.
pub(crate) fn sample(canvas: &mut Canvas, line: &Line<'_>) {
    fading(canvas, line, PLAN_PARTS, canvas.px(0.1, 1.0), |share| 0.35 * (1.2 - 0.8 * share));
}

/// A thick line in its driver's colour that fades towards its end.
pub(crate) fn plan(canvas: &mut Canvas, line: &Line<'_>) {
    fading(canvas, line, PLAN_PARTS, canvas.px(0.3, 2.0), |share| 0.95 * (1.2 - 0.8 * share));
}

/// Strokes a line in parts; `alpha` of a part is that of the share of the line that ends with it.
fn fading(canvas: &mut Canvas, line: &Line<'_>, parts: f32, width_px: f32, alpha: impl Fn(f32) -> f32) {
    if !canvas.view.sees(&Bounds::of(line.points), 1.0) {
        return;
    }
    let segments = line.points.len().saturating_sub(1);
    let parts = (parts as usize).min(segments);
    for part in 0..parts {
        let (from, to) = (part * segments / parts, (part + 1) * segments / parts);
        let mut outline = Outline::new();
        outline.polyline(canvas.view, &line.points[from..=to]);
        let alpha = alpha((part + 1) as f32 / parts as f32);
        canvas.stroke(outline, line.driver.colour(canvas.theme), alpha, width_px, false);
    }
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
    let palette = canvas.palette();
    canvas.stroke_path(&shaft, palette.paper, 0.7, width + 2.0, true);
    canvas.stroke_path(&point, palette.paper, 0.7, 2.0, true);
    canvas.stroke_path(&shaft, palette.arrow, alpha, width, false);
    canvas.fill_path(&point, palette.arrow, alpha);
}

/// The pixel some way from an end towards another one, and the unit vector of that way.
fn moved_in(end: (f32, f32), towards: (f32, f32), by_px: f32) -> ((f32, f32), (f32, f32)) {
    let (dx, dy) = (towards.0 - end.0, towards.1 - end.1);
    let length = (dx * dx + dy * dy).sqrt().max(1e-6);
    let unit = (dx / length, dy / length);
    ((end.0 + unit.0 * by_px, end.1 + unit.1 * by_px), unit)
}

/// A ring where agents met.
pub(crate) fn collision(canvas: &mut Canvas, at: Point2) {
    let mut ring = Outline::new();
    ring.circle(canvas.view.to_px(at), canvas.px(MARK_M, 0.0) + MARK_PX);
    canvas.stroke(ring, canvas.palette().collision, 1.0, 2.5, true);
}
