//! Energy conservation of a material's parameters, channel by channel.
//!
//! The scene format bounds the luminance of `rd + td + rs + ts`. Two kinds of materials within that bound would still return more
//! light than they receive:
//! - A saturated color of luminance 1 has a channel above 1 (red: 4.7). The parameters that share the light in such a channel are
//!   divided by their sum.
//! - A diffuse part under an interface gets the light that a smooth interface leaves (\[kelemen2001\]). A rough interface reflects
//!   more than a smooth one in some directions: at grazing facets, and from inside beyond the critical angle. The diffuse parts are
//!   reduced by the factor that the worst direction needs, found by quadrature when the material is created.
//!
//! Materials that do not gain energy stay unchanged, to the bit.

use super::{MaterialParameters, Model};
use crate::Fresnel;
use crate::fresnel::dielectric;
use crate::microfacet::{SMOOTH_ALPHA, reflect, sample_visible_normal, shadowing_given_masking};
use femc_math::{Rgb, glam::Vec3A};

/// Greatest reflectance used in computations; `f32` sums of larger ones could overflow.
const MAX_REFLECTANCE: f32 = 1e30;
/// Tolerance for the rounding of decimal fractions that add up to 1.
const SUM_TOLERANCE: f32 = 1e-6;

impl MaterialParameters {
    /// Limits each channel of the parameters to the light that the surface receives.
    ///
    /// The scattering model decides which of `rd`, `td`, `rs` and `ts` share the light:
    /// - without an index of refraction, and on sheets with `ts`: all four add up to at most 1;
    /// - a coat with an index: `rs` is at most 1, and so is `rd + td`, which get the light that the coat leaves;
    /// - a solid dielectric: `rd + td + ts`, which get the light that the interface does not reflect, is at most 1; `rs` does not
    ///   count.
    ///
    /// Law: `no_material_of_the_format_returns_more_than_it_receives`.
    #[must_use]
    pub fn energy_conserving(&self) -> Self {
        let [mut rd, mut td, mut rs, mut ts] =
            [self.rd, self.td, self.rs, self.ts].map(|color| color.clamp(Rgb::ZERO, Rgb::splat(MAX_REFLECTANCE)));
        match self.model() {
            Model::Solid { eta } => {
                divide_by_sum([&mut rd, &mut td, &mut ts]);
                limit_diffuse(|| max_diffuse_in_solid(eta, self.ts_alpha, ts), self.ts_alpha, [&mut rd, &mut td]);
            }
            Model::Sheet { fresnel: Fresnel::Unit, .. } | Model::Opaque { fresnel: Fresnel::Unit, .. } => {
                divide_by_sum([&mut rd, &mut td, &mut rs, &mut ts]);
            }
            Model::Sheet { fresnel } | Model::Opaque { fresnel } => {
                divide_by_sum([&mut rs]);
                divide_by_sum([&mut rd, &mut td]);
                // A coat reflects at most `rs`, so parts that add up to 1 cannot gain energy.
                if (rd + td + rs).max_element() > 1.0 {
                    limit_diffuse(
                        || max_diffuse_under_coat(fresnel, self.rs_alpha, rs),
                        self.rs_alpha,
                        [&mut rd, &mut td],
                    );
                }
            }
        }
        Self { rd, td, rs, ts, ..*self }
    }
}

/// Divides the colors by their sum in each channel where the sum is above 1.
fn divide_by_sum<const N: usize>(mut colors: [&mut Rgb; N]) {
    let sum = colors.iter().fold(Rgb::ZERO, |sum, color| sum + **color);
    let divisor = Rgb::select(sum.cmpgt(Rgb::splat(1.0 + SUM_TOLERANCE)), sum, Rgb::ONE);
    for color in &mut colors {
        **color = (**color / divisor).min(Rgb::ONE);
    }
}

/// Reduces the diffuse colors to the `max_diffuse` that a rough interface leaves them.
fn limit_diffuse(max_diffuse: impl FnOnce() -> Rgb, alpha: f32, [rd, td]: [&mut Rgb; 2]) {
    let sum = *rd + *td;
    if alpha <= SMOOTH_ALPHA || sum.max_element() <= 0.0 {
        return;
    }
    let room = max_diffuse();
    let factor = Rgb::select(sum.cmpgt(room * (1.0 + SUM_TOLERANCE)), room / sum, Rgb::ONE);
    *rd *= factor;
    *td *= factor;
}

