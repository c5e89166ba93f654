//! Choice of one light among many, in proportion to a bound on what each may send to a place.
//!
//! A binary tree over the lights (\[conty2018\]); a node knows the sphere around its lights, the cone of their normals and
//! their power. A place (a point, or a segment of a ray in fog) gives every node an importance; the choice goes down
//! from the root, to each child in proportion to its importance. A light has no probability only where it can send nothing.
//!
//! Importances are bounds where that matters (a light that faces a place is never lost) and estimates elsewhere; with
//! [`LightTree::probability`] for the weights the choice is unbiased whatever they are.

use crate::light::EmissionCone;
use femc_math::glam::Vec3A;
use std::f32::consts::{FRAC_PI_2, PI};

/// Cosines of bounds are trusted up to this much: rounding shall not lose a light.
const SLACK: f32 = 1e-3;
/// Depth below which nodes are cut in the middle, so that every path fits into a trail of 64 bits.
const STEEP: u32 = 32;
/// Places where a node may be cut, along each axis.
const BUCKETS: usize = 12;
/// Child index of a leaf; the light's index is beside it.
const LEAF: u32 = u32::MAX;
/// Trail of a light without power.
const ABSENT: u64 = u64::MAX;

/// What the tree knows of a light.
#[derive(Clone, Copy, Debug)]
pub struct LightBounds {
    /// Lower corner of the bounding box, m.
    pub low: Vec3A,
    /// Upper corner.
    pub high: Vec3A,
    /// Luminous flux, lm.
    pub power: f32,
    /// Bound on normals and emission.
    pub cone: EmissionCone,
}

/// A place that wants light.
pub trait Place {
    /// Importance of a node, >= 0; 0 only where its lights can send nothing.
    fn importance(&self, node: &Node) -> f32;
}

/// A point on a surface or in a medium.
#[derive(Clone, Copy, Debug)]
pub struct AtPoint {
    /// m.
    pub position: Vec3A,
    /// Unit normal of the side that light is scattered from; zero where light counts from all sides.
    pub normal: Vec3A,
    /// Extinction of the haze that is everywhere, 1/m.
    pub haze: f32,
}

/// A segment of a ray in fog: light is wanted along all of it.
#[derive(Clone, Copy, Debug)]
pub struct AlongSegment {
    /// Start of the ray, m.
    pub origin: Vec3A,
    /// Unit direction.
    pub dir: Vec3A,
    /// First and last distance on the ray, m; finite.
    pub range: (f32, f32),
    /// Extinction of the haze that is everywhere, 1/m.
    pub haze: f32,
}

/// A node: one light, or all lights below it.
#[derive(Clone, Copy, Debug)]
pub struct Node {
    center: Vec3A,
    axis: Vec3A,
    /// Radius of the sphere around the lights, m.
    radius: f32,
    /// Its square.
    radius2: f32,
    /// Candela at the peak of the profile, summed.
    intensity: f32,
    cos_normals: f32,
    sin_normals: f32,
    /// Power of the cosine that the intensity follows.
    exponent: f32,
    two_sided: bool,
    /// Index of the first child, the second follows; [`LEAF`] in leaves.
    children: u32,
    light: u32,
}

/// Cosine and sine of `a - b`, or of 0 where a < b; both in 0..pi.
#[inline]
fn angle_less((cos_a, sin_a): (f32, f32), (cos_b, sin_b): (f32, f32)) -> (f32, f32) {
    if cos_a >= cos_b { (1.0, 0.0) } else { (cos_a * cos_b + sin_a * sin_b, sin_a * cos_b - cos_a * sin_b) }
}

#[inline]
fn sine(cos: f32) -> f32 {
    (1.0 - cos * cos).max(0.0).sqrt()
}

impl Node {
    /// Whether the intensity is the same in every direction.
    #[inline]
    fn is_everywhere(&self) -> bool {
        self.cos_normals <= -1.0
    }

    /// Squared distance to the lights' middle, at least their radius; the direction from `point` to it; and the cosine and
    /// sine of the angle by which the lights' own directions may differ from it.
    #[inline]
    fn seen_from(&self, point: Vec3A) -> (f32, Vec3A, (f32, f32)) {
        let toward = self.center - point;
        let distance2 = toward.length_squared();
        if distance2 <= self.radius2 * 1.001 || distance2 == 0.0 {
            return (self.radius2.max(distance2).max(f32::MIN_POSITIVE), Vec3A::ZERO, (-1.0, 0.0));
        }
        let inverse = 1.0 / distance2.sqrt();
        let sin = self.radius * inverse;
        (distance2, toward * inverse, ((1.0 - sin * sin).max(0.0).sqrt(), sin))
    }

