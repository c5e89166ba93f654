//! Luminaire files with invented distributions, IESNA LM-63-2002, type C photometry. Their candelas are scaled to the stated flux.

use femc_math::elementary::double;
use std::f64::consts::PI;
use std::fmt::Write;

/// A road luminaire of 5000 lm, LED. It throws light along the road (C0, C180) and over it (C90), and little behind (C270). Its
/// luminous opening is 0.22 m along the road by 0.5 m across.
pub fn road() -> String {
    let vertical: Vec<f64> = (0..=18).map(|k| 5.0 * f64::from(k)).collect();
    let horizontal: Vec<f64> = (0..=24).map(|k| 15.0 * f64::from(k)).collect();
    let shape = |gamma: f64, c: f64| {
        // The peak rises from 35 degrees behind to 62 degrees along the road. A sharp cut-off limits glare.
        let along = double::cos(c.to_radians()).abs();
        let over = double::sin(c.to_radians());
        let peak = 42.0 + 22.0 * along + 7.0 * over;
        let strength = 0.75 + 0.85 * along * along + 0.35 * over;
        let width = if gamma < peak { 30.0 } else { 11.0 };
        let x = (gamma - peak) / width;
        if gamma >= 90.0 { 0.0 } else { 0.35 * double::cos(gamma.to_radians()) + strength * double::exp(-x * x) }
    };
    write_file(&FileHeader { name: "ROAD-50", opening: [0.5, 0.22, 0.0], flux: 5000.0 }, &vertical, &horizontal, shape)
}

/// A ceiling spot of 900 lm, rotationally symmetric: a point.
pub fn spot() -> String {
    let vertical: Vec<f64> = (0..=12).map(|k| 5.0 * f64::from(k)).chain([90.0]).collect();
    let shape = |gamma: f64, _: f64| {
        let x = gamma / 24.0;
        if gamma >= 60.0 { 0.0 } else { double::exp(-x * x) }
    };
    write_file(&FileHeader { name: "SPOT-9", opening: [0.0; 3], flux: 900.0 }, &vertical, &[0.0], shape)
}

struct FileHeader {
    name: &'static str,
    /// Width, length, height of the luminous opening, m.
    opening: [f64; 3],
    /// Luminous flux, lm.
    flux: f64,
}

fn write_file(head: &FileHeader, vertical: &[f64], horizontal: &[f64], shape: impl Fn(f64, f64) -> f64) -> String {
    let rows: Vec<Vec<f64>> = horizontal.iter().map(|&c| vertical.iter().map(|&g| shape(g, c)).collect()).collect();
    let factor = head.flux / flux(vertical, horizontal, &rows);
    let [width, length, height] = head.opening;
    let mut text = format!(
        "IESNA:LM-63-2002\n[TEST] invented, not measured\n[TESTLAB] none\n[ISSUEDATE] 01-JAN-2026\n[MANUFAC] femc example scenes\n\
         [LUMCAT] {}\nTILT=NONE\n1 -1 1 {} {} 1 2 {width} {length} {height}\n1 1 {}\n",
        head.name,
        vertical.len(),
        horizontal.len(),
        head.flux / 125.0,
    );
    let join = |values: &[f64], decimals: usize| -> String {
        values.iter().map(|v| format!("{v:.decimals$}")).collect::<Vec<_>>().join(" ")
    };
    let _ = writeln!(text, "{}\n{}", join(vertical, 0), join(horizontal, 0));
    for row in &rows {
        let candela: Vec<f64> = row.iter().map(|v| v * factor).collect();
        let _ = writeln!(text, "{}", join(&candela, 0));
    }
    text
}

/// Computes the flux of a table, lm: trapezoids in both angles, exact in the solid angle of a zone.
fn flux(vertical: &[f64], horizontal: &[f64], rows: &[Vec<f64>]) -> f64 {
    let zone = |row: &[f64]| -> f64 {
        let steps = vertical.windows(2).zip(row.windows(2));
        steps
            .map(|(g, i)| {
                let solid = double::cos(g[0].to_radians()) - double::cos(g[1].to_radians());
                0.5 * (i[0] + i[1]) * solid
            })
            .sum()
    };
    match rows {
        [only] => 2.0 * PI * zone(only),
        _ => horizontal
            .windows(2)
            .zip(rows.windows(2))
            .map(|(c, r)| 0.5 * (zone(&r[0]) + zone(&r[1])) * (c[1] - c[0]).to_radians())
            .sum(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(text: &str) -> Vec<f64> {
        let (_, body) = text.split_once("TILT=NONE\n").expect("a TILT line");
        body.split_whitespace().map(|w| w.parse().expect("a number")).collect()
    }

    #[test]
    fn the_files_carry_the_flux_they_state() {
        for (text, lumens) in [(road(), 5000.0), (spot(), 900.0)] {
            let n = numbers(&text);
            let (nv, nh) = (n[3] as usize, n[4] as usize);
            let (vertical, rest) = n[13..].split_at(nv);
            let (horizontal, candela) = rest.split_at(nh);
            assert_eq!(candela.len(), nv * nh);
            let rows: Vec<Vec<f64>> = candela.chunks(nv).map(<[f64]>::to_vec).collect();
            let flux = flux(vertical, horizontal, &rows);
            assert!((flux / lumens - 1.0).abs() < 0.005, "{flux} lm, not {lumens} lm");
        }
    }

    #[test]
    fn road_luminaire_throws_along_and_across_road_little_behind() {
        let n = numbers(&road());
        let nv = n[3] as usize;
        let candela = &n[13 + nv + n[4] as usize..];
        let peak = |c: usize| candela[c * nv..(c + 1) * nv].iter().copied().fold(0.0, f64::max);
        assert!(peak(0) > 1.5 * peak(18), "C0 {} against C270 {}", peak(0), peak(18));
        assert!(peak(6) > 1.5 * peak(18), "C90 {} against C270 {}", peak(6), peak(18));
    }
}
