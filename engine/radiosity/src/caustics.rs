//! Light of lamps that mirrors reflect or clear solids refract, by particles from the lamps.
//!
//! No shadow ray finds this light, and rays of leaves hit small lamps by chance only. So particles start from the lamps and follow
//! mirrors and clear surfaces to the first surface that scatters, or to the first point where the fog scatters them. They count there
//! if a mirror or a refracting surface has changed their direction, because the light of all others is the direct light.
//!
//! The directions of a lamp are divided into cells. A few particles of each cell show how much of its light counts; most other
//! particles start in the cells with more of it.

mod irradiance;

pub use irradiance::CausticLight;

use crate::arena::Arena;
use crate::rays::{Landing, PathKind, follow_path};
use crate::scene::{Lamp, SHUTTER_TIME, Scene};
use crate::tuning::{CAUSTIC_CELLS, CAUSTIC_PARTICLES, CAUSTIC_PILOTS, UNSEEN_CAUSTICS};
use crate::visibility::{RandomNumbers, VisibilityTester};
use femc_field::{NONE, SurfaceSpot};
use femc_math::color::luminance;
use femc_math::glam::{Vec2, Vec3A};
use femc_math::{Rgb, warp};
use femc_prepared::Prepared;
use rayon::prelude::*;
use std::f32::consts::PI;

/// Distance, in radii of a lamp, from which the points that emit in a direction are sampled.
const FAR: f32 = 4.0;
/// Minimum of this distance, m.
const MIN_FAR: f32 = 0.01;
/// Number of particles of a task.
const CHUNK: u32 = 512;

/// Light of lamps where it lands after mirrors and clear solids.
#[derive(Clone, Debug, Default)]
pub struct Caustics {
    /// Particles by surface; those in the fog are last.
    particles: Vec<Particle>,
}

/// Flux that lands at a point.
#[derive(Clone, Copy, Debug)]
struct Particle {
    /// Surface, or [`NONE`] in the fog.
    surface: u32,
    /// Parameters of the point on the surface, or the point in the fog, m.
    place: Vec3A,
    /// Luminous flux by channel, lm.
    flux: Rgb,
}

/// Directions of a lamp: equal parts of the sphere, by height and azimuth.
#[derive(Clone, Copy, Debug)]
struct Cells {
    /// Number of parts by height; there are twice as many by azimuth.
    rows: u32,
}

impl Cells {
    /// Creates the cells of each of `lamps` lamps.
    fn new(lamps: usize) -> Self {
        let of_lamp = CAUSTIC_PILOTS / (2 * lamps.max(1));
        Self { rows: (of_lamp as f32).sqrt().clamp(1.0, CAUSTIC_CELLS as f32) as u32 }
    }

    fn count(self) -> u32 {
        2 * self.rows * self.rows
    }

    /// Returns a direction of a cell.
    /// - `u`: numbers in [0, 1).
    fn direction(self, cell: u32, u: [f32; 2]) -> Vec3A {
        let (row, column) = (cell / (2 * self.rows), cell % (2 * self.rows));
        let height = (row as f32 + u[0]) / self.rows as f32;
        warp::direction(1.0 - 2.0 * height, (column as f32 + u[1]) / (2 * self.rows) as f32)
    }
}

/// Tracer of particles.
struct Emitter<'a> {
    scene: &'a Scene<'a>,
    arena: &'a Arena,
    cells: Cells,
}

/// A particle's flux at its lamp, by luminance, and where it lands.
struct Emitted {
    flux: f32,
    landed: Option<Particle>,
}

impl Emitter<'_> {
    /// Emits a particle from a lamp in a cell of directions, with the flux of the whole cell.
    fn emit(&self, lamp: u32, cell: u32, numbers: &mut RandomNumbers, tester: &mut VisibilityTester) -> Emitted {
        let Prepared { lights, world, textures, .. } = self.scene.prepared;
        let Lamp { center, radius, .. } = self.scene.lamps[lamp as usize];
        let outward = self.cells.direction(cell, [numbers.next(), numbers.next()]);
        // The points of the lamp are sampled as seen from a sphere around it.
        let far = (FAR * radius).max(MIN_FAR);
        let reference = center + outward * far;
        let u = [numbers.next(), numbers.next()];
        let nothing = Emitted { flux: 0.0, landed: None };
        let Some(sample) = lights.sample_light(world, textures, lamp, reference, SHUTTER_TIME, u) else {
            return nothing;
        };
        let dir = -sample.dir;
        let solid_angle = 4.0 * PI / self.cells.count() as f32;
        // Cosine between the direction and the sphere's normal, whose area is distributed evenly.
        let flux = sample.radiance * (far * far * dir.dot(outward).max(0.0) * solid_angle / sample.pdf);
        if !flux.is_finite() || luminance(flux) <= 0.0 {
            return nothing;
        }
        let spot = SurfaceSpot { position: sample.position, error: sample.error, normal: sample.normal };
        let landed = self.land(&spot, dir, flux, numbers, tester);
        Emitted { flux: luminance(flux), landed }
    }

    fn land(
        &self,
        spot: &SurfaceSpot,
        dir: Vec3A,
        flux: Rgb,
        numbers: &mut RandomNumbers,
        tester: &mut VisibilityTester,
    ) -> Option<Particle> {
        let end = follow_path(self.scene, self.arena, spot, dir, PathKind::Flux, numbers, tester);
        let flux = flux * end.flux;
        if !end.is_bent || !flux.is_finite() {
            return None;
        }
        match end.at {
            Landing::Surface { surface, place: Vec2 { x, y }, .. } => {
                Some(Particle { surface, place: Vec3A::new(x, y, 0.0), flux })
            }
            Landing::Fog(place) => Some(Particle { surface: NONE, place, flux }),
            Landing::Nowhere => None,
        }
    }
}

