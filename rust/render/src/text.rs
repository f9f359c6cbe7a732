//! What is written on an image: the caption, names, the legend and the scale bar.
//!
//! In DejaVu Sans (its licence is in the file): the Latin letters, without kerning and hinting.

use crate::agents::AgentBox;
use crate::canvas::{Canvas, Outline};
use crate::palette::Rgb;
use ccdiff_sim::scene::AgentKind;
use std::sync::LazyLock;
use ttf_parser::{Face, GlyphId, OutlineBuilder};

static FONT: LazyLock<Face<'static>> = LazyLock::new(|| {
    #[allow(clippy::expect_used, reason = "the file is compiled in, and a test reads it")]
    Face::parse(include_bytes!("DejaVuSans.ttf"), 0).expect("a font")
});

/// Pixels per unit of the font for capitals of a height.
fn scale(cap_px: f32) -> f32 {
    cap_px / f32::from(FONT.capital_height().unwrap_or(1493))
}

/// The glyphs of a text, and how far each moves the pen, units of the font.
fn glyphs(text: &str) -> impl Iterator<Item = (GlyphId, f32)> {
    text.chars().map(|c| {
        let glyph = FONT.glyph_index(c).unwrap_or_default();
        (glyph, f32::from(FONT.glyph_hor_advance(glyph).unwrap_or(0)))
    })
}

/// Width of a text whose capitals are `cap_px` high, pixels.
fn width_px(text: &str, cap_px: f32) -> f32 {
    glyphs(text).map(|(_, advance)| advance).sum::<f32>() * scale(cap_px)
}

/// A glyph on its way into an outline: where its base line begins, pixels, and pixels per unit.
struct Pen<'a> {
    outline: &'a mut Outline,
    at: (f32, f32),
    scale: f32,
}

impl Pen<'_> {
    fn px(&self, x: f32, y: f32) -> (f32, f32) {
        (self.at.0 + x * self.scale, self.at.1 - y * self.scale)
    }
}

impl OutlineBuilder for Pen<'_> {
    fn move_to(&mut self, x: f32, y: f32) {
        self.outline.move_to(self.px(x, y));
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.outline.line_to(self.px(x, y));
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        self.outline.curve_to(self.px(x1, y1), self.px(x, y));
    }

    fn curve_to(&mut self, _x1: f32, _y1: f32, _x2: f32, _y2: f32, _x: f32, _y: f32) {
        unreachable!("TrueType outlines are quadratic")
    }

    fn close(&mut self) {
        self.outline.close();
    }
}

/// Writes a text with the upper left corner of its capitals at a pixel; a halo keeps it apart from what is below.
fn write(canvas: &mut Canvas, text: &str, (x, y): (f32, f32), cap_px: f32, halo: bool) {
    let scale = scale(cap_px);
    let mut outline = Outline::new();
    let mut left = x;
    for (glyph, advance) in glyphs(text) {
        let mut pen = Pen { outline: &mut outline, at: (left, y + cap_px), scale };
        FONT.outline_glyph(glyph, &mut pen);
        left += advance * scale;
    }
    let Some(path) = outline.path() else { return };
    if halo {
        canvas.stroke_path(&path, canvas.palette().paper, 0.85, 3.0, true);
    }
    canvas.fill_path(&path, canvas.palette().ink, 1.0);
}

/// Most letters of a caption.
const LONGEST: usize = 200;

/// Height of capitals for an image, pixels.
fn cap_px(width: f32, height: f32) -> f32 {
    (width.min(height) / 56.0).clamp(7.0, 24.0)
}

/// Writes a caption on a light panel in the upper left corner, as small as it takes to fit.
pub(crate) fn caption(canvas: &mut Canvas, text: &str, (width, height): (f32, f32)) {
    // A long caption is made smaller, to fit; a name from a file can be longer than any image.
    let text: String = text.chars().take(LONGEST).collect();
    let units = width_px(&text, 1.0) + 3.4;
    let cap = cap_px(width, height).min(width / units);
    let (pad, margin) = (0.8 * cap, 0.9 * cap);
    let panel = (width_px(&text, cap) + 2.0 * pad, cap + 2.0 * pad);
    paper(canvas, (margin, margin), panel, cap);
    write(canvas, &text, (margin + pad, margin + pad), cap, false);
}

/// Draws a bar of a round number of metres in the lower left corner, about a fifth of the width.
pub(crate) fn scale_bar(canvas: &mut Canvas, (width, height): (f32, f32)) {
    let cap = cap_px(width, height);
    let room_m = 0.22 * width / canvas.view.px_per_m;
    let lengths = [0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0];
    let Some(metres) = lengths.into_iter().rfind(|m| *m <= room_m) else { return };
    let bar = metres * canvas.view.px_per_m;
    let (pad, margin) = (0.7 * cap, 0.9 * cap);
    let label = format!("{metres} m");
    let inner = bar.max(width_px(&label, cap));
    let panel = (inner + 2.0 * pad, 1.7 * cap + 2.0 * pad);
    let top = height - margin - panel.1;
    paper(canvas, (margin, top), panel, cap);
    let (left, base) = (margin + pad, top + panel.1 - pad);
    let mut line = Outline::new();
    line.move_to((left, base - 0.35 * cap));
    line.line_to((left, base));
    line.line_to((left + bar, base));
    line.line_to((left + bar, base - 0.35 * cap));
    canvas.stroke(line, canvas.palette().ink, 1.0, (0.14 * cap).max(1.0), false);
    let shift = 0.5 * (bar - width_px(&label, cap)).max(0.0);
    write(canvas, &label, (left + shift, top + pad), cap, false);
}

