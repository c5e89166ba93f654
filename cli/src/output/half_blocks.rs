//! Pictures on a terminal: half blocks, two pixels per character, 24-bit colors.

use femc_film::{Image, Picture, ToneCurve};
use std::fmt::Write as _;

/// Available size for a picture in characters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DrawingSize {
    /// Characters per line.
    columns: u32,
    /// Number of lines.
    lines: u32,
}

impl DrawingSize {
    /// Largest width in characters, enough for a glance.
    const MAX_COLUMNS: u32 = 60;
    /// Lines reserved for other output.
    const RESERVED_LINES: u32 = 4;
    /// Smallest useful size.
    const MIN: Self = Self { columns: 20, lines: 5 };
    /// Default size if the terminal's size is not known.
    const DEFAULT: Self = Self { columns: Self::MAX_COLUMNS, lines: 20 };

    /// Returns the available size of the terminal at stderr, if it is large enough.
    pub fn from_stderr() -> Option<Self> {
        let (lines, columns) = console::Term::stderr().size_checked()?;
        let size = Self {
            columns: u32::from(columns).saturating_sub(1).min(Self::MAX_COLUMNS),
            lines: u32::from(lines).saturating_sub(Self::RESERVED_LINES),
        };
        (size.columns >= Self::MIN.columns && size.lines >= Self::MIN.lines).then_some(size)
    }

    /// Returns the available size of the terminal at stderr, or the default size if it is not known or too small.
    pub fn from_stderr_or_default() -> Self {
        Self::from_stderr().unwrap_or(Self::DEFAULT)
    }
}

/// Returns `image` as lines of half blocks that fit into `size`. Each line sets its colors and resets them at its end.
/// - `curve`: tone curve; black stays black.
pub fn draw(image: &Image, curve: ToneCurve, size: DrawingSize) -> String {
    // A line has two rows of pixels, so that pixels are square.
    let by_height = u64::from(2 * size.lines) * u64::from(image.width) / u64::from(image.height.max(1));
    let small = image.shrunk_to(size.columns.min(by_height.max(1) as u32));
    to_lines(&curve.picture(&small), size.lines)
}

/// Returns the first `most` lines. Only a film that is a hundred times as high as wide has more.
fn to_lines(picture: &Picture, most: u32) -> String {
    let width = picture.width.max(1) as usize;
    let rows = picture.pixels.chunks(2 * width).take(most as usize);
    rows.map(|rows| line(rows, width)).collect::<Vec<_>>().join("\n")
}

/// Returns one line from one or two rows of pixels.
fn line(rows: &[[u8; 3]], width: usize) -> String {
    let (upper, lower) = rows.split_at(width.min(rows.len()));
    let (mut text, mut last) = (String::new(), None);
    for (i, &above) in upper.iter().enumerate() {
        let below = lower.get(i).copied();
        // Writing to a string does not fail.
        if last != Some((above, below)) {
            let [r, g, b] = above;
            let _ = write!(text, "\x1b[38;2;{r};{g};{b}m");
            if let Some([r, g, b]) = below {
                let _ = write!(text, "\x1b[48;2;{r};{g};{b}m");
            }
            last = Some((above, below));
        }
        text.push('▀');
    }
    text + "\x1b[0m"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_rows_make_one_line_and_an_odd_row_keeps_the_background() {
        let (red, green, blue) = ([255, 0, 0], [0, 255, 0], [0, 0, 255]);
        let picture = Picture { width: 2, height: 3, pixels: vec![red, red, green, green, blue, red] };
        let expected = "\x1b[38;2;255;0;0m\x1b[48;2;0;255;0m▀▀\x1b[0m\n\
                        \x1b[38;2;0;0;255m▀\x1b[38;2;255;0;0m▀\x1b[0m";
        assert_eq!(to_lines(&picture, 20), expected);
    }

    #[test]
    fn a_picture_keeps_its_proportions_and_fits() {
        let size = |width, height, room| {
            let text = draw(&Image::filled(width, height, [1.0; 3]), ToneCurve { exposure: 1.0 }, room);
            let lines: Vec<&str> = text.lines().collect();
            (lines[0].matches('▀').count(), lines.len())
        };
        let room = DrawingSize { columns: 60, lines: 20 };
        assert_eq!(size(3840, 2160, room), (60, 17));
        assert_eq!(size(1080, 1920, room), (22, 20), "as high as there is room");
        assert_eq!(size(32, 16, room), (32, 8), "never enlarged");
        assert_eq!(size(10, 10_000, room), (1, 20));
    }

    #[test]
    fn unrendered_pixels_are_black_and_lit_ones_set_the_exposure() {
        let mut image = Image::filled(2, 2, [3.0; 3]);
        image.pixels[0] = [0.0; 3];
        let text = draw(&image, ToneCurve::auto([&image]), DrawingSize { columns: 60, lines: 20 });
        assert!(text.starts_with("\x1b[38;2;0;0;0m"), "{text:?}");
        let gray = ToneCurve::auto([&image]).picture(&Image::filled(1, 1, [3.0; 3])).pixels[0][0];
        assert!(text.contains(&format!("\x1b[48;2;{gray};{gray};{gray}m")) && gray > 90, "{text:?}");
    }
}
