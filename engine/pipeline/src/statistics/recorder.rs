//! Recorder of light statistics during rendering.

use super::names::SceneNames;
use super::recorded::RecordedSamples;
use femc_geometry::{Ray, offset_origin};
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::hash::HashPrefix;
use femc_montecarlo::record::{
    BranchEvent, Continuation, Contribution, RecordLevel, Recorder, Step, StepNode, StepTree, Termination, Vertex,
    VertexLocation,
};
use femc_paths::pixels::PixelSums;
use femc_paths::record::{MAX_INTERSECTIONS, MAX_LIGHTS};
use femc_paths::statistics::DEEP_PATH_DEPTH;
use femc_paths::{
    InteractionKind, Intersection, LightPath, LightRecord, LightTechnique, Name, PathEnd, PathKey, Scope,
};

/// Light sampled or hit by a path.
struct RecordedLight {
    contribution: Contribution,
    /// Number of the latest vertex of its branch, and the number of vertices of the whole path up to then.
    vertex: u32,
    order: u32,
    occluder: Option<Name>,
}

/// Numbers in a record for a vertex of a tree: its own number, and the number of intersections up to it.
#[derive(Clone, Copy)]
struct RecordNumber {
    vertex: u32,
    order: u32,
}

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
    /// End of the branch with the most vertices.
    termination: Option<Termination>,
    steps: StepTree,
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
            termination: None,
            steps: StepTree::default(),
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
        let Termination { end, vertices, throughput } = self.termination();
        let (vertices_of_record, numbers) = self.record_vertices();
        let mut path = LightPath {
            key: self.key,
            radiance: color.to_array(),
            throughput: throughput.to_array(),
            depth: vertices,
            end,
            intersections: vertices_of_record
                .iter()
                .map(|node| self.intersection(&node.step, numbers[node.parent as usize].vertex))
                .collect(),
            lights: self.lights.iter().map(|light| self.recorded_light(light, &numbers)).collect(),
        };
        // The emission of a vertex is reported before the vertex itself.
        let own = |index: usize| {
            let after = |light: &&RecordedLight| numbers[light.order as usize].order as usize > index;
            let is_before = |light: &&RecordedLight| numbers[light.order as usize].order as usize == index;
            let before = self.lights.iter().rev().skip_while(after).take_while(is_before);
            let met =
                before.map(|light| &light.contribution).find(|found| found.technique == LightTechnique::EmitterHit);
            met.filter(|found| found.position == vertices_of_record[index].step.vertex.position)
        };
        let sent = path.outgoing_radiance(|index| own(index).is_some());
        path.intersections.iter_mut().zip(sent).for_each(|(it, sent)| it.radiance = sent);
        for (index, it) in path.intersections.iter_mut().enumerate() {
            let has_ended = vertices_of_record[index].step.continuation.is_none();
            if has_ended && own(index).is_some_and(|own| own.color != Rgb::ZERO) {
                it.interaction = InteractionKind::Emission;
            }
        }
        path.intersections.truncate(MAX_INTERSECTIONS);
        path.lights.truncate(MAX_LIGHTS);
        path
    }

    /// Returns the vertices without their repetitions, and their numbers in the record by those in the tree. A vertex that several
    /// copies left has the interaction of the first of them that went on.
    fn record_vertices(&self) -> (Vec<StepNode>, Vec<RecordNumber>) {
        let nodes = self.steps.nodes();
        let mut kept = Vec::<StepNode>::with_capacity(nodes.len());
        let mut numbers = Vec::with_capacity(nodes.len() + 1);
        numbers.push(RecordNumber { vertex: 0, order: 0 });
        for node in nodes {
            if node.repeats == 0 {
                kept.push(*node);
                numbers.push(RecordNumber { vertex: kept.len() as u32, order: kept.len() as u32 });
            } else {
                let vertex = numbers[node.repeats as usize].vertex;
                let step = &mut kept[vertex as usize - 1].step;
                step.continuation = step.continuation.or(node.step.continuation);
                numbers.push(RecordNumber { vertex, order: kept.len() as u32 });
            }
        }
        (kept, numbers)
    }

    fn termination(&self) -> Termination {
        self.termination.unwrap_or(Termination { end: PathEnd::Escaped, vertices: 0, throughput: Rgb::ZERO })
    }

    fn recorded_light(&self, recorded: &RecordedLight, numbers: &[RecordNumber]) -> LightRecord {
        let RecordedLight { contribution, vertex, order, occluder } = recorded;
        let &Contribution { technique, light, .. } = contribution;
        let medium = contribution.medium.map_or(Name::NONE, |medium| self.names.medium(medium));
        let (light, medium) = match technique {
            LightTechnique::Glow => (medium, Name::NONE),
            _ => (light.map_or(Name::NONE, |light| self.names.lamp(light)), medium),
        };
        let radiance = contribution.color.to_array();
        let (vertex, order) = (numbers[*vertex as usize].vertex, numbers[*order as usize].order);
        LightRecord { vertex, order, light, medium, radiance, occluder: *occluder, technique }
    }

    fn intersection(&self, step: &Step, parent: u32) -> Intersection {
        let (names, vertex) = (self.names, &step.vertex);
        let (object, material) = match vertex.location {
            VertexLocation::Surface { instance, primitive, material } => {
                (names.object(names.prepared.object_of(instance, primitive)), names.material(material))
            }
            VertexLocation::Medium(medium) => (Name::NONE, names.medium(medium)),
        };
        Intersection {
            parent,
            bounce: vertex.bounce,
            position: self.scope.snap_to_grid(names.prepared.to_world(vertex.position)),
            radiance: [0.0; 3],
            throughput: vertex.throughput.to_array(),
            object,
            material,
            interaction: step.interaction(),
        }
    }
}

