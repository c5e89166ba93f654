//! Luminous flux of a solution of the first pass, compared with the flux of rays from lamps and from elements.

use crate::rng::Rng;
use femc_geometry::{Ray, offset_origin};
use femc_math::color::luminance;
use femc_math::glam::{Vec2, Vec3A};
use femc_math::{Frame, Rgb, warp};
use femc_pipeline::radiosity::SolutionView;
use femc_pipeline::{Field, Form, Prepared, Side, Solution};
use femc_prepared::lights::EmitterPoint;
use femc_prepared::{Crossing, Orientation};
use std::f64::consts::PI;

/// No surface, no lamp.
const NONE: u32 = u32::MAX;
/// Time of the shutter, as in the solution.
const TIME: f32 = 0.5;
/// Number of rays from all lamps, and from all elements.
const RAYS: f64 = 100_000.0;
/// Number of mirrors and clear surfaces that a ray passes at most.
const MAX_PASSES: u32 = 64;

/// Luminous flux of a solution, lm.
///
/// One-sided surfaces are invisible from behind. So shadow rays find lamps from inside of a closed one-sided object, although no
/// light of lamps gets there: in such scenes more light is kept than is sent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SolutionFlux {
    /// Flux of all light sources.
    pub sent: f64,
    /// Flux that elements receive directly from lamps, in the solution.
    pub direct: f64,
    /// Flux that elements absorb, in the solution.
    pub kept: f64,
    /// Flux that rays find; `None` in fog, and if there are light sources that rays cannot start from, such as the sky.
    pub traced: Option<TracedFlux>,
}

/// Luminous flux that rays find, lm. Rays from elements start with the light of the solution.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TracedFlux {
    /// Flux of lamps that arrives at elements without mirrors and clear solids.
    pub direct: f64,
    /// Flux of lamps and elements that leaves the scene.
    pub escaped: f64,
    /// Flux of lamps and elements that other surfaces absorb: lamps, black surfaces, mirrors and clear solids.
    pub kept_elsewhere: f64,
}

impl SolutionFlux {
    /// Computes the flux of a solution.
    /// - `prepared`: the frame that was solved.
    pub fn new(prepared: &Prepared, solution: &Solution) -> Self {
        let view = SolutionView::new(prepared, &solution.field);
        let totals = view.totals();
        let mut tracer =
            FluxTracer { prepared, field: &solution.field, rng: Rng::new(1), found: TracedFlux::default() };
        let traced_emission = tracer.trace_lamps();
        let direct = tracer.trace_elements(&view);
        let is_complete = (traced_emission / totals.emitted - 1.0).abs() < 0.02 && prepared.media.is_empty();
        let traced = is_complete.then_some(tracer.found);
        Self { sent: totals.emitted, direct, kept: totals.absorbed, traced }
    }

    /// Returns the flux that is kept anywhere or escapes, relative to the sent flux: 1 if the solution conserves energy.
    pub fn balance(&self) -> Option<f64> {
        self.traced.map(|TracedFlux { escaped, kept_elsewhere, .. }| (self.kept + escaped + kept_elsewhere) / self.sent)
    }

    /// Returns the solution's flux directly from lamps, relative to that of the rays.
    pub fn direct_ratio(&self) -> Option<f64> {
        self.traced.map(|traced| self.direct / traced.direct)
    }
}

/// Kind of origin of a ray.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Origin {
    Lamp,
    Element,
}

struct FluxTracer<'a> {
    prepared: &'a Prepared,
    field: &'a Field,
    rng: Rng,
    found: TracedFlux,
}

