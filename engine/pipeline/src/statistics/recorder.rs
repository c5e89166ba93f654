//! Recorder of light statistics during rendering.

use super::heard::Heard;
use super::names::SceneNames;
use femc_geometry::{Ray, offset_origin};
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::hash::Begun;
use femc_montecarlo::record::{
    Contribution, Found as FoundBy, Hears, Leaving, Place, Recorder, Scatterer, Stop, Transmitted, Vertex,
};
use femc_paths::pixels::PixelSums;
use femc_paths::record::{MOST_INTERSECTIONS, MOST_LIGHTS};
use femc_paths::statistics::DEEP;
use femc_paths::{End, Found, Interaction, Intersection, Light, Name, Path, PathKey, Scope};

/// Light sampled or hit by a path: its contribution, the number of vertices up to then, and its occluder.
type Looked = (Contribution, usize, Option<Name>);

/// Recorder that keeps the requested data of samples.
pub(super) struct PathRecorder<'a> {
    names: &'a SceneNames<'a>,
    threshold: u64,
    scope: Scope,
    pub(super) heard: Heard,
    // State of the current sample:
    key: PathKey,
    hash: u64,
    /// Common hash state of its pixel's samples.
    pixel_hash: Begun,
    /// Whether its path is recorded.
    is_kept: bool,
    /// Whether all its events are needed: it is recorded, or all samples are counted in the histograms.
    is_wanted: bool,
    /// Current pixel.
    latest: Option<u32>,
    depth: u32,
    stop: (Stop, Rgb),
    steps: Vec<(Vertex, Option<Leaving>)>,
    lights: Vec<Looked>,
    occluder: Option<Name>,
}

impl<'a> PathRecorder<'a> {
    pub(super) fn new(names: &'a SceneNames<'a>, threshold: u64, scope: Scope) -> Self {
        Self {
            names,
            threshold,
            scope,
            heard: Heard::new(),
            key: PathKey::default(),
            hash: 0,
            pixel_hash: Begun::default(),
            is_kept: false,
            is_wanted: false,
            latest: None,
            depth: 0,
            stop: (Stop::Escaped, Rgb::ZERO),
            steps: Vec::new(),
            lights: Vec::new(),
            occluder: None,
        }
    }

    /// Returns the object of the first surface on a shadow ray that transmits nothing.
    fn occluder(&self, mut ray: Ray) -> Option<Name> {
        let prepared = self.names.prepared;
        for _ in 0..CLEAR_SURFACES {
            let hit = prepared.world.intersect(&ray)?;
            let point = prepared.surface(&ray, &hit);
            let back = point.normal.dot(ray.dir) > 0.0;
            let crossing = prepared.materials[point.material as usize].crossing[usize::from(back)];
            if crossing.unbent() == Rgb::ZERO {
                return Some(self.names.object(prepared.object_of(hit.instance, hit.primitive)));
            }
            let origin = offset_origin(point.position, point.error, point.normal, ray.dir);
            ray = Ray { origin, t_max: ray.t_max - hit.t, ..ray };
        }
        None
    }

    #[cold]
    fn begin_pixel(&mut self, pixel: u32) {
        self.latest = Some(pixel);
        self.pixel_hash = self.key.pixel_hash(self.scope.seed);
        self.heard.pixels.iter_mut().for_each(|pixels| pixels.push(PixelSums::default()));
    }

    /// Records the whole path of the sample.
    #[cold]
    fn record(&mut self, color: Rgb) {
        let path = self.path(color);
        if self.scope.is_full {
            self.heard.counters[usize::from(self.key.half())].count_bins(&self.scope, &path);
        }
        if self.is_kept {
            self.heard.paths.push(path);
        }
    }

    fn path(&self, color: Rgb) -> Path {
        let (stop, throughput) = self.stop;
        let mut path = Path {
            key: self.key,
            radiance: color.to_array(),
            throughput: throughput.to_array(),
            depth: self.depth,
            end: end(stop),
            intersections: self.steps.iter().map(|(vertex, leaving)| self.intersection(vertex, *leaving)).collect(),
            lights: self.lights.iter().map(|looked| self.light_of(looked)).collect(),
        };
        // The emission of a vertex is reported before the vertex itself.
        let own = |index: usize| {
            let before =
                self.lights.iter().rev().skip_while(|light| light.1 > index).take_while(|light| light.1 == index);
            let met = before.map(|light| &light.0).find(|found| found.found == FoundBy::Met);
            met.filter(|found| found.position == self.steps[index].0.position)
        };
        let sent = path.sent(|index| own(index).is_some());
        path.intersections.iter_mut().zip(sent).for_each(|(it, sent)| it.radiance = sent);
        // The path has left all its vertices except the last.
        if let (Some(last), Some((_, None))) = (path.intersections.last_mut(), self.steps.last())
            && own(self.steps.len() - 1).is_some_and(|own| own.color != Rgb::ZERO)
        {
            last.interaction = Interaction::Emission;
        }
        path.intersections.truncate(MOST_INTERSECTIONS);
        path.lights.truncate(MOST_LIGHTS);
        path
    }

