//! Tests of the leaves of a bottom-level tree: blocks of eight triangles, and shapes.

use super::{
    local_ray::RayData,
    traversal::{self, AnyLeaf, NearestLeaf},
};
use crate::{
    Hit,
    blas::{Blas, Block, Shape},
    shape::Span,
    tree::{Child, Lanes, WIDTH},
};
use femc_math::glam::Vec3A;
use femc_simd::{Simd, Vector};

/// The closest hit so far.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ClosestHit {
    pub t: f32,
    pub primitive: u32,
    pub u: f32,
    pub v: f32,
    /// Primitives below this index win at equal `t`.
    pub tie_limit: u32,
}

impl ClosestHit {
    /// Starts without a hit. Only hits before `t_max` count.
    #[inline(always)]
    pub fn new(t_max: f32) -> Self {
        Self { t: t_max, primitive: u32::MAX, u: 0.0, v: 0.0, tie_limit: 0 }
    }

    /// Returns the hit, in `instance`.
    #[inline(always)]
    pub fn hit(&self, instance: u32) -> Hit {
        Hit { t: self.t, instance, primitive: self.primitive, u: self.u, v: self.v }
    }

    #[inline(always)]
    fn admits(&self, t: f32, primitive: u32) -> bool {
        t < self.t || (t == self.t && primitive < self.tie_limit)
    }
}

/// Improves `best` with the closest hit in `blas`. Returns whether there was one.
#[inline(always)]
pub(crate) fn blas_closest<S: Simd>(simd: S, blas: &Blas, ray: impl RayData, best: &mut ClosestHit) -> bool {
    let before = best.primitive;
    best.primitive = u32::MAX;
    traversal::traverse_nearest_first(simd, &blas.tree, ray, best.t, &mut ClosestVisitor { simd, blas, ray, best });
    let improved = best.primitive != u32::MAX;
    if !improved {
        best.primitive = before;
    }
    improved
}

/// Returns whether anything in `blas` is hit before `t_max`.
#[inline(always)]
pub(crate) fn blas_occluded<S: Simd>(simd: S, blas: &Blas, ray: impl RayData, t_max: f32) -> bool {
    traversal::traverse_any(simd, &blas.tree, ray, t_max, &mut OcclusionVisitor { simd, blas, ray, t_max })
}

struct ClosestVisitor<'a, S, R> {
    simd: S,
    blas: &'a Blas,
    ray: R,
    best: &'a mut ClosestHit,
}

impl<S: Simd, R: RayData> NearestLeaf for ClosestVisitor<'_, S, R> {
    #[inline(always)]
    fn visit(&mut self, leaf: Child) -> f32 {
        if leaf.is_second_kind() {
            let shape = &self.blas.shapes[leaf.index()];
            if let Some(t) = shape_distance(shape, self.ray.vectors(), self.ray.mirrored(), self.best.t)
                && self.best.admits(t, shape.primitive)
            {
                *self.best = ClosestHit { t, primitive: shape.primitive, u: 0.0, v: 0.0, tie_limit: shape.primitive };
            }
        } else {
            let block = &self.blas.blocks[leaf.index()];
            if let Some(found) = BlockCrossings::find(self.simd, block, self.ray, self.best.t) {
                found.update_closest(block, self.ray, self.best);
            }
        }
        self.best.t
    }
}

struct OcclusionVisitor<'a, S, R> {
    simd: S,
    blas: &'a Blas,
    ray: R,
    t_max: f32,
}

impl<S: Simd, R: RayData> AnyLeaf for OcclusionVisitor<'_, S, R> {
    #[inline(always)]
    fn visit(&mut self, leaf: Child) -> bool {
        if leaf.is_second_kind() {
            let shape = &self.blas.shapes[leaf.index()];
            shape_distance(shape, self.ray.vectors(), self.ray.mirrored(), self.t_max).is_some_and(|t| t < self.t_max)
        } else {
            let block = &self.blas.blocks[leaf.index()];
            match BlockCrossings::find(self.simd, block, self.ray, self.t_max) {
                Some(found) => found.any_before(self.simd, self.t_max),
                None => false,
            }
        }
    }
}

