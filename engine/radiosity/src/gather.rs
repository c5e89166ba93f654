//! Gathering of light through links, and its transport down and up the tree.

use crate::arena::Arena;
use crate::element::{Element, Kind};
use crate::link::Link;
use crate::scene::Scene;
use femc_field::{Cell, Harmonics, NONE};
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::glam::{Vec2, Vec3A};
use rayon::prelude::*;

/// The light of an element.
#[derive(Clone, Copy, Debug)]
pub struct Light {
    /// Irradiance at the nodes, lx, received through the element's own links from light sources, and from elements.
    pub own: [[Rgb; 4]; 2],
    /// Irradiance at the nodes including that of the elements above it, lx.
    pub whole: [[Rgb; 4]; 2],
    /// Mean radiosity, lx; for fog per m.
    pub radiosity: Rgb,
    /// Bounds of the radiosity's luminance over the parts.
    pub darkest: f32,
    pub brightest: f32,
    /// Mean irradiance, by luminance, and the mean irradiance of the darkest part.
    pub mean: f32,
    pub least: f32,
    /// Intensity by direction that wide elements send, cd.
    pub sent: Harmonics,
}

impl Light {
    pub const NOTHING: Self = Self {
        own: [[Rgb::ZERO; 4]; 2],
        whole: [[Rgb::ZERO; 4]; 2],
        radiosity: Rgb::ZERO,
        darkest: 0.0,
        brightest: 0.0,
        mean: 0.0,
        least: 0.0,
        sent: Harmonics::ZERO,
    };
}

/// Arriving light of a wide element by direction, from sources and from elements: through its own links, and including that of the
/// elements above.
#[derive(Clone, Copy, Debug)]
pub struct Arriving {
    pub own: [Harmonics; 2],
    pub whole: [Harmonics; 2],
    /// Light of a ball that rays find in addition to that of the links.
    pub more: Harmonics,
}

impl Arriving {
    pub const NOTHING: Self = Self { own: [Harmonics::ZERO; 2], whole: [Harmonics::ZERO; 2], more: Harmonics::ZERO };
}

/// Indices of the kinds of light.
pub const FROM_SOURCES: usize = 0;
pub const FROM_ELEMENTS: usize = 1;

/// Treatment of irradiance that exceeds the possible maximum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bound {
    /// No bound: the irradiance stays.
    None,
    /// The excess is removed from now on, so that light cannot grow from reflection to reflection.
    RowSums,
}

/// Maximum irradiance of a point if all elements have a radiosity of 1.
const BEYOND: f32 = 1.1;
/// Maximum share of the light that a reflection may pass on under that bound.
const DECAY: f32 = 0.99;

/// Number of normals at which a ball's light is evaluated.
const AROUND: usize = 16;

/// Light of all elements.
#[derive(Clone, Debug)]
pub struct Lights {
    pub of: Vec<Light>,
    pub arriving: Vec<Arriving>,
    /// Accepted share of the links' light at the nodes, by element, see [`Lights::row_sum`].
    pub taken: Vec<[f32; 4]>,
    /// Light that rays find at the nodes in addition to that, by element, lx; see [`crate::rays`].
    pub more: Vec<[Rgb; 4]>,
}

impl Lights {
    /// Number of bytes of an element's light, without the light by direction.
    pub const BYTES: usize = size_of::<Light>() + size_of::<[f32; 4]>() + size_of::<[Rgb; 4]>();

    pub fn new(arena: &Arena) -> Self {
        let count = arena.elements.len();
        Self {
            of: vec![Light::NOTHING; count],
            arriving: vec![Arriving::NOTHING; arena.wide],
            taken: vec![[1.0; 4]; count],
            more: vec![[Rgb::ZERO; 4]; count],
        }
    }

    /// Allocates new elements, which begin with their parents' light.
    pub fn grow(&mut self, arena: &Arena) {
        for element in &arena.elements[self.of.len()..] {
            let parent = self.of[element.parent as usize];
            let Light { radiosity, darkest, brightest, mean, least, .. } = parent;
            self.of.push(Light { radiosity, darkest, brightest, mean, least, ..Light::NOTHING });
            let taken = self.taken[element.parent as usize].into_iter().fold(1.0, f32::min);
            self.taken.push([taken; 4]);
        }
        self.arriving.resize(arena.wide, Arriving::NOTHING);
        self.more.resize(arena.elements.len(), [Rgb::ZERO; 4]);
    }

