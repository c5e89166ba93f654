//! Transport of light from a lamp, as the rendering methods find it.
//!
//! Rendered paths start at the camera. A one-sided surface without an index of refraction is invisible from behind. It therefore
//! stops light that arrives at its back, because a viewer on the other side sees its front. It passes light that arrives at its
//! front, because a viewer behind it looks through it.

use super::{Hit, Ray, Scope, SplitMix64};
use crate::description::{Material, MaterialId, RegionBounds, ScatteringPart, Scene, Sides};
use femc_math::glam::DVec3;

/// Maximum number of surfaces that pass or reflect one ray.
const MAX_CROSSINGS: u32 = 64;
/// Roughness up to which a lobe counts as a perfect mirror or as perfectly clear, as in the renderer.
const SMOOTH: f64 = 1e-4;
/// Difference of the index of refraction from 1 up to which nothing is refracted, as in the renderer.
const MATCHED: f64 = 1e-3;
/// Scattering optical depth above which a medium makes visible the light that crosses it.
const VISIBLE_DEPTH: f64 = 0.05;

/// A point where light of a lamp arrives and is scattered.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LitPoint {
    /// Position, just before the surface.
    pub position: DVec3,
    /// Unit normal of the lit side; `None` if both sides are lit, or for a point in a medium.
    pub normal: Option<DVec3>,
}

/// End of a light path.
#[derive(Clone, Copy, Debug)]
pub(crate) enum LightPathEnd {
    /// The light left the scene.
    Escaped,
    /// A surface or a medium scatters the light.
    Lit(LitPoint),
    /// Light of a point lamp hit the smooth boundary of a solid that refracts it.
    Refracted(MaterialId),
    /// Light of a point lamp hit a perfect mirror.
    Mirrored(MaterialId),
    /// A surface stops the light.
    Stopped(MaterialId),
}

/// Effect of a surface on light that arrives at one of its sides.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SurfaceEffect {
    /// Whether the surface scatters into a range of directions.
    scatters: bool,
    /// Whether the surface also scatters to its other side.
    transmits: bool,
    /// Whether light goes straight through.
    passes: bool,
    /// Whether light is refracted through the surface.
    refracts: bool,
    /// Whether light is reflected into a single direction.
    mirrors: bool,
}

impl SurfaceEffect {
    /// Returns the effects of a material on light that arrives at its front and at its back.
    pub fn per_side(scene: &Scene, material: &Material) -> [Self; 2] {
        [true, false].map(|is_front| effect_on_side(scene, material, is_front))
    }
}

fn effect_on_side(scene: &Scene, material: &Material, is_front: bool) -> SurfaceEffect {
    let entity = format!("material.{}", material.name);
    let largest = |field: &str, now: f64| scene.max_over_time(&entity, field, now);
    let is_present = |part: &ScatteringPart| largest(part.name(), part.fraction(material).amount) > 0.0;
    let is_diffuse = |part: &ScatteringPart| part.roughness_name().is_none();
    // Whether the part scatters into a range of directions.
    let spreads = |part: &ScatteringPart| {
        let roughness = part.roughness_name().zip(part.roughness(material));
        roughness.is_none_or(|(field, alpha)| largest(field, alpha) > SMOOTH)
    };
    let parts: Vec<ScatteringPart> = ScatteringPart::ALL.into_iter().filter(is_present).collect();
    let any = |of: &dyn Fn(&ScatteringPart) -> bool| parts.iter().any(of);
    let index = material.ior.filter(|ior| ior.im == 0.0).map(|ior| (ior.re - 1.0).abs());
    let is_one_sided = material.sides == Sides::One;
    if is_one_sided && material.ior.is_none() && !is_front {
        return SurfaceEffect::default();
    }
    let refracted = ScatteringPart::SpecularTransmission;
    if let (true, true, Some(away)) = (is_one_sided, parts.contains(&refracted), index) {
        // If the index is close to 1 but not exactly 1, the boundary is smooth even with a roughness.
        let is_rough = spreads(&refracted) && (away == 0.0 || away >= MATCHED);
        let passes = away < MATCHED && !is_rough;
        return SurfaceEffect {
            scatters: any(&is_diffuse) || is_rough,
            transmits: any(&|part| is_diffuse(part) && part.is_transmitted()) || is_rough,
            passes,
            refracts: !passes,
            mirrors: false,
        };
    }
    let is_seen_through = is_one_sided && material.ior.is_none();
    SurfaceEffect {
        scatters: any(&spreads),
        transmits: any(&|part| spreads(part) && part.is_transmitted()),
        passes: any(&|part| !spreads(part) && part.is_transmitted()) || is_seen_through,
        refracts: false,
        mirrors: any(&|part| !spreads(part) && !part.is_transmitted()),
    }
}

