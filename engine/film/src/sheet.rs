//! Contact sheets with text: rows of pictures, with a title for each row and a caption for each picture.
//!
//! The font is Noto Sans Mono, 16 pixels high; characters that are not in this Latin font show as `?`.

use crate::Picture;
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, RasterizedChar, get_raster};

/// A row of pictures.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SheetRow {
    /// Title above the row; empty: no line is reserved for it.
    pub title: String,
    /// Cells from left to right.
    pub cells: Vec<SheetCell>,
}

/// A picture and its caption.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SheetCell {
    /// The picture.
    pub picture: Picture,
    /// Caption below the picture; cut off at the end of the cell.
    pub caption: String,
}

/// Pixels between and around everything.
const GAP: u32 = 6;
/// Height of a line of text, pixels.
const LINE_HEIGHT: u32 = 18;
/// Minimum width of a cell, pixels: captions of a dozen letters.
const MIN_CELL_WIDTH: u32 = 96;
const WEIGHT: FontWeight = FontWeight::Regular;
const HEIGHT: RasterHeight = RasterHeight::Size16;
const PAPER: [u8; 3] = [24, 24, 24];
const TITLE: [u8; 3] = [255, 255, 255];
const CAPTION: [u8; 3] = [176, 176, 176];

/// Lays out `rows`, with every picture in a cell of the largest one's size. Without rows, the sheet is empty and one gap in size.
pub fn labeled_sheet(rows: &[SheetRow]) -> Picture {
    let cells = || rows.iter().flat_map(|row| &row.cells);
    let cell_width = cells().map(|cell| cell.picture.width).max().unwrap_or(0).max(MIN_CELL_WIDTH);
    let columns = rows.iter().map(|row| row.cells.len() as u32).max().unwrap_or(0);
    let letter = letter('m').width() as u32;
    let titles = rows.iter().map(|row| row.title.chars().count() as u32 * letter).max().unwrap_or(0);
    let (heights, width) = (rows.iter().map(row_height), (columns * (cell_width + GAP)).max(titles + GAP) + GAP);
    let height = GAP + heights.sum::<u32>();
    let mut sheet = Picture { width, height, pixels: vec![PAPER; width as usize * height as usize] };
    let mut top = GAP;
    for row in rows {
        let mut y = top;
        if !row.title.is_empty() {
            sheet.write(&row.title, [GAP, y], width - GAP, TITLE);
            y += LINE_HEIGHT;
        }
        let below = y + picture_height(row);
        for (x, cell) in (GAP..).step_by((cell_width + GAP) as usize).zip(&row.cells) {
            sheet.put(&cell.picture, [x, y]);
            sheet.write(&cell.caption, [x, below], x + cell_width, CAPTION);
        }
        top += row_height(row);
    }
    sheet
}

fn picture_height(row: &SheetRow) -> u32 {
    row.cells.iter().map(|cell| cell.picture.height).max().unwrap_or(0)
}

/// Returns the height of a row, including the gap below it.
fn row_height(row: &SheetRow) -> u32 {
    let title = if row.title.is_empty() { 0 } else { LINE_HEIGHT };
    let captions = if row.cells.iter().all(|cell| cell.caption.is_empty()) { 0 } else { LINE_HEIGHT };
    title + picture_height(row) + captions + GAP
}

fn letter(c: char) -> RasterizedChar {
    let unknown = || get_raster('?', WEIGHT, HEIGHT);
    get_raster(c, WEIGHT, HEIGHT).or_else(unknown).expect("the font has a question mark")
}

impl Picture {
    fn put(&mut self, picture: &Self, [left, top]: [u32; 2]) {
        for (y, row) in (0..picture.height).zip(picture.pixels.chunks(picture.width.max(1) as usize)) {
            let start = (top + y) as usize * self.width as usize + left as usize;
            self.pixels[start..start + row.len()].copy_from_slice(row);
        }
    }

    /// Writes a line of text; letters that would not end before `right` are left out.
    fn write(&mut self, text: &str, [left, top]: [u32; 2], right: u32, ink: [u8; 3]) {
        let mut x = left;
        for c in text.chars() {
            let letter = letter(c);
            if x + letter.width() as u32 > right.min(self.width) {
                break;
            }
            for (row, line) in letter.rows().enumerate() {
                let start = (top as usize + row) * self.width as usize + x as usize;
                let pixels = self.pixels.get_mut(start..start + line.len()).into_iter().flatten();
                pixels.zip(line.iter()).for_each(|(pixel, cover)| *pixel = blend(*pixel, ink, *cover));
            }
            x += letter.width() as u32;
        }
    }
}

/// Blends `ink` over `paper`; a `cover` of 255 hides the paper.
fn blend(paper: [u8; 3], ink: [u8; 3], cover: u8) -> [u8; 3] {
    let cover = u16::from(cover);
    std::array::from_fn(|i| ((u16::from(paper[i]) * (255 - cover) + u16::from(ink[i]) * cover) / 255) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(width: u32, height: u32, value: u8, caption: &str) -> SheetCell {
        let picture = Picture { width, height, pixels: vec![[value, 0, 0]; (width * height) as usize] };
        SheetCell { picture, caption: caption.into() }
    }

    fn inked(sheet: &Picture, rows: std::ops::Range<u32>) -> usize {
        let width = sheet.width as usize;
        sheet.pixels[rows.start as usize * width..rows.end as usize * width].iter().filter(|p| p[0] > 100).count()
    }

    #[test]
    fn a_sheet_holds_every_picture_whole_and_every_line_of_text() {
        let rows = [
            SheetRow { title: "sigma_s = 0.01".into(), cells: vec![cell(100, 10, 60, "frame 1"), cell(90, 8, 61, "")] },
            SheetRow { title: String::new(), cells: vec![cell(100, 10, 62, "")] },
        ];
        let sheet = labeled_sheet(&rows);
        assert_eq!(
            (sheet.width, sheet.height),
            (2 * 106 + GAP, GAP + (LINE_HEIGHT + 10 + LINE_HEIGHT + GAP) + (10 + GAP))
        );
        for (value, area) in [(60, 1000), (61, 720), (62, 1000)] {
            assert_eq!(sheet.pixels.iter().filter(|pixel| **pixel == [value, 0, 0]).count(), area, "picture {value}");
        }
        assert!(inked(&sheet, GAP..GAP + LINE_HEIGHT) > 50, "the title is written");
        assert!(
            inked(&sheet, GAP + LINE_HEIGHT + 10..GAP + LINE_HEIGHT + 10 + LINE_HEIGHT) > 20,
            "the caption is written"
        );
    }

    #[test]
    fn caption_stays_in_its_cell_and_unknown_letters_are_replaced() {
        let long = "\u{4e2d}".repeat(40);
        let sheet = labeled_sheet(&[SheetRow {
            title: String::new(),
            cells: vec![cell(100, 4, 0, &long), cell(100, 4, 0, "")],
        }]);
        let right_of_cell = |at: usize| at % sheet.width as usize >= (GAP + 100) as usize;
        let strays = sheet.pixels.iter().enumerate().filter(|(at, pixel)| right_of_cell(*at) && pixel[0] > 100);
        assert_eq!(strays.count(), 0);
        assert!(inked(&sheet, GAP + 4..GAP + 4 + LINE_HEIGHT) > 20);
        assert_eq!(labeled_sheet(&[]).pixels.len(), (GAP * 2 * GAP) as usize);
    }
}