/// Writes names above agents; those of people where an image is larger still, those of obstacles never.
pub(crate) fn names(canvas: &mut Canvas, boxes: &[AgentBox], names: &[String], (width, height): (f32, f32)) {
    let cap = (0.7 * cap_px(width, height)).max(6.0);
    for (b, name) in boxes.iter().zip(names) {
        let least = match b.kind {
            AgentKind::Static => continue,
            AgentKind::Pedestrian => 14.0,
            _ => 3.5,
        };
        if canvas.view.px_per_m < least {
            continue;
        }
        let (x, y) = canvas.view.to_px(b.pose.position);
        let name: String = name.chars().take(LONGEST).collect();
        // clear of the box, whichever way it points
        let nose = canvas.local_px(&b.pose, 0.5 * b.length_m, 0.0).1 - y;
        let side = canvas.local_px(&b.pose, 0.0, 0.5 * b.width_m).1 - y;
        let above = (nose.abs() + side.abs()).max(4.0) + 3.0 + cap;
        write(canvas, &name, (x - 0.5 * width_px(&name, cap), y - above), cap, true);
    }
}

/// Writes what colours mean on a panel in the lower right corner; images without room for it go without.
pub(crate) fn legend(canvas: &mut Canvas, rows: &[(Rgb, String)], (width, height): (f32, f32)) {
    let cap = 0.85 * cap_px(width, height);
    let (pad, margin, line) = (0.8 * cap, 0.9 * cap, 1.9 * cap);
    let (swatch, gap) = (1.6 * cap, 0.7 * cap);
    let widest = rows.iter().map(|(_, title)| width_px(title, cap)).fold(0.0, f32::max);
    let panel = (swatch + gap + widest + 2.0 * pad, (rows.len() as f32 - 1.0) * line + cap + 2.0 * pad);
    if rows.is_empty() || panel.0 > 0.5 * width || panel.1 > 0.5 * height {
        return;
    }
    let (left, top) = (width - margin - panel.0, height - margin - panel.1);
    paper(canvas, (left, top), panel, cap);
    for (i, (rgb, title)) in rows.iter().enumerate() {
        let (x, y) = (left + pad, top + pad + i as f32 * line);
        canvas.fill(rounded((x, y), (swatch, cap), 0.3 * cap), *rgb, 1.0);
        write(canvas, title, (x + swatch + gap, y), cap, false);
    }
}

/// Lays a light panel under text.
fn paper(canvas: &mut Canvas, at: (f32, f32), size: (f32, f32), cap: f32) {
    canvas.fill(rounded(at, size, 0.6 * cap), canvas.palette().paper, 0.85);
}

/// A rectangle with round corners.
fn rounded((x, y): (f32, f32), (w, h): (f32, f32), r: f32) -> Outline {
    let mut outline = Outline::new();
    outline.move_to((x + r, y));
    outline.line_to((x + w - r, y));
    outline.curve_to((x + w, y), (x + w, y + r));
    outline.line_to((x + w, y + h - r));
    outline.curve_to((x + w, y + h), (x + w - r, y + h));
    outline.line_to((x + r, y + h));
    outline.curve_to((x, y + h), (x, y + h - r));
    outline.line_to((x, y + r));
    outline.curve_to((x, y), (x + r, y));
    outline.close();
    outline
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn latin_letters_are_drawn_apart_and_others_as_a_box() {
        let shape = |c: char| {
            let mut outline = Outline::new();
            let (glyph, _) = glyphs(&c.to_string()).next().unwrap();
            FONT.outline_glyph(glyph, &mut Pen { outline: &mut outline, at: (0.0, 0.0), scale: 1.0 });
            outline.path().map(|path| format!("{path:?}"))
        };
        let chars = ('!'..='~').chain('¡'..='ÿ').filter(|c| *c != '\u{ad}');
        let mut shapes: Vec<String> =
            chars.map(|c| shape(c).unwrap_or_else(|| panic!("{c} is blank"))).collect();
        let count = shapes.len();
        shapes.sort_unstable();
        shapes.dedup();
        assert_eq!(shapes.len(), count);
        assert_eq!(shape('道'), shape('\u{10ffff}'));
        assert_eq!(shape(' '), None);
    }

    #[test]
    fn figures_share_one_width() {
        let width = width_px("1", 12.0);
        assert!(('0'..='9').all(|c| width_px(&c.to_string(), 12.0) == width));
        assert_eq!(width_px("", 12.0), 0.0);
    }
}
