//! Writes a scene file: vertices by position, faces, prisms, and balanced transforms.
//!
//! Coordinates are rounded to 0.01 mm. Vertices that coincide after rounding share one name, which keeps meshes small. The price is
//! a prefix per file, because included files share one name space.

use femc_math::elementary::double;
use std::collections::BTreeMap;
use std::fmt::Write;

/// A point, m.
pub type Point = [f64; 3];

const UNITS_PER_METER: f64 = 1e5;

/// A file under construction.
pub struct MgfWriter {
    text: String,
    prefix: &'static str,
    vertex_names: BTreeMap<[i64; 3], usize>,
    open_transforms: u32,
}

impl MgfWriter {
    /// Begins a file.
    /// - `prefix`: begins every vertex name; differs between files that include each other.
    pub fn new(prefix: &'static str) -> Self {
        Self { text: String::new(), prefix, vertex_names: BTreeMap::new(), open_transforms: 0 }
    }

    /// Adds lines of `words` unchanged, with a line end if it is missing.
    pub fn write_lines(&mut self, words: &str) {
        self.text.push_str(words);
        if !words.ends_with('\n') {
            self.text.push('\n');
        }
    }

    /// Pushes a transform.
    pub fn push_transform(&mut self, arguments: &str) {
        let _ = writeln!(self.text, "xf {arguments}");
        self.open_transforms += 1;
    }

    /// Pops the transform that was pushed last.
    pub fn pop_transform(&mut self) {
        debug_assert!(self.open_transforms > 0, "nothing is open");
        self.open_transforms -= 1;
        self.write_lines("xf");
    }

    /// Makes `name` the current material.
    pub fn material(&mut self, name: &str) {
        let _ = writeln!(self.text, "m {name}");
    }

    /// Includes `path` with the transform `arguments`.
    pub fn include(&mut self, path: &str, arguments: &str) {
        self.write_lines(format!("i {path} {arguments}").trim_end());
    }

    /// Adds a planar polygon, counterclockwise seen from its front.
    pub fn face(&mut self, corners: &[Point]) {
        let names = self.vertices(corners);
        let _ = writeln!(self.text, "f{names}");
    }

    /// Adds a closed prism. One end is `corners` (its normal points out), and the prism reaches `length` behind it.
    pub fn prism(&mut self, corners: &[Point], length: f64) {
        let names = self.vertices(corners);
        let _ = writeln!(self.text, "prism{names} {}", number(length));
    }

    /// Adds an upright box from `low` to `high`.
    pub fn block(&mut self, low: Point, high: Point) {
        let z = high[2];
        self.prism(
            &[[low[0], low[1], z], [high[0], low[1], z], [high[0], high[1], z], [low[0], high[1], z]],
            high[2] - low[2],
        );
    }

    /// Adds a straight rod of regular cross-section from `start` to `end`, which must differ.
    pub fn rod(&mut self, start: Point, end: Point, radius: f64, sides: u32) {
        let axis = subtract(end, start);
        let length = dot(axis, axis).sqrt();
        let w = scale(axis, 1.0 / length);
        let helper = if w[2].abs() > 0.9 { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] };
        let u = unit(cross(helper, w));
        let v = cross(w, u);
        let corners: Vec<Point> = (0..sides)
            .map(|k| {
                let (s, c) = sin_cos_degrees(f64::from(k) * 360.0 / f64::from(sides));
                add(end, add(scale(u, radius * c), scale(v, radius * s)))
            })
            .collect();
        self.prism(&corners, length);
    }

    /// Returns the text. All transforms must be closed.
    pub fn finish(self) -> String {
        debug_assert!(self.open_transforms == 0, "{} transforms are open", self.open_transforms);
        self.text
    }

    fn vertices(&mut self, corners: &[Point]) -> String {
        let mut names = String::new();
        for corner in corners {
            let key = corner.map(|x| (x * UNITS_PER_METER).round() as i64);
            let next = self.vertex_names.len();
            let index = *self.vertex_names.entry(key).or_insert_with(|| {
                let [x, y, z] = corner.map(number);
                let _ = writeln!(self.text, "v {}{next} =\n\tp {x} {y} {z}", self.prefix);
                next
            });
            let _ = write!(names, " {}{index}", self.prefix);
        }
        names
    }
}

/// Formats `x` with at most five decimals.
pub fn number(x: f64) -> String {
    let rounded = (x * UNITS_PER_METER).round() as i64;
    let (whole, part) = (rounded.unsigned_abs() / 100_000, rounded.unsigned_abs() % 100_000);
    let sign = if rounded < 0 { "-" } else { "" };
    let digits = format!("{part:05}");
    match digits.trim_end_matches('0') {
        "" => format!("{sign}{whole}"),
        decimals => format!("{sign}{whole}.{decimals}"),
    }
}

/// Returns sine and cosine of `degrees`.
pub fn sin_cos_degrees(degrees: f64) -> (f64, f64) {
    double::sin_cos(degrees.to_radians())
}

/// Returns the point at `radius`, `degrees` about z, and height `z`.
pub fn polar(radius: f64, degrees: f64, z: f64) -> Point {
    let (s, c) = sin_cos_degrees(degrees);
    [radius * c, radius * s, z]
}

/// Computes a + b.
pub fn add(a: Point, b: Point) -> Point {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// Computes a - b.
pub fn subtract(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Computes f a.
pub fn scale(a: Point, f: f64) -> Point {
    a.map(|x| x * f)
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Point, b: Point) -> Point {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(a: Point) -> Point {
    scale(a, 1.0 / dot(a, a).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_keep_five_decimals() {
        assert_eq!(
            [0.0, -0.000_001, 1.5, -2.0, 0.000_01, 12.345_678].map(number),
            ["0", "0", "1.5", "-2", "0.00001", "12.34568"]
        );
    }

    #[test]
    fn coinciding_vertices_are_written_once_and_transforms_close() {
        let mut writer = MgfWriter::new("a");
        writer.push_transform("-s 2");
        writer.push_transform("-rz 10");
        writer.face(&[[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]);
        writer.face(&[[0.0; 3], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]);
        writer.pop_transform();
        writer.pop_transform();
        let text = writer.finish();
        assert_eq!(text.matches("v a").count(), 4);
        assert!(text.ends_with("f a0 a2 a3\nxf\nxf\n"), "{text}");
    }

    #[test]
    fn a_rod_ends_where_it_should() {
        let mut writer = MgfWriter::new("a");
        writer.rod([0.0; 3], [0.0, 0.0, 2.0], 0.1, 6);
        let text = writer.finish();
        assert_eq!(text.matches(" 2\n").count(), 7, "six corners at z = 2 and the length: {text}");
    }
}