/// Traces light until something scatters or stops it.
/// - `is_point`: whether the light comes straight from a point lamp. No path can hit a point, so after a mirror or a refraction
///   this light is not found.
pub(crate) fn trace_light(scope: &Scope<'_>, mut ray: Ray, is_point: bool, rng: &mut SplitMix64) -> LightPathEnd {
    let mut mirror = None;
    for _ in 0..MAX_CROSSINGS {
        let Some(hit) = scope.first_hit(&ray) else { return LightPathEnd::Escaped };
        mirror = None;
        let Some(effects) = scope.effects.get(hit.material.index()) else { return LightPathEnd::Stopped(hit.material) };
        let is_front = hit.is_front(&ray);
        let normal = if is_front { hit.normal } else { -hit.normal };
        let position = ray.origin + hit.distance * ray.dir;
        let effect = effects[usize::from(!is_front)];
        if effect.scatters && !(effect.passes && rng.next_f64() < 0.5) {
            let normal_of_side = (!effect.transmits).then_some(normal);
            return LightPathEnd::Lit(LitPoint {
                position: position + 2.0 * scope.offset() * normal,
                normal: normal_of_side,
            });
        }
        let lost: fn(MaterialId) -> LightPathEnd =
            if effect.refracts { LightPathEnd::Refracted } else { LightPathEnd::Mirrored };
        if effect.passes || (effect.refracts && !is_point) {
            ray.origin = position + scope.offset() * ray.dir;
        } else if effect.mirrors && !is_point {
            let dir = (ray.dir - 2.0 * ray.dir.dot(normal) * normal).normalize_or(normal);
            ray = Ray { origin: position + 2.0 * scope.offset() * normal, dir, ..ray };
            mirror = Some(hit.material);
        } else if let Some(lit) = lit_point_in_medium(scope, &ray, &hit, is_front) {
            return LightPathEnd::Lit(lit);
        } else if effect.refracts || effect.mirrors {
            return lost(hit.material);
        } else {
            return LightPathEnd::Stopped(hit.material);
        }
    }
    // The last surface was a mirror: the light is trapped. After many clear surfaces the result is unknown, so the light counts as
    // escaped.
    mirror.map_or(LightPathEnd::Escaped, LightPathEnd::Stopped)
}

/// Returns the middle of the segment if media on it scatter a visible share of the light.
fn lit_point_in_medium(scope: &Scope<'_>, ray: &Ray, hit: &Hit, is_front: bool) -> Option<LitPoint> {
    let middle = ray.origin + 0.5 * hit.distance * ray.dir;
    let scattering = |index: usize| {
        let medium = scope.scene.media.get(index)?;
        Some(scope.scene.max_over_time(&format!("medium.{}", medium.name), "sigma_s", medium.sigma_s))
    };
    let regions = scope.scene.regions.iter().filter(|region| match region.bounds {
        RegionBounds::Everywhere => true,
        RegionBounds::Box { min, max, to_world } => {
            let local = to_world.inverse().transform_point3(middle);
            local.cmpge(min.min(max)).all() && local.cmple(min.max(max)).all()
        }
    });
    let inside = hit.material(scope).filter(|_| !is_front).and_then(|material| material.inside);
    let media = regions.map(|region| region.medium).chain(inside);
    let depth = hit.distance * media.filter_map(|medium| scattering(medium.index())).sum::<f64>();
    (depth > VISIBLE_DEPTH).then_some(LitPoint { position: middle, normal: None })
}

/// Returns a ray of the light that a lit point scatters.
pub(crate) fn scattered_ray(scope: &Scope<'_>, lit: &LitPoint, rng: &mut SplitMix64) -> Ray {
    let any = rng.direction();
    let Some(normal) = lit.normal else { return Ray { origin: lit.position, dir: any, far: f64::INFINITY } };
    let dir = (normal + 0.999 * any).normalize_or(normal);
    Ray { origin: lit.position + scope.offset() * normal, dir, far: f64::INFINITY }
}
