//! Agents: rounded boxes with a heading notch, discs for people, crossed boxes for obstacles.

use crate::camera::Bounds;
use crate::canvas::{Canvas, Outline};
use crate::palette::{self, DrawStyle, Rgb};
use ccdiff_sim::geom::{Pose2, Real};
use ccdiff_sim::scene::AgentKind;

/// Smallest side or radius an agent is drawn with, pixels.
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
    /// Who moves it: sets the colour.
    pub driver: DrawStyle,
    /// Whether it is in a collision: outlined in red.
    pub collided: bool,
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
    let min_half_m = MIN_HALF_PX / canvas.view.px_per_m;
    let (half_l, half_w) = ((0.5 * b.length_m).max(min_half_m), (0.5 * b.width_m).max(min_half_m));
    let outline_px = canvas.px(0.16, 0.9).min(2.0);
    let body = match b.kind {
        AgentKind::Pedestrian => {
            let mut disc = Outline::new();
            disc.circle(canvas.local_px(&b.pose, 0.0, 0.0), canvas.px(half_l.max(half_w), 2.2));
            disc
        }
        AgentKind::Static => rounded_box(canvas, b, half_l, half_w, 0.0),
        AgentKind::Vehicle => rounded_box(canvas, b, half_l, half_w, (0.45 * half_w).min(0.7)),
        AgentKind::Cyclist | AgentKind::Motorcycle => rounded_box(canvas, b, half_l, half_w, 0.9 * half_w),
    };
    let Some(body) = body.path() else { return };
    let fill = if b.kind == AgentKind::Static { palette::STATIC } else { b.driver.colour() };
    if b.collided {
        canvas.stroke_path(&body, palette::COLLISION, 1.0, 2.0 * canvas.px(0.45, 2.2).min(5.0), true);
    } else if b.driver == DrawStyle::Ego {
        canvas.stroke_path(&body, palette::PAPER, 0.95, 2.0 * canvas.px(0.35, 2.0).min(4.0), true);
    } else if b.kind == AgentKind::Pedestrian {
        canvas.stroke_path(&body, palette::PAPER, 0.9, 2.0 * outline_px, true);
    }
    canvas.fill_path(&body, fill, 1.0);
    let edge = if b.kind == AgentKind::Pedestrian { 0.9 } else { 0.55 };
    canvas.stroke_path(&body, darker(fill), edge, outline_px, true);
    match b.kind {
        AgentKind::Vehicle => notch(canvas, b, half_l, half_w),
        AgentKind::Cyclist | AgentKind::Motorcycle => {
            let mut head = Outline::new();
            head.circle(canvas.local_px(&b.pose, 0.25 * half_l, 0.0), canvas.px(0.55 * half_w, 1.0));
            canvas.fill(head, palette::PAPER, 0.9);
        }
        AgentKind::Static => cross(canvas, b, half_l, half_w),
        AgentKind::Pedestrian => {}
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

/// A light chevron near the front: it tells the heading.
fn notch(canvas: &mut Canvas, b: &AgentBox, half_l: f32, half_w: f32) {
    let depth = half_w.min(half_l) * 0.75;
    let tip = 0.8 * half_l;
    let mut chevron = Outline::new();
    chevron.move_to(canvas.local_px(&b.pose, tip, 0.0));
    chevron.line_to(canvas.local_px(&b.pose, tip - depth, 0.6 * half_w));
    chevron.line_to(canvas.local_px(&b.pose, tip - 0.6 * depth, 0.0));
    chevron.line_to(canvas.local_px(&b.pose, tip - depth, -0.6 * half_w));
    chevron.close();
    canvas.fill(chevron, palette::PAPER, 0.9);
}

/// Both diagonals: an obstacle.
fn cross(canvas: &mut Canvas, b: &AgentBox, half_l: f32, half_w: f32) {
    if half_l.min(half_w) * canvas.view.px_per_m < 3.0 {
        return;
    }
    let mut lines = Outline::new();
    for side in [1.0, -1.0] {
        lines.move_to(canvas.local_px(&b.pose, half_l, side * half_w));
        lines.line_to(canvas.local_px(&b.pose, -half_l, -side * half_w));
    }
    canvas.stroke(lines, darker(palette::STATIC), 0.6, 1.0, false);
}

fn darker(Rgb(r, g, b): Rgb) -> Rgb {
    let half = |v: u8| (u16::from(v) * 9 / 20) as u8;
    Rgb(half(r), half(g), half(b))
}