/// Returns the distance of the first valid crossing, at most `t_max`.
/// - `vectors`: origin and direction of the ray;
/// - `mirrored`: whether the shape is seen through a map of negative determinant.
#[inline(never)]
fn shape_distance(shape: &Shape, vectors: [Vec3A; 2], mirrored: bool, t_max: f32) -> Option<f32> {
    // The end is extended so that ties are found; the caller compares in f32.
    let span = Span { from: 0.0, to: f64::from(t_max) * (1.0 + 1e-7) };
    let [origin, dir] = vectors;
    let t = shape.quadric.intersect(origin.as_dvec3(), dir.as_dvec3(), span, shape.crossings(mirrored))?;
    Some(t as f32).filter(|&t| t > 0.0 && t <= t_max)
}

/// Ray data of the watertight test: the permuted origin, and the shear.
struct ShearFrame<V> {
    origin: [V; 3],
    shear: [V; 2],
}

impl<V: Vector> ShearFrame<V> {
    /// Returns corner `i` of all triangles relative to the ray's origin, and its sheared coordinates. This is a function and not a
    /// closure, because closures are not compiled for the caller's instruction set unless they are inlined.
    #[inline(always)]
    fn corner<S: Simd<V = V>>(
        &self,
        simd: S,
        rx: &[Lanes; 4],
        ry: &[Lanes; 4],
        rz: &[Lanes; 4],
        i: usize,
    ) -> ([V; 3], V, V) {
        let x = simd.load(&rx[i]) - self.origin[0];
        let y = simd.load(&ry[i]) - self.origin[1];
        let z = simd.load(&rz[i]) - self.origin[2];
        ([x, y, z], x - self.shear[0] * z, y - self.shear[1] * z)
    }
}

/// Triangles of a block that the ray crosses, at positive distances up to the limit, from a side from which they are visible.
struct BlockCrossings<V> {
    mask: u32,
    /// Lanes with an edge function that is 0 in f32.
    on_edge: u32,
    t: V,
    /// Edge functions opposite to the three vertices.
    edges: [V; 3],
}

impl<V: Vector> BlockCrossings<V> {
    /// Tests eight triangles with the watertight test (\[woop2013\]).
    ///
    /// A sum of two rounded products has the exact sign or is 0, and the neighbor computes the same sum with the opposite sign. If
    /// the sum is 0, the test is repeated in f64, in which the products are exact. The distance is computed from the plane and not
    /// from the edge functions. Its sign is then that of `normal . (vertex - origin)` over `normal . dir`, which error bounds can
    /// guarantee even for grazing rays.
    #[inline(always)]
    fn find<S: Simd<V = V>>(simd: S, block: &Block, ray: impl RayData, t_max: f32) -> Option<Self> {
        let [kx, ky, kz] = ray.axes();
        let (rx, ry, rz) = (&block.rows[kx], &block.rows[ky], &block.rows[kz]);
        let (ox, oy, oz) = (
            simd.splat(ray.permuted_origin(0)),
            simd.splat(ray.permuted_origin(1)),
            simd.splat(ray.permuted_origin(2)),
        );
        let (sx, sy) = (simd.splat(ray.shear(0)), simd.splat(ray.shear(1)));
        let frame = ShearFrame { origin: [ox, oy, oz], shear: [sx, sy] };
        let (a, ax, ay) = frame.corner(simd, rx, ry, rz, 0);
        let (_, bx, by) = frame.corner(simd, rx, ry, rz, 1);
        let (_, cx, cy) = frame.corner(simd, rx, ry, rz, 2);
        let u = cx * by - cy * bx;
        let v = ax * cy - ay * cx;
        let w = bx * ay - by * ax;
        let zero = simd.splat(0.0);
        let (least, greatest) = (u.min(v).min(w), u.max(v).max(w));
        let inside = zero.le(least) | greatest.le(zero);
        if inside.signs() == 0 {
            return None;
        }
        let (nx, ny, nz) = (simd.load(&rx[3]), simd.load(&ry[3]), simd.load(&rz[3]));
        let (dx, dy, dz) =
            (simd.splat(ray.permuted_dir(0)), simd.splat(ray.permuted_dir(1)), simd.splat(ray.permuted_dir(2)));
        let slope = nx * dx + ny * dy + nz * dz;
        let t = (nx * a[0] + ny * a[1] + nz * a[2]) / slope;
        let in_range = zero.lt(t) & t.le(simd.splat(t_max));
        let mut mask = (inside & in_range).signs();
        if mask == 0 {
            return None;
        }
        // A mirrored frame swaps the sides.
        let from_behind = if ray.mirrored() { slope.lt(zero).signs() } else { zero.lt(slope).signs() };
        mask &= !(block.culled & from_behind);
        let edges = [u, v, w];
        let on_edge = (least.equal(zero) | greatest.equal(zero)).signs() & mask;
        if on_edge != 0 {
            mask = remove_missed_lanes(block, ray, mask, on_edge);
        }
        (mask != 0).then_some(Self { mask, on_edge, t, edges })
    }

