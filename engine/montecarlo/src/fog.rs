//! Participating media on a segment of a path: emission, free distances, and single scattering.
//!
//! Single scattering on the segment is sampled in two ways. (1) Choose a light by the amount of its light that the segment
//! scatters, a distance by the same measure, then a point on the light. (2) Sample a distance by transmittance, then a direction
//! that hits the light. Both have densities over (light, distance, direction) and are combined there with the power heuristic.
//!
//! Directions after an event are sampled from the phase function or toward a light, with the density of the mixture of both. A table
//! of directions, if a field has one, is a third part of the mixture.

use crate::dimensions as dim;
use crate::guided::TABLE_SHARE;
use crate::path_state::PathState;
use crate::record::Decision;
use crate::shadow::ShadowTester;
use crate::square;
use crate::technique::{MisTechnique, mis_weight};
use crate::tracer::TracerCounters;
use crate::window::DirectionNumbers;
use femc_emission::{DeltaKind, DirectionContext, LightWeights, SegmentContext};
use femc_field::DirectionTable;
use femc_math::Rgb;
use femc_math::glam::Vec3A;
use femc_prepared::Prepared;
use femc_prepared::media::{DistanceSample, MediaRay, ScatterEvent};
use femc_prepared::single_scatter::{MediumSegment, SingleScatterSampler};

/// Share of the directions after an event that are sampled from the phase function.
const PHASE_SHARE: f32 = 0.5;
/// Number of segments at whose ends directions may be sampled toward lights. In thick fog a path has thousands of segments, and the
/// product of so many factors with mean 1 would nearly always be close to 0. On the drive through the roundabout, a value of 6
/// makes paths a seventh longer than 24, and the variance is not lower.
const MAX_GUIDED_SEGMENTS: u32 = 24;
/// Number of angles at which the lights are evaluated, for a camera ray, whose light counts most, and for later ones.
const ANGLES_FROM_CAMERA: u32 = 6;
const ANGLES: u32 = 3;

/// The media of a ray, and the weights of the lights for it.
#[derive(Clone, Default)]
pub struct FoggyRay {
    /// Media of the ray.
    pub media: MediaRay,
    /// Scattering stretch of the segment, as context for the choice of a light. `None`: nothing scatters.
    light_context: Option<SegmentContext>,
    light_weights: LightWeights,
}

/// A scattering event of the path, with the data for the weights of lights that are hit later.
#[derive(Clone, Copy)]
pub struct Collision {
    /// The event; `pdf` is the density of its distance, 1/m.
    pub event: ScatterEvent,
    /// Position, m.
    pub position: Vec3A,
}

/// Outcome of sampling the distance of the next collision on a ray.
pub enum FreeFlight {
    /// The path collides before the end of the ray.
    Collision(Collision),
    /// The path reaches the end of the ray.
    Through {
        /// Transmittance of the ray, divided by the probability of no collision.
        weight: Rgb,
    },
}

/// A direction sampled after an event.
#[derive(Clone, Copy)]
pub struct DirectionSample {
    /// Unit direction.
    pub dir: Vec3A,
    /// Density of the direction, 1/sr.
    pub pdf: f32,
    /// Density of the direction by the phase function alone, 1/sr. Light that is hit is weighted with this one, because it needs no
    /// evaluation of the lights.
    pub phase_pdf: f32,
    /// Factor on the throughput.
    pub weight: Rgb,
    /// Whether a table of directions sampled the direction.
    pub is_guide_sample: bool,
}

/// Light scattered once on a segment.
#[derive(Clone, Copy)]
pub struct SingleScatterSample {
    /// Radiance at the segment's start, cd/m2.
    pub color: Rgb,
    /// Index of the chosen light.
    pub light: u32,
    /// Event that scattered the light.
    pub event: ScatterEvent,
}

impl FoggyRay {
    /// Returns the density, 1/m, with which way 1 chooses `light` and samples the distance of `event` on this ray.
    pub fn airlight_pdf(&self, scene: &Prepared, light: u32, time: f32, event: &ScatterEvent) -> f32 {
        let Some(light_context) = &self.light_context else { return 0.0 };
        let chosen = scene.lights.probability(&self.light_weights, light_context, light);
        if chosen <= 0.0 {
            return 0.0;
        }
        airlight_distances(scene, self, light_context, light, time)
            .map_or(0.0, |distances| chosen * distances.pdf(event))
    }
}

