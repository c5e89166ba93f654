//! Surfaces of a frame by object.
//!
//! Instances share compiled groups. A **piece** is the part of an object in one group, with all places of the group.

use femc_geometry::{Aabb, Quadric};
use femc_math::glam::Affine3A;
use femc_prepared::Prepared;
use femc_prepared::compile::CompiledGroup;
use femc_scene::ObjectId;
use std::collections::{BTreeMap, HashMap};
use std::ops::Range;
use std::sync::Arc;

use crate::tessellation::Steps;

/// Time of the poses of moving instances, in [0, 1] of the shutter.
pub(crate) const SHUTTER_TIME: f32 = 0.5;

/// All surfaces of one object.
pub(crate) struct ObjectSurfaces<'a> {
    /// `None`: surfaces outside all objects.
    pub object: Option<ObjectId>,
    pub pieces: Vec<Piece<'a>>,
}

/// Surfaces of an object in one group.
pub(crate) struct Piece<'a> {
    pub group: &'a CompiledGroup,
    /// Primitives, ascending.
    pub primitives: Vec<Range<u32>>,
    pub places: Arc<Vec<Place>>,
}

/// A place of a group.
#[derive(Clone, Copy)]
pub(crate) struct Place {
    /// Pose from the group's frame to the prepared frame.
    pub pose: Affine3A,
    /// Whether the pose changes during the shutter.
    pub moves: bool,
}

/// A surface that can be hit.
pub(crate) enum Surface {
    Triangle([femc_math::glam::Vec3A; 3]),
    Curved(Quadric),
}

impl Place {
    /// Returns a bound of the factor by which the pose changes lengths.
    pub(crate) fn scale(&self) -> f64 {
        // The Frobenius norm is at most sqrt(3) times the largest singular value; a rotation with a uniform scale has exactly that.
        let columns = [self.pose.matrix3.x_axis, self.pose.matrix3.y_axis, self.pose.matrix3.z_axis];
        let columns = columns.map(|column| column.as_dvec3());
        let lengths = columns.map(|column| column.length());
        let [x, y, z] = columns;
        let is_orthogonal =
            [x.dot(y), y.dot(z), z.dot(x)].iter().all(|dot| dot.abs() <= 1e-5 * lengths[0] * lengths[1]);
        let longest = lengths.iter().copied().fold(0.0, f64::max);
        if is_orthogonal { longest * (1.0 + 1e-4) } else { lengths.iter().map(|l| l * l).sum::<f64>().sqrt() }
    }
}

impl<'a> Piece<'a> {
    /// Returns the numbers of the primitives.
    pub(crate) fn numbers(&self) -> impl Iterator<Item = u32> + use<'_, 'a> {
        self.primitives.iter().flat_map(Clone::clone)
    }

    /// Returns a primitive, if it can be hit.
    pub(crate) fn surface(&self, primitive: u32) -> Option<Surface> {
        match (self.group.blas.triangle(primitive), self.group.blas.quadric(primitive)) {
            (Some(corners), _) => has_area(&corners).then_some(Surface::Triangle(corners)),
            (None, Some(shape)) => shape.is_valid().then_some(Surface::Curved(shape)),
            (None, None) => None,
        }
    }

    /// Returns the number of triangles at one place.
    /// - `share`: deviation of triangles from their shape, as a share of the shape's diagonal.
    pub(crate) fn triangles(&self, share: f64) -> u64 {
        let surfaces = self.numbers().filter_map(|primitive| self.surface(primitive));
        surfaces
            .map(|surface| match surface {
                Surface::Triangle(_) => 1,
                Surface::Curved(shape) => steps(&shape, share).triangles(&shape),
            })
            .sum()
    }

    /// Returns the box of the surfaces in the group's frame.
    pub(crate) fn bounds(&self) -> Aabb {
        let surfaces = self.numbers().filter_map(|primitive| self.surface(primitive));
        surfaces.fold(Aabb::EMPTY, |bounds, surface| {
            bounds.union(match surface {
                Surface::Triangle(corners) => Aabb::around(&corners),
                Surface::Curved(shape) => shape.bounds(),
            })
        })
    }
}

/// Returns the steps of a shape.
pub(crate) fn steps(shape: &Quadric, share: f64) -> Steps {
    Steps::for_deviation(shape, share * f64::from(shape.bounds().size().length()))
}

/// Returns whether a triangle is finite and has an area.
fn has_area(corners: &[femc_math::glam::Vec3A; 3]) -> bool {
    let [a, b, c] = corners.map(|corner| corner.as_dvec3());
    corners.iter().all(|corner| corner.is_finite()) && (b - a).cross(c - a).try_normalize().is_some()
}

/// Returns the surfaces of a frame by object, in the order of the objects; the surfaces outside all objects are first.
pub(crate) fn surfaces_by_object(prepared: &Prepared) -> Vec<ObjectSurfaces<'_>> {
    let mut groups: Vec<(&CompiledGroup, Vec<Place>)> = Vec::new();
    let mut known: HashMap<*const CompiledGroup, usize> = HashMap::new();
    for (number, instance) in (0u32..).zip(prepared.instances.iter()) {
        let index = *known.entry(Arc::as_ptr(&instance.compiled)).or_insert_with(|| {
            groups.push((&instance.compiled, Vec::new()));
            groups.len() - 1
        });
        let at = |time| prepared.world.pose_at(number, time);
        groups[index].1.push(Place { pose: at(SHUTTER_TIME), moves: at(0.0) != at(1.0) });
    }
    let mut objects: BTreeMap<Option<ObjectId>, Vec<Piece<'_>>> = BTreeMap::new();
    for (group, places) in groups {
        let places = Arc::new(places);
        for (object, primitives) in primitives_by_object(group) {
            let piece = Piece { group, primitives, places: places.clone() };
            if piece.numbers().any(|primitive| piece.surface(primitive).is_some()) {
                objects.entry(object).or_default().push(piece);
            }
        }
    }
    objects.into_iter().map(|(object, pieces)| ObjectSurfaces { object, pieces }).collect()
}

/// Returns the primitives of a group by object.
fn primitives_by_object(group: &CompiledGroup) -> BTreeMap<Option<ObjectId>, Vec<Range<u32>>> {
    let count = group.primitives.len() as u32;
    let mut all: BTreeMap<Option<ObjectId>, Vec<Range<u32>>> = BTreeMap::new();
    let starts = group.objects.iter().map(|(first, _)| *first);
    let before = starts.clone().next().unwrap_or(count);
    if before > 0 {
        all.entry(None).or_default().push(0..before);
    }
    let ends = starts.skip(1).chain([count]);
    for (&(first, object), end) in group.objects.iter().zip(ends) {
        all.entry(object).or_default().push(first..end);
    }
    all
}
