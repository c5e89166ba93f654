//! Compiler from groups of the description to BVHs.
//!
//! Each group that is placed by itself gets a BVH. Static groups inside it are baked in if their copies are few or small. Groups
//! that have not changed since the previous frame are reused.

use crate::duplicates::{self, Duplicates};
use crate::lights::PhotometryTables;
use femc_emission::light::{Face, Light};
use femc_geometry::{Blas, Cull, Facing as KernelFacing, Quadric as KernelShape, ShapeInput, TriangleInput};
use femc_math::elementary::double::cbrt;
use femc_math::glam::{DAffine3, DMat3, DVec3, Vec2, Vec3, Vec3A};
use femc_math::hash::combine;
use femc_math::transform::transform_normal;
use femc_scene::{Facing, Group, GroupId, Location, Luminaire, Motion, ObjectId, Scalars, Scene, Shape, Sides};
use std::collections::BTreeMap;
use std::sync::Arc;

/// "None" among `u32` indices.
pub const NONE: u32 = u32::MAX;

/// Data of a primitive that the kernels need besides its shape.
#[derive(Clone, Copy, Debug)]
pub struct Primitive {
    /// Index of the material.
    pub material: u32,
    /// Index into [`CompiledGroup::corners`], or [`NONE`].
    pub corners: u32,
    /// Index into [`CompiledGroup::emitters`], or [`NONE`].
    pub emitter: u32,
}

/// Shading data at the three corners of a triangle.
#[derive(Clone, Copy, Debug)]
pub struct Corners {
    /// Unit normals in the group's frame; zero if the file gives none.
    pub normals: [Vec3; 3],
    /// Texture coordinates.
    pub uv: [Vec2; 3],
}

/// Shape of a light source in the compiled frame.
#[derive(Clone, Copy, Debug)]
pub enum EmitterShape {
    /// One triangle.
    Triangle([DVec3; 3]),
    /// A corner and two edges. The front is on the side of their cross product.
    Parallelogram([DVec3; 3]),
    /// A curved surface.
    Curved(Shape),
    /// A luminaire with measured photometry; `to_group` maps to the compiled frame.
    Photometric(Luminaire),
}

/// A light source of a compiled group.
#[derive(Clone, Copy, Debug)]
pub struct Emitter {
    /// Shape.
    pub shape: EmitterShape,
    /// Material.
    pub material: u32,
    /// Innermost object that contains it.
    pub object: Option<ObjectId>,
    /// Location in the file.
    pub location: Location,
}

/// A group that is ready to trace.
#[derive(Debug)]
pub struct CompiledGroup {
    /// Tree over the primitives.
    pub blas: Arc<Blas>,
    /// Primitives by primitive index of the tree.
    pub primitives: Vec<Primitive>,
    /// Shading data of the triangles that have any.
    pub corners: Vec<Corners>,
    /// Surfaces that emit.
    pub emitters: Vec<Emitter>,
    /// Objects of the primitives, for messages: each entry has its first primitive; ascending.
    pub objects: Vec<(u32, Option<ObjectId>)>,
    /// Origin of the compiled frame in the group's frame, m.
    pub center: DVec3,
    /// Hash of the inputs of the compilation.
    key: u64,
}

/// A compiled group with its placement.
#[derive(Clone, Debug)]
pub struct GroupPlacement {
    /// The compiled group.
    pub compiled: Arc<CompiledGroup>,
    /// Motions from the group's frame to the world, innermost first.
    pub motions: Vec<Motion>,
    /// Whether the group was mirrored (x to -x) when it was compiled, so that its pose preserves orientation.
    pub mirrored: bool,
}

/// Compiled groups by (group, mirrored).
pub type Cache = BTreeMap<(GroupId, bool), Arc<CompiledGroup>>;

/// Properties of a material that the tracer needs: whether backs are invisible, and whether it emits.
#[derive(Clone, Copy, Debug)]
pub struct SurfaceClass {
    /// Visibility of the back.
    pub cull: Cull,
    /// Whether the surface emits.
    pub emits: bool,
}

