//! Records of light: a path, its intersections, and its light contributions.

use femc_math::hash::{HashPrefix, hash_prefix};
use std::collections::{BTreeMap, HashMap};
use std::hash::{BuildHasherDefault, Hasher};

/// A camera sample of a frame of a known seed.
///
/// Keys are ordered by frame, pixel and sample. Records are ordered by their hash first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PathKey {
    /// Number of the frame.
    pub frame: u32,
    /// Row-major index of the pixel in the whole film.
    pub pixel: u32,
    /// Number of the sample in its pixel.
    pub sample: u32,
}

/// Salt of the hash that chooses records. It separates this hash from the sampler's hashes of the same words.
const SALT: u64 = 0x7061_7468_2073_6574;

impl PathKey {
    /// Returns the hash that chooses samples. The subset of samples with hashes below `p` 2^64 has a share `p` of all samples,
    /// whatever their pixels and numbers (test `the_subset_is_fair`). It is never `u64::MAX`.
    #[inline]
    pub fn hash(self, seed: u64) -> u64 {
        self.hash_in_pixel(self.pixel_hash(seed))
    }

    /// Returns the common prefix state of the hashes of all samples of a pixel.
    #[inline]
    pub fn pixel_hash(self, seed: u64) -> HashPrefix {
        hash_prefix(&[SALT, seed, u64::from(self.frame) << 32 | u64::from(self.pixel)])
    }

    /// Returns [`Self::hash`], computed from the value of [`Self::pixel_hash`] for its pixel.
    #[inline]
    pub fn hash_in_pixel(self, pixel: HashPrefix) -> u64 {
        pixel.finish(&[u64::from(self.sample)]).min(u64::MAX - 1)
    }

    /// Returns the half that the sample belongs to: A (0) has the even numbers, B (1) the odd ones.
    #[inline]
    pub fn half(self) -> u8 {
        (self.sample % 2) as u8
    }
}

/// Kind of a named thing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum NameKind {
    /// An object of the scene, by its dotted name.
    Object,
    /// A material.
    Material,
    /// A medium.
    Medium,
    /// A lamp: an emitter and the object that holds it.
    Lamp,
}

impl NameKind {
    /// All kinds, in the order of their numbers.
    pub const ALL: [Self; 4] = [Self::Object, Self::Material, Self::Medium, Self::Lamp];
}

/// A kind and a text.
pub type NameEntry = (NameKind, String);

/// A stable key of an object, a material, a medium or a lamp. It is a hash of the kind and the name, so it is the same in all
/// frames, jobs and variants. [`LightStatistics::names`](crate::LightStatistics::names) has the texts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Name(pub u64);

impl Name {
    /// No object, or an unknown one.
    pub const NONE: Self = Self(0);

    /// Creates the name of a kind and a text. An empty text gives [`Self::NONE`].
    pub fn new(kind: NameKind, text: &str) -> Self {
        if text.is_empty() {
            return Self::NONE;
        }
        let mut hasher = blake3::Hasher::new();
        hasher.update(&[kind as u8]).update(text.as_bytes());
        let [a, b, c, d, e, f, g, h, ..] = *hasher.finalize().as_bytes();
        Self(u64::from_le_bytes([a, b, c, d, e, f, g, h]).max(1))
    }
}

/// The texts of names.
pub type Names = BTreeMap<Name, NameEntry>;

/// Map from names. Its iteration order has no meaning.
pub(crate) type NameMap<T> = HashMap<Name, T, BuildHasherDefault<KeyHasher>>;

/// Hasher that passes names through, since they are hashes already.
#[derive(Default)]
pub(crate) struct KeyHasher(u64);

impl Hasher for KeyHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|byte| self.0 = self.0.rotate_left(8) ^ u64::from(*byte));
    }

    fn write_u64(&mut self, key: u64) {
        self.0 = key;
    }
}

macro_rules! numbered {
    ($(#[$doc:meta])* $type:ident: $($(#[$about:meta])* $variant:ident = $word:literal),+ $(,)?) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum $type { $($(#[$about])* $variant),+ }

        impl $type {
            /// All variants, in the order of their numbers in files.
            pub const ALL: &[Self] = &[$(Self::$variant),+];

            /// Returns the word for it in tables and conditions.
            pub fn word(self) -> &'static str {
                match self { $(Self::$variant => $word),+ }
            }
        }
    };
}

numbered! {
    /// Reason why a path ended.
    PathEnd:
    /// The path left the scene.
    Escaped = "escaped",
    /// Nothing was scattered, or the scattered direction was not possible.
    Absorbed = "absorbed",
    /// Russian roulette.
    Roulette = "roulette",
    /// The path reached the maximum number of segments.
    Depth = "depth",
    /// The path ended with the light of a first pass.
    Field = "field",
}

