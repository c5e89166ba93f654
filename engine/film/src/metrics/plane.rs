//! One channel of an image, and separable convolution.

use rayon::prelude::*;

/// Values row by row.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Plane {
    pub width: usize,
    pub values: Vec<f32>,
}

impl Plane {
    pub fn from_values(width: u32, values: Vec<f32>) -> Self {
        Self { width: width as usize, values }
    }

    pub fn height(&self) -> usize {
        self.values.len() / self.width
    }

    pub fn mean(&self) -> f64 {
        self.values.iter().map(|&v| f64::from(v)).sum::<f64>() / self.values.len() as f64
    }

    /// Combines the values of two planes one by one.
    pub fn zip(&self, other: &Self, f: impl Fn(f32, f32) -> f32 + Sync) -> Self {
        let values = self.values.par_iter().zip(&other.values).map(|(&a, &b)| f(a, b)).collect();
        Self { width: self.width, values }
    }

    /// Correlates with the product of an odd kernel along rows and one along columns. Beyond the border, the nearest pixel is used.
    /// Each output is a sum in the kernel's order, so the number of threads does not change it.
    pub fn filter(&self, along_x: &[f32], along_y: &[f32]) -> Self {
        self.filter_rows(along_x).filter_columns(along_y)
    }

    fn filter_rows(&self, kernel: &[f32]) -> Self {
        let (radius, width) = (kernel.len() / 2, self.width);
        let mut values = vec![0.0; self.values.len()];
        values.par_chunks_mut(width).zip(self.values.par_chunks(width)).for_each(|(out, row)| {
            let mut padded = Vec::with_capacity(width + 2 * radius);
            padded.extend(std::iter::repeat_n(row[0], radius));
            padded.extend_from_slice(row);
            padded.extend(std::iter::repeat_n(row[width - 1], radius));
            for (k, &weight) in kernel.iter().enumerate() {
                out.iter_mut().zip(&padded[k..]).for_each(|(o, &v)| *o += weight * v);
            }
        });
        Self { width, values }
    }

    fn filter_columns(&self, kernel: &[f32]) -> Self {
        let (radius, width, height) = (kernel.len() / 2, self.width, self.height());
        let mut values = vec![0.0; self.values.len()];
        values.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
            for (k, &weight) in kernel.iter().enumerate() {
                let from = (y + k).saturating_sub(radius).min(height - 1);
                let row = &self.values[from * width..(from + 1) * width];
                out.iter_mut().zip(row).for_each(|(o, &v)| *o += weight * v);
            }
        });
        Self { width, values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filtering_is_the_double_sum_with_clamped_borders() {
        let plane = Plane { width: 5, values: (0..20).map(|i| (i * i % 7) as f32).collect() };
        let (kx, ky) = ([1.0, 2.0, -3.0, 0.5, 0.25], [0.5, -1.0, 4.0]);
        let out = plane.filter(&kx, &ky);
        for y in 0..4i32 {
            for x in 0..5i32 {
                let mut sum = 0.0;
                for (j, wy) in (-1..=1).zip(ky) {
                    for (i, wx) in (-2..=2).zip(kx) {
                        sum += wx * wy * plane.values[((y + j).clamp(0, 3) * 5 + (x + i).clamp(0, 4)) as usize];
                    }
                }
                assert!((out.values[(y * 5 + x) as usize] - sum).abs() < 1e-4, "pixel {x},{y}");
            }
        }
    }
}