    /// Accepts all light of the links.
    pub fn unbounded(&mut self) {
        self.taken.fill([1.0; 4]);
    }

    /// Returns the greatest irradiance of a point if all elements have a radiosity of 1, and the fog that of its extinction. It is
    /// 1 in a closed scene if all links are exact. The bound is [`BEYOND`], or less if elements reflect so much that light would
    /// still grow.
    pub fn row_sum(&mut self, scene: &Scene<'_>, arena: &Arena, links: &[Link], then: Bound) -> f32 {
        let (of, arriving) = (self.of.clone(), self.arriving.clone());
        for index in (0..arena.elements.len()).rev() {
            let element = &arena.elements[index];
            if !element.is_leaf() {
                self.pull(arena, index);
                continue;
            }
            let light = &mut self.of[index];
            light.radiosity = match element.kind {
                Kind::Fog => Rgb::splat(scene.prepared.media.extinction_at(element.center)),
                _ => Rgb::ONE,
            };
            if element.kind == Kind::Ball {
                light.sent = sent_of(scene, element, |_| Rgb::ONE);
            }
        }
        self.gather(arena, links);
        self.push_all(arena);
        let albedo = |element: &Element| match element.kind {
            Kind::Cluster => 0.0,
            Kind::Fog => {
                let extinction = scene.prepared.media.extinction_at(element.center);
                element.reflectance.max_element() / extinction.max(f32::MIN_POSITIVE)
            }
            Kind::Patch | Kind::Ball => (element.reflectance + element.transmittance).max_element(),
        };
        let greatest = arena.elements.iter().map(albedo).fold(0.0, f32::max);
        let bound = (DECAY / greatest.max(f32::MIN_POSITIVE)).clamp(1.0, BEYOND);
        let mut most = 0.0f32;
        for (index, element) in arena.elements.iter().enumerate().filter(|(_, element)| element.is_leaf()) {
            let received = match element.kind {
                Kind::Ball => [self.arriving[element.wide as usize].whole[FROM_ELEMENTS].total().y * 0.25; 4],
                _ => self.of[index].whole[FROM_ELEMENTS].map(|light| light.y),
            };
            most = received[..element.count].iter().copied().fold(most, f32::max);
            if then == Bound::RowSums {
                for (taken, received) in self.taken[index].iter_mut().zip(received) {
                    *taken = taken.min(bound / received.max(f32::MIN_POSITIVE));
                }
            }
        }
        (self.of, self.arriving) = (of, arriving);
        most
    }

    /// Gathers irradiance through all links, which are sorted by receiver. The light of each receiver is added in the links' order.
    pub fn gather(&mut self, arena: &Arena, links: &[Link]) {
        let rows: Vec<&[Link]> = links.chunk_by(|a, b| a.receiver == b.receiver).collect();
        let of = &self.of;
        let gathered: Vec<([Rgb; 4], Harmonics)> =
            rows.par_iter().with_min_len(64).map(|row| row_of(arena, of, row)).collect();
        for light in &mut self.of {
            light.own[FROM_ELEMENTS] = [Rgb::ZERO; 4];
        }
        for arriving in &mut self.arriving {
            arriving.own[FROM_ELEMENTS] = Harmonics::ZERO;
        }
        for (row, (nodes, arriving)) in rows.iter().zip(gathered) {
            let receiver = row[0].receiver as usize;
            self.of[receiver].own[FROM_ELEMENTS] = nodes;
            let wide = arena.elements[receiver].wide;
            if wide != NONE {
                self.arriving[wide as usize].own[FROM_ELEMENTS] = arriving;
            }
        }
    }

    /// Transports arriving light down the tree, and sent light up. Returns the change of the light that leaves all elements, and
    /// the total, lm. The changes are sums of the absolute changes of the leaves.
    pub fn push_pull(&mut self, scene: &Scene<'_>, arena: &Arena) -> (f64, f64) {
        self.push_all(arena);
        let (mut change, mut whole) = (0.0, 0.0);
        for index in (0..arena.elements.len()).rev() {
            let before = self.of[index].radiosity;
            if arena.elements[index].is_leaf() {
                self.reflect(scene, arena, index);
                let now = self.of[index].radiosity;
                let element = &arena.elements[index];
                // A box of fog sends in all directions four times as much as a surface of its radiosity.
                let size = f64::from(if element.kind == Kind::Fog { 4.0 * element.size } else { element.size });
                change += size * f64::from(luminance((now - before).abs()));
                whole += size * f64::from(luminance(now));
            } else {
                self.pull(arena, index);
            }
        }
        (change, whole)
    }