/// Compiler that compiles and places everything that is visible at one time.
pub struct Compiler<'a> {
    scene: &'a Scene,
    scalars: &'a Scalars,
    photometry: &'a PhotometryTables,
    classes: &'a [SurfaceClass],
    hidden: Vec<bool>,
    /// World position of the prepared frame's origin, m.
    origin: DVec3,
    previous: &'a Cache,
    /// Compiled groups; the next frame's `previous`.
    pub cache: Cache,
    /// Placed groups: the result.
    pub placements: Vec<GroupPlacement>,
    primitive_counts: Vec<u64>,
    pose_at_opening: &'a dyn Fn(&Motion) -> DAffine3,
}

impl<'a> Compiler<'a> {
    /// Creates a compiler for `scene`, whose materials have `classes`. `pose` returns a motion's transform at shutter opening.
    pub fn new(
        scene: &'a Scene,
        scalars: &'a Scalars,
        photometry: &'a PhotometryTables,
        classes: &'a [SurfaceClass],
        origin: DVec3,
        previous: &'a Cache,
        pose: &'a dyn Fn(&Motion) -> DAffine3,
    ) -> Self {
        let hidden = femc_scene::objects::hidden_objects(&scalars.objects);
        let mut primitive_counts = vec![u64::MAX; scene.groups.len()];
        for g in 0..scene.groups.len() {
            count_primitives(scene, GroupId(g as u32), &mut primitive_counts);
        }
        Self {
            scene,
            scalars,
            photometry,
            classes,
            hidden,
            origin,
            previous,
            cache: Cache::new(),
            placements: Vec::new(),
            primitive_counts,
            pose_at_opening: pose,
        }
    }

    /// Compiles the world and everything placed in it.
    pub fn run(&mut self) {
        self.place_group(GroupId(0), &[], false);
    }

    fn place_group(&mut self, group: GroupId, motions: &[Motion], mirrored: bool) {
        let mut builder = Builder::default();
        let start = if mirrored { mirror_transform() } else { DAffine3::IDENTITY };
        let mut pending = Vec::new();
        self.collect_group(group, start, &mut builder, &mut pending);
        let compiled = self.compile_or_reuse(group, mirrored, &builder);
        if !compiled.primitives.is_empty() || !compiled.emitters.is_empty() {
            self.placements.push(GroupPlacement { compiled, motions: motions.to_vec(), mirrored });
        }
        for (within, child, motion) in pending {
            // `within` maps the child's parent to this group's compiled frame; this removes the mirror that it contains.
            let within = if mirrored { mirror_transform() * within } else { within };
            let mut chain = vec![motion];
            if within != DAffine3::IDENTITY {
                chain.push(Motion::fixed(within));
            }
            chain.extend_from_slice(motions);
            let flips = chain.iter().filter(|m| (self.pose_at_opening)(m).matrix3.determinant() < 0.0).count();
            self.place_group(child, &chain, flips % 2 == 1);
        }
    }

    /// Adds the surfaces of `group` and of the groups that are baked into it. Leaves the other groups in `pending`.
    fn collect_group(
        &self,
        group: GroupId,
        to_compiled: DAffine3,
        builder: &mut Builder,
        pending: &mut Vec<(DAffine3, GroupId, Motion)>,
    ) {
        let source = &self.scene.groups[group.index()];
        builder.sources.push((group, to_compiled));
        let mut copies_of = BTreeMap::<GroupId, u64>::new();
        source.instances.iter().for_each(|i| *copies_of.entry(i.group).or_default() += 1);
        for instance in &source.instances {
            let copies = copies_of[&instance.group];
            let size = self.primitive_counts[instance.group.index()];
            match instance.motion.as_static() {
                Some(pose) if copies == 1 || size <= 8 || size.saturating_mul(copies) <= 20_000 => {
                    self.collect_group(instance.group, to_compiled * pose, builder, pending);
                }
                _ => pending.push((to_compiled, instance.group, instance.motion.clone())),
            }
        }
    }

