//! What the checks share: which surfaces are placed and shown, and where the placed triangles are in the world.

use super::tree::{Bounds, BoxTree};
use crate::{
    description::{Facing, Location, MaterialId, ObjectId, Scene, Shape},
    objects::hidden_objects,
};
use femc_math::{Transform, glam::DVec3};

/// Most triangles that are looked at in world space.
const TRIANGLE_LIMIT: usize = 1_000_000;
/// Most placements of groups that are followed.
const PLACEMENT_LIMIT: usize = 1_000_000;

/// A triangle in the world.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlacedTriangle {
    pub corners: [DVec3; 3],
    /// Number of the face's placement: equal for the triangles of one face in one place.
    pub face: u32,
    pub material: MaterialId,
    pub location: Location,
}

impl PlacedTriangle {
    /// Twice the area along the normal.
    pub fn cross(&self) -> DVec3 {
        let [a, b, c] = self.corners;
        (b - a).cross(c - a)
    }

    pub fn bounds(&self) -> Bounds {
        Bounds::of(self.corners)
    }
}

/// A sphere in the world.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlacedSphere {
    pub center: DVec3,
    pub radius: f64,
    pub facing: Facing,
    pub material: MaterialId,
}

/// The scene as the checks see it.
pub(super) struct Scope<'a> {
    pub scene: &'a Scene,
    /// Start of the clip, s.
    pub time: f64,
    /// Which groups are in the world.
    pub placed: Vec<bool>,
    /// Which objects are shown at some time.
    pub shown: Vec<bool>,
    /// Which materials are on a placed surface.
    pub used: Vec<bool>,
    /// Which materials are on a placed surface that is shown at some time.
    pub visible: Vec<bool>,
    /// World bounds of surfaces and luminaires.
    pub bounds: Bounds,
    /// Shown triangles.
    pub triangles: Vec<PlacedTriangle>,
    /// The tree of their bounds.
    pub tree: BoxTree,
    /// Shown spheres.
    pub spheres: Vec<PlacedSphere>,
    /// Whether the limits cut the list of triangles.
    pub is_cut: bool,
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
            bounds: Bounds::EMPTY,
            triangles: Vec::new(),
            tree: BoxTree::default(),
            spheres: Vec::new(),
            is_cut: false,
        };
        scope.mark_materials();
        scope.bounds = scope.group_bounds();
        scope.place_all();
        scope.tree = BoxTree::new(&scope.triangles.iter().map(PlacedTriangle::bounds).collect::<Vec<_>>());
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

    /// Bounds of the world; each group's are found once, children before parents.
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
            let own = Bounds::of(group.vertices.iter().map(|vertex| vertex.position));
            let quadrics = group.quadrics.iter().map(|quadric| shape_bounds(&quadric.shape));
            let lamps = group.luminaires.iter().map(|lamp| Bounds::of([lamp.to_group.translation]));
            let placed = group.instances.iter().filter_map(|instance| {
                let inner = known.get(instance.group.index()).copied().flatten()?;
                Some(transformed(&inner, &instance.motion.at(&self.scene.paths, self.time)))
            });
            known[index] = Some(quadrics.chain(lamps).chain(placed).fold(own, Bounds::union));
        }
        known.first().copied().flatten().unwrap_or(Bounds::EMPTY)
    }

    fn place_all(&mut self) {
        let (mut open, mut placements, mut faces) = (vec![(0, Transform::IDENTITY)], 0, 0);
        while let Some((index, to_world)) = open.pop() {
            let Some(group) = self.scene.groups.get(index) else { continue };
            placements += 1;
            if self.triangles.len() + group.triangles.len() > TRIANGLE_LIMIT || placements > PLACEMENT_LIMIT {
                self.is_cut = true;
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
            // Last in, first out: reversed, so that the order is that of the file.
            open.extend(
                group.instances.iter().rev().map(|instance| {
                    (instance.group.index(), to_world * instance.motion.at(&self.scene.paths, self.time))
                }),
            );
        }
    }
}

fn transformed(bounds: &Bounds, transform: &Transform) -> Bounds {
    if bounds.is_empty() {
        return *bounds;
    }
    let corner =
        |i: u8| DVec3::select(femc_math::glam::BVec3::new(i & 1 > 0, i & 2 > 0, i & 4 > 0), bounds.max, bounds.min);
    Bounds::of((0..8).map(|i| transform.transform_point3(corner(i))))
}

fn shape_bounds(shape: &Shape) -> Bounds {
    let around = |center: DVec3, radius: f64| Bounds { min: center - radius, max: center + radius };
    match *shape {
        Shape::Sphere { center, radius, .. } => around(center, radius),
        Shape::Cone { start, end, start_radius, end_radius, .. } => {
            around(start, start_radius).union(around(end, end_radius))
        }
        Shape::Ring { center, outer, .. } => around(center, outer),
        Shape::Torus { center, major, minor, .. } => around(center, major + minor),
    }
}
