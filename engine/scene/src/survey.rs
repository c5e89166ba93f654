//! Survey of a scene: its size, and its lamps with their luminous flux.

use crate::description::{Location, Photometry, RegionBounds, Scene, Sides};
use crate::world::{Bounds, Scope, group_touching, shape_area};
use femc_math::glam::DVec3;

/// Relative difference in luminous flux below which lamps are equal. It allows for the rounded areas of rotated copies.
const EQUAL: f64 = 1e-3;

/// Kind of lamp.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LampKind {
    /// Touching surfaces of this material.
    Surface {
        /// The material's name; empty for the unnamed one.
        material: String,
    },
    /// A luminaire of this photometric file.
    Luminaire {
        /// Path of the file, relative to the scene's root.
        path: String,
    },
    /// A box of this glowing medium.
    Medium {
        /// The medium's name.
        medium: String,
    },
}

/// A group of equal lamps.
#[derive(Clone, Debug, PartialEq)]
pub struct LampGroup {
    /// Kind of lamp.
    pub kind: LampKind,
    /// Number of lamps.
    pub count: u64,
    /// Luminous flux of each lamp, lm, at the start of the clip.
    pub lumens: f64,
    /// Emitting area of each lamp, m2, counting both sides of two-sided surfaces; `None` for luminaires and media.
    pub area: Option<f64>,
    /// Location of the first lamp.
    pub location: Location,
}

/// Survey of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Survey {
    /// Lower and upper corner of all shown surfaces and luminaires, in the world, m; `None` for an empty scene.
    pub bounds: Option<[DVec3; 2]>,
    /// Lamps in order of their location in the files.
    pub lamps: Vec<LampGroup>,
}

/// Surveys a scene at the start of its clip.
/// - `flux`: luminous flux of a photometric file, lm.
pub fn survey_scene(scene: &Scene, flux: &dyn Fn(&Photometry) -> f64) -> Survey {
    let scope = Scope::new(scene);
    let single = surface_lamps(&scope).into_iter().chain(luminaire_lamps(&scope, flux)).chain(medium_lamps(scene));
    let mut single: Vec<LampGroup> = single.collect();
    single.sort_by(|a, b| a.kind.cmp(&b.kind).then(a.lumens.total_cmp(&b.lumens)));
    let equal = |a: &LampGroup, b: &LampGroup| a.kind == b.kind && b.lumens <= a.lumens * (1.0 + EQUAL);
    let mut lamps: Vec<LampGroup> = single.chunk_by(equal).filter_map(merge_lamps).collect();
    lamps.sort_by_key(|lamp| lamp.location);
    let bounds = scope.shown_bounds();
    let bounds = (!bounds.is_empty()).then_some([bounds.min, bounds.max]);
    Survey { bounds, lamps }
}

/// Merges equal lamps into one entry.
fn merge_lamps(lamps: &[LampGroup]) -> Option<LampGroup> {
    let first = lamps.iter().min_by_key(|lamp| lamp.location)?;
    Some(LampGroup { count: lamps.len() as u64, ..first.clone() })
}

/// An emitting face or curved surface.
struct EmittingSurface {
    bounds: Bounds,
    area: f64,
    material: usize,
    location: Location,
}

/// Returns the surface lamps. Touching emitting surfaces of one material form one lamp.
fn surface_lamps(scope: &Scope<'_>) -> Vec<LampGroup> {
    let emitters = emitting_surfaces(scope);
    let bounds: Vec<Bounds> = emitters.iter().map(|element| element.bounds).collect();
    let groups =
        group_touching(&bounds, 1e-6 * scope.bounds.diagonal(), |a, b| emitters[a].material == emitters[b].material);
    let lamp_of = |group: Vec<usize>| {
        let area = group.iter().map(|&index| emitters[index].area).sum();
        lamp(scope.scene, &emitters[group[0]], area)
    };
    groups.into_iter().map(lamp_of).collect()
}

fn lamp(scene: &Scene, emitter: &EmittingSurface, area: f64) -> LampGroup {
    let material = &scene.materials[emitter.material];
    let sided = if material.sides == Sides::Two { 2.0 * area } else { area };
    let texture = material.map_ed.and_then(|image| scene.images.get(image.index()));
    let mean = texture.map_or(1.0, |image| {
        let weights = femc_math::color::LUMINANCE_WEIGHTS.to_array();
        let luminance = |pixel: &[f32; 3]| pixel.iter().zip(weights).map(|(c, w)| f64::from(c * w)).sum::<f64>();
        image.pixels.iter().map(luminance).sum::<f64>() / image.pixels.len().max(1) as f64
    });
    LampGroup {
        kind: LampKind::Surface { material: material.name.clone() },
        count: 1,
        lumens: material.ed.photometric_amount() * mean * sided,
        area: Some(sided),
        location: emitter.location,
    }
}

fn emitting_surfaces(scope: &Scope<'_>) -> Vec<EmittingSurface> {
    let emits: Vec<bool> =
        scope.scene.materials.iter().map(|material| material.ed.photometric_amount() > 0.0).collect();
    let mut emitters = Vec::new();
    for face in scope.triangles.chunk_by(|a, b| a.face == b.face) {
        if emits.get(face[0].material.index()) == Some(&true) {
            emitters.push(EmittingSurface {
                bounds: face.iter().map(|triangle| triangle.bounds()).fold(Bounds::EMPTY, Bounds::union),
                area: face.iter().map(|triangle| 0.5 * triangle.cross().length()).sum(),
                material: face[0].material.index(),
                location: face[0].location,
            });
        }
    }
    for quadric in scope.quadrics.iter().filter(|q| emits.get(q.material.index()) == Some(&true)) {
        let (material, location) = (quadric.material.index(), quadric.location);
        emitters.push(EmittingSurface {
            bounds: quadric.bounds(),
            area: shape_area(&quadric.shape),
            material,
            location,
        });
    }
    emitters
}

fn luminaire_lamps(scope: &Scope<'_>, flux: &dyn Fn(&Photometry) -> f64) -> Vec<LampGroup> {
    let scene = scope.scene;
    let fluxes: Vec<f64> = scene.photometry.iter().map(flux).collect();
    let lamp = |placed: &crate::world::PlacedLuminaire<'_>| {
        let file = placed.luminaire.photometry.index();
        Some(LampGroup {
            kind: LampKind::Luminaire { path: scene.photometry.get(file)?.path.clone() },
            count: 1,
            lumens: fluxes.get(file)? * placed.luminaire.multiplier,
            area: None,
            location: placed.luminaire.location,
        })
    };
    scope.luminaires.iter().filter_map(lamp).collect()
}

fn medium_lamps(scene: &Scene) -> Vec<LampGroup> {
    let lamp = |region: &crate::MediumRegion| {
        let medium = scene.media.get(region.medium.index()).filter(|medium| medium.glow > 0.0)?;
        let RegionBounds::Box { min, max, to_world } = region.bounds else { return None };
        let size = (max - min).abs();
        let volume = size.x * size.y * size.z * to_world.matrix3.determinant().abs();
        let tint = crate::TintedScalar { amount: medium.glow, color: medium.glow_color };
        let uniform = medium.density == crate::Density::Uniform;
        uniform.then(|| LampGroup {
            kind: LampKind::Medium { medium: medium.name.clone() },
            count: 1,
            lumens: tint.photometric_amount() * volume,
            area: None,
            location: region.location,
        })
    };
    scene.regions.iter().filter_map(lamp).collect()
}
