//! All the lights of a scene, and the choice of one in proportion to power.
//!
//! The unit interval is cut into 2^24 cells, as many as a random float in [0, 1) distinguishes, and each light owns whole
//! cells: its probability is exactly the share of numbers that choose it, however many lights there are. The map is
//! monotone, so stratified numbers choose stratified lights; that is why it is an inverted distribution function behind a
//! guide table and not an alias table. Both cost one memory access or two.

use crate::Light;

/// Cells of the unit interval.
const CELLS: u32 = 1 << 24;

/// A chosen light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightChoice {
    /// Index into [`LightSet::lights`].
    pub index: usize,
    /// Probability of this choice, > 0.
    pub probability: f32,
    /// What is left of the random number, in [0, 1); coarse for lights of little power.
    pub u: f32,
}

/// The lights of a scene.
#[derive(Clone, Debug, Default)]
pub struct LightSet {
    lights: Vec<Light>,
    /// First cell of each light, and the end.
    starts: Vec<u32>,
    /// For each of `guide.len()` equal parts of the cells: the light that owns the part's first cell.
    guide: Vec<u32>,
}

impl LightSet {
    /// Chooses in proportion to [`Light::power`]. Lights without power are never chosen.
    pub fn new(lights: Vec<Light>) -> Self {
        let weights: Vec<f64> = lights.iter().map(|l| f64::from(l.power())).collect();
        Self::with_weights(lights, &weights)
    }

    /// Chooses in proportion to `weights`, one for each light; what is not positive and finite counts as 0. A caller with
    /// textured emitters gives their textured power. Where more lights have weight than there are cells (2^24), only the
    /// strongest are ever chosen.
    pub fn with_weights(lights: Vec<Light>, weights: &[f64]) -> Self {
        debug_assert_eq!(lights.len(), weights.len());
        let starts = starts(&cells(weights));
        let parts = lights.len().next_power_of_two().clamp(1, 1 << 20);
        let width = CELLS / parts as u32;
        let mut light = 0;
        let guide = (0..parts as u32)
            .map(|part| {
                while light + 1 < lights.len() && starts[light + 1] <= part * width {
                    light += 1;
                }
                light as u32
            })
            .collect();
        Self { lights, starts, guide }
    }

    /// All lights, in the order given.
    pub fn lights(&self) -> &[Light] {
        &self.lights
    }

    /// Whether no light can be chosen.
    pub fn is_empty(&self) -> bool {
        self.starts.last().is_none_or(|&end| end == 0)
    }

    /// Probability of choosing light `index`; 0 beyond the end.
    #[inline]
    pub fn pmf(&self, index: usize) -> f32 {
        match (self.starts.get(index), self.starts.get(index + 1)) {
            (Some(start), Some(end)) => (end - start) as f32 / CELLS as f32,
            _ => 0.0,
        }
    }

    /// Chooses a light by `u` in [0, 1); `None` if there is none with power.
    #[inline]
    pub fn sample(&self, u: f32) -> Option<LightChoice> {
        if self.is_empty() {
            return None;
        }
        let at = u * CELLS as f32;
        let cell = (at as u32).min(CELLS - 1);
        let part = cell / (CELLS / self.guide.len() as u32);
        let mut index = self.guide[part as usize] as usize;
        while self.starts[index + 1] <= cell {
            index += 1;
        }
        let (start, end) = (self.starts[index], self.starts[index + 1]);
        let width = (end - start) as f32;
        let rest = ((cell - start) as f32 + (at - cell as f32)) / width;
        Some(LightChoice { index, probability: width / CELLS as f32, u: rest.clamp(0.0, 1.0 - f32::EPSILON) })
    }
}

/// Whole cells in proportion to `weights`, summing to `CELLS` (to 0 if there is no weight); at least one for each weight
/// as long as there are enough.
fn cells(weights: &[f64]) -> Vec<u32> {
    let weights: Vec<f64> = weights.iter().map(|&w| if w.is_finite() && w > 0.0 { w } else { 0.0 }).collect();
    let total: f64 = weights.iter().sum();
    let mut counts = vec![0u32; weights.len()];
    if total <= 0.0 || !total.is_finite() {
        return counts;
    }
    let mut order: Vec<usize> = (0..weights.len()).filter(|&i| weights[i] > 0.0).collect();
    order.sort_by(|&a, &b| weights[b].total_cmp(&weights[a]).then(a.cmp(&b)));
    order.truncate(CELLS as usize);
    for &i in &order {
        counts[i] = ((weights[i] / total * f64::from(CELLS)) as u32).max(1);
    }
    // What rounding left over or took too much goes to or from the strongest lights, never below one cell.
    let mut surplus: i64 = i64::from(CELLS) - counts.iter().map(|&c| i64::from(c)).sum::<i64>();
    while surplus != 0 {
        for &i in &order {
            if surplus > 0 {
                counts[i] += 1;
                surplus -= 1;
            } else if surplus < 0 && counts[i] > 1 {
                // Take in proportion where much is to be taken, so that this ends soon.
                let take = (-surplus).min(i64::from(counts[i] - 1)).min(1 + i64::from(counts[i] / 256));
                counts[i] -= take as u32;
                surplus += take;
            }
            if surplus == 0 {
                break;
            }
        }
    }
    counts
}

