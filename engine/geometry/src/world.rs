//! Placed instances, and the ray queries on them.

use crate::{
    Aabb, Blas, Hit, Interaction, Pose, Ray, RayLanes,
    interaction::triangle_interaction,
    kernel::{
        AnyLeaf, ClosestHit, Kernel, Level, LocalRay, LocalRays, NearestLeaf, Simd, blas_closest, blas_occluded,
        traverse_any, traverse_nearest_first,
    },
    motion::{Motion, Placement},
    tree::{Child, LeafRule, Tree, WIDTH, collapse},
};
use femc_math::{
    gamma,
    glam::{Affine3A, Vec3A},
};
use femc_simd::lanes_of;
use std::sync::Arc;

/// A placed group.
#[derive(Clone, Debug)]
pub struct InstanceInput {
    /// Surfaces of the group.
    pub blas: Arc<Blas>,
    /// Pose of the group.
    pub pose: Pose,
}

#[derive(Clone, Debug)]
enum InstanceTransform {
    Identity,
    Fixed(Placement),
    Moving(Motion),
}

#[derive(Clone, Debug)]
struct Instance {
    blas: Arc<Blas>,
    transform: InstanceTransform,
}

/// All surfaces of a frame. Immutable; queries may come from any thread.
#[derive(Clone, Debug)]
pub struct World {
    instances: Vec<Instance>,
    /// Tree over the instances; its leaves are instance indices.
    top: Tree,
    /// Whether an instance moves during the shutter.
    moves: bool,
    level: Level,
}

impl World {
    /// Builds the tree over the instances. Their own trees are shared, not rebuilt.
    pub fn build(instances: Vec<InstanceInput>) -> Self {
        let instances: Vec<Instance> = instances
            .into_iter()
            .map(|InstanceInput { blas, pose }| {
                let transform = match pose {
                    Pose::Moving(poses) if poses.len() > 1 => InstanceTransform::Moving(Motion::new(&poses)),
                    Pose::Moving(poses) => {
                        InstanceTransform::fixed(poses.first().copied().unwrap_or(Affine3A::IDENTITY))
                    }
                    Pose::Fixed(pose) => InstanceTransform::fixed(pose),
                };
                Instance { blas, transform }
            })
            .collect();
        let (mut boxes, mut indices) = (Vec::new(), Vec::new());
        for (index, instance) in instances.iter().enumerate() {
            let bounds = instance.bounds();
            if !bounds.is_empty() && bounds.min.is_finite() && bounds.max.is_finite() {
                boxes.push(bounds);
                indices.push(index);
            }
        }
        let top = collapse(&boxes, &mut OneInstance(&indices));
        let moves = instances.iter().any(|instance| matches!(instance.transform, InstanceTransform::Moving(_)));
        Self { instances, top, moves, level: Level::detect() }
    }

    /// Returns the world with the portable kernels, for any processor, to test that both kinds of kernels agree.
    #[cfg(test)]
    pub(crate) fn portable(mut self) -> Self {
        self.level = Level::PORTABLE;
        self
    }

    /// Returns whether an instance moves during the shutter.
    #[inline]
    pub fn moves(&self) -> bool {
        self.moves
    }

    /// Returns the bounds of all surfaces that can be hit during the shutter; empty if there are none.
    pub fn bounds(&self) -> Aabb {
        self.top.bounds
    }

    /// Returns the closest hit with t in (0, `t_max`). Among equally close hits, the lowest (instance, primitive) wins.
    #[inline]
    pub fn intersect(&self, ray: &Ray) -> Option<Hit> {
        let mut hit = match self.single_blas() {
            Some(blas) => self.level.run(SingleBlasClosest { blas, ray }),
            None => self.level.run(ClosestHitKernel { world: self, ray }),
        }?;
        if self.is_shape(&hit) {
            self.find_parameters(ray, &mut hit);
        }
        Some(hit)
    }

