//! Shared data of the checks: the surfaces that are placed and shown, and the placed triangles in world space.

use super::light_transport::SurfaceEffect;
use super::tree::{Bounds, BoxTree};
use crate::{
    description::{Facing, Location, Luminaire, Material, MaterialId, ObjectId, ScatteringPart, Scene, Shape},
    objects::hidden_objects,
};
use femc_math::{Transform, glam::DVec3};

/// Maximum number of triangles in world space; also of curved surfaces, and of luminaires.
const TRIANGLE_LIMIT: usize = 1_000_000;
/// Maximum number of group placements.
const PLACEMENT_LIMIT: usize = 1_000_000;

/// A triangle in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlacedTriangle {
    pub corners: [DVec3; 3],
    /// Number of the placed face; equal for all triangles of one face in one placement.
    pub face: u32,
    pub material: MaterialId,
    pub location: Location,
}

impl PlacedTriangle {
    /// Returns the normal, scaled to twice the area.
    pub fn cross(&self) -> DVec3 {
        let [a, b, c] = self.corners;
        (b - a).cross(c - a)
    }

    pub fn bounds(&self) -> Bounds {
        Bounds::from_points(self.corners)
    }
}

/// A sphere in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlacedSphere {
    pub center: DVec3,
    pub radius: f64,
    pub facing: Facing,
    pub material: MaterialId,
}

/// A curved surface in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlacedQuadric {
    pub shape: Shape,
    pub material: MaterialId,
    pub location: Location,
}

impl PlacedQuadric {
    pub fn bounds(&self) -> Bounds {
        shape_bounds(&self.shape)
    }
}

/// A luminaire in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlacedLuminaire<'a> {
    pub position: DVec3,
    /// Transform from the luminaire's own frame to the world.
    pub to_world: Transform,
    pub luminaire: &'a Luminaire,
}

/// Returns whether some light passes through a material at some time.
fn lets_through(scene: &Scene, material: &Material) -> bool {
    let entity = format!("material.{}", material.name);
    let is_present =
        |part: &ScatteringPart| scene.max_over_time(&entity, part.name(), part.fraction(material).amount) > 0.0;
    ScatteringPart::ALL.iter().filter(|part| part.is_transmitted()).any(is_present)
}

/// The scene, prepared for the checks.
pub(crate) struct Scope<'a> {
    pub scene: &'a Scene,
    /// Start of the clip, s.
    pub time: f64,
    /// Whether each group is placed in the world.
    pub placed: Vec<bool>,
    /// Whether each object is shown at some time.
    pub shown: Vec<bool>,
    /// Whether each material is on a placed surface.
    pub used: Vec<bool>,
    /// Whether each material is on a placed surface that is shown at some time.
    pub visible: Vec<bool>,
    /// Whether some light passes through each material at some time.
    pub lets_through: Vec<bool>,
    /// Effects of each material on light that arrives at its front and at its back.
    pub effects: Vec<[SurfaceEffect; 2]>,
    /// World bounds of surfaces and luminaires.
    pub bounds: Bounds,
    /// Shown triangles.
    pub triangles: Vec<PlacedTriangle>,
    /// Tree of the triangles' bounds.
    pub tree: BoxTree,
    /// Shown spheres.
    pub spheres: Vec<PlacedSphere>,
    /// Shown curved surfaces, including spheres.
    pub quadrics: Vec<PlacedQuadric>,
    /// Tree of the curved surfaces' bounds.
    pub quadric_tree: BoxTree,
    /// Shown luminaires.
    pub luminaires: Vec<PlacedLuminaire<'a>>,
    /// Whether the limits truncated the lists.
    pub is_truncated: bool,
}

