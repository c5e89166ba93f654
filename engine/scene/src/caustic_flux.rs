//! Estimate of the lamps' light that reaches a clear solid or a mirror before anything scatters it.
//!
//! Shadow rays do not find this light. The finite-element first pass has it as sharply as its elements are small, and path tracing
//! hits such lamps only by chance.

use crate::description::{Photometry, Scene};
use crate::world::{EmissionSampler, LightPathEnd, Scope, SplitMix64, light_sources, trace_light};

/// Minimum number of rays per lamp, and maximum number of rays of all lamps together.
const RAYS: [usize; 2] = [16, 1 << 16];
/// Maximum number of rays per lamp.
const MAX_RAYS_PER_LAMP: usize = 256;

/// Light that solids refract or mirrors reflect on its way from the lamps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CausticFlux {
    /// Luminous flux of this light, lm, at the start of the clip.
    pub lumens: f64,
    /// Share of the flux of all lamps.
    pub share: f64,
}

/// Traces rays from each lamp to the first surface that scatters, refracts or mirrors. If there are more than 4096 lamps, a regular
/// subset stands for all.
/// - `flux`: luminous flux of a photometric file, lm.
pub fn estimate_caustic_flux(scene: &Scene, flux: &dyn Fn(&Photometry) -> f64) -> CausticFlux {
    let scope = Scope::new(scene);
    let samplers: Vec<Option<EmissionSampler>> = scene.photometry.iter().map(EmissionSampler::new).collect();
    let fluxes: Vec<f64> = scene.photometry.iter().map(flux).collect();
    let all = light_sources(&scope);
    let step = all.len().div_ceil(RAYS[1] / RAYS[0]).max(1);
    let taken = all.len().div_ceil(step).max(1);
    let rays = (RAYS[1] / taken).clamp(RAYS[0], MAX_RAYS_PER_LAMP);
    let (mut caustic, mut sum, mut rng) = (0.0, 0.0, SplitMix64(17));
    for source in all.iter().step_by(step) {
        let lumens = source.lumens(&scope, &fluxes);
        let (mut number, mut met) = (0u32, 0u32);
        for ray in 0..rays {
            let at = (ray as f64 + 0.5) / rays as f64;
            let Some(emitted) = source.emit(&scope, &samplers, at, &mut rng) else { continue };
            number += 1;
            let end = trace_light(&scope, emitted.ray, true, &mut rng);
            met += u32::from(matches!(end, LightPathEnd::Refracted(_) | LightPathEnd::Mirrored(_)));
        }
        sum += lumens;
        caustic += lumens * f64::from(met) / f64::from(number.max(1));
    }
    CausticFlux { lumens: caustic * step as f64, share: if sum > 0.0 { caustic / sum } else { 0.0 } }
}
