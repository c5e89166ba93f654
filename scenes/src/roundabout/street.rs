//! Carriageway, kerbs, markings and the islands.
//!
//! The kerb line of a quarter runs from the right edge of the south approach through a 12 m fillet to the ring's outer circle and,
//! mirrored, to the edge of the east approach. Everything outside is offset from it along its normal.

use super::sign;
use crate::mgf_writer::{MgfWriter, Point, polar, scale, sin_cos_degrees};

/// Half width of an approach, m.
const HALF: f64 = 4.0;
/// Outer radius of the ring, followed by the inner radius of the ring and the radius of the island, m.
const OUTER: f64 = 18.0;
const INNER: f64 = 11.5;
const ISLAND: f64 = 10.0;
/// Distance of the edge of the world, m.
const EDGE: f64 = 105.0;
/// Radius of the fillet, followed by the distance of its center along the approach: (HALF + FILLET)^2 + REACH^2 = (OUTER +
/// FILLET)^2.
const FILLET: f64 = 12.0;
/// Height of the kerbs and the ground behind them, followed by that of paint on the asphalt.
const KERB: f64 = 0.12;
const PAINT: f64 = 0.005;

fn reach() -> f64 {
    ((OUTER + FILLET).powi(2) - (HALF + FILLET).powi(2)).sqrt()
}

/// Returns the angle between the approach's axis and the point where the fillet meets the ring.
fn mouth() -> f64 {
    femc_math::elementary::double::atan2(HALF + FILLET, reach()).to_degrees()
}

/// Returns points with outward normals (away from the road) along the right side of the south approach, from the approach to the
/// ring.
fn fillet(steps: u32) -> Vec<[f64; 4]> {
    // Seen from the fillet's center, the arc goes from 180 degrees down to the direction of the ring's center.
    let last = 90.0 + mouth();
    (0..=steps)
        .map(|k| {
            let (s, c) = sin_cos_degrees(180.0 + (last - 180.0) * f64::from(k) / f64::from(steps));
            [HALF + FILLET + FILLET * c, -reach() + FILLET * s, -c, -s]
        })
        .collect()
}

/// Returns the kerb line of the south-east quarter with its outward normals.
fn kerb_line() -> Vec<[f64; 4]> {
    let mut half: Vec<[f64; 4]> = [EDGE, 85.0, 65.0, 50.0, 38.0, 31.0].map(|y| [HALF, -y, 1.0, 0.0]).to_vec();
    half.extend(fillet(8));
    let (start, end) = (mouth() - 90.0, -45.0);
    for k in 1..=3 {
        let (s, c) = sin_cos_degrees(start + (end - start) * f64::from(k) / 3.0);
        half.push([OUTER * c, OUTER * s, c, s]);
    }
    let mirrored: Vec<[f64; 4]> = half.iter().rev().skip(1).map(|&[x, y, nx, ny]| [-y, -x, -ny, -nx]).collect();
    half.extend(mirrored);
    half
}

fn offset(at: [f64; 4], distance: f64, z: f64) -> Point {
    [at[0] + distance * at[2], at[1] + distance * at[3], z]
}

/// Asphalt: the ring and the approaches, one quarter repeated four times.
pub fn carriageway() -> String {
    let mut writer = MgfWriter::new("a");
    writer.write_lines("# Asphalt, z = 0.");
    writer.material("asphalt");
    writer.push_transform("-a 4 -rz 90");
    let mouth = mouth();
    // Angles of a quarter: over the approach's mouth, then along the quarter's kerb to the next mouth.
    let over: Vec<f64> = (0..=12).map(|k| -90.0 + mouth * (f64::from(k) / 6.0 - 1.0)).collect();
    let along = (1..=6).map(|k| -90.0 + mouth + (90.0 - 2.0 * mouth) * f64::from(k) / 6.0);
    let angles: Vec<f64> = over.iter().copied().chain(along).collect();
    for radii in [[INNER - 0.1, 14.7], [14.7, OUTER]] {
        for a in angles.windows(2) {
            let corner = |r: usize, k: usize| polar(radii[r], a[k], 0.0);
            writer.face(&[corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)]);
        }
    }
    // The mouth: between the ring's circle and the two fillets.
    let right = fillet(8);
    let mut outline: Vec<Point> = right.iter().map(|p| [p[0], p[1], 0.0]).collect();
    outline.extend(over.iter().rev().skip(1).map(|&a| polar(OUTER, a, 0.0)));
    outline.extend(right.iter().rev().skip(1).map(|p| [-p[0], p[1], 0.0]));
    writer.face(&outline);
    for y in [reach(), 31.0, 38.0, 50.0, 65.0, 85.0, EDGE].windows(2) {
        for x in [[-HALF, 0.0], [0.0, HALF]] {
            writer.face(&[[x[0], -y[1], 0.0], [x[1], -y[1], 0.0], [x[1], -y[0], 0.0], [x[0], -y[0], 0.0]]);
        }
    }
    writer.pop_transform();
    writer.finish()
}

