//! Evaluation of a solution for viewing: the light that arrives at a point of an element, and the light that it sends.

use crate::scene::SHUTTER_TIME;
use femc_field::{Cell, Field, Form, Leaf, NONE, Side, Surface, SurfaceSpot};
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::glam::{Vec2, Vec3A};
use femc_prepared::lights::EmitterPoint;
use femc_prepared::{KernelMaterial, Prepared};
use std::f32::consts::FRAC_1_PI;

/// Irradiance, lx by channel of linear Rec.709.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Irradiance {
    /// Irradiance from other surfaces and from fog, as in the field.
    pub indirect: Rgb,
    /// Irradiance directly from light sources, as in the elements.
    pub direct: Rgb,
}

impl Irradiance {
    /// Returns the sum of both.
    pub fn total(self) -> Rgb {
        self.indirect + self.direct
    }
}

/// Totals of the light of a solution.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LightTotals {
    /// Area of the surfaces with light in the solution, each side counted separately, m2.
    pub area: f64,
    /// Luminous flux of all light sources, lm.
    pub emitted: f64,
    /// Luminous flux of all light sources with the maximum of their textures, lm.
    pub max_emitted: f64,
    /// Luminous flux that these surfaces receive, counted at each arrival, lm.
    pub received: f64,
    /// Luminous flux that they absorb, lm.
    pub absorbed: f64,
    /// Least mean irradiance of a leaf, by luminance, lx.
    pub min_irradiance: f32,
    /// Median irradiance, lx: half of the area is in leaves of less mean irradiance.
    pub median: f32,
    /// Greatest mean irradiance of a leaf, lx.
    pub max_irradiance: f32,
    /// Greatest number of leaves of a surface.
    pub max_leaves: usize,
    /// Number of surfaces with a leaf.
    pub surfaces: usize,
    /// Median number of leaves of a surface: half of the surfaces have at most this number.
    pub median_leaves: usize,
}

/// A solution with its frame.
pub struct SolutionView<'a> {
    pub(crate) prepared: &'a Prepared,
    pub(crate) field: &'a Field,
    /// Reflected and transmitted share by material.
    diffuse_albedos: Vec<(Rgb, Rgb)>,
    /// Absorbed share by material. Light that mirrors and clear panes pass on is not absorbed.
    absorbed: Vec<Rgb>,
}

impl<'a> SolutionView<'a> {
    /// Combines a solution with its frame.
    /// - `prepared`: the frame for which `field` was computed.
    pub fn new(prepared: &'a Prepared, field: &'a Field) -> Self {
        let diffuse = |material: &KernelMaterial| material.bsdf.diffuse_albedos();
        let absorbed = |material: &KernelMaterial| (Rgb::ONE - material.bsdf.hemispherical_albedo()).max(Rgb::ZERO);
        let diffuse_albedos = prepared.materials.iter().map(diffuse).collect();
        Self { prepared, field, diffuse_albedos, absorbed: prepared.materials.iter().map(absorbed).collect() }
    }

    /// Returns the irradiance at a point of a leaf.
    /// - `local`: the point's coordinates in the leaf;
    /// - `normal`: unit normal of the surface's side there.
    pub fn irradiance(&self, leaf: u32, local: Vec2, normal: Vec3A) -> Irradiance {
        let at = |leaves: &[Leaf]| {
            leaves.get(leaf as usize).map_or(Rgb::ZERO, |leaf| finite_or_zero(leaf.irradiance(local, normal)))
        };
        Irradiance { indirect: at(&self.field.leaves), direct: at(&self.field.direct) }
    }

    /// Returns the luminance by channel, cd/m2, of a point of a surface, seen along its normal. Gloss counts as diffuse, and
    /// textures of `rd` are ignored, as in the solution.
    /// - `arriving`: irradiance there;
    /// - `place`: the point's parameters on the surface;
    /// - `inside`: parameters of a point near it in the interior of the same leaf. The other side is looked up there, because a
    ///   point on an edge belongs to two leaves.
    pub(crate) fn radiance(&self, surface: u32, arriving: Irradiance, place: Vec2, inside: Vec2) -> Rgb {
        let source = &self.field.surfaces[surface as usize];
        self.scattered_radiance(surface, arriving, inside) + self.emitted(source, place, &source.point_at(place))
    }

    /// Returns the part of a surface's luminance by channel, cd/m2, that it reflects and transmits at a point in the interior of a
    /// leaf.
    /// - `arriving`: irradiance there;
    /// - `place`: the point's parameters on the surface.
    pub fn scattered_radiance(&self, surface: u32, arriving: Irradiance, place: Vec2) -> Rgb {
        let source = &self.field.surfaces[surface as usize];
        let (reflected, transmitted) = self.diffuse_albedos[source.material as usize];
        let mut sent = reflected * arriving.total();
        if transmitted != Rgb::ZERO {
            sent += transmitted * self.back_irradiance(source, place);
        }
        finite_or_zero(sent * FRAC_1_PI)
    }

