//! What an image shows, and the order in which it is painted.

use crate::agents::AgentBox;
use crate::camera::Camera;
use crate::canvas::Canvas;
use crate::error::{RenderError, Result};
use crate::layers::MapLayers;
use crate::lines::Line;
use crate::palette::{Rgb, Theme};
use crate::{agents, lines, text};
use ccdiff_sim::geom::Point2;
use ccdiff_sim::scene::LightState;

/// Everything an image shows. All coordinates are of the scene frame, metres. Empty lists show nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Drawing<'a> {
    /// The map; `None` leaves bare ground.
    pub map: Option<&'a MapLayers>,
    /// Stop lines of traffic lights, and what these show.
    pub lights: &'a [([Point2; 2], LightState)],
    /// The ego's route: a broad translucent band.
    pub route: &'a [Point2],
    /// Where agents were, oldest point first: lines that fade with age.
    pub trails: &'a [Line<'a>],
    /// Sampled futures: thin lines that fade with time.
    pub samples: &'a [Line<'a>],
    /// Futures that are followed: thick lines that fade with time.
    pub plans: &'a [Line<'a>],
    /// Agents.
    pub boxes: &'a [AgentBox],
    /// Names of the agents, in their order; they are written where there is room.
    pub names: &'a [String],
    /// Points of collisions.
    pub collisions: &'a [Point2],
    /// Line of text in the upper left corner: figures, letters, `. , : - + = / _ ( )`. Empty: none.
    pub caption: &'a str,
    /// Whether a bar of a round number of metres stands in the lower left corner.
    pub scale_bar: bool,
    /// What colours mean, in the lower right corner of images that have room for it.
    pub legend: &'a [(Rgb, String)],
    /// Ground and colours.
    pub theme: Theme,
}

impl Drawing<'_> {
    /// Refuses numbers that are not finite.
    fn check(&self) -> Result<()> {
        const FINITE: &str = "finite numbers within 1000 km";
        let good = |p: &Point2| p.x.abs() < 1e6 && p.y.abs() < 1e6;
        let line = |what, index, points: &[Point2]| match points.iter().find(|p| !good(p)) {
            Some(p) => Err(RenderError::value(format!("{what} {index}"), p, FINITE)),
            None => Ok(()),
        };
        line("route", 0, self.route)?;
        line("collision mark", 0, self.collisions)?;
        for (what, list) in [("trail", self.trails), ("sample", self.samples), ("plan", self.plans)] {
            list.iter().enumerate().try_for_each(|(i, l)| line(what, i, l.points))?;
        }
        for (index, b) in self.boxes.iter().enumerate() {
            line("position of agent", index, &[b.pose.position])?;
            if ![b.pose.heading_rad, b.pose.cos, b.pose.sin].iter().all(|v| v.is_finite()) {
                let what = format!("heading of agent {index}");
                return Err(RenderError::value(what, b.pose.heading_rad, "a finite angle"));
            }
            if ![b.length_m, b.width_m].iter().all(|s| *s > 0.0 && *s < 1e4) {
                let got = format!("{} x {} m", b.length_m, b.width_m);
                let expected = "a positive length and width below 10 km";
                return Err(RenderError::value(format!("size of agent {index}"), got, expected));
            }
        }
        Ok(())
    }
}

/// Paints a drawing: red, green and blue of each pixel, [H, W, 3], row 0 at the top.
///
/// Order from below: map, lights, route, trails, samples, plans, agents (obstacles lowest, the ego highest),
/// collision marks, text.
///
/// # Errors
/// [`RenderError::Value`] for a camera that cannot be used, or the first thing with a number that is not finite or a size
/// that is not positive.
pub fn render(drawing: &Drawing<'_>, camera: &Camera) -> Result<Vec<u8>> {
    let view = camera.view()?;
    drawing.check()?;
    let (width, height) = (camera.width, camera.height);
    let canvas = Canvas::new(width, height, view, drawing.theme);
    let mut canvas = canvas.ok_or_else(|| RenderError::size(width, height))?;
    paint(drawing, camera, &mut canvas);
    Ok(canvas.finish())
}

/// The same as SVG, letters as outlines.
///
/// # Errors
/// Those of [`render`].
pub fn render_svg(drawing: &Drawing<'_>, camera: &Camera) -> Result<String> {
    let view = camera.view()?;
    drawing.check()?;
    let mut canvas = Canvas::vector(view, drawing.theme);
    paint(drawing, camera, &mut canvas);
    Ok(canvas.finish_svg(camera.width, camera.height))
}

fn paint(drawing: &Drawing<'_>, camera: &Camera, canvas: &mut Canvas) {
    if let Some(map) = drawing.map {
        map.draw(canvas);
    }
    for (stop_line, state) in drawing.lights {
        lines::light(canvas, stop_line, *state);
    }
    lines::route(canvas, drawing.route);
    for trail in drawing.trails {
        lines::trail(canvas, trail);
    }
    for sample in drawing.samples {
        lines::sample(canvas, sample);
    }
    for plan in drawing.plans {
        lines::plan(canvas, plan);
    }
    agents::draw(canvas, drawing.boxes);
    for mark in drawing.collisions {
        lines::collision(canvas, *mark);
    }
    let size_px = (camera.width as f32, camera.height as f32);
    text::names(canvas, drawing.boxes, drawing.names, size_px);
    text::legend(canvas, drawing.legend, size_px);
    if drawing.scale_bar {
        text::scale_bar(canvas, size_px);
    }
    if !drawing.caption.is_empty() {
        text::caption(canvas, drawing.caption, size_px);
    }
}
