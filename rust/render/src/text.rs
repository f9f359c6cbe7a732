//! A small stroke font and what is written with it: the caption, names, the legend and the scale bar.
//!
//! Glyphs are polylines on a grid 4 wide and 6 high (x to the right, y down; small letters begin at 2 and may reach
//! down to 8), two digits per point, lines apart by `|`. They are stroked with round ends, so they stay smooth at any size.

use crate::agents::AgentBox;
use crate::canvas::{Canvas, Outline};
use crate::palette::Rgb;
use ccdiff_sim::scene::AgentKind;

/// Height of a capital, grid units.
const CAP: f32 = 6.0;
/// Space after a glyph, grid units.
const GAP: f32 = 2.0;
/// Width of a grid unit as part of its height.
const NARROW: f32 = 0.82;

/// The lines of a glyph. Empty: a blank.
fn glyph(c: char) -> &'static str {
    match c {
        '0' => "10 30 41 45 36 16 05 01 10",
        '1' => "12 20 26|16 36",
        '2' => "01 10 30 41 42 06 46",
        '3' => "01 10 30 41 42 33 44 45 36 16 05|23 33",
        '4' => "36 30 04 44",
        '5' => "40 00 03 12 32 43 45 36 16 05",
        '6' => "41 30 10 01 05 16 36 45 44 33 13 04",
        '7' => "00 40 41 16",
        '8' => "13 02 01 10 30 41 42 33 13 04 05 16 36 45 44 33",
        '9' => "05 16 36 45 41 30 10 01 02 13 33 42",
        'A' => "06 02 20 42 46|04 44",
        'B' => "03 33 42 41 30 00 06 36 45 44 33",
        'C' => "41 30 10 01 05 16 36 45",
        'D' => "00 30 41 45 36 06 00",
        'E' => "40 00 06 46|03 33",
        'F' => "40 00 06|03 33",
        'G' => "41 30 10 01 05 16 36 45 43 23",
        'H' => "00 06|40 46|03 43",
        'I' => "10 30|20 26|16 36",
        'J' => "40 45 36 16 05",
        'K' => "00 06|40 03 46",
        'L' => "00 06 46",
        'M' => "06 00 23 40 46",
        'N' => "06 00 46 40",
        'O' => "10 30 41 45 36 16 05 01 10",
        'P' => "06 00 30 41 42 33 03",
        'Q' => "10 30 41 45 36 16 05 01 10|24 46",
        'R' => "06 00 30 41 42 33 03|23 46",
        'S' => "41 30 10 01 02 13 33 44 45 36 16 05",
        'T' => "00 40|20 26",
        'U' => "00 05 16 36 45 40",
        'V' => "00 26 40",
        'W' => "00 16 22 36 40",
        'X' => "00 46|40 06",
        'Y' => "00 23 40|23 26",
        'Z' => "00 40 06 46",
        'a' => "43 32 12 03 05 16 36 45|42 46",
        'b' => "00 06|03 12 32 43 45 36 16 05",
        'c' => "43 32 12 03 05 16 36 45",
        'd' => "43 32 12 03 05 16 36 45|40 46",
        'e' => "04 44 43 32 12 03 05 16 36 45",
        'f' => "30 20 11 16|02 32",
        'g' => "43 32 12 03 05 16 36 45|42 47 38 18 07",
        'h' => "00 06|03 12 32 43 46",
        'i' => "22 26|20 20",
        'j' => "32 37 28 18|30 30",
        'k' => "00 06|32 04 36",
        'l' => "20 25 36",
        'm' => "06 02|03 12 23 26|23 32 43 46",
        'n' => "02 06|03 12 32 43 46",
        'o' => "12 32 43 45 36 16 05 03 12",
        'p' => "02 08|03 12 32 43 45 36 16 05",
        'q' => "43 32 12 03 05 16 36 45|42 48",
        'r' => "02 06|03 12 32",
        's' => "43 32 12 03 14 34 45 36 16 05",
        't' => "10 15 26 36|02 32",
        'u' => "02 05 16 36 45|42 46",
        'v' => "02 26 42",
        'w' => "02 16 23 36 42",
        'x' => "02 46|06 42",
        'y' => "02 26|42 18 08",
        'z' => "02 42 06 46",
        ',' => "26 17",
        '(' => "20 11 15 26",
        ')' => "10 21 25 16",
        '.' => "16 16",
        ':' => "12 12|15 15",
        '-' => "13 33",
        '+' => "03 43|21 25",
        '=' => "02 42|04 44",
        '/' => "06 40",
        '_' => "06 46",
        _ => "",
    }
}