    /// Finds the closest hits of several rays, as [`Self::intersect`] does. Returns the lanes with a hit.
    /// - `used`: lanes with a ray;
    /// - `hits`: receives the hits.
    pub fn intersect_lanes(&self, rays: RayLanes<'_>, used: u32, hits: &mut [Hit; WIDTH]) -> u32 {
        let Some(blas) = self.single_blas() else {
            return set_lanes(used, |lane| {
                let found = self.intersect(&rays.ray(lane));
                hits[lane] = found.unwrap_or(hits[lane]);
                found.is_some()
            });
        };
        let found = self.level.run(ClosestInLanes { blas, rays, used, hits });
        for lane in lanes_of(found) {
            if self.is_shape(&hits[lane]) {
                self.find_parameters(&rays.ray(lane), &mut hits[lane]);
            }
        }
        found
    }

    /// Checks whether a hit is on an analytic shape.
    #[inline(always)]
    fn is_shape(&self, hit: &Hit) -> bool {
        hit.primitive as usize >= self.instances[hit.instance as usize].blas.triangles.len()
    }

    /// Computes the parameters of a hit on an analytic shape.
    #[inline(never)]
    fn find_parameters(&self, ray: &Ray, hit: &mut Hit) {
        let blas = &self.instances[hit.instance as usize].blas;
        let place = self.placement(hit.instance, ray.time);
        let local = place.map_or(ray.at(hit.t), |p| p.to_local.transform_point3a(ray.at(hit.t)));
        let uv = blas.quadrics[hit.primitive as usize - blas.triangles.len()].nearest(local.as_dvec3()).uv;
        (hit.u, hit.v) = (uv[0] as f32, uv[1] as f32);
    }

    /// Returns the lanes of rays that hit anything, as [`Self::occluded`] does.
    /// - `used`: lanes with a ray.
    pub fn occluded_lanes(&self, rays: RayLanes<'_>, used: u32) -> u32 {
        match self.single_blas() {
            Some(blas) => self.level.run(OcclusionInLanes { blas, rays, used }),
            None => set_lanes(used, |lane| self.occluded(&rays.ray(lane))),
        }
    }

    /// Returns whether anything is hit with t in (0, `t_max`).
    #[inline]
    pub fn occluded(&self, ray: &Ray) -> bool {
        match self.single_blas() {
            Some(blas) => self.level.run(SingleBlasOcclusion { blas, ray }),
            None => self.level.run(OcclusionKernel { world: self, ray }),
        }
    }

    /// Returns the surface point of `hit`, which `intersect` returned for `ray`.
    #[inline]
    pub fn interaction(&self, ray: &Ray, hit: &Hit) -> Interaction {
        let Instance { blas, transform } = &self.instances[hit.instance as usize];
        match (transform, blas.triangles.get(hit.primitive as usize)) {
            (InstanceTransform::Identity, Some(vertices)) => {
                triangle_interaction(&vertices.map(Vec3A::from_array), hit.u, hit.v)
            }
            _ => self.placed_interaction(ray, hit),
        }
    }

    /// Returns the vertices of the triangle of `hit`, m, if its instance has the world's frame.
    #[inline(always)]
    pub fn world_triangle(&self, hit: &Hit) -> Option<&[[f32; 3]; 3]> {
        let Instance { blas, transform } = &self.instances[hit.instance as usize];
        match transform {
            InstanceTransform::Identity => blas.triangles.get(hit.primitive as usize),
            InstanceTransform::Fixed(_) | InstanceTransform::Moving(_) => None,
        }
    }

    #[inline(never)]
    fn placed_interaction(&self, ray: &Ray, hit: &Hit) -> Interaction {
        let blas = &self.instances[hit.instance as usize].blas;
        let place = self.placement(hit.instance, ray.time);
        let local = match blas.triangles.get(hit.primitive as usize) {
            Some(vertices) => triangle_interaction(&vertices.map(Vec3A::from_array), hit.u, hit.v),
            None => {
                let quadric = &blas.quadrics[hit.primitive as usize - blas.triangles.len()];
                let near = ray.origin.as_dvec3() + ray.dir.as_dvec3() * f64::from(hit.t);
                let near = match &place {
                    Some(place) => place.to_local.transform_point3a(near.as_vec3a()).as_dvec3(),
                    None => near,
                };
                let point = quadric.nearest(near);
                let position = point.position.as_vec3a();
                let bounds = quadric.bounds();
                // Rounding to f32, plus f64 arithmetic with the shape's largest coordinate.
                let error = position.abs() * gamma(2) + bounds.min.abs().max(bounds.max.abs()).max_element() * 1e-12;
                Interaction { position, error, normal: point.normal.as_vec3a(), uv: [hit.u, hit.v] }
            }
        };
        match place {
            Some(place) => local.transformed(&place.to_world, &place.to_local),
            None => local,
        }
    }