    /// Transports arriving light down the tree.
    pub fn push_all(&mut self, arena: &Arena) {
        (0..arena.elements.len()).for_each(|index| self.push(arena, index));
    }

    fn push(&mut self, arena: &Arena, index: usize) {
        let element = &arena.elements[index];
        if element.is_wide() {
            let mut arriving = self.arriving[element.wide as usize];
            arriving.whole = arriving.own;
            if element.parent != NONE {
                let above = self.arriving[arena.elements[element.parent as usize].wide as usize].whole;
                (0..2).for_each(|kind| arriving.whole[kind] += above[kind]);
            }
            self.arriving[element.wide as usize] = arriving;
            return;
        }
        let mut whole = self.of[index].own;
        if element.parent != NONE {
            let above = &arena.elements[element.parent as usize];
            for kind in [FROM_SOURCES, FROM_ELEMENTS] {
                for (node, value) in whole[kind].iter_mut().enumerate().take(element.count) {
                    *value += if above.is_wide() {
                        let light = &self.arriving[above.wide as usize].whole[kind];
                        match element.kind {
                            // A point of fog receives a quarter of the light from all directions.
                            Kind::Fog => (light.total() * 0.25).max(Rgb::ZERO),
                            _ => light.cosine(element.nodes[node].normal),
                        }
                    } else {
                        above.between(&self.of[element.parent as usize].whole[kind], above.local_of(element, node))
                    };
                }
            }
        }
        self.of[index].whole = whole;
    }

    /// Returns the irradiance at an element's nodes from sources or from elements.
    pub fn at_nodes(&self, index: usize, from: usize) -> [Rgb; 4] {
        let mut values = self.of[index].whole[from];
        if from == FROM_ELEMENTS {
            let beyond = self.taken[index].into_iter().zip(self.more[index]);
            values.iter_mut().zip(beyond).for_each(|(value, (taken, more))| *value = *value * taken + more);
        }
        values
    }

    /// Returns the light by direction that a curved element receives from sources or from elements.
    pub fn around(&self, element: &Element, index: usize, from: usize) -> Harmonics {
        let Arriving { whole, more, .. } = self.arriving[element.wide as usize];
        if from == FROM_ELEMENTS { whole[from] * Rgb::splat(self.taken[index][0]) + more } else { whole[from] }
    }

    /// Computes the light that a leaf sends from the light that it receives.
    fn reflect(&mut self, scene: &Scene<'_>, arena: &Arena, index: usize) {
        let element = &arena.elements[index];
        let behind = self.behind(scene, arena, element);
        let of_elements = self.at_nodes(index, FROM_ELEMENTS);
        if element.kind == Kind::Ball {
            let arriving =
                self.arriving[element.wide as usize].whole[FROM_SOURCES] + self.around(element, index, FROM_ELEMENTS);
            let (mut sum, mut mean) = (Rgb::ZERO, 0.0);
            let sent = sent_of(scene, element, |normal| {
                let irradiance = arriving.cosine(normal);
                let radiosity = element.reflectance * irradiance + element.transmittance * behind;
                (sum, mean) = (sum + radiosity, mean + luminance(irradiance));
                radiosity
            });
            let light = &mut self.of[index];
            light.sent = sent;
            light.radiosity = sum / AROUND as f32;
            light.mean = mean / AROUND as f32;
            light.least = light.mean;
            (light.darkest, light.brightest) = (0.0, 2.0 * luminance(light.radiosity));
            return;
        }
        let light = &mut self.of[index];
        let (mut sum, mut mean, mut darkest, mut brightest) = (Rgb::ZERO, 0.0, f32::INFINITY, 0.0f32);
        for (node, of_elements) in of_elements.into_iter().enumerate().take(element.count) {
            let irradiance = (light.whole[FROM_SOURCES][node] + of_elements).max(Rgb::ZERO);
            let radiosity = element.reflectance * irradiance + element.transmittance * behind;
            let value = luminance(radiosity);
            (darkest, brightest) = (darkest.min(value), brightest.max(value));
            (sum, mean) = (sum + radiosity, mean + luminance(irradiance));
        }
        let share = 1.0 / element.count as f32;
        (light.radiosity, light.mean) = (sum * share, mean * share);
        light.least = light.mean;
        (light.darkest, light.brightest) = (darkest, brightest);
    }

