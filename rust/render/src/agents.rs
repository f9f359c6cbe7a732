//! Agents as the replay page has them: rounded boxes with a windscreen, discs for people, plain boxes for obstacles.

use crate::camera::Bounds;
use crate::canvas::{Canvas, Outline};
use crate::look::{LEAST_LENGTH_PX, PARKED_ALPHA};
use crate::palette::DrawStyle;
use ccdiff_sim::geom::{Pose2, Real};
use ccdiff_sim::scene::AgentKind;

/// Half of the smallest side that an agent is drawn with, pixels.
const MIN_HALF_PX: f32 = 1.5;

/// One agent of an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AgentBox {
    /// Centre and heading in the scene frame.
    pub pose: Pose2,
    /// Length along the heading, metres, > 0.
    pub length_m: Real,
    /// Width, metres, > 0.
    pub width_m: Real,
    /// Kind: sets the shape.
    pub kind: AgentKind,
    /// Its driver: sets the colour.
    pub driver: DrawStyle,
    /// Whether it is in a collision: outlined in red.
    pub collided: bool,
    /// Whether it is a vehicle that never moves: it is hollow.
    pub parked: bool,
    /// Whether it is an ego that has reached its goal: outlined in green.
    pub arrived: bool,
}

/// Draws all agents: obstacles lowest, then by driver, the ego on top.
pub(crate) fn draw(canvas: &mut Canvas, boxes: &[AgentBox]) {
    let view = canvas.view;
    let in_sight = |b: &&AgentBox| view.sees(&Bounds::of(&[b.pose.position]), b.length_m + b.width_m + 1.0);
    let mut order: Vec<&AgentBox> = boxes.iter().filter(in_sight).collect();
    order.sort_by_key(|b| match (b.kind, b.driver) {
        (_, DrawStyle::Ego) => 4,
        (AgentKind::Static, _) => 0,
        (_, DrawStyle::Replay) => 1,
        (AgentKind::Vehicle, _) => 2,
        _ => 3,
    });
    for b in order {
        draw_one(canvas, b);
    }
}

fn draw_one(canvas: &mut Canvas, b: &AgentBox) {
    let palette = canvas.palette();
    let px_per_m = canvas.view.px_per_m;
    let larger = match b.kind {
        AgentKind::Vehicle => (LEAST_LENGTH_PX / (b.length_m * px_per_m)).max(1.0),
        _ => 1.0,
    };
    let least_m = MIN_HALF_PX / px_per_m;
    let (half_l, half_w) =
        ((0.5 * larger * b.length_m).max(least_m), (0.5 * larger * b.width_m).max(least_m));
    let body = match b.kind {
        AgentKind::Pedestrian => {
            let mut disc = Outline::new();
            disc.circle(canvas.local_px(&b.pose, 0.0, 0.0), canvas.px(0.38, 2.2));
            disc
        }
        AgentKind::Static => rounded_box(canvas, b, half_l, half_w, 0.05),
        _ => rounded_box(canvas, b, half_l, half_w, (0.56 * half_w).min(0.6)),
    };
    let Some(body) = body.path() else { return };
    let fill = if b.kind == AgentKind::Static { palette.obstacle } else { b.driver.colour(canvas.theme) };
    let hollow = b.parked && !b.collided;
    canvas.fill_path(&body, fill, if b.parked { PARKED_ALPHA } else { 1.0 });
    let (edge, width) = if b.collided {
        (palette.collision, canvas.px(0.3, 2.2))
    } else if b.arrived {
        (palette.goal, canvas.px(0.3, 2.2))
    } else {
        (if hollow { fill } else { palette.outline }, canvas.px(0.08, 0.8))
    };
    canvas.stroke_path(&body, edge, 1.0, width, true);
    match b.kind {
        AgentKind::Vehicle if px_per_m > 2.5 && !b.parked => windows(canvas, b, half_l, half_w),
        AgentKind::Vehicle | AgentKind::Static => {}
        _ if px_per_m > 5.0 => {
            let mut nose = Outline::new();
            nose.circle(canvas.local_px(&b.pose, (0.3 * b.length_m).min(0.5), 0.0), canvas.px(0.13, 0.0));
            canvas.fill(nose, palette.outline, 0.5);
        }
        _ => {}
    }
}

/// The box as an outline with corners of a radius in metres.
fn rounded_box(canvas: &Canvas, b: &AgentBox, half_l: f32, half_w: f32, radius: f32) -> Outline {
    let mut outline = Outline::new();
    let at = |x: f32, y: f32| canvas.local_px(&b.pose, x, y);
    let (l, w, r) = (half_l, half_w, radius.min(half_l).min(half_w));
    outline.move_to(at(l - r, w));
    // Corner, and where the next side ends; the front corners are as round as the rear ones.
    for ((cx, cy), after, side) in [
        ((-l, w), (-l, w - r), (-l + r, w)),
        ((-l, -w), (-l + r, -w), (-l, -w + r)),
        ((l, -w), (l, -w + r), (l - r, -w)),
        ((l, w), (l - r, w), (l, w - r)),
    ] {
        outline.line_to(at(side.0, side.1));
        if r > 0.0 {
            outline.curve_to(at(cx, cy), at(after.0, after.1));
        }
    }
    outline.close();
    outline
}

/// Windscreen and rear window: they tell the heading.
fn windows(canvas: &mut Canvas, b: &AgentBox, half_l: f32, half_w: f32) {
    let panes = [
        ([(0.48, 0.68), (0.22, 0.8), (0.22, -0.8), (0.48, -0.68)], 0.42),
        ([(-0.54, 0.72), (-0.72, 0.72), (-0.72, -0.72), (-0.54, -0.72)], 0.22),
    ];
    for (corners, alpha) in panes {
        let mut pane = Outline::new();
        for (i, (forward, left)) in corners.into_iter().enumerate() {
            let at = canvas.local_px(&b.pose, forward * half_l, left * half_w);
            if i == 0 {
                pane.move_to(at);
            } else {
                pane.line_to(at);
            }
        }
        pane.close();
        canvas.fill(pane, canvas.palette().outline, alpha);
    }
}