    /// Bound on the intensity, cd, in direction `dir` (unit, from the lights to the place), whose error is `spread`.
    #[inline]
    fn intensity_toward(&self, dir: Vec3A, spread: (f32, f32)) -> f32 {
        if self.is_everywhere() || spread.0 <= -1.0 {
            return self.intensity;
        }
        let cos = self.axis.dot(dir);
        let cos = if self.two_sided { cos.abs() } else { cos }.clamp(-1.0, 1.0);
        let off_normals = angle_less((cos, sine(cos)), (self.cos_normals, self.sin_normals));
        let (cos, _) = angle_less(off_normals, spread);
        if cos < -SLACK {
            return 0.0;
        }
        self.intensity * self.profile(cos.max(SLACK))
    }

    /// The cosine's power, by a quotient that falls off more slowly (\[schlick1994\]).
    #[inline]
    fn profile(&self, cos: f32) -> f32 {
        cos / (self.exponent - self.exponent * cos + cos)
    }

    /// Estimate of the intensity, cd, toward a place that sees the lights' middle along `toward` (m, not unit).
    #[inline]
    fn intensity_about(&self, toward: Vec3A) -> f32 {
        if self.is_everywhere() {
            return self.intensity;
        }
        let inverse = 1.0 / toward.length_squared().max(self.radius2).max(f32::MIN_POSITIVE).sqrt();
        let cos = -self.axis.dot(toward) * inverse;
        let cos = if self.two_sided { cos.abs() } else { cos };
        let open = 1.0 - self.cos_normals + self.radius * inverse;
        self.intensity * self.profile((cos + open).clamp(SLACK, 1.0))
    }
}

/// An upper bound of exp(-x), x >= 0, without the price of an exponential.
#[inline]
fn attenuation(x: f32) -> f32 {
    1.0 / (1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0))))
}

impl Place for AtPoint {
    #[inline]
    fn importance(&self, node: &Node) -> f32 {
        let (distance2, toward, spread) = node.seen_from(self.position);
        let intensity = node.intensity_toward(-toward, spread);
        if intensity <= 0.0 {
            return 0.0;
        }
        let mut importance = intensity / distance2;
        if self.normal != Vec3A::ZERO && spread.0 > -1.0 {
            let cos = self.normal.dot(toward).clamp(-1.0, 1.0);
            let (cos, _) = angle_less((cos, sine(cos)), spread);
            if cos < -SLACK {
                return 0.0;
            }
            importance *= cos.max(SLACK);
        }
        if self.haze > 0.0 {
            importance *= attenuation(self.haze * distance2.sqrt());
        }
        importance
    }
}

impl Place for AlongSegment {
    /// The integral of 1 / distance^2 along the segment, times an estimate of the intensity toward its nearest point, or toward
    /// its ends where that one is behind the lights.
    #[inline]
    fn importance(&self, node: &Node) -> f32 {
        let (t0, t1) = self.range;
        let along = (node.center - self.origin).dot(self.dir);
        let nearest = along.clamp(t0, t1);
        let beside2 = (node.center - (self.origin + self.dir * along)).length_squared();
        let h = beside2.max(node.radius2).sqrt().max(f32::MIN_POSITIVE.sqrt());
        let angle = subtended(h * (t1 - t0), h * h + (t0 - along) * (t1 - along));
        let toward = |t: f32| node.intensity_about(node.center - (self.origin + self.dir * t));
        let mut intensity = toward(nearest);
        if intensity <= 2.0 * SLACK * node.intensity {
            intensity = intensity.max(0.5 * toward(t0).max(toward(t1)));
        }
        let importance = intensity * angle / h;
        if self.haze > 0.0 { importance * attenuation(self.haze * (nearest + h - t0)) } else { importance }
    }
}