impl<'a> Scope<'a> {
    pub fn new(scene: &'a Scene) -> Self {
        let blinking = scene.blinking_objects();
        let hidden = hidden_objects(&scene.objects);
        let mut scope = Self {
            scene,
            time: scene.clip.map_or(0.0, |clip| clip.start),
            placed: scene.placed_groups(),
            shown: hidden.iter().zip(blinking).map(|(hidden, blinks)| !hidden || blinks).collect(),
            used: vec![false; scene.materials.len()],
            visible: vec![false; scene.materials.len()],
            lets_through: scene.materials.iter().map(|material| lets_through(scene, material)).collect(),
            effects: scene.materials.iter().map(|material| SurfaceEffect::per_side(scene, material)).collect(),
            bounds: Bounds::EMPTY,
            triangles: Vec::new(),
            tree: BoxTree::default(),
            spheres: Vec::new(),
            quadrics: Vec::new(),
            quadric_tree: BoxTree::default(),
            luminaires: Vec::new(),
            is_truncated: false,
        };
        scope.mark_materials();
        scope.bounds = scope.group_bounds();
        scope.place_all();
        scope.tree = BoxTree::new(&scope.triangles.iter().map(PlacedTriangle::bounds).collect::<Vec<_>>());
        let bounds = scope.quadrics.iter().map(PlacedQuadric::bounds).collect::<Vec<_>>();
        scope.quadric_tree = BoxTree::new(&bounds);
        scope
    }

    pub fn is_shown(&self, object: Option<ObjectId>) -> bool {
        object.is_none_or(|object| self.shown.get(object.index()) != Some(&false))
    }

    fn mark_materials(&mut self) {
        for (group, _) in self.scene.groups.iter().zip(&self.placed).filter(|(_, placed)| **placed) {
            let faces = group.faces.iter().map(|face| (face.material, face.object));
            let quadrics = group.quadrics.iter().map(|quadric| (quadric.material, quadric.object));
            for (material, object) in faces.chain(quadrics) {
                let is_shown = object.is_none_or(|object| self.shown.get(object.index()) != Some(&false));
                if let Some(used) = self.used.get_mut(material.index()) {
                    *used = true;
                    self.visible[material.index()] |= is_shown;
                }
            }
        }
    }

    /// Returns the bounds of the world. The bounds of each group are computed once, children before parents.
    fn group_bounds(&self) -> Bounds {
        let groups = &self.scene.groups;
        let mut known: Vec<Option<Bounds>> = vec![None; groups.len()];
        let mut open = vec![(0, false)];
        while let Some((index, children_known)) = open.pop() {
            let Some(group) = groups.get(index).filter(|_| known[index].is_none()) else { continue };
            if !children_known {
                open.push((index, true));
                open.extend(group.instances.iter().map(|instance| (instance.group.index(), false)));
                continue;
            }
            let own = Bounds::from_points(group.vertices.iter().map(|vertex| vertex.position));
            let quadrics = group.quadrics.iter().map(|quadric| shape_bounds(&quadric.shape));
            let lamps = group.luminaires.iter().map(|lamp| Bounds::from_points([lamp.to_group.translation]));
            let placed = group.instances.iter().filter_map(|instance| {
                let inner = known.get(instance.group.index()).copied().flatten()?;
                Some(inner.transformed(&instance.motion.at(&self.scene.paths, self.time)))
            });
            known[index] = Some(quadrics.chain(lamps).chain(placed).fold(own, Bounds::union));
        }
        known.first().copied().flatten().unwrap_or(Bounds::EMPTY)
    }

    /// Returns tight world bounds of everything shown, or the bounds of the whole world if the limits truncated the lists.
    pub fn shown_bounds(&self) -> Bounds {
        if self.is_truncated {
            return self.bounds;
        }
        let triangles = self.triangles.iter().map(PlacedTriangle::bounds);
        let lamps = self.luminaires.iter().map(|lamp| Bounds::from_points([lamp.position]));
        triangles.chain(self.quadrics.iter().map(PlacedQuadric::bounds)).chain(lamps).fold(Bounds::EMPTY, Bounds::union)
    }

