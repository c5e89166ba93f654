//! Records of light: a path, its intersections, and what lights have brought it.

use femc_math::hash::{Begun, begun};
use std::collections::{BTreeMap, HashMap};
use std::hash::{BuildHasherDefault, Hasher};

/// A camera sample of a frame of a known seed.
///
/// The order of keys is that of frame, pixel and sample; records are ordered by their hash first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PathKey {
    /// Number of the frame.
    pub frame: u32,
    /// Row-major index of the pixel in the whole film.
    pub pixel: u32,
    /// Number of the sample in its pixel.
    pub sample: u32,
}

/// Keeps the hash that chooses records apart from the sampler's hashes of the same words.
const SALT: u64 = 0x7061_7468_2073_6574;

impl PathKey {
    /// What chooses samples: the subset of hashes below `p` 2^64 has a share `p` of all samples, whatever their pixels and numbers
    /// (test `the_subset_is_fair`). Never `u64::MAX`.
    #[inline]
    pub fn hash(self, seed: u64) -> u64 {
        self.hash_in_pixel(self.pixel_hash(seed))
    }

    /// What the hashes of all samples of a pixel begin with.
    #[inline]
    pub fn pixel_hash(self, seed: u64) -> Begun {
        begun(&[SALT, seed, u64::from(self.frame) << 32 | u64::from(self.pixel)])
    }

    /// [`Self::hash`], of what [`Self::pixel_hash`] gives for its pixel.
    #[inline]
    pub fn hash_in_pixel(self, pixel: Begun) -> u64 {
        pixel.end(&[u64::from(self.sample)]).min(u64::MAX - 1)
    }

    /// The half that the sample belongs to: A (0) has the even numbers, B (1) the odd ones.
    #[inline]
    pub fn half(self) -> u8 {
        (self.sample % 2) as u8
    }
}

/// What a name is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// An object of the scene, by its dotted name.
    Object,
    /// A material.
    Material,
    /// A medium.
    Medium,
    /// A lamp: what emits, and the object that holds it.
    Lamp,
}

impl Kind {
    /// All, in the order of their numbers.
    pub const ALL: [Self; 4] = [Self::Object, Self::Material, Self::Medium, Self::Lamp];
}

/// A kind and a text.
pub type Named = (Kind, String);

/// A stable key of an object, a material, a medium or a lamp: a hash of its kind and name, so that it is the same in all frames, jobs
/// and variants that have it. Which name it is, [`Statistics::names`](crate::Statistics::names) says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Name(pub u64);

impl Name {
    /// No object holds it, or it is not known.
    pub const NONE: Self = Self(0);

    /// Of a kind and a text; of an empty text none.
    pub fn of(kind: Kind, text: &str) -> Self {
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
pub type Names = BTreeMap<Name, Named>;

/// Something of each name; their order says nothing.
pub(crate) type ByName<T> = HashMap<Name, T, BuildHasherDefault<KeyHasher>>;

/// A name is a hash already.
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
            /// All, in the order of their numbers in files.
            pub const ALL: &[Self] = &[$(Self::$variant),+];

            /// The word for it in tables and conditions.
            pub fn word(self) -> &'static str {
                match self { $(Self::$variant => $word),+ }
            }
        }
    };
}

numbered! {
    /// Why a path ended.
    End:
    /// It left the scene.
    Escaped = "escaped",
    /// Nothing was scattered, or what was had no way to go.
    Absorbed = "absorbed",
    /// Russian roulette.
    Roulette = "roulette",
    /// It had as many segments as the settings allow.
    Depth = "depth",
    /// The light of a first pass was taken where it was scattered.
    Field = "field",
}

numbered! {
    /// How a path went on from an intersection.
    Interaction:
    /// It ended there.
    Absorbed = "absorbed",
    /// It ended at something that emits.
    Emission = "emission",
    /// Scattered in all directions, reflected or transmitted.
    Diffuse = "diffuse",
    /// Scattered by a rough surface about a direction.
    Glossy = "glossy",
    /// Reflected in the only direction.
    Reflection = "reflection",
    /// Refracted in the only direction.
    Refraction = "refraction",
    /// Straight through a clear surface.
    Straight = "straight",
    /// Scattered in a medium.
    Volume = "volume",
}

numbered! {
    /// How light was found.
    Found:
    /// A point on a lamp was drawn from the camera.
    Sight = "sight",
    /// The path has met a lamp.
    Met = "met",
    /// A point on a lamp was drawn from a surface.
    Surface = "surface",
    /// A lamp, and a distance by what a medium scatters of its light.
    Airlight = "airlight",
    /// A medium glows.
    Glow = "glow",
    /// The light of a first pass.
    Field = "field",
}

/// One sample of a pixel: a light path from the camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    /// Which sample.
    pub key: PathKey,
    /// What the sample adds to its pixel, cd/m2 by channel; finite, not negative.
    pub radiance: [f32; 3],
    /// Factor of the path at its end, 0 where it has lost everything; finite, not negative.
    pub throughput: [f32; 3],
    /// Number of its intersections, those past [`MOST_INTERSECTIONS`] among them.
    pub depth: u32,
    /// Why it ended.
    pub end: End,
    /// The first of its intersections, in order from the camera.
    pub intersections: Vec<Intersection>,
    /// The first of its lights, in the order in which they were found.
    pub lights: Vec<Light>,
}

