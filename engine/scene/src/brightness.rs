//! Overall brightness of a scene's lamps.
//!
//! Light is proportional to the emission of the lamps. A result for lamps of brightness 1 therefore serves all scenes with the same
//! ratios between their lamps: multiply it by their brightness.

use crate::selector::Scalars;

impl Scalars {
    /// Returns the brightness of the lamps: the greatest emittance of a material, lm/m2. If no material emits, it is the greatest
    /// multiplier of a luminaire, or else the greatest glow of a medium. It is 1 if nothing emits.
    pub fn brightness(&self) -> f64 {
        let greatest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
        let materials = greatest(&mut self.materials.iter().map(|material| material.ed.amount));
        let luminaires = greatest(&mut self.luminaires.iter().flatten().map(|luminaire| luminaire.multiplier));
        let media = greatest(&mut self.media.iter().map(|medium| medium.glow));
        [materials, luminaires, media].into_iter().find(|&it| it > 0.0 && it.is_finite()).unwrap_or(1.0)
    }

    /// Returns a copy whose lamps have brightness 1 and keep their ratios. Scenes that differ only in brightness give equal copies.
    pub fn with_unit_brightness(&self) -> Self {
        let (mut one, whole) = (self.clone(), self.brightness());
        one.materials.iter_mut().for_each(|material| material.ed.amount = share(material.ed.amount, whole));
        let luminaires = one.luminaires.iter_mut().flatten();
        luminaires.for_each(|luminaire| luminaire.multiplier = share(luminaire.multiplier, whole));
        one.media.iter_mut().for_each(|medium| medium.glow = share(medium.glow, whole));
        one
    }
}

/// Returns `part / whole`, rounded to 41 bits, because the last bits of quotients of equal ratios differ.
fn share(part: f64, whole: f64) -> f64 {
    const LAST: u64 = 12;
    let bits = (part / whole).to_bits() + (1 << (LAST - 1));
    f64::from_bits(bits >> LAST << LAST)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_of_equal_proportions_are_equal_and_near() {
        for k in 1..2000 {
            let (part, whole, factor) = (0.1 + 0.37 * f64::from(k), 811.3, 1.0 + 0.013 * f64::from(k));
            assert_eq!(share(part, whole).to_bits(), share(part * factor, whole * factor).to_bits());
            assert!((share(part, whole) * whole / part - 1.0).abs() < 1e-12);
        }
        assert_eq!([share(0.0, 3.0), share(3.0, 3.0)], [0.0, 1.0]);
    }
}
