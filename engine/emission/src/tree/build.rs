//! Construction of the light tree.

use super::LightBounds;
use super::importance::{Node, sin_from_cos};
use crate::light::EmissionCone;
use femc_math::glam::Vec3A;
use std::f32::consts::PI;

/// Number of buckets along each axis; nodes are split between buckets.
const BUCKETS: usize = 12;

/// A light or a cluster of lights during construction.
#[derive(Clone, Copy)]
pub(super) struct Cluster {
    pub(super) low: Vec3A,
    pub(super) high: Vec3A,
    center: Vec3A,
    pub(super) power: f32,
    extinction: f32,
    pub(super) intensity: f32,
    pub(super) cone: EmissionCone,
    pub(super) light: u32,
}

impl Cluster {
    pub(super) fn new(light: &LightBounds, index: u32) -> Self {
        let cone = light.cone;
        // Integral of the profile over the directions of emission.
        let solid_angle = if cone.is_omnidirectional() {
            4.0 * PI
        } else {
            2.0 * PI / (cone.exponent + 1.0) * if cone.two_sided { 2.0 } else { 1.0 }
        };
        let intensity = light.power / solid_angle;
        let &LightBounds { low, high, center, power, extinction, .. } = light;
        Self { low, high, center, power, extinction, intensity, cone, light: index }
    }

    pub(super) fn join(self, other: &Self) -> Self {
        let (low, high) = (self.low.min(other.low), self.high.max(other.high));
        Self {
            low,
            high,
            center: (low + high) * 0.5,
            power: self.power + other.power,
            extinction: self.extinction.min(other.extinction),
            intensity: self.intensity + other.intensity,
            cone: self.cone.join(&other.cone),
            light: self.light,
        }
    }

    pub(super) fn node(&self, children: u32, light: u32) -> Node {
        // For a single light, the middle need not be the middle of its box.
        let radius2 = (self.high - self.center).max(self.center - self.low).length_squared();
        Node {
            center: self.center,
            axis: self.cone.axis,
            radius: radius2.sqrt(),
            radius2,
            intensity: self.intensity,
            cos_normals: self.cone.cos_normals,
            sin_normals: sin_from_cos(self.cone.cos_normals),
            exponent: self.cone.exponent,
            two_sided: self.cone.two_sided,
            extinction: self.extinction,
            children,
            light,
            ranks: (0, 0),
        }
    }

    /// Computes the cost of the cluster in a tree: power, extent and spread of directions (\[conty2018\], equation 1).
    fn cost(&self, regularity: f32) -> f32 {
        let size = self.high - self.low;
        let area = size.x * size.y + size.y * size.z + size.z * size.x + 1e-6 * size.length_squared();
        self.power * self.cone.measure() * regularity * area.max(f32::MIN_POSITIVE)
    }
}

/// Partitions `leaves` into two parts, neither empty, of the least cost; returns the number in the first.
pub(super) fn partition_leaves(whole: &Cluster, leaves: &mut [Cluster]) -> usize {
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
        // Thin slabs across the longest axis are worse than their area suggests.
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
    // The stable partition keeps the tree independent of the algorithm.
    leaves.sort_by_key(|leaf| bucket(leaf, axis) >= at);
    leaves.partition_point(|leaf| bucket(leaf, axis) < at)
}