    /// Returns the map from an instance's frame to the world's at a shutter time.
    pub fn pose_at(&self, instance: u32, time: f32) -> Affine3A {
        match &self.instances[instance as usize].transform {
            InstanceTransform::Identity => Affine3A::IDENTITY,
            InstanceTransform::Fixed(place) => place.to_world,
            InstanceTransform::Moving(motion) => motion.pose_at(time),
        }
    }

    /// Returns a box in the world's frame around `local`, a box in an instance's frame, for all times of the shutter.
    pub fn swept_bounds(&self, instance: u32, local: &Aabb) -> Aabb {
        self.instances[instance as usize].transform.swept_bounds(local)
    }

    fn placement(&self, instance: u32, time: f32) -> Option<Placement> {
        match &self.instances[instance as usize].transform {
            InstanceTransform::Identity => None,
            InstanceTransform::Fixed(place) => Some(*place),
            InstanceTransform::Moving(motion) => Some(motion.placement_at(time)),
        }
    }

    /// Returns the only instance, if there is just one and its pose is the identity. Then the top level is skipped.
    #[inline(always)]
    fn single_blas(&self) -> Option<&Blas> {
        match &*self.instances {
            [Instance { blas, transform: InstanceTransform::Identity }] => Some(blas),
            _ => None,
        }
    }
}

impl InstanceTransform {
    fn fixed(pose: Affine3A) -> Self {
        if pose == Affine3A::IDENTITY { Self::Identity } else { Self::Fixed(Placement::new(pose)) }
    }

    fn swept_bounds(&self, local: &Aabb) -> Aabb {
        match self {
            Self::Identity => *local,
            Self::Fixed(place) => local.transformed(&place.to_world),
            Self::Moving(motion) => motion.swept_bounds(local),
        }
    }
}

impl Instance {
    fn bounds(&self) -> Aabb {
        self.transform.swept_bounds(&self.blas.bounds())
    }

    /// Returns the ray in the instance's frame.
    #[inline(always)]
    fn local_ray(&self, ray: &Ray) -> LocalRay {
        match &self.transform {
            InstanceTransform::Identity => LocalRay::new(ray.origin, ray.dir),
            InstanceTransform::Fixed(place) => {
                LocalRay::transformed(ray.origin, ray.dir, &place.to_local, place.mirrored)
            }
            InstanceTransform::Moving(motion) => {
                let place = motion.placement_at(ray.time);
                LocalRay::transformed(ray.origin, ray.dir, &place.to_local, place.mirrored)
            }
        }
    }
}

/// Leaves of the top level: one instance each, at about the cost of a few nodes.
struct OneInstance<'a>(&'a [usize]);

impl LeafRule for OneInstance<'_> {
    fn may_share(&self, _: u32, _: u32) -> bool {
        false
    }
    fn max_primitives(&self, _: u32) -> usize {
        1
    }
    fn cost(&self, _: u32, _: usize) -> f32 {
        5.0
    }
    fn leaf(&mut self, items: &[u32]) -> Child {
        Child::first_kind(self.0[items[0] as usize])
    }
    fn clear(&mut self) {}
}

/// Returns the lanes of a mask that meet a condition.
fn set_lanes(used: u32, mut condition: impl FnMut(usize) -> bool) -> u32 {
    lanes_of(used).fold(0, |set, lane| set | u32::from(condition(lane)) << lane)
}

/// Closest hits in the only instance.
struct ClosestInLanes<'a> {
    blas: &'a Blas,
    rays: RayLanes<'a>,
    used: u32,
    hits: &'a mut [Hit; WIDTH],
}

impl Kernel for ClosestInLanes<'_> {
    type Output = u32;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> u32 {
        let Self { blas, rays, mut used, hits } = self;
        let local_rays = LocalRays::new(simd, rays.origin, rays.dir);
        let mut found = 0;
        while used != 0 {
            let lane = used.trailing_zeros() as usize % WIDTH;
            used &= used - 1;
            let mut best = ClosestHit::new(rays.t_max.0[lane]);
            if blas_closest(simd, blas, local_rays.ray(lane), &mut best) {
                hits[lane] = best.hit(0);
                found |= 1 << lane;
            }
        }
        found
    }
}

