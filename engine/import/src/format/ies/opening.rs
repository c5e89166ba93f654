//! Luminous openings: the signs of width (y), length (x) and height define their shape.
//!
//! Zeros make a point, positive sizes a box. Negative sizes are diameters of round shapes, according to two tables. Parentheses
//! mark signs that the editions of a column do not define; they have the meaning of the other column.
//!
//! | width, length, height | 1986 to 1995 | since 2002 |
//! | --- | --- | --- |
//! | -d 0 0 | circle | (as before) |
//! | -d 0 h | upright cylinder | (as before) |
//! | -d 0 -d | sphere | upright disk |
//! | 0 l -d; w 0 -d | lying cylinder | (as before) |
//! | -w l h; w -l h | ellipse | (as before) |
//! | -w l -h; w -l -h | ellipsoid | lying cylinder |
//! | -d -d 0; -d -d h | (as since 2002) | circle, upright cylinder |
//! | -w -l 0; -w -l h | (as since 2002) | ellipse, elliptic cylinder |
//! | -d -d -d; -w -l -h | (as since 2002) | sphere, ellipsoid |
//!
//! No edition defines `w l -h`: it is a box.

use super::edition::Edition;
use femc_math::elementary::double::cbrt;
use femc_scene::Opening;

const LINE: &str = "luminous opening is a line: treated as a point";
const ELLIPSE: &str = "elliptic luminous opening: treated as a circle of the same area";
const ELLIPSOID: &str = "ellipsoidal luminous opening: treated as a sphere of the same volume";
const LYING: &str = "round luminous opening with a horizontal axis: treated as its bounding box";

/// Returns the luminous opening of `size` (width, length and height in meters). Round shapes that the description cannot represent
/// become their box or their mean, with a remark.
pub(super) fn opening(edition: Edition, size: [f64; 3]) -> (Opening, Option<&'static str>) {
    let [w, l, h] = size.map(f64::abs);
    let [negative_w, negative_l, negative_h] = size.map(|x| x < 0.0);
    let around = Opening::Box { width: w, length: l, height: h };
    let sizes = size.iter().filter(|&&x| x != 0.0).count();
    match (negative_w, negative_l, negative_h) {
        _ if sizes == 0 => (Opening::Point, None),
        (false, false, _) if sizes == 1 => (Opening::Point, Some(LINE)),
        (false, false, false) => (around, None),
        (false, false, true) if w == 0.0 => (Opening::Box { width: h, length: l, height: h }, Some(LYING)),
        (false, false, true) if l == 0.0 => (Opening::Box { width: w, length: h, height: h }, Some(LYING)),
        (false, false, true) => (around, Some(LYING)),
        (true, true, false) | (true, false, false) | (false, true, false) => {
            let (diameter, ellipse) = circle_diameter(w, l);
            (Opening::Cylinder { diameter, height: h }, ellipse.then_some(ELLIPSE))
        }
        (true, false, true) | (false, true, true) if edition.has_shapes_of_2002() => (around, Some(LYING)),
        (true, _, true) | (_, true, true) => {
            let (across, ellipse) = circle_diameter(w, l);
            let sphere = !ellipse && h == across;
            (Opening::Sphere { diameter: cbrt(across * across * h) }, (!sphere).then_some(ELLIPSOID))
        }
    }
}

/// Returns the diameter of the circle with the area of an ellipse, and whether the sizes differ. A size of 0 is replaced by the
/// other size.
fn circle_diameter(a: f64, b: f64) -> (f64, bool) {
    if a == 0.0 || b == 0.0 || a == b {
        return (a.max(b), false);
    }
    ((a * b).sqrt(), true)
}
