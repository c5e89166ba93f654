//! Elements: parts of surfaces, boxes of fog, and clusters of them.

use crate::bounds::{NormalCone, curved_box, spread_of_normals};
use crate::scene::Scene;
use crate::tuning::{BULGE_BOX, BULGE_RADIUS, EQUAL_NORMALS_ANGLE, MIN_NORMAL_COSINE};
use femc_field::{Form, Leaf, NONE, Outline, Side, Split, Surface, SurfaceSpot};
use femc_geometry::Quadric;
use femc_math::Rgb;
use femc_math::glam::{DVec3, Vec2, Vec3A};
use femc_math::hash::combine;
use std::ops::Range;

/// An element: its place in the tree, its bounds, and its shape. Lengths in m, prepared frame.
#[derive(Clone, Debug)]
pub struct Element {
    /// Key that identifies the element, independent of the order in which elements are created.
    pub key: u64,
    /// Element that contains this one, or [`NONE`].
    pub parent: u32,
    /// Its two parts, or [`NONE`].
    pub children: [u32; 2],
    /// Center and radius of a bounding sphere. A patch contains its center. The sphere of a whole ring is too small by a ninth.
    pub center: Vec3A,
    pub radius: f32,
    /// Center of the bounding box, and half of the box's edges.
    pub box_center: Vec3A,
    pub half_extent: Vec3A,
    pub shape: Shape,
}

/// Shape of an element, with its optical properties.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "most elements are patches")]
pub enum Shape {
    Patch(Patch),
    Curved(Curved),
    Volume(Volume),
    Cluster(Cluster),
}

/// Part of a surface, as patches and curved elements have it.
#[derive(Clone, Debug)]
pub struct SurfacePart {
    /// Index of the surface.
    pub surface: u32,
    /// Outline in the surface's parameters.
    pub outline: Outline,
    /// Outline in the parent's parameters; for a root, in the surface's.
    pub in_parent: Outline,
    /// Split of the part, existing or possible.
    pub split: Split,
    /// Area, m2.
    pub area: f32,
    /// Share of the arriving light that the surface reflects diffusely.
    pub reflectance: Rgb,
    /// Share that it transmits to the other side.
    pub transmittance: Rgb,
    /// Greatest angle between the normal at the middle and another normal.
    pub spread: f32,
    /// Maximum number of times that a line crosses the part from its back to its front.
    pub layers: u8,
    /// Whether the part is in a plane.
    pub is_flat: bool,
}

/// Form of a patch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PatchForm {
    /// Triangle: three nodes and three corners.
    Triangle,
    /// Parallelogram: four nodes and four corners.
    Parallelogram,
    /// Slightly curved part: four nodes. The corners are joined by curves.
    Bent,
}

/// A part of a surface with nearly one normal. Its light is linear over it.
#[derive(Clone, Debug)]
pub struct Patch {
    pub part: SurfacePart,
    pub form: PatchForm,
    /// Unit normal at the center.
    pub normal: Vec3A,
    nodes: [SurfaceSpot; 4],
    corners: [Vec3A; 4],
}

/// A part of a curved surface with many normals. Its light is a function of only the normal.
#[derive(Clone, Debug)]
pub struct Curved {
    pub part: SurfacePart,
    /// Unit normal at the middle.
    pub normal: Vec3A,
    /// Index of its normals in the arena.
    pub normals: u32,
    /// Index of its light by direction.
    pub directional: u32,
}

/// A box of fog, which is the bounding box of its element.
#[derive(Clone, Debug)]
pub struct Volume {
    /// Volume, m3.
    pub volume: f32,
    /// Mean scattering coefficient, 1/m.
    pub sigma_s: Rgb,
    /// Mean extinction coefficient by luminance, 1/m.
    pub sigma_t: f32,
}

/// A group of nearby surfaces, treated as one. Without parts it stands for all of its surfaces: each receives the cluster's light by
/// its normal.
#[derive(Clone, Debug)]
pub struct Cluster {
    /// Area of its surfaces, m2.
    pub area: f32,
    /// Normals of all parts.
    pub normals: NormalCone,
    /// Sum of [`SurfacePart::layers`] over its surfaces.
    pub layers: f32,
    /// Mean reflectance of its surfaces, by area.
    pub reflectance: Rgb,
    /// Range of its surfaces among the arena's members, and its index in the tree of clusters. The cluster of all surfaces and the fog
    /// has no members of its own.
    pub members: Range<u32>,
    pub node: u32,
    /// Index of its light by direction.
    pub directional: u32,
}