    fn place_all(&mut self) {
        let (mut open, mut placements, mut faces) = (vec![(0, Transform::IDENTITY)], 0, 0);
        while let Some((index, to_world)) = open.pop() {
            let Some(group) = self.scene.groups.get(index) else { continue };
            placements += 1;
            let most = [
                self.triangles.len() + group.triangles.len(),
                self.quadrics.len() + group.quadrics.len(),
                self.luminaires.len() + group.luminaires.len(),
            ];
            if most.into_iter().any(|count| count > TRIANGLE_LIMIT) || placements > PLACEMENT_LIMIT {
                self.is_truncated = true;
                return;
            }
            for face in group.faces.iter().filter(|face| self.is_shown(face.object)).copied().collect::<Vec<_>>() {
                let first = face.first_triangle as usize;
                for triangle in group.triangles.get(first..first + face.triangle_count as usize).unwrap_or_default() {
                    let corners = triangle.map(|v| to_world.transform_point3(group.vertices[v as usize].position));
                    let (material, location) = (face.material, face.location);
                    self.triangles.push(PlacedTriangle { corners, face: faces, material, location });
                }
                faces += 1;
            }
            let shown = |object| self.is_shown(object);
            let lamps = group.luminaires.iter().filter(|lamp| shown(lamp.object)).map(|luminaire| {
                let position = to_world.transform_point3(luminaire.to_group.translation);
                PlacedLuminaire { position, to_world: to_world * luminaire.to_group, luminaire }
            });
            let curved = group.quadrics.iter().filter(|quadric| shown(quadric.object)).map(|quadric| {
                let shape = placed_shape(&quadric.shape, &to_world);
                PlacedQuadric { shape, material: quadric.material, location: quadric.location }
            });
            let (lamps, curved): (Vec<_>, Vec<_>) = (lamps.collect(), curved.collect());
            self.luminaires.extend(lamps);
            self.quadrics.extend(curved);
            for quadric in &group.quadrics {
                if let Shape::Sphere { center, radius, facing } = quadric.shape
                    && self.is_shown(quadric.object)
                {
                    let scale = to_world.matrix3.x_axis.length();
                    let center = to_world.transform_point3(center);
                    self.spheres.push(PlacedSphere {
                        center,
                        radius: radius * scale,
                        facing,
                        material: quadric.material,
                    });
                }
            }
            // The stack is last in, first out, so reversing keeps the order of the file.
            open.extend(
                group.instances.iter().rev().map(|instance| {
                    (instance.group.index(), to_world * instance.motion.at(&self.scene.paths, self.time))
                }),
            );
        }
    }
}

/// Transforms a shape by a similarity.
fn placed_shape(shape: &Shape, to_world: &Transform) -> Shape {
    let scale = to_world.matrix3.x_axis.length();
    let point = |p: DVec3| to_world.transform_point3(p);
    let direction = |d: DVec3| to_world.transform_vector3(d).normalize_or_zero();
    match *shape {
        Shape::Sphere { center, radius, facing } => {
            Shape::Sphere { center: point(center), radius: scale * radius, facing }
        }
        Shape::Cone { start, end, start_radius, end_radius, facing } => Shape::Cone {
            start: point(start),
            end: point(end),
            start_radius: scale * start_radius,
            end_radius: scale * end_radius,
            facing,
        },
        Shape::Ring { center, normal, inner, outer } => {
            Shape::Ring { center: point(center), normal: direction(normal), inner: scale * inner, outer: scale * outer }
        }
        Shape::Torus { center, axis, major, minor, facing } => Shape::Torus {
            center: point(center),
            axis: direction(axis),
            major: scale * major,
            minor: scale * minor,
            facing,
        },
    }
}

fn shape_bounds(shape: &Shape) -> Bounds {
    let around = |center: DVec3, reach: DVec3| Bounds { min: center - reach, max: center + reach };
    // Extent along each coordinate axis of a unit circle perpendicular to a unit axis.
    let across = |axis: DVec3| (DVec3::ONE - axis * axis).max(DVec3::ZERO).map(f64::sqrt);
    match *shape {
        Shape::Sphere { center, radius, .. } => around(center, DVec3::splat(radius)),
        Shape::Cone { start, end, start_radius, end_radius, .. } => {
            let across = across((end - start).normalize_or_zero());
            around(start, start_radius * across).union(around(end, end_radius * across))
        }
        Shape::Ring { center, normal, outer, .. } => around(center, outer * across(normal)),
        Shape::Torus { center, axis, major, minor, .. } => around(center, major * across(axis) + minor),
    }
}
