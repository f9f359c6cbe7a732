//! Lines and marks over the map: route, trails, planned samples, collisions.

use crate::camera::Bounds;
use crate::canvas::{Canvas, Outline};
use crate::look::{
    GREEN_LIGHT_M, MARK_M, MARK_PX, PATH_ALPHA, PLAN_PARTS, RED_LIGHT_M, TRAIL_PARTS, YELLOW_LIGHT_M,
};
use crate::palette::DrawStyle;
use ccdiff_sim::geom::Point2;
use ccdiff_sim::scene::LightState;

/// A line that belongs to an agent: where it was, or where it may go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line<'a> {
    /// Points in the scene frame, metres, in order of time.
    pub points: &'a [Point2],
    /// The agent's driver: sets the colour.
    pub driver: DrawStyle,
}

/// A broad translucent band in the ego's colour.
pub(crate) fn route(canvas: &mut Canvas, points: &[Point2]) {
    let mut outline = Outline::new();
    outline.polyline(canvas.view, points);
    let width = canvas.px(1.6, 3.0);
    canvas.stroke(outline, DrawStyle::Ego.colour(canvas.theme), PATH_ALPHA, width, true);
}

/// A stop line in the colour of its light; nothing where that is not known.
pub(crate) fn light(canvas: &mut Canvas, [from, to]: &[Point2; 2], state: LightState) {
    let palette = canvas.palette();
    let (rgb, width_m) = match state {
        LightState::Red => (palette.red_light, RED_LIGHT_M),
        LightState::Yellow => (palette.yellow_light, YELLOW_LIGHT_M),
        LightState::Green => (palette.green_light, GREEN_LIGHT_M),
        LightState::Unknown => return,
    };
    let mut outline = Outline::new();
    outline.polyline(canvas.view, &[*from, *to]);
    canvas.stroke(outline, rgb, 1.0, canvas.px(width_m, 3.0 * width_m), false);
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

/// A ring where agents met.
pub(crate) fn collision(canvas: &mut Canvas, at: Point2) {
    let mut ring = Outline::new();
    ring.circle(canvas.view.to_px(at), canvas.px(MARK_M, 0.0) + MARK_PX);
    canvas.stroke(ring, canvas.palette().collision, 1.0, 2.5, true);
}