impl FluxTracer<'_> {
    fn number(&mut self) -> f32 {
        (self.rng.bits() >> 40) as f32 / (1u64 << 24) as f32
    }

    /// Returns parameters of a random point.
    fn place(&mut self, form: &Form) -> Vec2 {
        let place = Vec2::new(self.number(), self.number());
        let is_outside = matches!(form, Form::Triangle(_)) && place.x + place.y > 1.0;
        if is_outside { Vec2::ONE - place } else { place }
    }

    /// Returns a direction by the cosine distribution.
    fn direction(&mut self, normal: Vec3A) -> Vec3A {
        (warp::direction(1.0 - 2.0 * self.number(), self.number()) + normal).normalize_or(normal)
    }

    /// Traces rays from all lamps that are surfaces. Returns their flux.
    fn trace_lamps(&mut self) -> f64 {
        let Prepared { instances, world, lights, textures, .. } = self.prepared;
        let all: f64 = (0..lights.len() as u32).map(|light| f64::from(lights.power(light))).sum();
        let mut emitted = 0.0;
        for (instance, group) in instances.iter().enumerate() {
            let pose = world.pose_at(instance as u32, TIME);
            let blas = &group.compiled.blas;
            for (primitive, part) in group.compiled.primitives.iter().enumerate().filter(|(_, p)| p.emitter != NONE) {
                let light = group.first_light + part.emitter;
                let form = match (blas.triangle(primitive as u32), blas.quadric(primitive as u32)) {
                    (Some(corners), _) => {
                        let [a, b, c] = corners.map(|corner| pose.transform_point3a(corner));
                        Form::Triangle([a, b - a, c - a])
                    }
                    (None, Some(shape)) => Form::Curved { shape, pose },
                    (None, None) => continue,
                };
                let primitives = [primitive as u32; 2];
                let side = Side::Front;
                let surface =
                    femc_field::Surface { instance: instance as u32, primitives, material: part.material, side, form };
                let count = (f64::from(lights.power(light)) / all * RAYS).ceil();
                let weight = f64::from(surface.area()) * PI / count;
                for _ in 0..2 * count as u32 {
                    // Rays from front and back in turn.
                    let place = self.place(&surface.form);
                    let mut spot = surface.point_at(place);
                    let front = spot.normal;
                    if self.rng.bits() & 1 == 0 {
                        spot.normal = -front;
                    }
                    let dir = self.direction(spot.normal);
                    let point = EmitterPoint { light, normal: front, parametric: place.to_array() };
                    let flux = weight * f64::from(luminance(lights.radiance(world, textures, &point, dir, TIME)));
                    emitted += flux;
                    if flux > 0.0 {
                        let origin = offset_origin(spot.position, spot.error, spot.normal, dir);
                        self.trace(origin, dir, flux, Origin::Lamp);
                    }
                }
            }
        }
        emitted
    }

    /// Traces rays from all elements. Returns the flux that they receive directly from lamps, in the solution.
    fn trace_elements(&mut self, view: &SolutionView<'_>) -> f64 {
        let field = self.field;
        let has_light = |index: &usize| field.roots[*index] != NONE;
        let area: f64 =
            (0..field.surfaces.len()).filter(has_light).map(|index| f64::from(field.surfaces[index].area())).sum();
        let mut direct = 0.0;
        for (index, surface) in field.surfaces.iter().enumerate() {
            for (leaf, outline) in field.leaves_of(index as u32) {
                let size = f64::from(surface.area() * outline.edges[0].perp_dot(outline.edges[1]).abs());
                let count = (size / area * RAYS + f64::from(self.number())) as u32;
                for _ in 0..count {
                    let local = self.place(&surface.form);
                    let place = outline.point_at(local);
                    let spot = surface.point_at(place);
                    let arriving = view.irradiance(leaf, local, spot.normal);
                    direct += f64::from(luminance(arriving.direct)) * area / RAYS;
                    let sent = luminance(view.scattered_radiance(index as u32, arriving, place));
                    let flux = f64::from(sent) * PI * area / RAYS;
                    if flux > 0.0 {
                        let dir = self.direction(spot.normal);
                        let origin = offset_origin(spot.position, spot.error, spot.normal, dir);
                        self.trace(origin, dir, flux, Origin::Element);
                    }
                }
            }
        }
        direct
    }

    /// Follows light to the surfaces that absorb or scatter it.
    fn trace(&mut self, origin: Vec3A, dir: Vec3A, mut flux: f64, from: Origin) {
        let mut ray = Ray { origin, dir, t_max: f32::INFINITY, time: TIME };
        let mut is_bent = false;
        for _ in 0..MAX_PASSES {
            let Some(hit) = self.prepared.world.intersect(&ray) else {
                self.found.escaped += flux;
                return;
            };
            let point = self.prepared.shading_point(&ray, &hit);
            let is_back = point.normal.dot(ray.dir) > 0.0;
            let material = &self.prepared.materials[point.material as usize];
            if let Crossing::Null { tint } = material.crossing[usize::from(is_back)] {
                self.found.kept_elsewhere += flux * (1.0 - f64::from(luminance(tint)));
                flux *= f64::from(luminance(tint));
                ray.origin = offset_origin(point.position, point.error, point.normal, ray.dir);
                continue;
            }
            let is_turned = is_back && material.orientation == Orientation::TowardViewer;
            let normal = if is_turned { -point.normal } else { point.normal };
            let frame = Frame::from_normal(normal);
            let wo = frame.to_local(-ray.dir);
            let surface = self.field.sides[hit.instance as usize][hit.primitive as usize][usize::from(is_back)];
            if surface != NONE && self.field.roots[surface as usize] != NONE {
                if from == Origin::Lamp && !is_bent {
                    self.found.direct += flux;
                }
            } else {
                let absorbed = (Rgb::ONE - material.bsdf.albedo(wo)).max(Rgb::ZERO);
                self.found.kept_elsewhere += flux * f64::from(luminance(absorbed));
            }
            if !material.bsdf.has_delta() {
                return;
            }
            let u = [self.number(), self.number()];
            let Some(sample) = material.bsdf.without_lambertian().sample(wo, u, self.number()) else { return };
            is_bent = true;
            // Radiance changes with the square of the index, flux does not.
            flux *= f64::from(luminance(sample.weight) * sample.eta * sample.eta);
            let dir = frame.to_world(sample.wi).normalize_or(normal);
            ray = Ray { origin: offset_origin(point.position, point.error, point.normal, dir), dir, ..ray };
        }
        // Light between mirrors without end.
        self.found.kept_elsewhere += flux;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::closed_forms::{CAMERA, furnace};
    use crate::random_rooms::{RoomOptions, random_room};
    use femc_pipeline::radiosity::{SolveOptions, solve};
    use femc_pipeline::{SceneSource, Settings, prepare_world};
    use std::sync::atomic::AtomicBool;

    fn flux_of(text: &str) -> SolutionFlux {
        let source = SceneSource::new(crate::parse_scene(text));
        let prepared = prepare_world(&source, &Settings::default(), 1, None).unwrap_or_else(|e| panic!("{e}"));
        let options = SolveOptions { error: 1.0, ..SolveOptions::default() };
        let solution = solve(&prepared, &options, &AtomicBool::new(false)).unwrap_or_else(|e| panic!("{e:?}"));
        SolutionFlux::new(&prepared, &solution)
    }

    #[test]
    fn a_furnace_keeps_all_light() {
        let flux = flux_of(&furnace(0.5, 0.0).text);
        let traced = flux.traced.expect("rays");
        assert!((flux.sent / (6.0 * PI) - 1.0).abs() < 1e-5 && traced.escaped < 1e-3 * flux.sent, "{flux:?}");
        assert!((flux.balance().unwrap_or(0.0) - 1.0).abs() < 0.01, "{flux:?}");
        assert!((flux.direct_ratio().unwrap_or(0.0) - 1.0).abs() < 0.01, "{flux:?}");
    }

    /// A lamp above a floor, whose light leaves the scene after one reflection, beside a mirror.
    #[test]
    fn light_of_an_open_scene_escapes() {
        let square = |name: &str, half: f64, z: f64, order: [usize; 4]| {
            let at = [[-half, -half], [half, -half], [half, half], [-half, half]];
            let corner = |k: usize| format!("v {name}{k} =\n  p {} {} {z}\n", at[k][0], at[k][1]);
            let names = order.map(|k| format!("{name}{k}")).join(" ");
            (0..4).map(corner).collect::<String>() + &format!("f {names}\n")
        };
        let floor = format!("m floor =\n  sides 1\n  rd .5\n{}", square("f", 2.0, 0.0, [0, 1, 2, 3]));
        let lamp = format!("m lamp =\n  sides 1\n  ed 1000\n{}", square("l", 0.1, 1.0, [3, 2, 1, 0]));
        let open = flux_of(&format!("{CAMERA}{floor}{lamp}"));
        let traced = open.traced.expect("rays");
        assert!((open.balance().unwrap_or(0.0) - 1.0).abs() < 0.02, "{open:?}");
        assert!((traced.escaped / (open.sent - open.kept) - 1.0).abs() < 0.04, "{open:?}");
        // Of the lamp's light, 40 lm, a mirror below the lamp sends all that it receives past the floor.
        let mirror = format!("m mirror =\n  sides 2\n  rs 1 0\n{}", square("m", 1.0, 0.5, [0, 1, 2, 3]));
        let covered = flux_of(&format!("{CAMERA}{floor}{lamp}{mirror}"));
        let escaped = covered.traced.map_or(0.0, |traced| traced.escaped);
        assert!(escaped > 0.8 * covered.sent && covered.kept < 0.2 * covered.sent, "{covered:?}");
    }

    #[test]
    fn a_random_room_with_an_opening_loses_light() {
        let is_open = |seed: &u64| random_room(*seed, &RoomOptions::default()).features.contains(&"open");
        let seed = (0..50).find(is_open).expect("an open room");
        let flux = flux_of(&random_room(seed, &RoomOptions::default()).text);
        assert!(flux.traced.is_some_and(|traced| traced.escaped > 0.02 * flux.sent), "{flux:?}");
        assert!((flux.balance().unwrap_or(0.0) - 1.0).abs() < 0.2, "{flux:?}");
    }
}