    fn is_visible(&self, object: Option<ObjectId>) -> bool {
        object.is_none_or(|o| !self.hidden[o.index()])
    }

    fn compile_or_reuse(&mut self, group: GroupId, mirrored: bool, builder: &Builder) -> Arc<CompiledGroup> {
        if let Some(done) = self.cache.get(&(group, mirrored)) {
            return done.clone();
        }
        let key = self.input_key(group, builder);
        if let Some(old) = self.previous.get(&(group, mirrored))
            && old.key == key
        {
            self.cache.insert((group, mirrored), old.clone());
            return old.clone();
        }
        let center = if group == GroupId(0) { self.origin } else { self.center(builder) };
        let compiled = Arc::new(self.compile(builder, center, key));
        self.cache.insert((group, mirrored), compiled.clone());
        compiled
    }

    /// Returns a hash of the inputs that affect the compiled form besides the description itself: visibility, culling, emission,
    /// and for the world the origin.
    fn input_key(&self, group: GroupId, builder: &Builder) -> u64 {
        let mut key = 0u64;
        let mut add = |word: u64| key = combine(&[key, word]);
        if group == GroupId(0) {
            self.origin.to_array().iter().for_each(|coordinate| add(coordinate.to_bits()));
        }
        let word = |visible: bool, material: u32| {
            let class = self.classes[material as usize];
            u64::from(visible) | u64::from(class.cull == Cull::Back) << 1 | u64::from(class.emits) << 2
        };
        for (group, _) in &builder.sources {
            let source = &self.scene.groups[group.index()];
            source.faces.iter().for_each(|f| add(word(self.is_visible(f.object), f.material.0)));
            source.quadrics.iter().for_each(|q| add(word(self.is_visible(q.object), q.material.0)));
            for luminaire in &self.scalars.luminaires[group.index()] {
                add(u64::from(self.is_visible(luminaire.object)));
                add(luminaire.multiplier.to_bits());
            }
        }
        key
    }

    /// Compiles the collected surfaces.
    ///
    /// `center`: origin of the compiled frame. For the world it is the prepared frame's own origin, so its pose is the identity.
    /// Then nothing is rounded twice, and the tracer needs no top level.
    fn compile(&self, builder: &Builder, center: DVec3, key: u64) -> CompiledGroup {
        let mut out = Output::default();
        for (group, to_compiled) in &builder.sources {
            let to_local = DAffine3::from_translation(-center) * *to_compiled;
            let source = &self.scene.groups[group.index()];
            self.add_faces(source, &to_local, &mut out);
            self.add_quadrics(source, &to_local, &mut out);
        }
        for (group, to_compiled) in &builder.sources {
            let to_local = DAffine3::from_translation(-center) * *to_compiled;
            let luminaires = &self.scalars.luminaires[group.index()];
            for luminaire in luminaires.iter().filter(|l| self.is_visible(l.object)) {
                self.add_luminaire(&Luminaire { to_group: to_local * luminaire.to_group, ..*luminaire }, &mut out);
            }
        }
        // Shapes follow all triangles in primitive order.
        let triangles = out.primitives.len() as u32;
        out.primitives.append(&mut out.shape_primitives);
        out.objects.extend(out.shape_objects.iter().map(|&(first, object)| (triangles + first, object)));
        let Output { primitives, corners, emitters, objects, .. } = out;
        let blas = Arc::new(Blas::build(out.triangles, out.shapes));
        CompiledGroup { blas, primitives, corners, emitters, objects, center, key }
    }

    /// Returns a round point near the middle of the compiled surfaces, so that their coordinates are small. Returns zero if they
    /// are small anyway.
    fn center(&self, builder: &Builder) -> DVec3 {
        let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for (group, to_compiled) in &builder.sources {
            for place in self.scene.groups[group.index()].positions() {
                let p = to_compiled.transform_point3(place);
                (min, max) = (min.min(p), max.max(p));
            }
        }
        if min.x > max.x {
            return DVec3::ZERO;
        }
        (0.5 * (min + max)).round()
    }