numbered! {
    /// Interaction with which a path continued from an intersection.
    InteractionKind:
    /// The path ended there.
    Absorbed = "absorbed",
    /// The path ended at an emitter.
    Emission = "emission",
    /// Scattered diffusely in all directions, by reflection or transmission.
    Diffuse = "diffuse",
    /// Scattered by a rough surface around a direction.
    Glossy = "glossy",
    /// Specular reflection.
    Reflection = "reflection",
    /// Specular refraction.
    Refraction = "refraction",
    /// Straight through a clear surface.
    Straight = "straight",
    /// Scattered in a medium.
    Volume = "volume",
}

numbered! {
    /// Technique that found light.
    LightTechnique:
    /// A point on a lamp was sampled from the camera.
    CameraNextEvent = "sight",
    /// The path hit a lamp.
    EmitterHit = "met",
    /// A point on a lamp was sampled from a surface.
    NextEvent = "surface",
    /// A lamp was sampled, with a distance by its light that a medium scatters.
    Airlight = "airlight",
    /// A medium emits light.
    Glow = "glow",
    /// The light of a first pass.
    Field = "field",
}

/// One sample of a pixel: a light path from the camera, with the branches into which it was split.
#[derive(Clone, Debug, PartialEq)]
pub struct LightPath {
    /// Key of the sample.
    pub key: PathKey,
    /// Contribution of the sample to its pixel, cd/m2 by channel; finite, not negative.
    pub radiance: [f32; 3],
    /// Throughput of the longest branch at its end, 0 if nothing is left; finite, not negative.
    pub throughput: [f32; 3],
    /// Number of intersections of its longest branch, including those past [`MAX_INTERSECTIONS`].
    pub depth: u32,
    /// Reason why the longest branch ended.
    pub end: PathEnd,
    /// First intersections of the path, in order from the camera, branch by branch.
    pub intersections: Vec<Intersection>,
    /// First light contributions of the path, in the order in which they were found.
    pub lights: Vec<LightRecord>,
}

/// Maximum number of intersections in a record.
pub const MAX_INTERSECTIONS: usize = 255;
/// Maximum number of lights in a record.
pub const MAX_LIGHTS: usize = 1023;

/// A vertex of a path: a surface or a point in a medium.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intersection {
    /// Number, from 1, of the intersection before it on its branch; 0: the camera.
    pub parent: u32,
    /// Index of the path segment that ends there, 0: the camera's. Surfaces that a segment goes straight through share its index.
    pub bounce: u32,
    /// Position, world, m; finite.
    pub position: [f64; 3],
    /// Radiance that leaves the intersection along the path, by the light that all its branches found there and later, cd/m2. This is its
    /// part of the sample without the throughput on arrival. Finite, not negative.
    pub radiance: [f32; 3],
    /// Throughput of the path on arrival; finite, not negative.
    pub throughput: [f32; 3],
    /// Innermost object. None in a medium.
    pub object: Name,
    /// Material or medium.
    pub material: Name,
    /// Interaction with which the path continued: its first branch, if it was split there.
    pub interaction: InteractionKind,
}

/// A light contribution at a vertex of a path, possibly occluded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightRecord {
    /// Number, from 1, of the latest intersection of its branch; 0: at the camera.
    pub vertex: u32,
    /// Number of the path's intersections up to then, of all branches.
    pub order: u32,
    /// Lamp, or the medium that emits. None for the light of a first pass.
    pub light: Name,
    /// Medium that scattered the lamp's light into the segment ([`LightTechnique::Airlight`]), else none.
    pub medium: Name,
    /// Contribution to the sample, cd/m2: 0 if the lamp is occluded. Finite, not negative.
    pub radiance: [f32; 3],
    /// Nearest object that hides the lamp from the vertex, or from the point in the medium.
    pub occluder: Option<Name>,
    /// Technique that found the light.
    pub technique: LightTechnique,
}

impl LightPath {
    /// Returns the luminance of the sample, cd/m2.
    pub fn luminance(&self) -> f32 {
        luminance(self.radiance)
    }