/// Points of a glyph's lines, grid units.
fn strokes(c: char) -> impl Iterator<Item = impl Iterator<Item = (f32, f32)>> {
    let number = |b: u8| f32::from(b.saturating_sub(b'0'));
    let lines = glyph(c).split('|').filter(|l| !l.is_empty());
    lines.map(move |line| {
        let pairs = line.split(' ').filter_map(|p| p.as_bytes().first_chunk::<2>());
        pairs.map(move |[x, y]| (number(*x), number(*y)))
    })
}

/// Left edge and width of a glyph, grid units. Figures all have one width: a clock does not jump.
fn extent(c: char) -> (f32, f32) {
    let xs = || strokes(c).flatten().map(|(x, _)| x);
    if c.is_ascii_digit() || glyph(c).is_empty() {
        return (0.0, if c == ' ' { 1.5 } else { 4.0 });
    }
    let left = xs().fold(4.0, f32::min);
    (left, xs().fold(0.0, f32::max) - left)
}

/// Width of a text whose capitals are `cap_px` high, pixels.
fn width_px(text: &str, cap_px: f32) -> f32 {
    let units: f32 = text.chars().map(|c| extent(c).1 + GAP).sum();
    (units - GAP).max(0.0) * NARROW * cap_px / CAP
}

/// Writes a text with its upper left corner at a pixel; a halo keeps it apart from what is below.
fn write(canvas: &mut Canvas, text: &str, (x, y): (f32, f32), cap_px: f32, halo: bool) {
    let unit = cap_px / CAP;
    let mut outline = Outline::new();
    let mut pen = x;
    for c in text.chars() {
        let (left, width) = extent(c);
        for line in strokes(c) {
            for (i, (gx, gy)) in line.enumerate() {
                let at = (pen + (gx - left) * NARROW * unit, y + gy * unit);
                if i == 0 {
                    outline.move_to(at);
                } else {
                    // A point is a line of next to no length: its round ends draw it.
                    outline.line_to((at.0 + 0.01, at.1));
                }
            }
        }
        pen += (width + GAP) * NARROW * unit;
    }
    let Some(path) = outline.path() else { return };
    let width = (0.16 * cap_px).max(1.1);
    if halo {
        canvas.stroke_path(&path, canvas.palette().paper, 0.85, width + 3.0, true);
    }
    canvas.stroke_path(&path, canvas.palette().ink, 1.0, width, true);
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
    let mut outline = Outline::new();
    rounded(&mut outline, (margin, margin), panel, 0.6 * cap);
    canvas.fill(outline, canvas.palette().paper, 0.85);
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
    let mut outline = Outline::new();
    rounded(&mut outline, (margin, top), panel, 0.6 * cap);
    canvas.fill(outline, canvas.palette().paper, 0.85);
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
        let above = canvas.px(0.5 * b.width_m, 4.0) + 3.0 + cap;
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
    let mut outline = Outline::new();
    rounded(&mut outline, (left, top), panel, 0.6 * cap);
    canvas.fill(outline, canvas.palette().paper, 0.85);
    for (i, (rgb, title)) in rows.iter().enumerate() {
        let (x, y) = (left + pad, top + pad + i as f32 * line);
        let mut dot = Outline::new();
        rounded(&mut dot, (x, y), (swatch, cap), 0.3 * cap);
        canvas.fill(dot, *rgb, 1.0);
        write(canvas, title, (x + swatch + gap, y), cap, false);
    }
}

/// Adds a rectangle with round corners.
fn rounded(outline: &mut Outline, (x, y): (f32, f32), (w, h): (f32, f32), r: f32) {
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
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_glyph_stays_on_its_grid_and_no_two_but_o_and_zero_look_alike() {
        let chars: Vec<char> = ('0'..='9').chain('A'..='Z').chain('a'..='z').collect();
        for c in &chars {
            assert!(strokes(*c).count() > 0, "{c}");
            let lowest = if "gjpqy".contains(*c) { 8.0 } else { CAP };
            assert!(strokes(*c).flatten().all(|(x, y)| x <= 4.0 && y <= lowest), "{c}");
        }
        let mut shapes: Vec<&str> = chars.iter().filter(|c| **c != 'O').map(|c| glyph(*c)).collect();
        let count = shapes.len();
        shapes.sort_unstable();
        shapes.dedup();
        assert_eq!(shapes.len(), count);
    }

    #[test]
    fn figures_share_one_width() {
        let width = width_px("1", 12.0);
        assert!(('0'..='9').all(|c| width_px(&c.to_string(), 12.0) == width));
        assert_eq!(width_px("", 12.0), 0.0);
    }
}