/// The angle whose tangent is `y / x`, 0..pi, to 1 %; y >= 0.
#[inline]
fn subtended(y: f32, x: f32) -> f32 {
    let small = |t: f32| t / (1.0 + 0.28 * t * t);
    if x >= y {
        if y > 0.0 { small(y / x) } else { f32::MIN_POSITIVE }
    } else if x > -y {
        FRAC_PI_2 - small(x.abs() / y).copysign(x)
    } else {
        PI - small(y / -x)
    }
}

/// The tree.
#[derive(Clone, Debug, Default)]
pub struct LightTree {
    nodes: Vec<Node>,
    /// For each light the turns from the root to it, the first in the lowest bit; [`ABSENT`] if it is not in the tree.
    trails: Vec<u64>,
}

impl LightTree {
    /// A tree over `lights`, whose indices it gives out. Lights without power, or with bounds that are not finite, are left
    /// out: they are never chosen.
    pub fn new(lights: &[LightBounds]) -> Self {
        let has_power = |l: &LightBounds| l.power > 0.0 && l.power.is_finite() && (l.low + l.high).is_finite();
        let mut leaves: Vec<Cluster> = (0..lights.len() as u32)
            .zip(lights)
            .filter(|(_, light)| has_power(light))
            .map(|(index, light)| Cluster::of(light, index))
            .collect();
        let mut tree = Self { nodes: Vec::new(), trails: vec![ABSENT; lights.len()] };
        if !leaves.is_empty() {
            tree.nodes.reserve(2 * leaves.len() - 1);
            tree.nodes.push(Node::ABSENT);
            tree.build(0, &mut leaves, 0, 0);
        }
        tree
    }

    /// Whether no light can be chosen.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    fn build(&mut self, at: usize, leaves: &mut [Cluster], trail: u64, depth: u32) {
        let whole = leaves.iter().skip(1).fold(leaves[0], |all, leaf| all.join(leaf));
        if let [leaf] = leaves {
            self.nodes[at] = whole.node(LEAF, leaf.light);
            self.trails[leaf.light as usize] = trail;
            return;
        }
        let middle = if depth < STEEP { cut(&whole, leaves) } else { leaves.len() / 2 };
        let children = self.nodes.len();
        self.nodes.push(Node::ABSENT);
        self.nodes.push(Node::ABSENT);
        self.nodes[at] = whole.node(children as u32, 0);
        let (left, right) = leaves.split_at_mut(middle);
        self.build(children, left, trail, depth + 1);
        self.build(children + 1, right, trail | 1 << depth, depth + 1);
    }

    /// Probability of the first child of a node; `None` where neither can send anything.
    #[inline]
    fn first_share(&self, children: u32, place: &impl Place) -> Option<f64> {
        let pair = &self.nodes[children as usize..children as usize + 2];
        let (a, b) = (f64::from(place.importance(&pair[0])), f64::from(place.importance(&pair[1])));
        let share = a / (a + b);
        (share.is_finite()).then_some(share)
    }

    /// Chooses a light for `place` by `u` in [0, 1): its index and probability > 0. `None`: no light can send anything.
    #[inline]
    pub fn choose(&self, place: &impl Place, mut u: f64) -> Option<(u32, f32)> {
        let mut node = self.nodes.first()?;
        if place.importance(node) <= 0.0 {
            return None;
        }
        let mut probability = 1.0;
        while node.children != LEAF {
            let share = self.first_share(node.children, place)?;
            if u < share {
                u /= share;
                probability *= share;
                node = &self.nodes[node.children as usize];
            } else {
                u = ((u - share) / (1.0 - share)).min(1.0 - f64::EPSILON);
                probability *= 1.0 - share;
                node = &self.nodes[node.children as usize + 1];
            }
        }
        let probability = probability as f32;
        (probability > 0.0).then_some((node.light, probability))
    }

    /// Probability with which [`Self::choose`] chooses `light` for `place`.
    #[inline]
    pub fn probability(&self, place: &impl Place, light: u32) -> f32 {
        let mut trail = self.trails[light as usize];
        let Some(mut node) = self.nodes.first().filter(|_| trail != ABSENT) else { return 0.0 };
        if place.importance(node) <= 0.0 {
            return 0.0;
        }
        let mut probability = 1.0;
        while node.children != LEAF {
            let Some(share) = self.first_share(node.children, place) else { return 0.0 };
            probability *= if trail & 1 == 0 { share } else { 1.0 - share };
            node = &self.nodes[node.children as usize + (trail & 1) as usize];
            trail >>= 1;
        }
        probability as f32
    }
}

