//! Recorder of light statistics during rendering.

use super::names::SceneNames;
use super::recorded::RecordedSamples;
use femc_geometry::{Ray, offset_origin};
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::hash::HashPrefix;
use femc_montecarlo::record::{
    Continuation, Contribution, LightTechnique as TracedTechnique, RecordLevel, Recorder, Scatterer, Termination,
    Transmitted, Vertex, VertexLocation,
};
use femc_paths::pixels::PixelSums;
use femc_paths::record::{MAX_INTERSECTIONS, MAX_LIGHTS};
use femc_paths::statistics::DEEP_PATH_DEPTH;
use femc_paths::{
    InteractionKind, Intersection, LightPath, LightRecord, LightTechnique, Name, PathEnd, PathKey, Scope,
};

/// Light sampled or hit by a path: its contribution, the number of vertices up to then, and its occluder.
type RecordedLight = (Contribution, usize, Option<Name>);

/// Recorder that keeps the requested data of samples.
pub(crate) struct PathRecorder<'a> {
    names: &'a SceneNames<'a>,
    threshold: u64,
    scope: Scope,
    pub(crate) recorded: RecordedSamples,
    // State of the current sample:
    key: PathKey,
    hash: u64,
    /// Common hash state of its pixel's samples.
    pixel_hash: HashPrefix,
    /// Whether its path is recorded.
    is_recorded: bool,
    /// Whether all its events are needed: it is recorded, or all samples are counted in the histograms.
    is_wanted: bool,
    /// Current pixel.
    current_pixel: Option<u32>,
    depth: u32,
    stop: (Termination, Rgb),
    steps: Vec<(Vertex, Option<Continuation>)>,
    lights: Vec<RecordedLight>,
    occluder: Option<Name>,
}

impl<'a> PathRecorder<'a> {
    pub(super) fn new(names: &'a SceneNames<'a>, threshold: u64, scope: Scope) -> Self {
        Self {
            names,
            threshold,
            scope,
            recorded: RecordedSamples::new(),
            key: PathKey::default(),
            hash: 0,
            pixel_hash: HashPrefix::default(),
            is_recorded: false,
            is_wanted: false,
            current_pixel: None,
            depth: 0,
            stop: (Termination::Escaped, Rgb::ZERO),
            steps: Vec::new(),
            lights: Vec::new(),
            occluder: None,
        }
    }

    /// Returns the object of the first surface on a shadow ray that transmits nothing.
    fn occluder(&self, mut ray: Ray) -> Option<Name> {
        let prepared = self.names.prepared;
        for _ in 0..MAX_CLEAR_SURFACES {
            let hit = prepared.world.intersect(&ray)?;
            let point = prepared.shading_point(&ray, &hit);
            let back = point.normal.dot(ray.dir) > 0.0;
            let crossing = prepared.materials[point.material as usize].crossing[usize::from(back)];
            if crossing.straight_through() == Rgb::ZERO {
                return Some(self.names.object(prepared.object_of(hit.instance, hit.primitive)));
            }
            let origin = offset_origin(point.position, point.error, point.normal, ray.dir);
            ray = Ray { origin, t_max: ray.t_max - hit.t, ..ray };
        }
        None
    }

    #[cold]
    fn begin_pixel(&mut self, pixel: u32) {
        self.current_pixel = Some(pixel);
        self.pixel_hash = self.key.pixel_hash(self.scope.seed);
        self.recorded.pixels.iter_mut().for_each(|pixels| pixels.push(PixelSums::default()));
    }

    /// Records the whole path of the sample.
    #[cold]
    fn record(&mut self, color: Rgb) {
        let path = self.path(color);
        if self.scope.has_full_histograms {
            self.recorded.counters[usize::from(self.key.half())].count_bins(&self.scope, &path);
        }
        if self.is_recorded {
            self.recorded.paths.push(path);
        }
    }

    fn path(&self, color: Rgb) -> LightPath {
        let (stop, throughput) = self.stop;
        let mut path = LightPath {
            key: self.key,
            radiance: color.to_array(),
            throughput: throughput.to_array(),
            depth: self.depth,
            end: path_end(stop),
            intersections: self.steps.iter().map(|(vertex, leaving)| self.intersection(vertex, *leaving)).collect(),
            lights: self.lights.iter().map(|looked| self.recorded_light(looked)).collect(),
        };
        // The emission of a vertex is reported before the vertex itself.
        let own = |index: usize| {
            let before =
                self.lights.iter().rev().skip_while(|light| light.1 > index).take_while(|light| light.1 == index);
            let met = before.map(|light| &light.0).find(|found| found.technique == TracedTechnique::EmitterHit);
            met.filter(|found| found.position == self.steps[index].0.position)
        };
        let sent = path.outgoing_radiance(|index| own(index).is_some());
        path.intersections.iter_mut().zip(sent).for_each(|(it, sent)| it.radiance = sent);
        // The path has left all its vertices except the last.
        if let (Some(last), Some((_, None))) = (path.intersections.last_mut(), self.steps.last())
            && own(self.steps.len() - 1).is_some_and(|own| own.color != Rgb::ZERO)
        {
            last.interaction = InteractionKind::Emission;
        }
        path.intersections.truncate(MAX_INTERSECTIONS);
        path.lights.truncate(MAX_LIGHTS);
        path
    }