    fn light_of(&self, (found, vertices, occluder): &Looked) -> Light {
        let light = match (found.found, found.light) {
            (FoundBy::Glow(medium), None) => self.names.medium(medium),
            (_, light) => light.map_or(Name::NONE, |light| self.names.lamp(light)),
        };
        let (how, medium) = match found.found {
            FoundBy::Sight => (Found::Sight, Name::NONE),
            FoundBy::Met => (Found::Met, Name::NONE),
            FoundBy::Surface => (Found::Surface, Name::NONE),
            FoundBy::Airlight(medium) => (Found::Airlight, self.names.medium(medium)),
            FoundBy::Glow(_) => (Found::Glow, Name::NONE),
            FoundBy::Field => (Found::Field, Name::NONE),
        };
        let (vertex, radiance) = (*vertices as u32, found.color.to_array());
        Light { vertex, light, medium, radiance, occluder: *occluder, found: how }
    }

    fn intersection(&self, vertex: &Vertex, leaving: Option<Leaving>) -> Intersection {
        let names = self.names;
        let (object, material) = match vertex.place {
            Place::Surface { instance, primitive, material } => {
                (names.object(names.prepared.object_of(instance, primitive)), names.material(material))
            }
            Place::Medium(medium) => (Name::NONE, names.medium(medium)),
        };
        let interaction = match leaving {
            None => Interaction::Absorbed,
            Some(Leaving::Straight) => Interaction::Straight,
            Some(Leaving::Delta(Transmitted::No)) => Interaction::Reflection,
            Some(Leaving::Delta(Transmitted::Yes)) => Interaction::Refraction,
            Some(Leaving::Scattered { by: Scatterer::Diffuse, .. }) => Interaction::Diffuse,
            Some(Leaving::Scattered { by: Scatterer::Glossy, .. }) => Interaction::Glossy,
            Some(Leaving::Scattered { by: Scatterer::Phase, .. }) => Interaction::Volume,
        };
        Intersection {
            bounce: vertex.bounce,
            position: self.scope.on_grid(names.prepared.in_world(vertex.position)),
            radiance: [0.0; 3],
            throughput: vertex.throughput.to_array(),
            object,
            material,
            interaction,
        }
    }
}

/// Maximum number of clear surfaces to pass in the search for an occluder.
const CLEAR_SURFACES: usize = 256;

fn end(stop: Stop) -> End {
    match stop {
        Stop::Escaped => End::Escaped,
        Stop::Absorbed => End::Absorbed,
        Stop::Roulette => End::Roulette,
        Stop::Depth => End::Depth,
        Stop::Field => End::Field,
    }
}

impl Recorder for PathRecorder<'_> {
    #[inline(always)]
    fn begin(&mut self, pixel: u32, sample: u32) -> Hears {
        self.key = PathKey { frame: self.scope.frame, pixel, sample };
        if self.latest != Some(pixel) {
            self.begin_pixel(pixel);
        }
        self.hash = self.key.hash_in_pixel(self.pixel_hash);
        self.is_kept = self.hash < self.threshold;
        self.is_wanted = self.is_kept || self.scope.is_full;
        if !self.is_wanted {
            return Hears::End;
        }
        self.steps.clear();
        self.lights.clear();
        self.occluder = None;
        Hears::All
    }

    fn vertex(&mut self, vertex: impl FnOnce() -> Vertex) {
        self.steps.push((vertex(), None));
    }

    fn leave(&mut self, way: Leaving) {
        if let Some(last) = self.steps.last_mut() {
            last.1 = Some(way);
        }
    }

    fn hidden(&mut self, shadow: impl FnOnce() -> Ray) {
        self.occluder = self.occluder(shadow());
    }

    fn light(&mut self, contribution: impl FnOnce() -> Contribution) {
        let (contribution, occluder) = (contribution(), self.occluder.take());
        let is_drawn = matches!(contribution.found, FoundBy::Surface | FoundBy::Airlight(_));
        if contribution.color != Rgb::ZERO || is_drawn && contribution.light.is_some() {
            self.lights.push((contribution, self.steps.len(), occluder));
        }
    }

    #[inline]
    fn stop(&mut self, vertices: u32, why: Stop, throughput: Rgb) {
        (self.depth, self.stop) = (vertices, (why, throughput));
    }

    #[inline(always)]
    fn end(&mut self, color: Option<Rgb>) {
        let half = usize::from(self.key.half());
        let counters = &mut self.heard.counters[half];
        let Some(color) = color else {
            counters.bad += 1;
            return;
        };
        let (stop, throughput) = self.stop;
        let luminance = luminance(color);
        counters.count(luminance, self.depth, end(stop));
        let greatest = throughput.max_element().max(0.0);
        if let Some(pixel) = self.heard.pixels[half].last_mut() {
            pixel.count(luminance, greatest, self.depth);
        }
        self.heard.bright.offer(luminance, self.hash, self.key);
        if self.depth >= DEEP {
            self.heard.deep.offer(greatest, self.hash, self.key);
        }
        if self.is_wanted {
            self.record(color);
        }
    }
}