impl Caustics {
    /// Traces particles from all lamps. There are none, at no cost, without mirrors and clear solids.
    pub fn trace(scene: &Scene<'_>, arena: &Arena) -> (Self, u64) {
        let lamps = scene.lamps.len();
        let prepared = scene.prepared;
        if lamps == 0 || arena.root == NONE || !prepared.materials.iter().any(|material| material.bsdf.has_delta()) {
            return (Self::default(), 0);
        }
        let cells = Cells::new(lamps);
        let emitter = Emitter { scene, arena, cells };
        let count = lamps as u32 * cells.count();
        let each = (CAUSTIC_PILOTS as u32 / count).max(1);
        let trace = |number: u32, of: &(dyn Fn(u32, &mut VisibilityTester) -> Emitted + Sync)| {
            let chunks: Vec<(Vec<Emitted>, u64)> = (0..number.div_ceil(CHUNK))
                .into_par_iter()
                .map(|chunk| {
                    let mut tester = VisibilityTester::default();
                    let range = chunk * CHUNK..((chunk + 1) * CHUNK).min(number);
                    (range.map(|index| of(index, &mut tester)).collect(), tester.rays)
                })
                .collect();
            let rays = chunks.iter().map(|(_, rays)| rays).sum::<u64>();
            (chunks.into_iter().flat_map(|(emitted, _)| emitted).collect::<Vec<_>>(), rays)
        };
        let key = |stage: u64, index: u32| RandomNumbers::new(&[21, stage, u64::from(index)]);
        let (pilots, pilot_rays) = trace(count * each, &|index, tester| {
            let cell = index / each;
            emitter.emit(cell / cells.count(), cell % cells.count(), &mut key(0, index), tester)
        });
        // Flux of each cell that the lamp sends, and that lands and counts.
        let sums: Vec<[f64; 2]> = pilots
            .chunks(each as usize)
            .map(|pilots| {
                let landed = |pilot: &Emitted| pilot.landed.map_or(0.0, |particle| luminance(particle.flux));
                let sum = |of: &dyn Fn(&Emitted) -> f32| pilots.iter().map(|pilot| f64::from(of(pilot))).sum::<f64>();
                [sum(&|pilot| pilot.flux) / f64::from(each), sum(&landed) / f64::from(each)]
            })
            .collect();
        let [sent, landed] = [0, 1].map(|k| sums.iter().map(|sum| sum[k]).sum::<f64>());
        if landed <= 0.0 {
            return (Self::default(), pilot_rays);
        }
        let number =
            ((CAUSTIC_PARTICLES[1] as f64 * (landed / sent).min(1.0).sqrt()) as u32).max(CAUSTIC_PARTICLES[0] as u32);
        let weights = sums.iter().map(|[of, found]| found / landed + f64::from(UNSEEN_CAUSTICS) * of / sent);
        let mut ends: Vec<f64> = weights
            .scan(0.0, |sum, weight| {
                *sum += weight;
                Some(*sum)
            })
            .collect();
        let whole = ends[ends.len() - 1];
        ends.iter_mut().for_each(|end| *end /= whole);
        let (emitted, rays) = trace(number, &|index, tester| {
            let mut numbers = key(1, index);
            let at = (f64::from(index) + f64::from(numbers.next())) / f64::from(number);
            let cell = ends.partition_point(|&end| end <= at).min(ends.len() - 1);
            let probability = ends[cell] - if cell > 0 { ends[cell - 1] } else { 0.0 };
            let cell = cell as u32;
            let mut emitted = emitter.emit(cell / cells.count(), cell % cells.count(), &mut numbers, tester);
            if let Some(particle) = &mut emitted.landed {
                particle.flux *= (1.0 / (probability * f64::from(number))) as f32;
            }
            emitted
        });
        let mut particles: Vec<Particle> = emitted.into_iter().filter_map(|emitted| emitted.landed).collect();
        particles.sort_by_key(|particle| particle.surface);
        (Self { particles }, pilot_rays + rays)
    }

    /// Checks whether there are no particles.
    pub fn is_empty(&self) -> bool {
        self.particles.is_empty()
    }
}