    fn recorded_light(&self, (contribution, vertices, occluder): &RecordedLight) -> LightRecord {
        let light = match (contribution.technique, contribution.light) {
            (TracedTechnique::Glow(medium), None) => self.names.medium(medium),
            (_, light) => light.map_or(Name::NONE, |light| self.names.lamp(light)),
        };
        let (technique, medium) = match contribution.technique {
            TracedTechnique::CameraNextEvent => (LightTechnique::CameraNextEvent, Name::NONE),
            TracedTechnique::EmitterHit => (LightTechnique::EmitterHit, Name::NONE),
            TracedTechnique::NextEvent => (LightTechnique::NextEvent, Name::NONE),
            TracedTechnique::Airlight(medium) => (LightTechnique::Airlight, self.names.medium(medium)),
            TracedTechnique::Glow(_) => (LightTechnique::Glow, Name::NONE),
            TracedTechnique::Field => (LightTechnique::Field, Name::NONE),
        };
        let (vertex, radiance) = (*vertices as u32, contribution.color.to_array());
        LightRecord { vertex, light, medium, radiance, occluder: *occluder, technique }
    }

    fn intersection(&self, vertex: &Vertex, leaving: Option<Continuation>) -> Intersection {
        let names = self.names;
        let (object, material) = match vertex.location {
            VertexLocation::Surface { instance, primitive, material } => {
                (names.object(names.prepared.object_of(instance, primitive)), names.material(material))
            }
            VertexLocation::Medium(medium) => (Name::NONE, names.medium(medium)),
        };
        let interaction = match leaving {
            None => InteractionKind::Absorbed,
            Some(Continuation::Straight) => InteractionKind::Straight,
            Some(Continuation::Delta(Transmitted::No)) => InteractionKind::Reflection,
            Some(Continuation::Delta(Transmitted::Yes)) => InteractionKind::Refraction,
            Some(Continuation::Scattered { scatterer: Scatterer::Diffuse, .. }) => InteractionKind::Diffuse,
            Some(Continuation::Scattered { scatterer: Scatterer::Glossy, .. }) => InteractionKind::Glossy,
            Some(Continuation::Scattered { scatterer: Scatterer::Phase, .. }) => InteractionKind::Volume,
        };
        Intersection {
            bounce: vertex.bounce,
            position: self.scope.snap_to_grid(names.prepared.to_world(vertex.position)),
            radiance: [0.0; 3],
            throughput: vertex.throughput.to_array(),
            object,
            material,
            interaction,
        }
    }
}

/// Maximum number of clear surfaces to pass in the search for an occluder.
const MAX_CLEAR_SURFACES: usize = 256;

fn path_end(stop: Termination) -> PathEnd {
    match stop {
        Termination::Escaped => PathEnd::Escaped,
        Termination::Absorbed => PathEnd::Absorbed,
        Termination::Roulette => PathEnd::Roulette,
        Termination::Depth => PathEnd::Depth,
        Termination::Field => PathEnd::Field,
    }
}

impl Recorder for PathRecorder<'_> {
    #[inline(always)]
    fn begin_sample(&mut self, pixel: u32, sample: u32) -> RecordLevel {
        self.key = PathKey { frame: self.scope.frame, pixel, sample };
        if self.current_pixel != Some(pixel) {
            self.begin_pixel(pixel);
        }
        self.hash = self.key.hash_in_pixel(self.pixel_hash);
        self.is_recorded = self.hash < self.threshold;
        self.is_wanted = self.is_recorded || self.scope.has_full_histograms;
        if !self.is_wanted {
            return RecordLevel::End;
        }
        self.steps.clear();
        self.lights.clear();
        self.occluder = None;
        RecordLevel::All
    }

    fn vertex(&mut self, vertex: impl FnOnce() -> Vertex) {
        self.steps.push((vertex(), None));
    }

    fn leave(&mut self, continuation: Continuation) {
        if let Some(last) = self.steps.last_mut() {
            last.1 = Some(continuation);
        }
    }

    fn occluded(&mut self, shadow: impl FnOnce() -> Ray) {
        self.occluder = self.occluder(shadow());
    }

    fn contribution(&mut self, contribution: impl FnOnce() -> Contribution) {
        let (contribution, occluder) = (contribution(), self.occluder.take());
        let is_drawn = matches!(contribution.technique, TracedTechnique::NextEvent | TracedTechnique::Airlight(_));
        if contribution.color != Rgb::ZERO || is_drawn && contribution.light.is_some() {
            self.lights.push((contribution, self.steps.len(), occluder));
        }
    }

    #[inline]
    fn terminate(&mut self, vertices: u32, termination: Termination, throughput: Rgb) {
        (self.depth, self.stop) = (vertices, (termination, throughput));
    }

    #[inline(always)]
    fn end_sample(&mut self, color: Option<Rgb>) {
        let half = usize::from(self.key.half());
        let counters = &mut self.recorded.counters[half];
        let Some(color) = color else {
            counters.invalid += 1;
            return;
        };
        let (stop, throughput) = self.stop;
        let luminance = luminance(color);
        counters.count(luminance, self.depth, path_end(stop));
        let greatest = throughput.max_element().max(0.0);
        if let Some(pixel) = self.recorded.pixels[half].last_mut() {
            pixel.count(luminance, greatest, self.depth);
        }
        self.recorded.bright.offer(luminance, self.hash, self.key);
        if self.depth >= DEEP_PATH_DEPTH {
            self.recorded.deep.offer(greatest, self.hash, self.key);
        }
        if self.is_wanted {
            self.record(color);
        }
    }
}