/// Nodes of a box of fog. Four of its eight corners, moved inward, integrate quadratic functions exactly.
pub const FOG_NODES: [Vec3A; 4] = {
    const D: f32 = 0.577_350_26;
    [Vec3A::new(D, D, D), Vec3A::new(D, -D, -D), Vec3A::new(-D, D, -D), Vec3A::new(-D, -D, D)]
};

impl Patch {
    /// Returns the points at which its light is known.
    pub fn nodes(&self) -> &[SurfaceSpot] {
        &self.nodes[..if self.form == PatchForm::Triangle { 3 } else { 4 }]
    }

    /// Returns the corners of a polygon, counterclockwise as seen from the side; none if the patch is bent.
    pub fn polygon(&self) -> &[Vec3A] {
        match self.form {
            PatchForm::Triangle => &self.corners[..3],
            PatchForm::Parallelogram => &self.corners,
            PatchForm::Bent => &[],
        }
    }

    /// Returns the corners of a patch of any form. The corners of a bent patch have the same order for both sides.
    pub fn corners(&self) -> &[Vec3A] {
        if self.form == PatchForm::Bent { &self.corners } else { self.polygon() }
    }

    /// Evaluates a linear function from its values at the nodes.
    /// - `local`: the point, in the patch's coordinates.
    fn interpolate(&self, values: &[Rgb; 4], local: Vec2) -> Rgb {
        match self.form {
            PatchForm::Triangle => Leaf::interpolate_triangle(&[values[0], values[1], values[2]], local),
            PatchForm::Parallelogram | PatchForm::Bent => Leaf::interpolate_rectangle(values, local),
        }
    }
}

impl SurfacePart {
    fn new(scene: &Scene<'_>, surface: u32, outline: Outline, in_parent: Outline) -> Self {
        let source = &scene.surfaces[surface as usize];
        let (reflectance, transmittance) = scene.surface_albedos(surface);
        let split = match source.form {
            Form::Triangle(_) => Split::Bisection,
            Form::Parallelogram(_) | Form::Curved { .. } => longer_half(source, &outline),
        };
        let area = source.area() * outline.edges[0].perp_dot(outline.edges[1]).abs();
        let spread = spread_of_normals(source, &outline);
        let layers = 1 + u8::from(matches!(&source.form, Form::Curved { shape: Quadric::Torus { .. }, .. }));
        let is_flat = source.is_flat();
        Self { surface, outline, in_parent, split, area, reflectance, transmittance, spread, layers, is_flat }
    }

    /// Returns the point with these coordinates in the part.
    pub fn point_at(&self, scene: &Scene<'_>, local: Vec2) -> SurfaceSpot {
        scene.surfaces[self.surface as usize].point_at(self.outline.point_at(local))
    }
}

/// Returns the split of a part across its longer direction. Chords approximate lengths along curves.
fn longer_half(source: &Surface, outline: &Outline) -> Split {
    let length = |from: Vec2, to: Vec2| -> f32 {
        let at = |k: u32| source.point_at(outline.point_at(from.lerp(to, k as f32 * 0.25))).position;
        let points = [0, 1, 2, 3, 4].map(at);
        points.windows(2).map(|pair| pair[0].distance(pair[1])).sum()
    };
    let lengths = [length(Vec2::new(0.0, 0.5), Vec2::new(1.0, 0.5)), length(Vec2::new(0.5, 0.0), Vec2::new(0.5, 1.0))];
    Split::Half(u8::from(lengths[1] > lengths[0]))
}

/// Returns the center and half of the edges of the box around some points.
fn bounding_box(points: impl Iterator<Item = Vec3A>) -> (Vec3A, Vec3A) {
    let (low, high) =
        points.fold((Vec3A::INFINITY, Vec3A::NEG_INFINITY), |(low, high), point| (low.min(point), high.max(point)));
    (0.5 * (low + high), 0.5 * (high - low))
}

impl Element {
    /// Creates a cluster without parts.
    pub fn cluster(parent: u32, key: u64) -> Self {
        Self {
            key,
            parent,
            children: [NONE; 2],
            center: Vec3A::ZERO,
            radius: 0.0,
            box_center: Vec3A::ZERO,
            half_extent: Vec3A::ZERO,
            shape: Shape::Cluster(Cluster {
                area: 0.0,
                normals: NormalCone::ALL,
                layers: 0.0,
                reflectance: Rgb::ZERO,
                members: 0..0,
                node: NONE,
                directional: NONE,
            }),
        }
    }