    #[inline(always)]
    fn any_before<S: Simd<V = V>>(&self, simd: S, t_max: f32) -> bool {
        self.t.lt(simd.splat(t_max)).signs() & self.mask != 0
    }

    /// Updates `best` with the nearest crossing. Among equally near ones, the lowest primitive wins.
    #[inline(always)]
    fn update_closest(&self, block: &Block, ray: impl RayData, best: &mut ClosestHit) {
        let t = self.t.lanes().0;
        let mut taken = None;
        let mut mask = self.mask;
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize % WIDTH;
            mask &= mask - 1;
            let primitive = block.primitives[lane];
            if best.admits(t[lane], primitive) {
                *best = ClosestHit { t: t[lane], primitive, tie_limit: primitive, ..*best };
                taken = Some(lane);
            }
        }
        let Some(lane) = taken else { return };
        let exact = if self.on_edge >> lane & 1 == 1 { exact_edges(block, ray, lane) } else { None };
        let [u, v, w] = match exact {
            Some(edges) => edges,
            None => {
                let [u, v, w] = self.edges;
                [u.lanes().0[lane], v.lanes().0[lane], w.lanes().0[lane]]
            }
        };
        let sum = u + v + w;
        (best.u, best.v) = (v / sum, w / sum);
    }
}

/// Returns the mask without the lanes of `on_edge` that f64 edge functions find outside.
#[cold]
#[inline(never)]
fn remove_missed_lanes(block: &Block, ray: impl RayData, mask: u32, on_edge: u32) -> u32 {
    (0..WIDTH)
        .filter(|lane| on_edge >> lane & 1 == 1)
        .fold(mask, |mask, lane| if exact_edges(block, ray, lane).is_some() { mask } else { mask & !(1 << lane) })
}

/// Returns the edge functions of one lane with exact products, if the ray is inside or on the edge and the triangle is not seen
/// edge-on.
#[cold]
#[inline(never)]
fn exact_edges(block: &Block, ray: impl RayData, lane: usize) -> Option<[f32; 3]> {
    let [kx, ky, kz] = ray.axes();
    let corner = |i: usize| {
        let at = |k: usize| block.rows[k][i].0[lane] - ray.origin(k);
        let z = at(kz);
        (f64::from(at(kx) - ray.shear(0) * z), f64::from(at(ky) - ray.shear(1) * z))
    };
    let ((ax, ay), (bx, by), (cx, cy)) = (corner(0), corner(1), corner(2));
    let edges = [cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax];
    let inside = edges.iter().all(|&e| e >= 0.0) || edges.iter().all(|&e| e <= 0.0);
    let sum = edges[0] + edges[1] + edges[2];
    (inside && sum != 0.0).then(|| edges.map(|e| (e / sum) as f32))
}