/// Intersections that a record keeps of a path.
pub const MOST_INTERSECTIONS: usize = 255;
/// Lights that a record keeps of a path.
pub const MOST_LIGHTS: usize = 1023;

/// A vertex of a path: a surface or a point in a medium.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intersection {
    /// Segment of the path that ends there, 0: the camera's. It is the same for surfaces that the segment goes straight through.
    pub bounce: u32,
    /// Where, world, m; finite.
    pub position: [f64; 3],
    /// Light that goes from there along the path, by what the path has found there and after it, cd/m2: its part of the sample without
    /// the factor on arrival. Finite, not negative.
    pub radiance: [f32; 3],
    /// Factor of the path on arrival; finite, not negative.
    pub throughput: [f32; 3],
    /// The innermost object; in a medium none.
    pub object: Name,
    /// The material, or the medium.
    pub material: Name,
    /// How the path went on.
    pub interaction: Interaction,
}

/// Light that a path has looked for at one of its vertices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Number of the path's intersections until then; 0: the camera's own.
    pub vertex: u32,
    /// The lamp; of a glowing medium the medium; none: the light of a first pass.
    pub light: Name,
    /// The medium that has scattered the lamp's light into the segment ([`Found::Airlight`]); else none.
    pub medium: Name,
    /// What it adds to the sample, cd/m2: 0 where something is in between. Finite, not negative.
    pub radiance: [f32; 3],
    /// The nearest object that hides the lamp from the vertex, or from the point in the medium.
    pub occluder: Option<Name>,
    /// How it was found.
    pub found: Found,
}

impl Path {
    /// Luminance of the sample, cd/m2.
    pub fn luminance(&self) -> f32 {
        luminance(self.radiance)
    }

    /// Light that goes from each intersection along the path, cd/m2: the record's lights from there on, the latest first, without the
    /// factor on arrival; 0 where that is 0.
    /// - `emits`: whether an intersection is itself what the latest lamp was that the path met before it counted as one.
    pub fn sent(&self, emits: impl Fn(usize) -> bool) -> Vec<[f32; 3]> {
        let (mut sum, mut earlier) = ([0f32; 3], &self.lights[..]);
        let mut sent = vec![[0f32; 3]; self.intersections.len()];
        for (index, (it, sent)) in self.intersections.iter().zip(&mut sent).enumerate().rev() {
            while let Some((light, before)) = earlier.split_last()
                && light.vertex as usize > index
            {
                sum = added(sum, light.radiance);
                earlier = before;
            }
            let mut here = earlier.iter().rev().take_while(|light| light.vertex as usize == index);
            let own = here.find(|light| light.found == Found::Met).filter(|_| emits(index));
            let all = own.map_or(sum, |own| added(sum, own.radiance));
            *sent = std::array::from_fn(|channel| {
                let (light, factor) = (all[channel], it.throughput[channel]);
                if factor > 0.0 { (light / factor).min(f32::MAX) } else { 0.0 }
            });
        }
        sent
    }

    /// What its lights add up to, cd/m2: those drawn from the camera are added last, as a renderer does.
    pub(crate) fn sum(&self) -> [f32; 3] {
        let of = |is_sight: bool| {
            let lights = self.lights.iter().filter(|light| (light.found == Found::Sight) == is_sight);
            lights.fold([0f32; 3], |sum, light| added(sum, light.radiance))
        };
        added(of(false), of(true))
    }

    /// All names that the record has.
    pub(crate) fn names(&self) -> impl Iterator<Item = Name> + '_ {
        let surfaces = self.intersections.iter().flat_map(|it| [it.object, it.material]);
        let lights = self.lights.iter().flat_map(|it| [it.light, it.medium, it.occluder.unwrap_or_default()]);
        surfaces.chain(lights)
    }

    /// Whether all numbers are what they may be.
    pub fn is_sound(&self) -> bool {
        let is_light = |rgb: [f32; 3]| rgb.iter().all(|value| value.is_finite() && *value >= 0.0);
        let are_sound = self.intersections.iter().all(|it| {
            is_light(it.radiance) && is_light(it.throughput) && it.position.iter().all(|axis| axis.is_finite())
        });
        let kept = self.intersections.len();
        kept <= MOST_INTERSECTIONS
            && self.lights.len() <= MOST_LIGHTS
            && (self.depth as usize == kept || kept == MOST_INTERSECTIONS && self.depth as usize > kept)
            && is_light(self.radiance)
            && is_light(self.throughput)
            && are_sound
            && self.lights.iter().all(|it| is_light(it.radiance) && it.vertex <= self.depth)
    }
}

fn added(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|channel| a[channel] + b[channel])
}

/// Luminance of a color, cd/m2 of cd/m2 by channel.
pub fn luminance([r, g, b]: [f32; 3]) -> f32 {
    femc_math::color::luminance(femc_math::Rgb::new(r, g, b))
}