/// Occlusion by the only instance.
struct OcclusionInLanes<'a> {
    blas: &'a Blas,
    rays: RayLanes<'a>,
    used: u32,
}

impl Kernel for OcclusionInLanes<'_> {
    type Output = u32;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> u32 {
        let Self { blas, rays, mut used } = self;
        let local_rays = LocalRays::new(simd, rays.origin, rays.dir);
        let mut occluded = 0;
        while used != 0 {
            let lane = used.trailing_zeros() as usize % WIDTH;
            used &= used - 1;
            let hit = blas_occluded(simd, blas, local_rays.ray(lane), rays.t_max.0[lane]);
            occluded |= u32::from(hit) << lane;
        }
        occluded
    }
}

struct SingleBlasClosest<'a> {
    blas: &'a Blas,
    ray: &'a Ray,
}

impl Kernel for SingleBlasClosest<'_> {
    type Output = Option<Hit>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Option<Hit> {
        let mut best = ClosestHit::new(self.ray.t_max);
        let local_ray = LocalRay::new(self.ray.origin, self.ray.dir);
        if blas_closest(simd, self.blas, &local_ray, &mut best) { Some(best.hit(0)) } else { None }
    }
}

struct ClosestHitKernel<'a> {
    world: &'a World,
    ray: &'a Ray,
}

impl Kernel for ClosestHitKernel<'_> {
    type Output = Option<Hit>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Option<Hit> {
        let Self { world, ray } = self;
        let mut best = ClosestHit::new(ray.t_max);
        let local_ray = LocalRay::new(ray.origin, ray.dir);
        let mut leaf = ClosestInstance { simd, world, ray, best: &mut best, instance: u32::MAX };
        traverse_nearest_first(simd, &world.top, &local_ray, ray.t_max, &mut leaf);
        let instance = leaf.instance;
        if instance == u32::MAX { None } else { Some(best.hit(instance)) }
    }
}

struct ClosestInstance<'a, S> {
    simd: S,
    world: &'a World,
    ray: &'a Ray,
    best: &'a mut ClosestHit,
    instance: u32,
}

impl<S: Simd> NearestLeaf for ClosestInstance<'_, S> {
    #[inline(always)]
    fn visit(&mut self, leaf: Child) -> f32 {
        let index = leaf.index();
        let instance = &self.world.instances[index];
        let local_ray = instance.local_ray(self.ray);
        // At equal distances a lower instance wins, regardless of the primitive; nothing wins at `t_max`.
        self.best.tie_limit = if self.instance == u32::MAX || index as u32 > self.instance { 0 } else { u32::MAX };
        if blas_closest(self.simd, &instance.blas, &local_ray, self.best) {
            self.instance = index as u32;
        }
        self.best.t
    }
}

struct SingleBlasOcclusion<'a> {
    blas: &'a Blas,
    ray: &'a Ray,
}

impl Kernel for SingleBlasOcclusion<'_> {
    type Output = bool;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> bool {
        let local_ray = LocalRay::new(self.ray.origin, self.ray.dir);
        blas_occluded(simd, self.blas, &local_ray, self.ray.t_max)
    }
}

struct OcclusionKernel<'a> {
    world: &'a World,
    ray: &'a Ray,
}

impl Kernel for OcclusionKernel<'_> {
    type Output = bool;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> bool {
        let Self { world, ray } = self;
        let local_ray = LocalRay::new(ray.origin, ray.dir);
        traverse_any(simd, &world.top, &local_ray, ray.t_max, &mut AnyInstance { simd, world, ray })
    }
}

struct AnyInstance<'a, S> {
    simd: S,
    world: &'a World,
    ray: &'a Ray,
}

impl<S: Simd> AnyLeaf for AnyInstance<'_, S> {
    #[inline(always)]
    fn visit(&mut self, leaf: Child) -> bool {
        let instance = &self.world.instances[leaf.index()];
        blas_occluded(self.simd, &instance.blas, &instance.local_ray(self.ray), self.ray.t_max)
    }
}
