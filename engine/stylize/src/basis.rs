//! Principal components of patches. 16 components keep most of the variance of the hundreds of values of a patch.

use crate::Patches;
use femc_math::hash::mix32;
use rayon::prelude::*;

/// Number of coordinates of a point, one per principal component.
pub const DIMENSIONS: usize = 16;
/// A patch as coordinates along the principal components.
pub type Point = [f32; DIMENSIONS];
/// Number of patches from which the components are computed.
const SAMPLES: usize = 2048;
/// Rounds of subspace iteration: the components need not be exact, only orthogonal.
const ROUNDS: usize = 5;

/// Principal components of the patches of a source.
#[derive(Clone, Debug)]
pub struct Basis {
    mean: Vec<f32>,
    /// Axes, orthonormal, or zero where the patches have fewer dimensions.
    axes: Vec<Vec<f32>>,
}

impl Basis {
    /// Computes the components of a sample of `patches`, by subspace iteration.
    pub fn from_patches(patches: &Patches) -> Self {
        let (count, values) = (patches.grid().count(), patches.patch_values());
        let samples = count.min(SAMPLES);
        let mut data = vec![0.0; samples * values];
        data.par_chunks_mut(values)
            .enumerate()
            .for_each(|(i, room)| patches.gather((i * count / samples) as u32, room));
        let mut mean = vec![0.0f32; values];
        data.chunks(values).for_each(|row| add(&mut mean, 1.0, row));
        mean.iter_mut().for_each(|value| *value /= samples as f32);
        data.par_chunks_mut(values).for_each(|row| add(row, -1.0, &mean));
        let start =
            |axis: usize| (0..values).map(move |i| mix32((axis * values + i) as u32) as f32 / 2_147_483_648.0 - 1.0);
        let mut axes: Vec<Vec<f32>> = (0..DIMENSIONS).map(|axis| start(axis).collect()).collect();
        for _ in 0..ROUNDS {
            orthonormalize(&mut axes);
            axes.par_iter_mut().for_each(|axis| {
                let mut next = vec![0.0; values];
                data.chunks(values).for_each(|row| add(&mut next, dot(row, axis), row));
                *axis = next;
            });
        }
        orthonormalize(&mut axes);
        Self { mean, axes }
    }

    /// Returns the points of all patches, by number. `patches` has as many channels as the patches of the components.
    pub fn points(&self, patches: &Patches) -> Vec<Point> {
        let room = || vec![0.0; self.mean.len()];
        let all = (0..patches.grid().count() as u32).into_par_iter();
        all.map_init(room, |room, at| self.point(patches, at, room)).collect()
    }

    fn point(&self, patches: &Patches, at: u32, values: &mut [f32]) -> Point {
        patches.gather(at, values);
        add(values, -1.0, &self.mean);
        let mut point = [0.0; DIMENSIONS];
        point.iter_mut().zip(&self.axes).for_each(|(out, axis)| *out = dot(values, axis));
        point
    }
}

/// Adds `factor * from` to `to`.
fn add(to: &mut [f32], factor: f32, from: &[f32]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += factor * from);
}

/// Orthonormalizes the axes with modified Gram-Schmidt, run twice. An axis that depends on earlier axes becomes zero.
fn orthonormalize(axes: &mut [Vec<f32>]) {
    for at in 0..axes.len() {
        let (before, rest) = axes.split_at_mut(at);
        let axis = &mut rest[0];
        let long = dot(axis, axis).sqrt();
        for _ in 0..2 {
            for other in &*before {
                let along = dot(axis, other);
                add(axis, -along, other);
            }
        }
        let left = dot(axis, axis).sqrt();
        let scale = if left > 1e-4 * long { 1.0 / left } else { 0.0 };
        axis.iter_mut().for_each(|value| *value *= scale);
    }
}

/// Computes the sum of the products, in eight lanes.
#[inline]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    let mut lanes = [0.0f32; 8];
    for (a, b) in a.iter().zip(b) {
        for lane in 0..8 {
            lanes[lane] += a[lane] * b[lane];
        }
    }
    let rest: f32 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    let [a, b, c, d, e, f, g, h] = lanes;
    ((a + e) + (b + f)) + ((c + g) + (d + h)) + rest
}
