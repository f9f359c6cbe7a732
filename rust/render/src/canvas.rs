//! Anti-aliased fills and strokes in pixels, on top of `tiny-skia`.

use crate::camera::View;
use crate::palette::{Palette, Rgb, Theme};
use ccdiff_sim::geom::{Point2, Pose2, Vector2};
use std::fmt::Write;
use tiny_skia::{
    Color, FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, PathSegment, Pixmap, Shader, Stroke,
    Transform,
};

/// Points nearer than this to the one before are left out, pixels.
const MERGE_PX: f32 = 0.35;
/// Coordinates are held within this, pixels: far outside any image, well inside what the rasteriser can take.
const FAR_PX: f32 = 1e6;

/// What is painted on.
enum Surface {
    Pixels(Pixmap),
    /// Elements of an SVG.
    Vector(String),
}

/// A surface and the view that places metres on it.
pub(crate) struct Canvas {
    surface: Surface,
    pub(crate) view: View,
    pub(crate) theme: Theme,
}

/// Collects lines and rings in pixels and becomes one path.
pub(crate) struct Outline {
    builder: PathBuilder,
    last: (f32, f32),
}

impl Canvas {
    /// Canvas in the colour of the ground; `None` where there is no room for it.
    pub(crate) fn new(width: u32, height: u32, view: View, theme: Theme) -> Option<Self> {
        let mut pixmap = Pixmap::new(width, height)?;
        pixmap.fill(colour(theme.palette().ground, 1.0));
        Some(Self { surface: Surface::Pixels(pixmap), view, theme })
    }

    /// Canvas of an SVG, without ground.
    pub(crate) fn vector(view: View, theme: Theme) -> Self {
        Self { surface: Surface::Vector(String::new()), view, theme }
    }

    /// Colours of the map and the marks.
    pub(crate) fn palette(&self) -> &'static Palette {
        self.theme.palette()
    }

    /// Fills a path by the non-zero rule.
    pub(crate) fn fill(&mut self, outline: Outline, rgb: Rgb, alpha: f32) {
        if let Some(path) = outline.builder.finish() {
            self.fill_path(&path, rgb, alpha);
        }
    }

    /// Fills a finished path.
    pub(crate) fn fill_path(&mut self, path: &Path, rgb: Rgb, alpha: f32) {
        match &mut self.surface {
            Surface::Pixels(pixmap) => {
                pixmap.fill_path(path, &paint(rgb, alpha), FillRule::Winding, Transform::identity(), None);
            }
            Surface::Vector(text) => {
                element(text, path, &format!("fill=\"{}\" fill-opacity", hex(rgb)), alpha)
            }
        }
    }

    /// Strokes a path with round joins; `round` ends or flat ones.
    pub(crate) fn stroke(&mut self, outline: Outline, rgb: Rgb, alpha: f32, width_px: f32, round: bool) {
        if let Some(path) = outline.builder.finish() {
            self.stroke_path(&path, rgb, alpha, width_px, round);
        }
    }

    /// Strokes a finished path.
    pub(crate) fn stroke_path(&mut self, path: &Path, rgb: Rgb, alpha: f32, width_px: f32, round: bool) {
        let stroke = Stroke {
            width: width_px,
            line_cap: if round { LineCap::Round } else { LineCap::Butt },
            line_join: LineJoin::Round,
            ..Stroke::default()
        };
        match &mut self.surface {
            Surface::Pixels(pixmap) => {
                pixmap.stroke_path(path, &paint(rgb, alpha), &stroke, Transform::identity(), None);
            }
            Surface::Vector(text) => {
                let (colour, cap) = (hex(rgb), if round { "round" } else { "butt" });
                let how = format!(
                    "fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width_px:.2}\" stroke-linecap=\"{cap}\" stroke-linejoin=\"round\" stroke-opacity"
                );
                element(text, path, &how, alpha);
            }
        }
    }

    /// Pixels of a length in metres, at least `min_px`.
    pub(crate) fn px(&self, length_m: f32, min_px: f32) -> f32 {
        (length_m * self.view.px_per_m).max(min_px)
    }

    /// A point of an agent's own frame in pixels.
    pub(crate) fn local_px(&self, pose: &Pose2, forward_m: f32, left_m: f32) -> (f32, f32) {
        self.view.to_px(pose.position + pose.rotate(Vector2::new(forward_m, left_m)))
    }

    /// Drops the alpha channel: everything was drawn on an opaque ground.
    pub(crate) fn finish(self) -> Vec<u8> {
        let Surface::Pixels(pixmap) = self.surface else {
            return Vec::new();
        };
        let rgba = pixmap.data();
        let mut rgb = vec![0; rgba.len() / 4 * 3];
        for (to, from) in rgb.chunks_exact_mut(3).zip(rgba.chunks_exact(4)) {
            to.copy_from_slice(&from[..3]);
        }
        rgb
    }

    /// The SVG of so many pixels, on the colour of the ground.
    pub(crate) fn finish_svg(self, width: u32, height: u32) -> String {
        let ground = hex(self.palette().ground);
        let Surface::Vector(text) = self.surface else { return String::new() };
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\">\n<rect width=\"100%\" height=\"100%\" fill=\"{ground}\"/>\n{text}</svg>\n"
        )
    }
}

