//! Light that fog sends along a line, leaf by leaf.

use super::integral::{SourceTerm, density, endpoint_weights, invert_integral};
use super::tree::{FogTree, NodeKind, PlacedLeaf};
use femc_math::Rgb;
use femc_math::color::LUMINANCE_WEIGHTS;
use femc_math::glam::{DVec3, Vec3A};

/// A stretch of a line in one leaf.
#[derive(Clone, Copy, Debug)]
struct LinePiece {
    /// Distance of its start from the line's origin, m.
    start: f64,
    /// Luminance that arrives at the line's start from this piece and all pieces before it, cd/m2.
    cumulative_luminance: f64,
    length: f32,
    /// Optical depth.
    depth: f32,
    /// Luminance sent per m at its start and its end, attenuated by the pieces before.
    sent: [f32; 2],
}

/// Optical depth and light sent by channel, for a piece from which on the fog has color.
#[derive(Clone, Copy, Debug)]
struct Channels {
    depth: [f32; 3],
    sent: [[f32; 2]; 3],
}

/// A point on a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FogLinePoint {
    /// Distance from the line's origin, m.
    pub t: f32,
    /// Density of the distance, 1/m.
    pub pdf: f32,
}

/// Light that fog sends along a line: the light that it scatters toward the line's start, without direct light from light sources.
/// See [`FogTree::radiance_along`].
#[derive(Clone, Debug, Default)]
pub struct FogLine {
    pieces: Vec<LinePiece>,
    /// Channels of the last pieces, from the first one with colored fog on.
    colored: Vec<Channels>,
    /// Boxes that are not visited yet: the node, and the distance at which the line leaves it.
    pending: Vec<(u32, f64)>,
    total: Rgb,
    transmittance: Rgb,
}

impl FogLine {
    /// Returns the radiance that arrives at the line's start, cd/m2.
    pub fn radiance(&self) -> Rgb {
        self.total
    }

    /// Returns the luminance that arrives at the line's start, cd/m2.
    pub fn luminance(&self) -> f32 {
        self.pieces.last().map_or(0.0, |piece| piece.cumulative_luminance) as f32
    }

    /// Returns the number of boxes that it goes through.
    pub fn leaves(&self) -> usize {
        self.pieces.len()
    }

    /// Returns the transmittance from the line's end to its start through the fog of the boxes.
    pub fn transmittance(&self) -> Rgb {
        self.transmittance
    }

    /// Samples a point from which light comes, by luminance.
    /// - `u`: in [0, 1);
    /// - returns `None` if no light comes; [`Self::pdf`] is the density.
    pub fn sample(&self, u: f64) -> Option<FogLinePoint> {
        let whole = self.pieces.last()?.cumulative_luminance;
        let wanted = u * whole;
        let index = self.pieces.partition_point(|piece| piece.cumulative_luminance <= wanted);
        let piece = self.pieces.get(index)?;
        let (before, length) =
            (if index == 0 { 0.0 } else { self.pieces[index - 1].cumulative_luminance }, f64::from(piece.length));
        let (channels, count) = self.channels(index);
        let share = invert_integral(
            &channels[..count],
            (wanted - before) / length,
            (piece.cumulative_luminance - before) / length,
        );
        let t = (piece.start + length * share) as f32;
        let pdf = self.pdf(t);
        (pdf > 0.0).then_some(FogLinePoint { t, pdf })
    }