/// Maximum number of clear surfaces to pass in the search for an occluder.
const MAX_CLEAR_SURFACES: usize = 256;

impl Recorder for PathRecorder<'_> {
    #[inline(always)]
    fn begin_sample(&mut self, pixel: u32, sample: u32) -> RecordLevel {
        self.key = PathKey { frame: self.scope.frame, pixel, sample };
        if self.current_pixel != Some(pixel) {
            self.begin_pixel(pixel);
        }
        self.termination = None;
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
        self.steps.vertex(vertex());
    }

    fn leave(&mut self, continuation: Continuation) {
        self.steps.leave(continuation);
    }

    fn occluded(&mut self, shadow: impl FnOnce() -> Ray) {
        self.occluder = self.occluder(shadow());
    }

    fn contribution(&mut self, contribution: impl FnOnce() -> Contribution) {
        let (contribution, occluder) = (contribution(), self.occluder.take());
        let is_drawn = matches!(contribution.technique, LightTechnique::NextEvent | LightTechnique::Airlight);
        if contribution.color != Rgb::ZERO || is_drawn && contribution.light.is_some() {
            let [vertex, order] = [self.steps.latest(), self.steps.nodes().len() as u32];
            self.lights.push(RecordedLight { contribution, vertex, order, occluder });
        }
    }

    fn branch(&mut self, event: BranchEvent) {
        self.steps.on_branch(event);
    }

    #[inline]
    fn terminate(&mut self, termination: Termination) {
        if self.termination.is_none_or(|deepest| deepest.vertices < termination.vertices) {
            self.termination = Some(termination);
        }
    }

    #[inline(always)]
    fn end_sample(&mut self, color: Option<Rgb>) {
        let half = usize::from(self.key.half());
        let Termination { end, vertices, throughput } = self.termination();
        let counters = &mut self.recorded.counters[half];
        let Some(color) = color else {
            counters.invalid += 1;
            return;
        };
        let luminance = luminance(color);
        counters.count(luminance, vertices, end);
        let greatest = throughput.max_element().max(0.0);
        if let Some(pixel) = self.recorded.pixels[half].last_mut() {
            pixel.count(luminance, greatest, vertices);
        }
        self.recorded.bright.offer(luminance, self.hash, self.key);
        if vertices >= DEEP_PATH_DEPTH {
            self.recorded.deep.offer(greatest, self.hash, self.key);
        }
        if self.is_wanted {
            self.record(color);
        }
    }
}