    /// Creates a part of a surface.
    /// - `parent`: index of the parent, and the parent, which is a part of the same surface;
    /// - `inner`: outline in the parent; for a root, in the surface's parameters.
    pub fn from_surface(
        scene: &Scene<'_>,
        surface: u32,
        parent: Option<(u32, &Self)>,
        inner: Outline,
        part: u64,
    ) -> Self {
        let around = parent.and_then(|(_, parent)| parent.surface_part()).map_or(Outline::WHOLE, |part| part.outline);
        let key = combine(&[parent.map_or(u64::from(surface), |(_, parent)| parent.key), part]);
        let parent = parent.map_or(NONE, |(index, _)| index);
        let source = &scene.surfaces[surface as usize];
        let part = SurfacePart::new(scene, surface, around.compose(&inner), inner);
        let outline = part.outline;
        let at = |local: Vec2| source.point_at(outline.point_at(local));
        let form = match source.form {
            Form::Triangle(_) => PatchForm::Triangle,
            Form::Parallelogram(_) => PatchForm::Parallelogram,
            Form::Curved { .. } => PatchForm::Bent,
        };
        let (places, middle, ends): (&[Vec2], _, _) = if form == PatchForm::Triangle {
            (&Leaf::TRIANGLE_POINTS, Vec2::splat(1.0 / 3.0), [Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::Y])
        } else {
            (&Leaf::RECTANGLE_POINTS, Vec2::splat(0.5), [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y])
        };
        let mut nodes = [SurfaceSpot::default(); 4];
        nodes.iter_mut().zip(places).for_each(|(node, place)| *node = at(*place));
        let SurfaceSpot { position: center, normal, .. } = at(middle);
        let mut corners = ends.map(|local| at(local).position);
        if let Form::Curved { shape, pose } = &source.form {
            let exact = curved_box(shape, pose, &outline);
            return Self::bent(key, parent, Patch { normal, nodes, corners, form, part }, center, exact, at);
        }
        let count = if form == PatchForm::Triangle { 3 } else { 4 };
        let radius = corners[..count].iter().map(|c| c.distance(center)).fold(0.0, f32::max);
        let (box_center, half_extent) = bounding_box(corners[..count].iter().copied());
        if source.side == Side::Back {
            // Counterclockwise as seen from the side.
            corners[..count].reverse();
        }
        let shape = Shape::Patch(Patch { normal, nodes, corners, form, part });
        Self { key, parent, children: [NONE; 2], center, radius, box_center, half_extent, shape }
    }

    /// Creates a part of a curved surface: a patch, or a curved element if the part has many normals.
    /// - `center`: center of the patch;
    /// - `exact`: corners of a box that contains the part;
    /// - `at`: the surface at a point in the patch's coordinates.
    fn bent(
        key: u64,
        parent: u32,
        patch: Patch,
        center: Vec3A,
        exact: [DVec3; 2],
        at: impl Fn(Vec2) -> SurfaceSpot,
    ) -> Self {
        let grid = || (0..25).map(|k| at(Vec2::new((k % 5) as f32, (k / 5) as f32) * 0.25));
        let (box_center, half) = bounding_box(grid().map(|spot| spot.position));
        let least = grid().map(|spot| spot.normal.dot(patch.normal)).fold(1.0, f32::min);
        let (diagonal, error) = ((half * 2.0).length(), patch.nodes[0].error);
        let (center, shape) = if least < MIN_NORMAL_COSINE {
            (
                box_center,
                Shape::Curved(Curved { part: patch.part, normal: patch.normal, normals: NONE, directional: NONE }),
            )
        } else {
            (center, Shape::Patch(patch))
        };
        // Between the points of the grid the surface may bulge.
        let radius = BULGE_RADIUS * 0.5 * diagonal;
        let [low, high] = exact.map(|corner| (corner - box_center.as_dvec3()).as_vec3a());
        let half_extent = (half + BULGE_BOX * radius).max(high.max(-low) + error);
        Self { key, parent, children: [NONE; 2], center, radius, box_center, half_extent, shape }
    }