    fn add_faces(&self, source: &Group, to_local: &DAffine3, out: &mut Output) {
        let sides = |material: femc_scene::MaterialId| self.scalars.materials[material.index()].sides;
        for face in source.faces.iter().filter(|f| self.is_visible(f.object)) {
            let first = face.first_triangle as usize;
            let triangles = &source.triangles[first..first + face.triangle_count as usize];
            let material = face.material.0;
            let class = self.classes[face.material.index()];
            let textured = {
                let m = &self.scalars.materials[face.material.index()];
                m.map_rd.is_some() || m.map_ed.is_some() || m.map_n.is_some()
            };
            start_object(&mut out.objects, out.primitives.len(), face.object);
            let (object, location) = (face.object, face.location);
            let pair = if class.emits && !textured { parallelogram(source, triangles) } else { None };
            let shared = pair.map(|[o, a, b]| {
                let q = to_local.transform_point3(o);
                let [a, b] = [a, b].map(|edge| to_local.transform_vector3(edge));
                let corners = [q, q + a, q + b, q + a + b].map(|p| p.as_vec3a());
                let surface = duplicates::flat_key(&corners, a.cross(b).as_vec3a(), sides(face.material));
                let shape = EmitterShape::Parallelogram([q, a, b]);
                out.emitter(Emitter { shape, material, object, location }, surface)
            });
            for triangle in triangles {
                let corner = triangle.map(|v| source.vertices[v as usize]);
                let p = corner.map(|v| to_local.transform_point3(v.position));
                let emitter = match (shared, class.emits) {
                    (Some(shared), _) => shared,
                    (None, true) => {
                        let normal = (p[1] - p[0]).cross(p[2] - p[0]).as_vec3a();
                        let mut surface = duplicates::flat_key(&p.map(|p| p.as_vec3a()), normal, sides(face.material));
                        if textured {
                            // Twins may have different texture coordinates, so their number is part of the key.
                            surface.push(out.emitters.len() as u32);
                        }
                        out.emitter(Emitter { shape: EmitterShape::Triangle(p), material, object, location }, surface)
                    }
                    (None, false) => NONE,
                };
                let corners = if corner.iter().any(|v| v.normal.is_some() || v.uv.is_some()) {
                    let normals =
                        corner.map(|v| v.normal.map_or(Vec3::ZERO, |n| transform_normal(to_local, n).as_vec3()));
                    let uv = corner.map(|v| v.uv.map_or(Vec2::ZERO, |uv| uv.as_vec2()));
                    out.corners.push(Corners { normals, uv });
                    out.corners.len() as u32 - 1
                } else {
                    NONE
                };
                out.triangles.push(TriangleInput { vertices: p.map(|p| p.as_vec3a()), cull: class.cull });
                out.primitives.push(Primitive { material, corners, emitter });
            }
        }
    }

    fn add_quadrics(&self, source: &Group, to_local: &DAffine3, out: &mut Output) {
        for quadric in source.quadrics.iter().filter(|q| self.is_visible(q.object)) {
            let class = self.classes[quadric.material.index()];
            let shape = transform_shape(&quadric.shape, to_local);
            let material = quadric.material.0;
            let (object, location) = (quadric.object, quadric.location);
            start_object(&mut out.shape_objects, out.shape_primitives.len(), object);
            let emitter = if class.emits {
                let sides = self.scalars.materials[quadric.material.index()].sides;
                let surface = duplicates::curved_key(&kernel_shape(&shape), sides);
                out.emitter(Emitter { shape: EmitterShape::Curved(shape), material, object, location }, surface)
            } else {
                NONE
            };
            out.shapes.push(ShapeInput { shape: kernel_shape(&shape), cull: class.cull });
            out.shape_primitives.push(Primitive { material, corners: NONE, emitter });
        }
    }

