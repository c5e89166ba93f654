//! Exact luminous flux of a table.
//!
//! A table is bilinear between its angles. Every value is the height of a hat function, so the flux is the sum of the values times
//! the integrals of their hats. In one direction these are integrals of linear ramps times the sine of the polar angle, in the
//! other direction trapezoids. Tables that cover a part of the sphere are completed by symmetry, like the distributions of
//! `femc_emission`. A test compares the two fluxes.

use femc_math::elementary::double::{cos, sin};
use femc_scene::{Photometry, PhotometryType};
use std::f64::consts::{PI, TAU};

/// Returns the luminous flux, lm.
pub(super) fn lumens(photometry: &Photometry) -> f64 {
    let Photometry { kind, vertical, horizontal, candela, .. } = photometry;
    let (vertical, horizontal) = (radians(vertical), radians(horizontal));
    let (by_vertical, by_horizontal) = match kind {
        PhotometryType::C => (polar(&vertical, 0.0), around(&horizontal)),
        PhotometryType::A => {
            let across = if horizontal.len() == 1 { vec![TAU] } else { mirrored(&horizontal, trapezoids(&horizontal)) };
            (polar(&vertical, 0.5 * PI), across)
        }
        PhotometryType::B => {
            let across =
                if horizontal.len() == 1 { vec![2.0] } else { mirrored(&horizontal, polar(&horizontal, 0.5 * PI)) };
            (trapezoids(&vertical), across)
        }
    };
    let planes = candela.chunks(vertical.len().max(1)).zip(by_horizontal);
    planes.map(|(plane, weight)| weight * plane.iter().zip(&by_vertical).map(|(i, w)| i * w).sum::<f64>()).sum()
}

fn radians(angles: &[f64]) -> Vec<f64> {
    angles.iter().map(|angle| angle.to_radians()).collect()
}

/// Returns the integrals of the hats times the sine of the angle from the axis, which is the table's angle plus `shift`.
fn polar(angles: &[f64], shift: f64) -> Vec<f64> {
    let mut weights = vec![0.0; angles.len()];
    for (i, pair) in angles.windows(2).enumerate() {
        let (a, b) = (pair[0] + shift, pair[1] + shift);
        let all = cos(a) - cos(b);
        let rising = (sin(b) - sin(a)) / (b - a) - cos(b);
        weights[i] += all - rising;
        weights[i + 1] += rising;
    }
    weights
}

/// Returns the integrals of the hats.
fn trapezoids(angles: &[f64]) -> Vec<f64> {
    let mut weights = vec![0.0; angles.len()];
    for (i, pair) in angles.windows(2).enumerate() {
        weights[i] += 0.5 * (pair[1] - pair[0]);
        weights[i + 1] += 0.5 * (pair[1] - pair[0]);
    }
    weights
}

/// Returns the integrals of the hats about the axis of type C, for a single plane, quadrants, halves or a full turn. The last plane
/// is extended to the end of its quadrant or half. In a full turn, the first plane also ends the circle.
fn around(angles: &[f64]) -> Vec<f64> {
    let [first, .., last] = *angles else { return vec![TAU; angles.len()] };
    let span = last - first;
    let part = if span <= 0.5 * PI + 1e-5 { 0.5 * PI } else { PI };
    let mut weights = trapezoids(angles);
    let end = weights.len() - 1;
    if span > PI + 1e-5 {
        weights[0] += 0.5 * (TAU - span);
        weights[end] += 0.5 * (TAU - span);
        return weights;
    }
    weights[end] += part - span;
    weights.into_iter().map(|weight| weight * TAU / part).collect()
}

/// Doubles the weights of types A and B if the angles start at 0 or above, because such tables are mirrored.
fn mirrored(angles: &[f64], weights: Vec<f64>) -> Vec<f64> {
    let copies = if angles[0] >= 0.0 { 2.0 } else { 1.0 };
    weights.into_iter().map(|weight| weight * copies).collect()
}