    /// Returns the density of [`Self::sample`] at a distance from the line's origin, 1/m. It integrates to 1 over the line, if
    /// there is any light.
    /// - `t`: m.
    pub fn pdf(&self, t: f32) -> f32 {
        let (Some(first), Some(last)) = (self.pieces.first(), self.pieces.last()) else { return 0.0 };
        let t = f64::from(t);
        // Rounding may place a sample at an end slightly outside.
        let slack = f64::from(f32::EPSILON) * t.abs();
        let end = last.start + f64::from(last.length);
        if !(last.cumulative_luminance > 0.0 && t >= first.start - slack && t <= end + slack) {
            return 0.0;
        }
        let index = self.pieces.partition_point(|piece| piece.start <= t).saturating_sub(1);
        let piece = &self.pieces[index];
        let at = ((t - piece.start) / f64::from(piece.length)).clamp(0.0, 1.0);
        let (channels, count) = self.channels(index);
        let value: f64 = channels[..count].iter().map(|&(depth, sent)| density(depth, sent, at)).sum();
        (value / last.cumulative_luminance) as f32
    }

    /// Returns the optical depth and the light sent of a piece: for all channels together, or for each.
    #[inline]
    fn channels(&self, index: usize) -> ([(f64, SourceTerm); 3], usize) {
        let channel = |depth: f32, [from, to]: [f32; 2]| {
            (f64::from(depth), SourceTerm { start: f64::from(from), end: f64::from(to) })
        };
        let gray = self.pieces.len() - self.colored.len();
        if index < gray {
            let LinePiece { depth, sent, .. } = self.pieces[index];
            return ([channel(depth, sent); 3], 1);
        }
        let Channels { depth, sent } = &self.colored[index - gray];
        ([0, 1, 2].map(|k| channel(depth[k], sent[k])), 3)
    }

    fn clear(&mut self) {
        self.pieces.clear();
        self.colored.clear();
        self.pending.clear();
        (self.total, self.transmittance) = (Rgb::ZERO, Rgb::ONE);
    }
}

/// State of the walk along a line.
struct Walk {
    origin: DVec3,
    dir: DVec3,
    /// Transmittance to the line's start, by channel.
    transmittance: [f64; 3],
    total: Rgb,
    luminance: f64,
}

impl Walk {
    /// Returns the light that a leaf sends at the two ends of a stretch in it, per m.
    #[inline]
    fn source_term(&self, placed: &PlacedLeaf, start: f64, length: f32) -> [Rgb; 2] {
        let [from, slope] = placed.value_and_slope(self.origin + self.dir * start, self.dir);
        let scattering = placed.leaf.sigma_s * placed.leaf.directional_factor(-self.dir.as_vec3a());
        [from, from + slope * length].map(|mean| scattering * mean.max(Rgb::ZERO))
    }

    /// Adds the stretch of the line in a leaf, if all fog so far is gray.
    #[inline]
    fn add_gray(&mut self, placed: &PlacedLeaf, start: f64, end: f64, pieces: &mut Vec<LinePiece>) {
        let length = end - start;
        let sent = self.source_term(placed, start, length as f32);
        let through = self.transmittance[0];
        let depth = f64::from(placed.leaf.sigma_t.x) * length;
        let ([first, second], passes) = endpoint_weights(depth);
        let [from, to] = sent.map(|color| color.dot(LUMINANCE_WEIGHTS) * through as f32);
        self.luminance += length * (f64::from(from) * first + f64::from(to) * second);
        let scale = through * length;
        self.total += sent[0] * ((first * scale) as f32) + sent[1] * ((second * scale) as f32);
        self.transmittance[0] = through * passes;
        pieces.push(LinePiece {
            start,
            cumulative_luminance: self.luminance,
            length: length as f32,
            depth: depth as f32,
            sent: [from, to],
        });
    }