impl Outline {
    /// An empty outline.
    pub(crate) fn new() -> Self {
        Self { builder: PathBuilder::new(), last: (0.0, 0.0) }
    }

    /// Begins a new line at a pixel.
    pub(crate) fn move_to(&mut self, (x, y): (f32, f32)) {
        self.last = (held(x), held(y));
        self.builder.move_to(self.last.0, self.last.1);
    }

    /// Draws on to a pixel.
    pub(crate) fn line_to(&mut self, (x, y): (f32, f32)) {
        self.last = (held(x), held(y));
        self.builder.line_to(self.last.0, self.last.1);
    }

    /// Draws a quadratic curve to a pixel.
    pub(crate) fn curve_to(&mut self, (cx, cy): (f32, f32), (x, y): (f32, f32)) {
        self.last = (held(x), held(y));
        self.builder.quad_to(held(cx), held(cy), self.last.0, self.last.1);
    }

    /// Joins the line to its beginning.
    pub(crate) fn close(&mut self) {
        self.builder.close();
    }

    /// Adds a circle.
    pub(crate) fn circle(&mut self, (x, y): (f32, f32), radius_px: f32) {
        self.builder.push_circle(held(x), held(y), radius_px);
    }

    /// Adds a line of the scene frame, without the points that no one would see.
    pub(crate) fn polyline(&mut self, view: View, points: &[Point2]) {
        let Some((first, rest)) = points.split_first() else { return };
        self.move_to(view.to_px(*first));
        for (i, p) in rest.iter().enumerate() {
            let (x, y) = view.to_px(*p);
            let far = (x - self.last.0).abs() > MERGE_PX || (y - self.last.1).abs() > MERGE_PX;
            if far || i + 1 == rest.len() {
                self.line_to((x, y));
            }
        }
    }

    /// Adds a closed ring of the scene frame.
    pub(crate) fn ring(&mut self, view: View, points: &[Point2]) {
        if points.len() >= 3 {
            self.polyline(view, points);
            self.close();
        }
    }

    /// The path, for a fill and a stroke of the same outline; `None` if it is empty.
    pub(crate) fn path(self) -> Option<Path> {
        self.builder.finish()
    }
}

/// `#rrggbb`.
fn hex(Rgb(r, g, b): Rgb) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// Adds a path to an SVG.
fn element(text: &mut String, path: &Path, how: &str, alpha: f32) {
    text.push_str("<path d=\"");
    for segment in path.segments() {
        let (letter, points): (char, &[tiny_skia::Point]) = match &segment {
            PathSegment::MoveTo(p) => ('M', &[*p]),
            PathSegment::LineTo(p) => ('L', &[*p]),
            PathSegment::QuadTo(c, p) => ('Q', &[*c, *p]),
            PathSegment::CubicTo(c, d, p) => ('C', &[*c, *d, *p]),
            PathSegment::Close => ('Z', &[]),
        };
        text.push(letter);
        for (i, p) in points.iter().enumerate() {
            let gap = if i > 0 { " " } else { "" };
            let _ = write!(text, "{gap}{:.2} {:.2}", p.x, p.y);
        }
    }
    let _ = writeln!(text, "\" {how}=\"{:.3}\"/>", alpha.clamp(0.0, 1.0));
}

fn held(v: f32) -> f32 {
    v.clamp(-FAR_PX, FAR_PX)
}

fn colour(Rgb(r, g, b): Rgb, alpha: f32) -> Color {
    let mut c = Color::from_rgba8(r, g, b, 255);
    c.apply_opacity(alpha.clamp(0.0, 1.0));
    c
}

fn paint(rgb: Rgb, alpha: f32) -> Paint<'static> {
    Paint { shader: Shader::SolidColor(colour(rgb, alpha)), anti_alias: true, ..Paint::default() }
}