    /// Creates a box of fog.
    /// - `parent`: index and key of the parent.
    pub fn from_fog(scene: &Scene<'_>, parent: Option<(u32, u64)>, [min, max]: [Vec3A; 2], part: u64) -> Self {
        let key = combine(&[parent.map_or(0x0f09, |(_, key)| key), part]);
        let (center, half_extent) = (0.5 * (min + max), 0.5 * (max - min));
        // For fog that thins out upward, the mean is used.
        let (media, points) = (&scene.prepared.media, FOG_NODES.map(|place| center + half_extent * place));
        let volume = Volume {
            volume: 8.0 * half_extent.x * half_extent.y * half_extent.z,
            sigma_s: points.iter().map(|&point| media.scattering_at(point)).sum::<Rgb>() * 0.25,
            sigma_t: points.iter().map(|&point| media.extinction_at(point)).sum::<f32>() * 0.25,
        };
        Self {
            key,
            parent: parent.map_or(NONE, |(index, _)| index),
            children: [NONE; 2],
            center,
            radius: half_extent.length(),
            box_center: center,
            half_extent,
            shape: Shape::Volume(volume),
        }
    }

    pub fn is_leaf(&self) -> bool {
        self.children[0] == NONE
    }

    pub fn is_cluster(&self) -> bool {
        matches!(self.shape, Shape::Cluster(_))
    }

    pub fn is_volume(&self) -> bool {
        matches!(self.shape, Shape::Volume(_))
    }

    pub fn is_triangle(&self) -> bool {
        self.patch().is_some_and(|patch| patch.form == PatchForm::Triangle)
    }

    /// Returns the patch, if the element is one.
    pub fn patch(&self) -> Option<&Patch> {
        if let Shape::Patch(patch) = &self.shape { Some(patch) } else { None }
    }

    /// Returns the part of a surface; `None` for clusters and fog.
    pub fn surface_part(&self) -> Option<&SurfacePart> {
        match &self.shape {
            Shape::Patch(Patch { part, .. }) | Shape::Curved(Curved { part, .. }) => Some(part),
            Shape::Volume(_) | Shape::Cluster(_) => None,
        }
    }

    /// Returns the index of the light by direction; `None` if light is stored at nodes.
    pub fn directional(&self) -> Option<usize> {
        match self.shape {
            Shape::Curved(Curved { directional, .. }) | Shape::Cluster(Cluster { directional, .. }) => {
                Some(directional as usize)
            }
            Shape::Patch(_) | Shape::Volume(_) => None,
        }
    }

    /// Checks whether light is stored by direction here.
    pub fn is_directional(&self) -> bool {
        self.directional().is_some()
    }

    /// Returns the weight of the element's light in a sum over siblings: the area of its surfaces, m2, or the volume of fog, m3.
    pub fn size(&self) -> f32 {
        match &self.shape {
            Shape::Patch(Patch { part, .. }) | Shape::Curved(Curved { part, .. }) => part.area,
            Shape::Volume(fog) => fog.volume,
            Shape::Cluster(cluster) => cluster.area,
        }
    }

    /// Returns the ratio of the element's flux to its radiosity: m2, for fog m3. A box of fog sends in all directions four times as
    /// much as a surface of its radiosity.
    pub fn sending_size(&self) -> f32 {
        if self.is_volume() { 4.0 * self.size() } else { self.size() }
    }

    /// Returns the flux that the element receives, as a share of its irradiance and its size: for fog, the light that it scatters,
    /// 1/m.
    pub fn received_share(&self) -> Rgb {
        if let Shape::Volume(fog) = &self.shape { fog.sigma_s * 4.0 } else { Rgb::ONE }
    }

    /// Returns the flux that the element stops, as [`Element::received_share`]: for fog, with the light that it absorbs.
    pub fn stopped_share(&self) -> f32 {
        if let Shape::Volume(fog) = &self.shape { fog.sigma_t * 4.0 } else { 1.0 }
    }

    /// Returns the unit normal; zero for curved elements, fog, and clusters with more than one normal.
    pub fn normal(&self) -> Vec3A {
        match &self.shape {
            Shape::Patch(patch) => patch.normal,
            Shape::Cluster(_) => self.single_normal().unwrap_or(Vec3A::ZERO),
            Shape::Curved(_) | Shape::Volume(_) => Vec3A::ZERO,
        }
    }

    /// Returns a cone of all normals; for fog, which has none, a cone of all directions.
    pub fn normals(&self) -> NormalCone {
        match &self.shape {
            Shape::Patch(Patch { part, normal, .. }) | Shape::Curved(Curved { part, normal, .. }) => {
                NormalCone { axis: *normal, angle: part.spread }
            }
            Shape::Cluster(cluster) => cluster.normals,
            Shape::Volume(_) => NormalCone::ALL,
        }
    }

