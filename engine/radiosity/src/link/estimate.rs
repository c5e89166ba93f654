//! Light of a link without occlusion, with estimates of its error.

use super::{Oracle, Pair};
use crate::element::{Element, PatchForm, Shape};
use crate::tuning::{
    CENTER_WEIGHT, CLUSTER_SHARE, DIRECTIONAL_ERROR, EDGE_WEIGHT, MIN_NEIGHBOR_RADII, MIN_SOURCE_SHARE, NODES_WEIGHT,
    SHAPE_WEIGHT, SURFACE_EDGE_WEIGHT, THICKNESS_WEIGHT,
};
use crate::visibility::VisibilityTester;

/// Light of a link without occlusion.
#[derive(Clone, Copy, Debug)]
pub struct LinkEstimate {
    /// Factors as in [`Link::factors`](super::Link::factors).
    pub factors: [f32; 4],
    /// Mean factor over the receiver.
    pub mean: f32,
    /// Estimated errors of the irradiance, lx: caused by the size of the receiver, and by the size of the source.
    pub errors: [f32; 2],
    /// Estimated error of the irradiance by this link alone, lx.
    pub error: f32,
}

impl Oracle<'_> {
    /// Computes the light of a link without occlusion.
    pub fn estimate(&self, pair: &Pair<'_>, tester: &mut VisibilityTester) -> LinkEstimate {
        let Pair { p, q, .. } = *pair;
        let count = p.node_count();
        let mut factors = [0.0; 4];
        for (factor, node) in factors.iter_mut().zip(p.nodes()) {
            *factor = self.factor(p, q, &node, tester);
        }
        let nodes = &factors[..count];
        let mut mean = nodes.iter().sum::<f32>() / count as f32;
        let (low, high) = nodes.iter().fold((f32::INFINITY, 0.0f32), |(low, high), &f| (low.min(f), high.max(f)));
        let missed =
            if self.is_beside(pair) { self.add_missed_light(pair, (&mut factors, &mut mean), tester) } else { 0.0 };
        let source_error = source_error(pair, mean);
        let sum = |receiver_error: f32| {
            let errors = self.sum_errors(pair, mean, [receiver_error * pair.radiosity, source_error]);
            LinkEstimate { factors, mean, errors, error: receiver_error * pair.radiosity + source_error }
        };
        if p.is_directional() {
            return sum(directional_share(p) * mean * directional_error(pair.near_p));
        }
        // If a part of the receiver's error is too large and the greater one, the receiver is split, whatever the rest is.
        let is_enough = |LinkEstimate { errors, .. }: &LinkEstimate| errors[0] > pair.allowed && errors[0] >= errors[1];
        let mut error = NODES_WEIGHT * (high - low) + SHAPE_WEIGHT * pair.near_p * pair.near_p * mean + missed;
        let weight = match (&p.shape, &q.shape) {
            (Shape::Volume(_), Shape::Volume(_)) => EDGE_WEIGHT,
            (Shape::Volume(_), Shape::Patch(_)) => SURFACE_EDGE_WEIGHT,
            _ => 0.0,
        };
        let partial = sum(error);
        if is_enough(&partial) {
            return partial;
        }
        if weight > 0.0 {
            error += weight * self.edge_error(p, q, &factors, tester);
            let partial = sum(error);
            if is_enough(&partial) {
                return partial;
            }
        }
        let middle = if count > 1 { self.factor(p, q, &p.center_spot(), tester) } else { mean };
        sum(error + CENTER_WEIGHT * (middle - mean).abs())
    }

    /// Checks whether a small source is next to a box of fog. It mostly lights the fog next to itself, where there may be no node.
    fn is_beside(&self, pair: &Pair<'_>) -> bool {
        let Pair { p, q, .. } = *pair;
        p.is_volume()
            && pair.near_p + pair.near_q > MIN_NEIGHBOR_RADII
            && match &q.shape {
                Shape::Patch(_) => q.radius < p.radius,
                Shape::Volume(_) => q.size() < p.size(),
                Shape::Cluster(_) | Shape::Curved(_) => false,
            }
    }

    /// Computes the light that the whole box receives in the reverse direction, and spreads the part that the nodes miss over the
    /// box. Returns that part as a factor.
    fn add_missed_light(
        &self,
        pair: &Pair<'_>,
        (factors, mean): (&mut [f32; 4], &mut f32),
        tester: &mut VisibilityTester,
    ) -> f32 {
        let Pair { p, q, .. } = *pair;
        let back: f32 =
            q.nodes().map(|spot| self.factor_from_fog(q, p, &spot, tester)).sum::<f32>() / q.node_count() as f32;
        let share = if q.is_volume() { 1.0 } else { 0.25 };
        let whole = share * back * q.size() / p.size();
        let less = whole - *mean;
        let scale = if *mean > 0.0 { (whole / *mean).min(1.0) } else { 1.0 };
        *factors = factors.map(|factor| factor * scale + less.max(0.0));
        *mean = whole;
        less.abs()
    }

    /// Scales the errors of a link to the sum over similar links of the receiver, and adds the error of the attenuation by fog.
    fn sum_errors(&self, pair: &Pair<'_>, mean: f32, mut errors: [f32; 2]) -> [f32; 2] {
        let Pair { p, q, near_q, .. } = *pair;
        // A source that is small from here is one of many adjacent ones, whose errors at the receiver are alike and add up.
        if p.is_volume() {
            errors[0] /= near_q.max(MIN_SOURCE_SHARE);
        } else {
            let share = if pair.has_directional() { 0.25 * near_q * near_q } else { mean };
            let many = 1.0 / share.sqrt().clamp(MIN_SOURCE_SHARE, 1.0);
            errors = errors.map(|error| error * many);
        }
        if self.scene.fog.is_some() {
            // The attenuation by fog varies over the source. A box of fog also has no single distance.
            let thickness = (self.extinction(q) * q.radius).min(1.0);
            let shape = if q.is_volume() { near_q * near_q } else { 0.0 };
            errors[1] += mean * pair.radiosity * (shape + THICKNESS_WEIGHT * near_q * thickness);
        }
        errors
    }
}

/// Returns the error caused by the size of the source, lx.
fn source_error(pair: &Pair<'_>, mean: f32) -> f32 {
    let Pair { q, near_q, radiosity, .. } = *pair;
    if q.is_directional() {
        return mean * radiosity * directional_error(near_q);
    }
    // A few points represent a shape that is not a polygon.
    let is_bent = q.patch().is_some_and(|patch| patch.form == PatchForm::Bent);
    let shape = if is_bent { SHAPE_WEIGHT * near_q * near_q } else { 0.0 };
    let sent = pair.sent();
    mean * (0.5 * (sent.high - sent.low) * (2.0 * near_q).min(1.0) + shape * radiosity)
}

/// Returns the mean irradiance of an element with light by direction, relative to that of a surface that faces the source.
pub fn directional_share(element: &Element) -> f32 {
    // The surfaces of a cluster with parts have errors of their own.
    if element.is_cluster() && element.is_leaf() { CLUSTER_SHARE } else { 1.0 }
}

/// Returns the error of an element with light by direction, as a share of the light.
/// - `near`: radius over distance.
fn directional_error(near: f32) -> f32 {
    DIRECTIONAL_ERROR[0] + DIRECTIONAL_ERROR[1] * near * near
}