    /// Adds the stretch of the line in a leaf, by channel.
    fn add_colored(&mut self, placed: &PlacedLeaf, start: f64, end: f64, line: &mut FogLine) {
        let length = end - start;
        let sent = self.source_term(placed, start, length as f32);
        let mut channels = Channels { depth: [0.0; 3], sent: [[0.0; 2]; 3] };
        for k in 0..3 {
            let through = self.transmittance[k];
            let depth = f64::from(placed.leaf.sigma_t[k]) * length;
            let ([first, second], passes) = endpoint_weights(depth);
            let [from, to] = sent.map(|color| f64::from(color[k]) * through);
            let arrives = length * (from * first + to * second);
            self.total[k] += arrives as f32;
            let weight = f64::from(LUMINANCE_WEIGHTS[k]);
            self.luminance += weight * arrives;
            channels.depth[k] = depth as f32;
            channels.sent[k] = [from, to].map(|value| (weight * value) as f32);
            self.transmittance[k] = through * passes;
        }
        line.colored.push(channels);
        line.pieces.push(LinePiece {
            start,
            cumulative_luminance: self.luminance,
            length: length as f32,
            depth: 0.0,
            sent: [0.0; 2],
        });
    }
}

impl FogTree {
    /// Computes the light that the fog sends along a line, as in [`FogLine`]. Outside of the boxes there is no fog.
    /// - `origin`: prepared frame, m;
    /// - `dir`: unit;
    /// - `t0`, `t1`: distances of the line's start and end from the origin, m;
    /// - `line`: result. Its old contents are lost, its buffers are reused.
    pub fn radiance_along(&self, origin: Vec3A, dir: Vec3A, t0: f32, t1: f32, line: &mut FogLine) {
        line.clear();
        if self.nodes.is_empty() {
            return;
        }
        let (o, d) = (origin.as_dvec3(), dir.as_dvec3());
        let Some((mut start, mut end)) = self.clip(o, d, [t0, t1].map(f64::from)) else { return };
        let inverse = d.recip().to_array();
        let (from, way) = (o.to_array(), d.to_array());
        let mut walk = Walk { origin: o, dir: d, transmittance: [1.0; 3], total: Rgb::ZERO, luminance: 0.0 };
        let mut gray = true;
        let mut node = 0;
        loop {
            match self.nodes[node as usize].kind() {
                NodeKind::Split { axis, at, low } => {
                    let at = f64::from(at);
                    if way[axis] == 0.0 {
                        node = low + u32::from(from[axis] >= at);
                        continue;
                    }
                    let later = u32::from(way[axis] > 0.0);
                    let crossing = (at - from[axis]) * inverse[axis];
                    if crossing >= end {
                        node = low + (1 - later);
                    } else if crossing > start {
                        line.pending.push((low + later, end));
                        node = low + (1 - later);
                        end = crossing;
                    } else {
                        node = low + later;
                    }
                }
                NodeKind::Leaf(index) => {
                    if end > start {
                        let placed = &self.leaves[index as usize];
                        if gray && !placed.is_gray {
                            gray = false;
                            walk.transmittance = [walk.transmittance[0]; 3];
                        }
                        if gray {
                            walk.add_gray(placed, start, end, &mut line.pieces);
                        } else {
                            walk.add_colored(placed, start, end, line);
                        }
                        start = end;
                    }
                    let Some((next, until)) = line.pending.pop() else { break };
                    (node, end) = (next, until);
                }
            }
        }
        line.total = walk.total;
        let through = if gray { [walk.transmittance[0]; 3] } else { walk.transmittance };
        line.transmittance = Rgb::from_array(through.map(|x| x as f32));
    }

    /// Returns the part of a line in the bounding box; `None` if there is none.
    fn clip(&self, origin: DVec3, dir: DVec3, [mut start, mut end]: [f64; 2]) -> Option<(f64, f64)> {
        let (min, max) = (self.min.as_dvec3(), self.max.as_dvec3());
        for axis in 0..3 {
            if dir[axis] == 0.0 {
                if origin[axis] < min[axis] || origin[axis] > max[axis] {
                    return None;
                }
                continue;
            }
            let [a, b] = [min, max].map(|corner| (corner[axis] - origin[axis]) / dir[axis]);
            (start, end) = (start.max(a.min(b)), end.min(a.max(b)));
        }
        // Not `>=`: a NaN must give no part, either.
        (start < end && end.is_finite() && start.is_finite()).then_some((start, end))
    }
}