impl Node {
    const ABSENT: Self = Self {
        center: Vec3A::ZERO,
        axis: Vec3A::Z,
        radius: 0.0,
        radius2: 0.0,
        intensity: 0.0,
        cos_normals: -1.0,
        sin_normals: 0.0,
        exponent: 1.0,
        two_sided: false,
        children: LEAF,
        light: 0,
    };
}

/// Lights on their way into the tree.
#[derive(Clone, Copy)]
struct Cluster {
    low: Vec3A,
    high: Vec3A,
    power: f32,
    intensity: f32,
    cone: EmissionCone,
    light: u32,
}

impl Cluster {
    fn of(light: &LightBounds, index: u32) -> Self {
        let cone = light.cone;
        // Integral of the profile over the directions that it emits to.
        let solid_angle = if cone.is_everywhere() {
            4.0 * PI
        } else {
            2.0 * PI / (cone.exponent + 1.0) * if cone.two_sided { 2.0 } else { 1.0 }
        };
        let intensity = light.power / solid_angle;
        Self { low: light.low, high: light.high, power: light.power, intensity, cone, light: index }
    }

    fn join(self, other: &Self) -> Self {
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            power: self.power + other.power,
            intensity: self.intensity + other.intensity,
            cone: self.cone.join(&other.cone),
            light: self.light,
        }
    }

    fn node(&self, children: u32, light: u32) -> Node {
        Node {
            center: (self.low + self.high) * 0.5,
            axis: self.cone.axis,
            radius: (self.high - self.low).length() * 0.5,
            radius2: (self.high - self.low).length_squared() * 0.25,
            intensity: self.intensity,
            cos_normals: self.cone.cos_normals,
            sin_normals: sine(self.cone.cos_normals),
            exponent: self.cone.exponent,
            two_sided: self.cone.two_sided,
            children,
            light,
        }
    }

    /// What the cluster costs in a tree: power, extent and spread of directions (\[conty2018\], equation 1).
    fn cost(&self, regularity: f32) -> f32 {
        let size = self.high - self.low;
        let area = size.x * size.y + size.y * size.z + size.z * size.x + 1e-6 * size.length_squared();
        self.power * self.cone.measure() * regularity * area.max(f32::MIN_POSITIVE)
    }
}

/// Sorts `leaves` into two parts, neither empty, of the least cost; returns the number in the first.
fn cut(whole: &Cluster, leaves: &mut [Cluster]) -> usize {
    let middle = |c: &Cluster| (c.low + c.high) * 0.5;
    let low = leaves.iter().map(middle).fold(Vec3A::INFINITY, Vec3A::min);
    let size = leaves.iter().map(middle).fold(Vec3A::NEG_INFINITY, Vec3A::max) - low;
    let extent = whole.high - whole.low;
    let bucket = |c: &Cluster, axis: usize| {
        let share = (middle(c)[axis] - low[axis]) / size[axis];
        ((share * BUCKETS as f32) as usize).min(BUCKETS - 1)
    };
    let mut best: Option<(f32, usize, usize)> = None;
    for axis in (0..3).filter(|&axis| size[axis] > 0.0) {
        let mut buckets: [Option<Cluster>; BUCKETS] = [None; BUCKETS];
        for leaf in leaves.iter() {
            let slot = &mut buckets[bucket(leaf, axis)];
            *slot = Some(slot.map_or(*leaf, |all| all.join(leaf)));
        }
        let union = |part: &[Option<Cluster>]| part.iter().flatten().copied().reduce(|all, one| all.join(&one));
        // Thin slabs across the longest axis are worse than their area tells.
        let regularity = extent.max_element() / extent[axis].max(f32::MIN_POSITIVE);
        for at in 1..BUCKETS {
            let (Some(left), Some(right)) = (union(&buckets[..at]), union(&buckets[at..])) else { continue };
            let cost = left.cost(regularity) + right.cost(regularity);
            if best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, axis, at));
            }
        }
    }
    let Some((_, axis, at)) = best else { return leaves.len() / 2 };
    // A stable partition, so that the tree does not depend on how it is done.
    leaves.sort_by_key(|leaf| bucket(leaf, axis) >= at);
    leaves.partition_point(|leaf| bucket(leaf, axis) < at)
}

#[cfg(test)]
mod tests;