    /// Returns the radiance that leaves each intersection along the path, cd/m2: the sum of the record's lights from there on, last
    /// ones first, divided by the throughput on arrival. It is 0 where the throughput is 0.
    /// - `includes_emission`: whether the last lamp hit before an intersection was counted lies at that intersection itself, so
    ///   that its light is included.
    pub fn outgoing_radiance(&self, includes_emission: impl Fn(usize) -> bool) -> Vec<[f32; 3]> {
        let mut earlier = &self.lights[..];
        // Light of each intersection and of those after it.
        let mut sums = vec![[0f32; 3]; self.intersections.len()];
        let mut outgoing = vec![[0f32; 3]; self.intersections.len()];
        for (index, (it, sent)) in self.intersections.iter().zip(&mut outgoing).enumerate().rev() {
            while let Some((light, before)) = earlier.split_last()
                && light.order as usize > index
            {
                // Light of an intersection that is not recorded counts for the last one that is.
                if let Some(vertex) = (light.vertex as usize).min(sums.len()).checked_sub(1) {
                    sums[vertex] = add_rgb(sums[vertex], light.radiance);
                }
                earlier = before;
            }
            let mut here = earlier.iter().rev().take_while(|light| light.order as usize == index);
            let own =
                here.find(|light| light.technique == LightTechnique::EmitterHit).filter(|_| includes_emission(index));
            let sum = sums[index];
            if let Some(parent) = (it.parent as usize).checked_sub(1).filter(|parent| *parent < index) {
                sums[parent] = add_rgb(sums[parent], sum);
            }
            let all = own.map_or(sum, |own| add_rgb(sum, own.radiance));
            *sent = std::array::from_fn(|channel| {
                let (light, factor) = (all[channel], it.throughput[channel]);
                if factor > 0.0 { (light / factor).min(f32::MAX) } else { 0.0 }
            });
        }
        outgoing
    }

    /// Returns the recorded intersections of the branch that ends at an intersection, the last one first.
    /// - `number`: number of the intersection, from 1; 0: the camera.
    pub fn branch(&self, number: u32) -> impl Iterator<Item = &Intersection> + Clone {
        let at = |number: u32| self.intersections.get(number.checked_sub(1)? as usize);
        std::iter::successors(at(number), move |it| at(it.parent))
    }

    /// Returns the numbers of intersections from the camera to each intersection, itself included.
    pub fn levels(&self) -> Vec<u32> {
        let mut levels = Vec::<u32>::with_capacity(self.intersections.len());
        for it in &self.intersections {
            let before = (it.parent as usize).checked_sub(1).and_then(|index| levels.get(index));
            levels.push(before.map_or(1, |before| before + 1));
        }
        levels
    }

    /// Returns the sum of its lights, cd/m2. Lights sampled from the camera are added last, as in a renderer.
    pub(crate) fn sum_of_lights(&self) -> [f32; 3] {
        let sum_lights = |is_camera_next_event: bool| {
            let lights = self
                .lights
                .iter()
                .filter(|light| (light.technique == LightTechnique::CameraNextEvent) == is_camera_next_event);
            lights.fold([0f32; 3], |sum, light| add_rgb(sum, light.radiance))
        };
        add_rgb(sum_lights(false), sum_lights(true))
    }

    /// Returns the index of the intersection at which a light of this path was sampled; `None`: at the camera, or past the recorded
    /// intersections.
    pub fn parent(&self, light: &LightRecord) -> Option<u32> {
        light.vertex.checked_sub(1).filter(|&index| (index as usize) < self.intersections.len())
    }

    /// Returns the light of greatest luminance; of equal ones, the last.
    pub fn brightest_light(&self) -> Option<&LightRecord> {
        let ranked = self.lights.iter().map(|light| (luminance(light.radiance), light));
        ranked.max_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, light)| light)
    }

    /// Returns all names in the record.
    pub(crate) fn names(&self) -> impl Iterator<Item = Name> + '_ {
        let surfaces = self.intersections.iter().flat_map(|it| [it.object, it.material]);
        let lights = self.lights.iter().flat_map(|it| [it.light, it.medium, it.occluder.unwrap_or_default()]);
        surfaces.chain(lights)
    }

    /// Checks that all numbers are in their valid ranges.
    pub fn is_valid(&self) -> bool {
        let is_light = |rgb: [f32; 3]| rgb.iter().all(|value| value.is_finite() && *value >= 0.0);
        let are_sound = self.intersections.iter().all(|it| {
            is_light(it.radiance) && is_light(it.throughput) && it.position.iter().all(|axis| axis.is_finite())
        });
        let kept = self.intersections.len();
        let longest = self.levels().into_iter().max().unwrap_or(0);
        let is_whole = kept < MAX_INTERSECTIONS;
        let is_number = |number: u32| !is_whole || number as usize <= kept;
        kept <= MAX_INTERSECTIONS
            && self.lights.len() <= MAX_LIGHTS
            && (self.depth == longest || !is_whole && self.depth > longest)
            && (1..).zip(&self.intersections).all(|(number, it)| it.parent < number)
            && is_light(self.radiance)
            && is_light(self.throughput)
            && are_sound
            && self.lights.iter().all(|it| is_light(it.radiance) && it.vertex <= it.order && is_number(it.order))
    }
}

fn add_rgb(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|channel| a[channel] + b[channel])
}

/// Returns the luminance of a color, cd/m2, from cd/m2 by channel.
pub fn luminance([r, g, b]: [f32; 3]) -> f32 {
    femc_math::color::luminance(femc_math::Rgb::new(r, g, b))
}