/// Number of directions that are tested for the room, and number of facets for each.
const VIEWS: u32 = 32;
const FACETS: u32 = 256;

/// Returns directions from nearly grazing to the normal, denser at grazing ones, where reflectance changes fast. On the denser side
/// of an interface (`eta` < 1), directions of total reflection are excluded.
fn test_directions(eta: f32) -> impl Iterator<Item = Vec3A> {
    (0..=VIEWS).map(move |k| {
        let cos = ((k as f32 + 0.5) / VIEWS as f32).min(1.0).powi(2);
        let sin2 = (1.0 - cos) * (1.0 + cos) * eta.min(1.0).powi(2);
        Vec3A::new(sin2.sqrt(), 0.0, (1.0 - sin2).sqrt())
    })
}

/// Returns means over the facets that are visible from `wo`: of `reflected(wo.h)` times the shadowing of the mirror direction, and
/// of `1 - reflected(wo.h)` times that of the direction with the cosine `refracted(wo, h)` on the other side.
fn facet_means(
    wo: Vec3A,
    alpha: f32,
    reflected: impl Fn(f32) -> f32,
    refracted: impl Fn(Vec3A, Vec3A) -> Option<f32>,
) -> (f32, f32) {
    let (mut back, mut through) = (0.0, 0.0);
    for k in 0..FACETS {
        // The additive lattice of \[roberts2018\].
        let step = |a: f64| ((0.5 + a * f64::from(k)).fract() as f32).min(1.0 - f32::EPSILON / 2.0);
        let u = [step(0.754_877_666_246_692_8), step(0.569_840_290_998_053_3)];
        let h = sample_visible_normal(wo, alpha, u);
        let f = reflected(wo.dot(h).clamp(0.0, 1.0));
        let wi = reflect(wo, h);
        if wi.z > 0.0 {
            back += f * shadowing_given_masking(wo.z, wi.z, alpha);
        }
        if let Some(cos) = refracted(wo, h) {
            through += (1.0 - f) * shadowing_given_masking(wo.z, cos, alpha);
        }
    }
    (back / FACETS as f32, through / FACETS as f32)
}

/// Returns the greatest `rd + td` under a rough coat that reflects `rs` times the Fresnel factor. The diffuse parts return that sum
/// times the light that a smooth coat leaves.
fn max_diffuse_under_coat(fresnel: Fresnel, alpha: f32, rs: Rgb) -> Rgb {
    let eta = match fresnel {
        Fresnel::Dielectric { eta } => eta,
        Fresnel::Unit | Fresnel::Conductor { .. } => 1.0,
    };
    test_directions(eta).fold(Rgb::ONE, |room, wo| {
        let (back, _) = facet_means(wo, alpha, |cos| fresnel.eval(cos), |_, _| None);
        let left = Rgb::ONE - rs * fresnel.eval(wo.z);
        room.min(share(Rgb::ONE - rs * back, left))
    })
}

/// Returns the greatest `rd + td` of a solid with a rough interface, seen from both sides.
fn max_diffuse_in_solid(eta: f32, alpha: f32, ts: Rgb) -> Rgb {
    [eta, 1.0 / eta].into_iter().fold(Rgb::ONE, |room, eta| {
        let fresnel = |cos: f32| dielectric(cos, eta);
        test_directions(eta).fold(room, |room, wo| {
            let refracted = |wo: Vec3A, h: Vec3A| {
                let o_h = wo.dot(h).clamp(0.0, 1.0);
                let wi = h * (o_h / eta - fresnel(o_h).cos_transmitted) - wo / eta;
                (wi.z < 0.0).then(|| (-wi.z).min(1.0))
            };
            let (back, through) = facet_means(wo, alpha, |cos| fresnel(cos).reflectance, refracted);
            let left = Rgb::splat(1.0 - fresnel(wo.z).reflectance);
            room.min(share(Rgb::ONE - Rgb::splat(back) - ts * through, left))
        })
    })
}

/// Returns `part / whole`, at least 0; 1 if nothing is left to share.
fn share(part: Rgb, whole: Rgb) -> Rgb {
    Rgb::select(whole.cmpgt(Rgb::splat(1e-6)), part.max(Rgb::ZERO) / whole.max(Rgb::splat(1e-6)), Rgb::ONE)
}