    /// Adds a luminaire: the faces of its opening, with a black material under their emission. A point luminaire has nothing to
    /// hit.
    fn add_luminaire(&self, luminaire: &Luminaire, out: &mut Output) {
        let emitter = out.emitters.len() as u32;
        let material = self.scene.materials.len() as u32;
        let (object, location) = (luminaire.object, luminaire.location);
        out.emitters.push(Emitter { shape: EmitterShape::Photometric(*luminaire), material, object, location });
        let light = self.photometry.light(luminaire, &luminaire.to_group);
        let Light::PhotometricSolid(solid) = light else { return };
        let primitive = Primitive { material, corners: NONE, emitter };
        start_object(&mut out.objects, out.primitives.len(), object);
        start_object(&mut out.shape_objects, out.shape_primitives.len(), object);
        for face in solid.faces() {
            match face {
                Face::Parallelogram { origin, edge_u, edge_v } => {
                    let far = origin + edge_u + edge_v;
                    for vertices in [[origin, origin + edge_u, far], [origin, far, origin + edge_v]] {
                        out.triangles.push(TriangleInput { vertices, cull: Cull::None });
                        out.primitives.push(primitive);
                    }
                }
                curved => {
                    out.shapes.push(ShapeInput { shape: face_shape(&curved), cull: Cull::None });
                    out.shape_primitives.push(primitive);
                }
            }
        }
    }
}

/// Groups, with their maps to the compiled frame, that go into one compiled group.
#[derive(Default)]
struct Builder {
    sources: Vec<(GroupId, DAffine3)>,
}

#[derive(Default)]
struct Output {
    triangles: Vec<TriangleInput>,
    shapes: Vec<ShapeInput>,
    primitives: Vec<Primitive>,
    shape_primitives: Vec<Primitive>,
    corners: Vec<Corners>,
    emitters: Vec<Emitter>,
    objects: Vec<(u32, Option<ObjectId>)>,
    shape_objects: Vec<(u32, Option<ObjectId>)>,
    duplicates: Duplicates,
}

impl Output {
    /// Returns the index of a surface's emitter. A twin of an earlier surface shares its emitter.
    fn emitter(&mut self, emitter: Emitter, surface: Vec<u32>) -> u32 {
        let fresh = self.emitters.len() as u32;
        let index = self.duplicates.get_or_insert(emitter.material, surface, fresh);
        if index == fresh {
            self.emitters.push(emitter);
        }
        index
    }
}

/// Records that primitives from `first` on belong to `object`.
fn start_object(objects: &mut Vec<(u32, Option<ObjectId>)>, first: usize, object: Option<ObjectId>) {
    if objects.last().is_none_or(|(_, latest)| *latest != object) {
        objects.push((first as u32, object));
    }
}

/// Returns the number of primitives of a group including everything static in it, counted once each.
fn count_primitives(scene: &Scene, group: GroupId, sizes: &mut [u64]) -> u64 {
    if sizes[group.index()] != u64::MAX {
        return sizes[group.index()];
    }
    let source = &scene.groups[group.index()];
    let mut size = (source.triangles.len() + source.quadrics.len() + source.luminaires.len()) as u64;
    for instance in &source.instances {
        size = size.saturating_add(count_primitives(scene, instance.group, sizes)).min(u64::MAX - 1);
    }
    sizes[group.index()] = size;
    size
}

/// Returns the mirror that is baked into compiled groups whose placements reverse orientation.
pub fn mirror_transform() -> DAffine3 {
    DAffine3::from_mat3(DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)))
}

/// Returns corner and edges if the two triangles form a parallelogram.
fn parallelogram(source: &Group, triangles: &[[u32; 3]]) -> Option<[DVec3; 3]> {
    let [a, b] = triangles else { return None };
    let apex = a.iter().position(|v| !b.contains(v))?;
    let other = b.iter().find(|v| !a.contains(v))?;
    let p = |v: u32| source.vertices[v as usize].position;
    // In order around the quadrilateral: apex, next, other, last.
    let (apex, next, last) = (p(a[apex]), p(a[(apex + 1) % 3]), p(a[(apex + 2) % 3]));
    let miss = (next + last - apex - p(*other)).length();
    let size = (next - last).length();
    (miss <= 1e-6 * size).then_some([apex, next - apex, last - apex])
}