    /// Returns the unit normal, if all points have this one.
    pub fn single_normal(&self) -> Option<Vec3A> {
        match &self.shape {
            Shape::Patch(patch) => patch.part.is_flat.then_some(patch.normal),
            Shape::Cluster(cluster) => (cluster.normals.angle < EQUAL_NORMALS_ANGLE).then_some(cluster.normals.axis),
            Shape::Curved(_) | Shape::Volume(_) => None,
        }
    }

    /// Returns the maximum number of times that a line crosses its surfaces from their back to their front.
    pub fn layers(&self) -> f32 {
        match &self.shape {
            Shape::Patch(Patch { part, .. }) | Shape::Curved(Curved { part, .. }) => f32::from(part.layers),
            Shape::Cluster(cluster) => cluster.layers,
            Shape::Volume(_) => 0.0,
        }
    }

    /// Returns the number of points at which its light is known.
    pub fn node_count(&self) -> usize {
        match &self.shape {
            Shape::Patch(patch) => patch.nodes().len(),
            Shape::Volume(_) => FOG_NODES.len(),
            Shape::Curved(_) | Shape::Cluster(_) => 1,
        }
    }

    /// Returns a point at which its light is known; for an element with light by direction, the center. Nodes in space have no
    /// normal.
    /// - `index`: less than [`Self::node_count`].
    pub fn node(&self, index: usize) -> SurfaceSpot {
        let position = match &self.shape {
            Shape::Patch(patch) => return patch.nodes[index],
            Shape::Volume(_) => self.center + self.half_extent * FOG_NODES[index],
            Shape::Curved(_) | Shape::Cluster(_) => self.center,
        };
        SurfaceSpot { position, ..SurfaceSpot::default() }
    }

    /// Returns all nodes in order.
    pub fn nodes(&self) -> impl ExactSizeIterator<Item = SurfaceSpot> {
        (0..self.node_count()).map(|index| self.node(index))
    }

    /// Returns the center as a point of the element.
    pub fn center_spot(&self) -> SurfaceSpot {
        SurfaceSpot { position: self.center, normal: self.normal(), error: self.node(0).error }
    }

    /// Returns the point with these coordinates in a part of a surface; the center of another element.
    pub fn point_at(&self, scene: &Scene<'_>, local: Vec2) -> SurfaceSpot {
        self.surface_part().map_or_else(|| self.center_spot(), |part| part.point_at(scene, local))
    }

    /// Returns the maximum height above the plane through `point` with unit normal `normal`, m.
    pub fn max_height(&self, point: Vec3A, normal: Vec3A) -> f32 {
        normal.dot(self.box_center - point) + normal.abs().dot(self.half_extent)
    }

    /// Evaluates a linear function from its values at the nodes.
    /// - `local`: the point, in a patch's coordinates; for fog, relative to the center in half edges of the box.
    pub fn interpolate(&self, values: &[Rgb; 4], local: Vec3A) -> Rgb {
        match &self.shape {
            Shape::Patch(patch) => patch.interpolate(values, Vec2::new(local.x, local.y)),
            Shape::Volume(_) => {
                let [middle, slopes @ ..] = Self::fog_slopes(values);
                middle + slopes[0] * local.x + slopes[1] * local.y + slopes[2] * local.z
            }
            Shape::Curved(_) | Shape::Cluster(_) => values[0],
        }
    }

    /// Converts the values at a box's nodes to the value at the center, and the changes over half an edge, by axis.
    pub fn fog_slopes(values: &[Rgb; 4]) -> [Rgb; 4] {
        let mut out = [Rgb::ZERO; 4];
        for (value, node) in values.iter().zip(FOG_NODES) {
            out[0] += *value * 0.25;
            // The nodes' coordinates are orthogonal: their squares sum to 4 / 3.
            (0..3).for_each(|axis| out[1 + axis] += *value * (node[axis] * 0.75));
        }
        out
    }

    /// Returns the position of a child's node, as an argument of [`Self::interpolate`].
    pub fn node_in_parent(&self, child: &Self, node: usize) -> Vec3A {
        let Some(patch) = child.patch() else {
            return (child.node(node).position - self.center) / self.half_extent;
        };
        let triangle = patch.form == PatchForm::Triangle;
        let place = if triangle { Leaf::TRIANGLE_POINTS[node] } else { Leaf::RECTANGLE_POINTS[node] };
        let local = patch.part.in_parent.point_at(place);
        Vec3A::new(local.x, local.y, 0.0)
    }
}
