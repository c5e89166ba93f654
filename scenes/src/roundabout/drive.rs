//! Route of the drive, and the blinking lights along it.
//!
//! The route enters by the south approach and follows the center line of the ring counterclockwise to the west exit. The exit
//! mirrors the entry in the line through the ring's center that halves the driven arc.

use crate::mgf_writer::{number, sin_cos_degrees};
use std::fmt::Write;

/// Radius of the driven circle, m.
const RADIUS: f64 = 14.6;
/// Angle at which the route enters the ring, followed by that at which it leaves, degrees about the center.
const ENTER: f64 = -48.0;
const LEAVE: f64 = 138.0;
/// Duration of the drive, s: 120 frames at 10 per second.
const DURATION: f64 = 11.9;
/// Time between keys, s.
const STEP: f64 = 0.35;

/// A pose on the route: x, y in meters, heading in degrees, unwrapped.
#[derive(Clone, Copy)]
struct Pose {
    x: f64,
    y: f64,
    heading: f64,
}

/// The entry: 2 m straight, then a cubic that joins the ring tangentially. `u` in [0, 1].
fn entry(u: f64) -> Pose {
    let (s, c) = sin_cos_degrees(ENTER);
    let joint = (RADIUS * c, RADIUS * s);
    let controls = [(2.15, -30.0), (2.15, -21.5), (joint.0 + 6.0 * s, joint.1 - 6.0 * c), joint];
    if u < 0.1 {
        return Pose { x: 2.15, y: -32.0 + 20.0 * u, heading: 90.0 };
    }
    let t = (u - 0.1) / 0.9;
    let (a, b) = (1.0 - t, t);
    let weights = [a * a * a, 3.0 * a * a * b, 3.0 * a * b * b, b * b * b];
    let slopes = [-a * a, a * a - 2.0 * a * b, 2.0 * a * b - b * b, b * b];
    let blend =
        |w: &[f64; 4]| controls.iter().zip(w).fold((0.0, 0.0), |sum, (p, w)| (sum.0 + p.0 * w, sum.1 + p.1 * w));
    let (x, y) = blend(&weights);
    let (dx, dy) = blend(&slopes);
    Pose { x, y, heading: femc_math::elementary::double::atan2(dy, dx).to_degrees() }
}

/// The route at fraction `u` in [0, 1] of its parameter: entry, ring, exit.
fn route(u: f64) -> Pose {
    if u < 0.25 {
        return entry(4.0 * u);
    }
    if u > 0.75 {
        // Mirror in the axis at half of the arc. The direction of travel is reversed.
        let there = entry(4.0 * (1.0 - u));
        let axis = 0.5 * (ENTER + LEAVE);
        let (s, c) = sin_cos_degrees(2.0 * axis);
        return Pose {
            x: c * there.x + s * there.y,
            y: s * there.x - c * there.y,
            heading: 2.0 * axis - there.heading + 180.0,
        };
    }
    let angle = ENTER + (LEAVE - ENTER) * (u - 0.25) * 2.0;
    let (s, c) = sin_cos_degrees(angle);
    Pose { x: RADIUS * c, y: RADIUS * s, heading: angle + 90.0 }
}

/// The route over time: slower on the ring than on the approaches, `DURATION` in total.
fn timed_route() -> Vec<(f64, Pose)> {
    const FINE: u32 = 4000;
    let at = |k: u32| route(f64::from(k) / f64::from(FINE));
    let mut clock = vec![0.0];
    for k in 0..FINE {
        let (a, b) = (at(k), at(k + 1));
        let length = ((b.x - a.x).powi(2) + (b.y - a.y).powi(2)).sqrt();
        let from_middle = (f64::from(2 * k) / f64::from(FINE) - 1.0).abs();
        let outside = ((from_middle - 0.4) / 0.6).clamp(0.0, 1.0);
        clock.push(clock[k as usize] + length / (1.0 + 0.3 * outside));
    }
    let scale = DURATION / clock[FINE as usize];
    let mut keys = Vec::new();
    let mut k = 0;
    for n in 0..=(DURATION / STEP).round() as u32 {
        let time = (f64::from(n) * STEP).min(DURATION);
        while k < FINE as usize && clock[k + 1] * scale <= time {
            k += 1;
        }
        keys.push((time, at(k as u32)));
    }
    keys
}

/// `path drive`: the pose of the car, x forward, z up.
pub fn path() -> String {
    let mut text =
        String::from("# The route: speed about 9 m/s on the approaches, 7.5 m/s on the ring.\npath drive = spline\n");
    for (time, Pose { x, y, heading }) in timed_route() {
        let _ = writeln!(text, "\tkey {} -rz {} -t {} {} 0", number(time), number(heading), number(x), number(y));
    }
    text
}

/// Scalars over time: the hazard lights of the parked car, and the right indicator before the exit.
pub fn blinking_lights() -> String {
    let blink = |selector: &str, first: f64, last: f64, bright: u32| {
        let mut text = format!("vary {selector} = ");
        if first > 0.0 {
            text.push_str("0 0 ");
        }
        let mut time = first;
        while time < last {
            let edges = [(0.01, bright), (0.33, bright), (0.34, 0)].map(|(t, e)| format!("{} {e}", number(time + t)));
            let _ = write!(text, "{} 0 {} ", number(time), edges.join(" "));
            time += 0.7;
        }
        format!("{}\n", text.trim_end())
    };
    format!(
        "# Blinking lights, on for a third of a second.\n{}{}",
        blink("material.hazard.ed", 0.0, 11.8, 6000),
        blink("material.indicator.ed", 7.1, 11.8, 6000)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn route_is_smooth_stays_on_carriageway_and_fills_whole_clip() {
        let keys = timed_route();
        for pair in keys.windows(2) {
            let ((t0, a), (t1, b)) = (pair[0], pair[1]);
            let speed = ((b.x - a.x).powi(2) + (b.y - a.y).powi(2)).sqrt() / (t1 - t0);
            assert!((6.0..11.0).contains(&speed), "{speed} m/s at {t0} s");
            assert!((b.heading - a.heading).abs() < 20.0, "turns {} degrees at {t0} s", b.heading - a.heading);
            let radius = (a.x * a.x + a.y * a.y).sqrt();
            assert!(radius > 13.5, "over the apron at {t0} s");
        }
        let last = keys.last().expect("a key");
        assert!((last.0 - DURATION).abs() < 1e-9, "{}", last.0);
        assert!(last.1.x < -30.0 && (last.1.y - 2.15).abs() < 0.01, "leaves at {} {}", last.1.x, last.1.y);
    }
}