/// Returns the tracer's shape of a curved face.
fn face_shape(face: &Face) -> KernelShape {
    let facing = KernelFacing::Outward;
    match *face {
        Face::Cylinder { base, top, radius } => {
            KernelShape::Cone { start: base, end: top, start_radius: radius, end_radius: radius, facing }
        }
        Face::Disc { center, normal, radius } => KernelShape::Ring { center, normal, inner: 0.0, outer: radius },
        Face::Sphere { center, radius } => KernelShape::Sphere { center, radius, facing },
        // Parallelograms have already been split into triangles.
        Face::Parallelogram { origin, edge_u, edge_v } => KernelShape::Ring {
            center: origin,
            normal: femc_math::cross(edge_u, edge_v).normalize_or(Vec3A::Z),
            inner: 0.0,
            outer: 0.0,
        },
    }
}

/// Transforms a shape by a similarity.
pub fn transform_shape(shape: &Shape, t: &DAffine3) -> Shape {
    let scale = cbrt(t.matrix3.determinant().abs());
    let point = |p: DVec3| t.transform_point3(p);
    let axis = |v: DVec3| t.transform_vector3(v).normalize_or(DVec3::Z);
    match *shape {
        Shape::Sphere { center, radius, facing } => {
            Shape::Sphere { center: point(center), radius: radius * scale, facing }
        }
        Shape::Cone { start, end, start_radius, end_radius, facing } => Shape::Cone {
            start: point(start),
            end: point(end),
            start_radius: start_radius * scale,
            end_radius: end_radius * scale,
            facing,
        },
        Shape::Ring { center, normal, inner, outer } => {
            Shape::Ring { center: point(center), normal: axis(normal), inner: inner * scale, outer: outer * scale }
        }
        Shape::Torus { center, axis: a, major, minor, facing } => {
            Shape::Torus { center: point(center), axis: axis(a), major: major * scale, minor: minor * scale, facing }
        }
    }
}

fn kernel_facing(facing: Facing) -> KernelFacing {
    match facing {
        Facing::Outward => KernelFacing::Outward,
        Facing::Inward => KernelFacing::Inward,
    }
}

/// Returns the tracer's f32 version of a shape.
fn kernel_shape(shape: &Shape) -> KernelShape {
    let v = |p: DVec3| -> Vec3A { p.as_vec3a() };
    match *shape {
        Shape::Sphere { center, radius, facing } => {
            KernelShape::Sphere { center: v(center), radius: radius as f32, facing: kernel_facing(facing) }
        }
        Shape::Cone { start, end, start_radius, end_radius, facing } => KernelShape::Cone {
            start: v(start),
            end: v(end),
            start_radius: start_radius as f32,
            end_radius: end_radius as f32,
            facing: kernel_facing(facing),
        },
        Shape::Ring { center, normal, inner, outer } => {
            KernelShape::Ring { center: v(center), normal: v(normal), inner: inner as f32, outer: outer as f32 }
        }
        Shape::Torus { center, axis, major, minor, facing } => KernelShape::Torus {
            center: v(center),
            axis: v(axis),
            major: major as f32,
            minor: minor as f32,
            facing: kernel_facing(facing),
        },
    }
}

/// Returns the properties of a material that the tracer needs.
pub fn surface_class(material: &femc_scene::Material) -> SurfaceClass {
    // A one-sided surface with a medium behind it must be visible from behind, because paths leave the medium there.
    let cull = match material.sides {
        Sides::One if material.ior.is_none() && material.inside.is_none() => Cull::Back,
        _ => Cull::None,
    };
    let emits = material.ed.amount > 0.0 && material.ed.color.iter().any(|&c| c > 0.0);
    SurfaceClass { cull, emits }
}