fn starts(counts: &[u32]) -> Vec<u32> {
    let mut starts = Vec::with_capacity(counts.len() + 1);
    let mut sum = 0;
    starts.push(0);
    for &c in counts {
        sum += c;
        starts.push(sum);
    }
    starts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::Sphere;
    use crate::{Emission, Profile, Sides};
    use femc_math::Rgb;
    use femc_math::glam::Vec3A;
    use femc_math::hash::{combine, unit_f32};

    fn set(weights: &[f64]) -> LightSet {
        let emission = Emission { emittance: Rgb::ONE, profile: Profile::Lambertian, sides: Sides::One };
        let lights = weights.iter().map(|_| Light::Sphere(Sphere::new(Vec3A::ZERO, 1.0, emission))).collect();
        LightSet::with_weights(lights, weights)
    }

    #[test]
    fn probabilities_sum_to_one_and_are_the_exact_shares_of_the_numbers_that_choose() {
        let weights = [1.0, 0.0, 5.0, 1e-12, 2.5, f64::NAN, 1e3, -4.0];
        let set = set(&weights);
        let mut counts = [0u32; 8];
        for cell in 0..CELLS {
            let choice = set.sample(cell as f32 / CELLS as f32).expect("lights with power");
            counts[choice.index] += 1;
        }
        for (i, &count) in counts.iter().enumerate() {
            assert_eq!(set.pmf(i), count as f32 / CELLS as f32, "light {i}");
            assert_eq!(count == 0, weights[i].is_nan() || weights[i] <= 0.0, "light {i}");
        }
        assert_eq!(counts.iter().sum::<u32>(), CELLS);
        assert!((set.pmf(2) / set.pmf(0) - 5.0).abs() < 1e-2 && set.pmf(3) == 1.0 / CELLS as f32);
        assert_eq!(set.pmf(8), 0.0);
    }

    #[test]
    fn choices_are_monotone_and_the_rest_of_the_number_is_uniform() {
        let set = set(&[3.0, 1.0, 2.0, 4.0]);
        let (mut last, mut sums) = (0, [0.0f64; 4]);
        let n = 40_000u32;
        for i in 0..n {
            let choice = set.sample((i as f32 + 0.5) / n as f32).expect("lights with power");
            assert!(choice.index >= last && (0.0..1.0).contains(&choice.u), "{choice:?}");
            assert_eq!(choice.probability, set.pmf(choice.index));
            last = choice.index;
            sums[last] += f64::from(choice.u) / f64::from(choice.probability) / f64::from(n);
        }
        assert!(sums.iter().all(|mean| (mean - 0.5).abs() < 1e-3), "{sums:?}");
    }

    #[test]
    fn ten_thousand_lights_of_very_different_power_keep_their_shares() {
        let weights: Vec<f64> =
            (0..10_000u64).map(|i| f64::from(unit_f32(combine(&[i]) as u32)).powi(8) + 1e-9).collect();
        let set = set(&weights);
        let total: f64 = weights.iter().sum();
        let sum: f64 = (0..weights.len()).map(|i| f64::from(set.pmf(i))).sum();
        assert!((sum - 1.0).abs() < 1e-12);
        for (i, w) in weights.iter().enumerate() {
            let cells = f64::from(set.pmf(i)) * f64::from(CELLS);
            let wanted = w / total * f64::from(CELLS);
            assert!(cells >= 1.0 && (cells - wanted).abs() <= 2.0 + wanted / 50.0, "light {i}: {cells} of {wanted}");
        }
        for i in 0..20_000u64 {
            let u = unit_f32(combine(&[i, 7]) as u32);
            let choice = set.sample(u).expect("lights with power");
            assert!(set.starts[choice.index] as f32 <= u * CELLS as f32, "{choice:?}");
        }
    }

    #[test]
    fn without_power_there_is_no_choice() {
        for weights in [&[][..], &[0.0, 0.0]] {
            let set = set(weights);
            assert!(set.is_empty() && set.sample(0.5).is_none() && set.pmf(0) == 0.0);
        }
        assert!(LightSet::default().is_empty() && LightSet::default().sample(0.1).is_none());
    }
}