/// Kerbs, verges, markings, splitter island, bollards and signs of the south approach and the south-east corner.
pub fn quarter() -> String {
    let mut writer = MgfWriter::new("q");
    writer.write_lines("# The south approach and the south-east corner: everything on and beside the asphalt.");
    verge(&mut writer);
    splitter(&mut writer);
    markings(&mut writer);
    bollards(&mut writer);
    sign::approach(&mut writer);
    writer.finish()
}

fn verge(writer: &mut MgfWriter) {
    let line = kerb_line();
    let strip = |writer: &mut MgfWriter, from: (f64, f64), to: (f64, f64)| {
        for p in line.windows(2) {
            writer.face(&[
                offset(p[0], from.0, from.1),
                offset(p[0], to.0, to.1),
                offset(p[1], to.0, to.1),
                offset(p[1], from.0, from.1),
            ]);
        }
    };
    writer.material("kerbstone");
    strip(writer, (0.0, -0.05), (0.0, KERB));
    strip(writer, (0.0, KERB), (0.16, KERB));
    writer.material("paving");
    strip(writer, (0.16, KERB), (2.16, KERB));
    writer.material("grass");
    let mut outline: Vec<Point> = line.iter().map(|&p| offset(p, 2.16, KERB)).collect();
    outline.push([EDGE, -EDGE, KERB]);
    outline.reverse();
    writer.face(&outline);
}

/// Adds the splitter island: two parts with a crossing between them.
fn splitter(writer: &mut MgfWriter) {
    let parts: [&[[f64; 2]]; 2] = [
        &[[1.35, -20.4], [1.0, -20.0], [-1.0, -20.0], [-1.35, -20.4], [-1.05, -24.0], [1.05, -24.0]],
        &[[0.8, -28.0], [-0.8, -28.0], [-0.35, -37.6], [0.0, -38.2], [0.35, -37.6]],
    ];
    for part in parts {
        let ring = |shrink: f64, z: f64| -> Vec<Point> {
            let n = part.len() as f64;
            let middle = part.iter().fold([0.0; 2], |m, p| [m[0] + p[0] / n, m[1] + p[1] / n]);
            part.iter()
                .map(|p| {
                    let d = [p[0] - middle[0], p[1] - middle[1]];
                    [middle[0] + d[0] * shrink, middle[1] + d[1] * (1.0 - (1.0 - shrink) * 0.4), z]
                })
                .collect()
        };
        writer.material("kerbstone");
        writer.prism(&ring(1.0, KERB), KERB + 0.05);
        writer.material("paving");
        writer.prism(&ring(0.8, KERB + 0.02), 0.05);
    }
}

fn bar(writer: &mut MgfWriter, low: [f64; 2], high: [f64; 2]) {
    writer.face(&[
        [low[0], low[1], PAINT],
        [high[0], low[1], PAINT],
        [high[0], high[1], PAINT],
        [low[0], high[1], PAINT],
    ]);
}

/// Adds a flat outline on the asphalt at (x, y).
fn glyph(writer: &mut MgfWriter, outline: &[[f64; 2]], x: f64, y: f64) {
    let corners: Vec<Point> = outline.iter().map(|p| [p[0] + x, p[1] + y, PAINT]).collect();
    writer.face(&corners);
}

fn markings(writer: &mut MgfWriter) {
    writer.material("paint");
    // Zebra crossing through the gap of the splitter island.
    for x in [1.15, 2.15, 3.15] {
        bar(writer, [x, -27.5], [x + 0.5, -24.5]);
        bar(writer, [-x - 0.5, -27.5], [-x, -24.5]);
    }
    // Center dashes and edge lines of the approach.
    writer.push_transform("-a 7 -t 0 -9 0");
    bar(writer, [-0.06, -43.0], [0.06, -40.0]);
    writer.pop_transform();
    for y in [[-104.0, -80.0], [-79.0, -60.0], [-59.0, -44.0], [-43.0, -32.0]] {
        bar(writer, [3.68, y[0]], [3.8, y[1]]);
        bar(writer, [-3.8, y[0]], [-3.68, y[1]]);
    }
    let arrow = [[-0.07, 0.0], [0.07, 0.0], [0.07, 2.2], [0.3, 2.2], [0.0, 3.4], [-0.3, 2.2], [-0.07, 2.2]];
    glyph(writer, &arrow, 2.1, -48.0);
    // Give-way teeth across the entry, which point at the driver, and the broken line across the exit.
    for k in 0..6 {
        let middle = -84.0 + 3.4 * f64::from(k);
        let tip = 18.95;
        writer.face(&[polar(tip, middle, PAINT), polar(18.3, middle + 0.9, PAINT), polar(18.3, middle - 0.9, PAINT)]);
    }
    for k in 0..5 {
        let middle = -97.5 - 4.0 * f64::from(k);
        arc(writer, 18.2, 18.4, middle - 1.0, middle + 1.0);
    }
    // Edge lines of the ring, and two arrows.
    for k in 0..15 {
        let start = -90.0 + 6.0 * f64::from(k);
        arc(writer, 11.75, 11.87, start, start + 6.0);
    }
    for k in 0..5 {
        let start = -57.0 + 4.8 * f64::from(k);
        arc(writer, 17.6, 17.72, start, start + 4.8);
    }
    writer.push_transform("-t 14.6 0 0 -rz -28");
    glyph(writer, &arrow, 0.0, 0.0);
    writer.pop_transform();
}

