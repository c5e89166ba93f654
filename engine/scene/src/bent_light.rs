//! Estimate of the lamps' light that reaches a clear solid or a mirror before anything scatters it.
//!
//! Shadow rays do not find this light. The finite-element first pass has few rays for it, and path tracing hits such lamps only by
//! chance.

use crate::description::{Photometry, Scene};
use crate::world::{Beams, Dice, Scope, Shone, shine, sources};

/// Minimum number of rays per lamp, and maximum number of rays of all lamps together.
const RAYS: [usize; 2] = [16, 1 << 16];
/// Maximum number of rays per lamp.
const MOST: usize = 256;

/// Light that solids refract or mirrors reflect on its way from the lamps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BentLight {
    /// Luminous flux of this light, lm, at the start of the clip.
    pub lumens: f64,
    /// Share of the flux of all lamps.
    pub share: f64,
}

/// Traces rays from each lamp to the first surface that scatters, refracts or mirrors. If there are more than 4096 lamps, a regular
/// subset stands for all.
/// - `flux`: luminous flux of a photometric file, lm.
pub fn bent_light(scene: &Scene, flux: &dyn Fn(&Photometry) -> f64) -> BentLight {
    let scope = Scope::new(scene);
    let beams: Vec<Option<Beams>> = scene.photometry.iter().map(Beams::new).collect();
    let fluxes: Vec<f64> = scene.photometry.iter().map(flux).collect();
    let all = sources(&scope);
    let step = all.len().div_ceil(RAYS[1] / RAYS[0]).max(1);
    let taken = all.len().div_ceil(step).max(1);
    let rays = (RAYS[1] / taken).clamp(RAYS[0], MOST);
    let (mut bent, mut sum, mut dice) = (0.0, 0.0, Dice(17));
    for source in all.iter().step_by(step) {
        let lumens = source.lumens(&scope, &fluxes);
        let (mut number, mut met) = (0u32, 0u32);
        for ray in 0..rays {
            let at = (ray as f64 + 0.5) / rays as f64;
            let Some(emitted) = source.emit(&scope, &beams, at, &mut dice) else { continue };
            number += 1;
            let end = shine(&scope, emitted.ray, true, &mut dice);
            met += u32::from(matches!(end, Shone::Bent(_) | Shone::Mirrored(_)));
        }
        sum += lumens;
        bent += lumens * f64::from(met) / f64::from(number.max(1));
    }
    BentLight { lumens: bent * step as f64, share: if sum > 0.0 { bent / sum } else { 0.0 } }
}