    /// Returns the irradiance of the other side of a surface.
    fn back_irradiance(&self, surface: &Surface, place: Vec2) -> Rgb {
        let field = self.field;
        let sides = field.sides[surface.instance as usize][surface.primitives[0] as usize];
        let other = sides[usize::from(surface.side == Side::Front)];
        let root = if other == NONE { NONE } else { field.roots[other as usize] };
        let normal = -surface.point_at(place).normal;
        let found = Cell::find(&field.cells, root, place);
        found.map_or(Rgb::ZERO, |(leaf, local)| self.irradiance(leaf, local, normal).total())
    }

    /// Returns the luminance by channel, cd/m2, that a surface itself emits along its normal.
    pub(crate) fn emitted(&self, surface: &Surface, place: Vec2, spot: &SurfaceSpot) -> Rgb {
        let Surface { instance, primitives, side, .. } = *surface;
        let second = matches!(surface.form, Form::Parallelogram(_)) && place.x + place.y > 1.0;
        let primitive = primitives[usize::from(second)];
        let group = &self.prepared.instances[instance as usize];
        let emitter = group.compiled.primitives[primitive as usize].emitter;
        if emitter == NONE {
            return Rgb::ZERO;
        }
        let pose = self.prepared.world.pose_at(instance, SHUTTER_TIME);
        let parametric = group.compiled.blas.triangle(primitive).map_or([0.0; 2], |corners| {
            let [a, b, c] = corners.map(|corner| pose.transform_point3a(corner));
            let triangle = Surface { form: Form::Triangle([a, b - a, c - a]), ..surface.clone() };
            triangle.parameters(spot.position, [0.0; 2]).to_array()
        });
        let front = if side == Side::Back { -spot.normal } else { spot.normal };
        let Prepared { lights, world, textures, .. } = self.prepared;
        let point = EmitterPoint { light: group.first_light + emitter, normal: front, parametric };
        finite_or_zero(lights.radiance(world, textures, &point, spot.normal, SHUTTER_TIME))
    }

    /// Returns the totals over all leaves.
    pub fn totals(&self) -> LightTotals {
        let Prepared { lights, textures, .. } = self.prepared;
        let field = self.field;
        let all =
            |power: &dyn Fn(u32) -> f32| (0..lights.len() as u32).fold(0.0, |sum, light| sum + f64::from(power(light)));
        let emitted = all(&|light| lights.power(light));
        let emitted_at_most = all(&|light| lights.max_power(textures, light));
        let mut totals = LightTotals { emitted, max_emitted: emitted_at_most, ..LightTotals::default() };
        let (mut leaves, mut counts) = (Vec::new(), Vec::new());
        for (index, surface) in field.surfaces.iter().enumerate() {
            let parts = field.leaves_of(index as u32);
            if parts.is_empty() {
                continue;
            }
            counts.push(parts.len());
            let kept = self.absorbed[surface.material as usize];
            for (leaf, outline) in parts {
                let area = f64::from(surface.area() * outline.edges[0].perp_dot(outline.edges[1]).abs());
                let at = |local: &Vec2| {
                    self.irradiance(leaf, *local, surface.point_at(outline.point_at(*local)).normal).total()
                };
                let mean = match field.leaves[leaf as usize] {
                    Leaf::Triangle(_) => Leaf::TRIANGLE_POINTS.iter().map(at).sum::<Rgb>() / 3.0,
                    Leaf::Rectangle(_) => Leaf::RECTANGLE_POINTS.iter().map(at).sum::<Rgb>() / 4.0,
                    Leaf::Curved(_) => {
                        let place = |k: u8| (Vec2::new(f32::from(k % 4), f32::from(k / 4)) + 0.5) * 0.25;
                        (0..16).map(|k| at(&place(k))).sum::<Rgb>() / 16.0
                    }
                };
                totals.area += area;
                totals.received += area * f64::from(luminance(mean));
                totals.absorbed += area * f64::from(luminance(kept * mean));
                leaves.push((luminance(mean), area));
            }
        }
        leaves.sort_by(|a, b| a.0.total_cmp(&b.0));
        counts.sort_unstable();
        totals.min_irradiance = leaves.first().map_or(0.0, |leaf| leaf.0);
        totals.max_irradiance = leaves.last().map_or(0.0, |leaf| leaf.0);
        let mut below = 0.0;
        let middle = leaves.iter().find(|leaf| {
            below += leaf.1;
            below >= 0.5 * totals.area
        });
        totals.median = middle.map_or(0.0, |leaf| leaf.0);
        totals.surfaces = counts.len();
        totals.max_leaves = counts.last().copied().unwrap_or(0);
        totals.median_leaves = counts.get(counts.len().saturating_sub(1) / 2).copied().unwrap_or(0);
        totals
    }
}

/// Replaces values that are not finite with zero.
fn finite_or_zero(color: Rgb) -> Rgb {
    if color.is_finite() { color.max(Rgb::ZERO) } else { Rgb::ZERO }
}