fn arc(writer: &mut MgfWriter, inner: f64, outer: f64, from: f64, to: f64) {
    writer.face(&[
        polar(inner, from, PAINT),
        polar(outer, from, PAINT),
        polar(outer, to, PAINT),
        polar(inner, to, PAINT),
    ]);
}

fn bollards(writer: &mut MgfWriter) {
    let ring = |radius: f64, z: f64| -> Vec<Point> { (0..6).map(|k| polar(radius, 60.0 * f64::from(k), z)).collect() };
    writer.push_transform("-t 18.6 0 0.12 -rz -57 -a 5 -rz 6");
    writer.material("black");
    writer.prism(&ring(0.07, 0.9), 0.95);
    writer.material("white");
    writer.prism(&ring(0.078, 0.82), 0.12);
    writer.pop_transform();
}

/// The central island: cobbled apron, kerb, mound, shrubs.
pub fn island() -> String {
    let mut writer = MgfWriter::new("i");
    writer.write_lines("# The central island: a cobbled apron 3 cm above the asphalt, a kerb, a mound, shrubs.");
    writer.push_transform("-a 4 -rz 90");
    // (material, radius and height of the inner edge, radius and height of the outer edge)
    let rings = [
        ("kerbstone", [INNER, 0.03], [INNER, -0.05]),
        ("paving", [ISLAND, 0.05], [INNER, 0.03]),
        ("kerbstone", [ISLAND, 0.2], [ISLAND, 0.05]),
        ("kerbstone", [ISLAND - 0.2, 0.2], [ISLAND, 0.2]),
        ("grass", [8.0, 0.5], [ISLAND - 0.2, 0.2]),
        ("grass", [5.5, 0.95], [8.0, 0.5]),
        ("grass", [2.8, 1.25], [5.5, 0.95]),
    ];
    for (material, inner, outer) in rings {
        writer.material(material);
        for k in 0..12 {
            let (a, b) = (-90.0 + 7.5 * f64::from(k), -82.5 + 7.5 * f64::from(k));
            let at = |edge: [f64; 2], angle: f64| polar(edge[0], angle, edge[1]);
            writer.face(&[at(inner, a), at(outer, a), at(outer, b), at(inner, b)]);
        }
    }
    for k in 0..12 {
        let (a, b) = (-90.0 + 7.5 * f64::from(k), -82.5 + 7.5 * f64::from(k));
        writer.face(&[[0.0, 0.0, 1.35], polar(2.8, a, 1.25), polar(2.8, b, 1.25)]);
    }
    writer.pop_transform();
    for (radius, z, scale_by, count, first) in
        [(6.6, 0.95, 1.0, 14, 5.0), (4.0, 1.3, 1.4, 8, 20.0), (1.6, 1.5, 1.8, 4, 40.0)]
    {
        let [x, y, _] = scale(polar(1.0, first, 0.0), radius);
        let arguments =
            format!("-rz 31 -s {scale_by} -t {x:.3} {y:.3} {z} -a {count} -rz {}", 360.0 / f64::from(count));
        writer.include("shrub.mgf", &arguments);
    }
    sign::chevrons(&mut writer);
    writer.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kerb_line_has_no_kink_and_unit_normals() {
        let line = kerb_line();
        for p in &line {
            assert!((p[2] * p[2] + p[3] * p[3] - 1.0).abs() < 1e-12);
            assert!((p[0] * p[0] + p[1] * p[1]).sqrt() > OUTER - 1e-9);
        }
        for p in line.windows(2) {
            let (dx, dy) = (p[1][0] - p[0][0], p[1][1] - p[0][1]);
            let length = (dx * dx + dy * dy).sqrt();
            assert!(length > 0.1, "two points coincide");
            // In the direction of travel along the line, the outside is on the right.
            let sine = (p[0][2] * dx + p[0][3] * dy) / length;
            let side = (p[0][2] * dy - p[0][3] * dx) / length;
            assert!(side > 0.98 && sine.abs() < 0.15, "{p:?}");
        }
    }
}