    /// Returns the mean irradiance of the other side if the surface transmits light.
    fn behind(&self, scene: &Scene<'_>, arena: &Arena, element: &Element) -> Rgb {
        if element.transmittance == Rgb::ZERO || element.kind == Kind::Fog {
            return Rgb::ZERO;
        }
        let other = scene.behind(element.surface);
        let root = if other == NONE { NONE } else { arena.roots[other as usize] };
        if root == NONE {
            return Rgb::ZERO;
        }
        // Both sides are split alike, though one may be split further.
        let middle = if element.corner_count == 3 { Vec2::splat(1.0 / 3.0) } else { Vec2::splat(0.5) };
        let (index, _) = arena.part_at(root, element.outline.at(middle), 0.0);
        let other = &arena.elements[index as usize];
        if other.kind == Kind::Ball {
            let sources = self.arriving[other.wide as usize].whole[FROM_SOURCES];
            return (sources + self.around(other, index as usize, FROM_ELEMENTS)).total() * 0.25;
        }
        let [sources, elements] = [FROM_SOURCES, FROM_ELEMENTS].map(|from| self.at_nodes(index as usize, from));
        let sum: Rgb = (0..other.count).map(|node| sources[node] + elements[node]).sum();
        (sum / other.count as f32).max(Rgb::ZERO)
    }

    fn pull(&mut self, arena: &Arena, index: usize) {
        let element = &arena.elements[index];
        let [a, b] = element.children.map(|child| (&arena.elements[child as usize], self.of[child as usize]));
        let mut out = self.of[index];
        let size = a.0.size + b.0.size;
        let [wa, wb] = [a, b].map(|(part, _)| if size > 0.0 { part.size / size } else { 0.5 });
        if element.is_wide() {
            out.sent = Harmonics::ZERO;
            for (part, light) in [a, b] {
                match part.kind {
                    Kind::Cluster | Kind::Ball => out.sent += light.sent,
                    Kind::Patch => {
                        let amount = light.radiosity * (part.size / (std::f32::consts::PI * part.count as f32));
                        for node in &part.nodes[..part.count] {
                            out.sent += Harmonics::toward(node.normal, amount);
                        }
                    }
                    Kind::Fog => {}
                }
            }
        }
        out.radiosity = a.1.radiosity * wa + b.1.radiosity * wb;
        out.mean = a.1.mean * wa + b.1.mean * wb;
        out.least = a.1.least.min(b.1.least);
        out.darkest = a.1.darkest.min(b.1.darkest);
        out.brightest = a.1.brightest.max(b.1.brightest);
        self.of[index] = out;
    }
}

/// Returns the intensity of a curved element by direction, cd, from the radiosity at points around it.
fn sent_of(scene: &Scene<'_>, element: &Element, mut radiosity: impl FnMut(Vec3A) -> Rgb) -> Harmonics {
    let surface = &scene.surfaces[element.surface as usize];
    let mut sent = Harmonics::ZERO;
    for k in 0..AROUND {
        let place = Vec2::new((k % 4) as f32 + 0.5, (k / 4) as f32 + 0.5) * 0.25;
        let normal = surface.at(element.outline.at(place)).normal;
        sent += Harmonics::toward(normal, radiosity(normal) * (element.size / (std::f32::consts::PI * AROUND as f32)));
    }
    sent
}

fn row_of(arena: &Arena, of: &[Light], row: &[Link]) -> ([Rgb; 4], Harmonics) {
    let p = &arena.elements[row[0].receiver as usize];
    let (mut nodes, mut arriving) = ([Rgb::ZERO; 4], Harmonics::ZERO);
    for link in row {
        let (q, light) = (&arena.elements[link.source as usize], &of[link.source as usize]);
        let way: Vec3A = q.center - p.center;
        let sent = if q.is_wide() { light.sent.cosine(-way.normalize_or(Vec3A::Z)) } else { light.radiosity };
        if p.is_wide() {
            arriving += Harmonics::toward(way.normalize_or(Vec3A::Z), sent * link.factors[0]);
        } else {
            for (node, factor) in nodes.iter_mut().zip(link.factors) {
                *node += sent * factor;
            }
        }
    }
    (nodes, arriving)
}

/// Returns the cell of an element for the field.
pub fn cell_of(element: &Element, next: u32) -> Cell {
    Cell { outline: element.in_parent, split: crate::arena::split_of(element), next }
}
