//! The finished image.

use crate::palette::Rgb;

/// An opaque image, row-major [H, W, 3] bytes, row 0 at the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    /// Width W, pixels.
    pub width: u32,
    /// Height H, pixels.
    pub height: u32,
    /// Red, green, blue of every pixel: H * W * 3 bytes.
    pub rgb: Vec<u8>,
}

impl Image {
    /// Colour of a pixel; `None` outside.
    pub fn pixel(&self, column: u32, row: u32) -> Option<Rgb> {
        if column >= self.width || row >= self.height {
            return None;
        }
        let at = 3 * (row as usize * self.width as usize + column as usize);
        self.rgb.get(at..at + 3).map(|c| Rgb(c[0], c[1], c[2]))
    }
}