/// Returns the distribution of distances for a light.
fn airlight_distances(
    scene: &Prepared,
    ray: &FoggyRay,
    light_context: &SegmentContext,
    light: u32,
    time: f32,
) -> Option<SingleScatterSampler> {
    let stretch = MediumSegment {
        light_context,
        media: &scene.media,
        ray: &ray.media,
        min_light_distance: scene.min_light_distance,
    };
    SingleScatterSampler::new(&scene.lights, &scene.world, &stretch, light, time)
}

/// Sampler of the media on the current ray of a path. The caller has found their intervals.
pub struct FogSampler<'a> {
    /// The scene.
    pub scene: &'a Prepared,
    /// Media of the ray.
    pub ray: &'a mut FoggyRay,
    /// Weights of lights for directions.
    pub direction_weights: &'a mut LightWeights,
    /// Tester of shadow rays.
    pub shadow: &'a mut ShadowTester,
    /// Counters of the work.
    pub counters: &'a mut TracerCounters,
    /// Only technique that counts, if set.
    pub single_technique: Option<MisTechnique>,
}

impl FogSampler<'_> {
    /// Returns the radiance that the media of the segment emit.
    pub fn glow(&mut self, path: &mut PathState) -> Rgb {
        if !self.scene.media.glows() {
            return Rgb::ZERO;
        }
        path.stream.seek(path.base + dim::GLOW);
        self.scene.media.emitted_radiance(&self.ray.media, path.stream.next_1d())
    }

    /// Samples the distance of the next collision.
    pub fn sample_collision(&mut self, path: &mut PathState) -> FreeFlight {
        path.stream.seek(path.base + dim::DISTANCE);
        let [u, channel] = path.stream.next_2d();
        path.stream.seek(path.base + dim::DISTANCE_FINE);
        match self.scene.media.sample_distance(&self.ray.media, dim::uniform_48([u, path.stream.next_1d()]), channel) {
            DistanceSample::Through { weight } => FreeFlight::Through { weight },
            DistanceSample::Scatter(event) => {
                FreeFlight::Collision(Collision { event, position: path.ray.origin + path.ray.dir * event.t })
            }
        }
    }

    /// Weighs the lights for the segment. Call it before [`Self::sample_airlight`] and [`FoggyRay::airlight_pdf`].
    pub fn weigh_lights(&mut self, path: &PathState) {
        let scene = self.scene;
        self.ray.light_context = None;
        if scene.lights.is_empty() {
            return;
        }
        let Some(range) = scene.media.scattering_range(&self.ray.media) else { return };
        let fog = scene.media.mean_properties(&self.ray.media, range);
        let angles = if path.bounce == 0 { ANGLES_FROM_CAMERA } else { ANGLES };
        let light_context = scene.lights.segment_context(path.ray.origin, path.ray.dir, range, fog, angles);
        scene.lights.weigh(&light_context, &mut self.ray.light_weights);
        self.ray.light_context = Some(light_context);
    }

    /// Samples single scattering on the segment with a light and a distance for it (way 1).
    /// - `decide`: called before the random numbers of each decision are drawn. It is not generic: copies of this function for each
    ///   recorder are inlined less, which costs path tracing in fog 2 % more instructions.
    pub fn sample_airlight(
        &mut self,
        path: &mut PathState,
        decide: &mut dyn FnMut(Decision, &mut PathState),
    ) -> Option<SingleScatterSample> {
        let scene = self.scene;
        let light_context = self.ray.light_context?;
        decide(Decision::AirlightLamp, path);
        let choice = || dim::draw_48(&mut path.stream, path.base + dim::AIRLIGHT_LIGHT);
        let (light, probability) = scene.lights.choose(&self.ray.light_weights, &light_context, choice)?;
        let distances = airlight_distances(scene, self.ray, &light_context, light, path.ray.time)?;
        decide(Decision::AirlightDistance, path);
        path.stream.seek(path.base + dim::AIRLIGHT);
        let u = path.stream.next_1d();
        path.stream.seek(path.base + dim::AIRLIGHT_CHANNEL);
        let (event, density) = distances.sample(&scene.media, &self.ray.media, u, path.stream.next_1d())?;
        let position = path.ray.origin + path.ray.dir * event.t;
        decide(Decision::AirlightPoint, path);
        path.stream.seek(path.base + dim::AIRLIGHT_POINT);
        let point = path.stream.next_2d();
        let sample = scene.lights.sample_light(&scene.world, &scene.textures, light, position, path.ray.time, point)?;
        let nothing = SingleScatterSample { color: Rgb::ZERO, light, event };
        if sample.radiance == Rgb::ZERO {
            return Some(nothing);
        }
        let (phase, phase_pdf) = scene.media.phase(&self.ray.media, &event, -path.ray.dir, sample.dir);
        let pdf = density * probability * sample.pdf;
        let by_scattering = if sample.delta == DeltaKind::Position { 0.0 } else { square(event.pdf * phase_pdf / pdf) };
        let weight = mis_weight(self.single_technique, MisTechnique::Light, by_scattering);
        if weight <= 0.0 {
            return Some(nothing);
        }
        let from = (position, Vec3A::ZERO, Vec3A::ZERO);
        let visibility =
            self.shadow.visibility::<true>(scene, from, &sample, path.ray.time, &path.medium_stack, self.counters);
        Some(SingleScatterSample {
            color: event.weight * phase * sample.radiance * visibility * (weight / pdf),
            ..nothing
        })
    }

    /// Returns the medium of an event on the segment. Among several media it is the one that scatters most there.
    pub fn dominant_medium(&self, event: &ScatterEvent) -> u16 {
        self.scene.media.dominant_medium(&self.ray.media, event)
    }

    /// Returns the first emitting medium on the segment.
    pub fn emitting_medium(&self) -> u16 {
        self.scene.media.emitting_medium(&self.ray.media)
    }

    /// Weighs the lights for directions toward them after an event, and returns the event's context for [`Self::sample_direction`].
    /// `None`: directions are not sampled toward lights.
    pub fn weigh_directions(&mut self, path: &PathState, collision: &Collision) -> Option<DirectionContext> {
        let many = self.scene.lights.sampler();
        if path.bounce >= MAX_GUIDED_SEGMENTS || many.is_empty() {
            return None;
        }
        let (extinction, phase) = self.scene.media.event_properties(&self.ray.media, &collision.event);
        let from = DirectionContext { position: collision.position, wo: -path.ray.dir, extinction, phase };
        many.weigh_directions(&from, self.direction_weights);
        Some(from)
    }

    /// Samples the direction after an event.
    /// - `from`: value of [`Self::weigh_directions`];
    /// - `table`: table of directions from which a share of the directions is sampled;
    /// - `copy`: number of a copy of the path, and the number of copies.
    pub fn sample_direction(
        &mut self,
        path: &mut PathState,
        collision: &Collision,
        from: Option<&DirectionContext>,
        table: Option<&DirectionTable>,
        [copy, copies]: [u32; 2],
    ) -> Option<DirectionSample> {
        let scene = self.scene;
        let (media, event, many) = (&scene.media, &collision.event, scene.lights.sampler());
        path.stream.seek(path.base + dim::LOBE);
        let choice = path.stream.next_1d();
        path.stream.seek(path.base + dim::DIRECTION);
        let numbers = DirectionNumbers { u: path.stream.next_2d(), choice };
        let DirectionNumbers { u, mut choice } = if copy == 0 { numbers } else { numbers.of_copy(copy, copies) };
        let table_share = if table.is_some() { TABLE_SHARE } else { 0.0 };
        let is_guide_sample = choice < table_share;
        if !is_guide_sample {
            choice = (choice - table_share) / (1.0 - table_share);
        }
        let mut toward_light = None;
        if let Some(from) = from {
            if !is_guide_sample && choice >= PHASE_SHARE {
                choice = (choice - PHASE_SHARE) / (1.0 - PHASE_SHARE);
                path.stream.seek(path.base + dim::LIGHT_DIRECTION);
                let lamp = dim::uniform_48(path.stream.next_2d()) + f64::from(copy) / f64::from(copies);
                let lamp = if lamp >= 1.0 { lamp - 1.0 } else { lamp };
                toward_light = many.sample_direction(from, self.direction_weights, lamp, u);
            } else {
                choice /= PHASE_SHARE;
            }
        }
        let by_phase = || media.sample_phase(&self.ray.media, event, choice).sample(-path.ray.dir, u).wi;
        let dir = match table {
            Some(table) if is_guide_sample => table.sample(u),
            _ => toward_light.unwrap_or_else(by_phase),
        };
        let (value, phase) = media.phase(&self.ray.media, event, -path.ray.dir, dir);
        let unguided = match from {
            None => phase,
            Some(from) => {
                PHASE_SHARE * phase + (1.0 - PHASE_SHARE) * many.direction_pdf(from, self.direction_weights, dir, phase)
            }
        };
        let by_table = table.map_or(0.0, |table| table.pdf(dir));
        let pdf = table_share * by_table + (1.0 - table_share) * unguided;
        let sample = || DirectionSample { dir, pdf, phase_pdf: phase, weight: value / pdf, is_guide_sample };
        (pdf > 0.0 && phase > 0.0).then(sample)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path_state::PathState;
    use crate::test_scene::{center_path, prepare};
    use femc_field::{TABLE_CELLS, TableCells, TableExtent};
    use femc_geometry::Ray;
    use femc_math::color::luminance;
    use femc_stats::testing::{Moments, pooled_test, sidak};

    /// Probability of a false alarm over all statistical tests here.
    const LEVEL: f64 = 1e-4;
    /// Number of statistical tests here.
    const TESTS: usize = 11;

    /// Colored fog in a box, thinner fog around it whose density falls with height, and a lamp beside the camera's ray.
    const SCENE: &str = "\
medium ink =
 c
 cxy .5 .4
 sigma_s .5
 sigma_a .2
 phase hg .5
medium haze =
 sigma_s .15
 phase hg -.3
 height -.2 .7
mbox ink -1 -1 -1 1 1 1
mglobal haze
m lamp =
 sides 2
 c
 ed 100
v a =
 p -.3 .2 1.5
v b =
 p .3 .2 1.5
v c =
 p .3 .8 1.5
v d =
 p -.3 .8 1.5
m lamp
f a b c d
v e =
 p -2 4 -2
v f =
 p 2 4 -2
v g =
 p 2 4 2
v h =
 p -2 4 2
m wall =
 sides 2
 c
 rd .5
m wall
f e f g h
";

    /// A path with its media, found up to the wall.
    struct Fixture<'s> {
        scene: &'s Prepared,
        ray: FoggyRay,
        direction_weights: LightWeights,
        shadow: ShadowTester,
        counters: TracerCounters,
        t_end: f32,
    }

    impl<'s> Fixture<'s> {
        fn new(scene: &'s Prepared) -> Self {
            let path = center_path(scene, 0);
            let t_end = scene.world.intersect(&path.ray).expect("the wall").t;
            let mut ray = FoggyRay::default();
            let PathState { ray: Ray { origin, dir, .. }, medium_stack, .. } = path;
            assert!(scene.media.find_intervals(origin, dir, t_end, &medium_stack, &mut ray.media));
            let mut fixture = Self {
                scene,
                ray,
                direction_weights: LightWeights::default(),
                shadow: ShadowTester::default(),
                counters: TracerCounters::default(),
                t_end,
            };
            fixture.sampler().weigh_lights(&path);
            fixture
        }

        fn sampler(&mut self) -> FogSampler<'_> {
            FogSampler {
                scene: self.scene,
                ray: &mut self.ray,
                direction_weights: &mut self.direction_weights,
                shadow: &mut self.shadow,
                counters: &mut self.counters,
                single_technique: None,
            }
        }

        /// Tests the distances of events, some of them missing, against their density along the ray, 1/m.
        fn assert_distances(&self, name: &str, distances: &[Option<f32>], pdf: impl Fn(&ScatterEvent) -> f32) {
            const BINS: usize = 40;
            const STEPS: usize = 64;
            let (n, width) = (distances.len() as f64, self.t_end / BINS as f32);
            let density = |t: f32| self.scene.media.event_at(&self.ray.media, t).map_or(0.0, |event| pdf(&event));
            let mass = |bin: usize| {
                let middle = |step: usize| (bin as f32 + (step as f32 + 0.5) / STEPS as f32) * width;
                (0..STEPS).map(|step| f64::from(density(middle(step)))).sum::<f64>() * f64::from(width) / STEPS as f64
            };
            let mut expected: Vec<f64> = (0..BINS).map(mass).collect();
            expected.push((1.0 - expected.iter().sum::<f64>()).max(0.0));
            let mut observed = vec![0; BINS + 1];
            for distance in distances {
                observed[distance.map_or(BINS, |t| ((t / width) as usize).min(BINS - 1))] += 1;
            }
            let expected: Vec<f64> = expected.into_iter().map(|mass| mass * n).collect();
            pooled_test(&expected, &observed).expect(sidak(LEVEL, TESTS), name);
        }
    }

    #[test]
    fn free_flights_follow_their_density_and_weigh_transmittance() {
        let scene = prepare(SCENE);
        let mut fixture = Fixture::new(&scene);
        let (mut distances, mut through) = (Vec::new(), [Moments::default(); 3]);
        for seed in 0..40_000 {
            let mut path = center_path(&scene, seed);
            let weight = match fixture.sampler().sample_collision(&mut path) {
                FreeFlight::Collision(Collision { event, position }) => {
                    assert!((path.ray.origin + path.ray.dir * event.t - position).length() < 1e-5);
                    distances.push(Some(event.t));
                    Rgb::ZERO
                }
                FreeFlight::Through { weight } => {
                    distances.push(None);
                    weight
                }
            };
            through.iter_mut().zip(weight.to_array()).for_each(|(channel, weight)| channel.add(weight.into()));
        }
        fixture.assert_distances("free flights", &distances, |event| event.pdf);
        for (channel, expected) in through.iter().zip(scene.media.transmittance(&fixture.ray.media).to_array()) {
            let p = channel.p_value(expected.into());
            assert!(p >= sidak(LEVEL, TESTS), "{channel:?} for {expected}: {p}");
        }
    }

    /// Direct light in fog chooses a lamp and a distance. The density of both is the weight of the lamp when scattering hits it.
    #[test]
    fn airlight_distances_follow_the_density_that_weights_hit_lamps() {
        let scene = prepare(SCENE);
        let mut fixture = Fixture::new(&scene);
        let mut distances = Vec::new();
        for seed in 0..40_000 {
            let mut path = center_path(&scene, seed);
            let scattered = fixture.sampler().sample_airlight(&mut path, &mut |_, _| ());
            distances.push(scattered.map(|scattered| {
                assert_eq!(scattered.light, 0);
                scattered.event.t
            }));
        }
        fixture.assert_distances("airlight", &distances, |event| fixture.ray.airlight_pdf(&scene, 0, 0.5, event));
    }

    /// The inverse density of a direction has the mean 4 pi, its weight the mean 1: phase functions are normalized.
    #[test]
    fn directions_after_a_collision_have_their_density() {
        let scene = prepare(SCENE);
        let mut fixture = Fixture::new(&scene);
        let event = scene.media.event_at(&fixture.ray.media, 2.5).expect("fog");
        let mut light = [0.1; TABLE_CELLS];
        light[TableCells::new(TableExtent::Sphere).find(Vec3A::Y).expect("all directions")] = 40.0;
        let table = DirectionTable::new(TableExtent::Sphere, &light).expect("light");
        for table in [None, Some(&table)] {
            let (mut solid_angle, mut weight, mut phase) = (Moments::default(), Moments::default(), Moments::default());
            let mut guided = 0;
            for seed in 0..40_000 {
                let mut path = center_path(&scene, seed);
                let collision = Collision { event, position: path.ray.origin + path.ray.dir * event.t };
                let mut fog = fixture.sampler();
                let from = fog.weigh_directions(&path, &collision);
                let scattered =
                    fog.sample_direction(&mut path, &collision, from.as_ref(), table, [0, 1]).expect("a direction");
                assert!((scattered.dir.length() - 1.0).abs() < 1e-4);
                solid_angle.add(1.0 / f64::from(scattered.pdf));
                weight.add(luminance(scattered.weight).into());
                phase.add(f64::from(scattered.phase_pdf) / f64::from(scattered.pdf));
                guided += u32::from(scattered.is_guide_sample);
            }
            for (name, moments, expected) in
                [("sphere", solid_angle, 4.0 * std::f64::consts::PI), ("weight", weight, 1.0), ("phase", phase, 1.0)]
            {
                let p = moments.p_value(expected);
                assert!(p >= sidak(LEVEL, TESTS), "{name}: {moments:?} for {expected}: {p}");
            }
            let expected = if table.is_some() { 20_000 } else { 0 };
            assert!(guided.abs_diff(expected) < 1_000, "{guided} from the table");
        }
    }
}
