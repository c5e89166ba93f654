//! Elements: parts of surfaces, boxes of fog, and clusters of them.

use crate::scene::Scene;
use femc_field::{Leaf, NONE, Outline, Split, SurfaceSpot};
use femc_math::Rgb;
use femc_math::glam::{Vec2, Vec3A};
use femc_math::hash::combine;

/// Kind of an element.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ElementKind {
    /// A group of nearby elements, treated as one.
    Cluster,
    /// A part of a surface with nearly one normal. Its light is linear over it.
    Patch,
    /// A part of a curved surface with many normals. Its light is a function of only the normal.
    Curved,
    /// A box of fog.
    Volume,
}

/// An element. Lengths in m, prepared frame.
#[derive(Clone, Debug)]
pub struct Element {
    pub kind: ElementKind,
    /// Element that contains this one, or [`NONE`].
    pub parent: u32,
    /// Its two parts, or [`NONE`].
    pub children: [u32; 2],
    /// Surface of the element, or [`NONE`].
    pub surface: u32,
    /// Outline in the surface's parameters.
    pub outline: Outline,
    /// Outline in the parent's parameters.
    pub in_parent: Outline,
    /// Split of the element, existing or possible.
    pub split: Split,
    /// Area, m2; volume of fog, m3.
    pub size: f32,
    /// Center and radius of a bounding sphere.
    pub center: Vec3A,
    pub radius: f32,
    /// Center of the bounding box, and half of the box's edges.
    pub box_center: Vec3A,
    pub half_extent: Vec3A,
    /// Unit normal at the center; zero for balls, fog, and clusters with more than one normal.
    pub normal: Vec3A,
    /// Points at which its light is known: `node_count` of them. Clusters and balls have only the center.
    pub nodes: [SurfaceSpot; 4],
    pub node_count: usize,
    /// Corners: polygons have `corner_count` of them in order, other elements none.
    pub corners: [Vec3A; 4],
    pub corner_count: usize,
    /// Reflectance, and transmittance to the other side; for fog the scattering coefficient, 1/m.
    pub reflectance: Rgb,
    pub transmittance: Rgb,
    /// Key that identifies the element, independent of the order in which elements are created.
    pub key: u64,
    /// Index of the light by direction, for clusters and balls, else [`NONE`].
    pub directional: u32,
}

/// Nodes of a box of fog. Four of its eight corners, moved inward, integrate quadratic functions exactly.
pub const FOG_NODES: [Vec3A; 4] = {
    const D: f32 = 0.577_350_26;
    [Vec3A::new(D, D, D), Vec3A::new(D, -D, -D), Vec3A::new(-D, D, -D), Vec3A::new(-D, -D, D)]
};

/// Cosine between an element's normals below which they no longer count as one.
const MIN_NORMAL_COSINE: f32 = 0.85;

impl Element {
    fn empty(kind: ElementKind, parent: u32, key: u64) -> Self {
        Self {
            kind,
            parent,
            children: [NONE; 2],
            surface: NONE,
            outline: Outline::WHOLE,
            in_parent: Outline::WHOLE,
            split: Split::None,
            size: 0.0,
            center: Vec3A::ZERO,
            radius: 0.0,
            box_center: Vec3A::ZERO,
            half_extent: Vec3A::ZERO,
            normal: Vec3A::ZERO,
            nodes: [SurfaceSpot::default(); 4],
            node_count: 1,
            corners: [Vec3A::ZERO; 4],
            corner_count: 0,
            reflectance: Rgb::ZERO,
            transmittance: Rgb::ZERO,
            key,
            directional: NONE,
        }
    }

    pub fn cluster(parent: u32, key: u64) -> Self {
        Self::empty(ElementKind::Cluster, parent, key)
    }

    /// Creates a part of a surface. `inner`: outline in its parent; for a root, in the surface's parameters.
    pub fn from_surface(
        scene: &Scene<'_>,
        surface: u32,
        parent: Option<(u32, &Self)>,
        inner: Outline,
        part: u64,
    ) -> Self {
        let around = parent.map_or(Outline::WHOLE, |(_, parent)| parent.outline);
        let key = combine(&[parent.map_or(u64::from(surface), |(_, parent)| parent.key), part]);
        let mut element = Self::empty(ElementKind::Patch, parent.map_or(NONE, |(index, _)| index), key);
        let outline = around.compose(&inner);
        let source = &scene.surfaces[surface as usize];
        let at = |local: Vec2| source.point_at(outline.point_at(local));
        let triangle = matches!(source.form, femc_field::Form::Triangle(_));
        (element.surface, element.outline, element.in_parent) = (surface, outline, inner);
        let share = outline.edges[0].perp_dot(outline.edges[1]).abs();
        element.size = source.area() * share;
        (element.reflectance, element.transmittance) = scene.surface_albedos(surface);
        let places: &[Vec2] = if triangle { &Leaf::TRIANGLE_POINTS } else { &Leaf::RECTANGLE_POINTS };
        element.node_count = places.len();
        for (node, place) in element.nodes.iter_mut().zip(places) {
            *node = at(*place);
        }
        let middle = at(if triangle { Vec2::splat(1.0 / 3.0) } else { Vec2::splat(0.5) });
        (element.center, element.normal) = (middle.position, middle.normal);
        if triangle {
            element.split = Split::Bisection;
            element.corners = [Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::Y].map(|local| at(local).position);
            element.corner_count = 3;
        } else {
            // Length along curves, by chords.
            let length = |from: Vec2, to: Vec2| -> f32 {
                let points = [0, 1, 2, 3, 4].map(|k| at(from.lerp(to, k as f32 * 0.25)).position);
                points.windows(2).map(|pair| pair[0].distance(pair[1])).sum()
            };
            let lengths =
                [length(Vec2::new(0.0, 0.5), Vec2::new(1.0, 0.5)), length(Vec2::new(0.5, 0.0), Vec2::new(0.5, 1.0))];
            element.split = Split::Half(u8::from(lengths[1] > lengths[0]));
            element.corners = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y].map(|local| at(local).position);
            element.corner_count = if source.is_polygon() { 4 } else { 0 };
        }
        if source.side == femc_field::Side::Back {
            // Counterclockwise as seen from the side.
            element.corners[..element.corner_count].reverse();
        }
        if source.is_polygon() {
            element.radius = element.corners.iter().map(|c| c.distance(element.center)).fold(0.0, f32::max);
            let corners = element.corners.iter();
            let (low, high) =
                corners.fold((Vec3A::INFINITY, Vec3A::NEG_INFINITY), |(low, high), &c| (low.min(c), high.max(c)));
            (element.box_center, element.half_extent) = (0.5 * (low + high), 0.5 * (high - low));
            return element;
        }
        let grid = (0..25).map(|k| at(Vec2::new((k % 5) as f32, (k / 5) as f32) * 0.25));
        let (mut low, mut high, mut least) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY, 1.0f32);
        for spot in grid {
            (low, high) = (low.min(spot.position), high.max(spot.position));
            least = least.min(spot.normal.dot(element.normal));
        }
        if least < MIN_NORMAL_COSINE {
            element.kind = ElementKind::Curved;
            element.normal = Vec3A::ZERO;
            element.center = 0.5 * (low + high);
            element.node_count = 1;
            element.nodes[0] = SurfaceSpot { position: element.center, ..SurfaceSpot::default() };
        }
        // Between the points of the grid the surface may bulge.
        element.radius = 1.1 * 0.5 * (high - low).length();
        (element.box_center, element.half_extent) = (0.5 * (low + high), 0.5 * (high - low) + 0.05 * element.radius);
        element
    }

    /// Creates a box of fog.
    pub fn from_fog(scene: &Scene<'_>, parent: Option<(u32, u64)>, [min, max]: [Vec3A; 2], part: u64) -> Self {
        let key = combine(&[parent.map_or(0x0f09, |(_, key)| key), part]);
        let mut element = Self::empty(ElementKind::Volume, parent.map_or(NONE, |(index, _)| index), key);
        element.center = 0.5 * (min + max);
        element.box_center = element.center;
        element.half_extent = 0.5 * (max - min);
        element.radius = element.half_extent.length();
        element.size = 8.0 * element.half_extent.x * element.half_extent.y * element.half_extent.z;
        element.node_count = 4;
        for (node, place) in element.nodes.iter_mut().zip(FOG_NODES) {
            node.position = element.center + element.half_extent * place;
        }
        // For fog that thins out upward, the mean is used.
        let scattering = element.nodes.map(|node| scene.prepared.media.scattering_at(node.position));
        element.reflectance = scattering.into_iter().sum::<Rgb>() * 0.25;
        element
    }

    pub fn is_leaf(&self) -> bool {
        self.children[0] == NONE
    }

    /// Returns the maximum height above the plane through `point` with unit normal `normal`, m.
    pub fn max_height(&self, point: Vec3A, normal: Vec3A) -> f32 {
        normal.dot(self.box_center - point) + normal.abs().dot(self.half_extent)
    }

    /// Checks whether light is stored by direction here.
    pub fn is_directional(&self) -> bool {
        matches!(self.kind, ElementKind::Cluster | ElementKind::Curved)
    }

    /// Evaluates a linear function from its values at the nodes.
    /// - `local`: the point, in a patch's coordinates; for fog, relative to the center in half edges of the box.
    pub fn interpolate(&self, values: &[Rgb; 4], local: Vec3A) -> Rgb {
        let place = Vec2::new(local.x, local.y);
        match (self.kind, self.node_count) {
            (ElementKind::Patch, 3) => Leaf::interpolate_triangle(&[values[0], values[1], values[2]], place),
            (ElementKind::Patch, _) => Leaf::interpolate_rectangle(values, place),
            _ => {
                let [middle, slopes @ ..] = Self::fog_slopes(values);
                middle + slopes[0] * local.x + slopes[1] * local.y + slopes[2] * local.z
            }
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
        if self.kind == ElementKind::Volume {
            return (child.nodes[node].position - self.center) / self.half_extent;
        }
        let place = if child.node_count == 3 { Leaf::TRIANGLE_POINTS[node] } else { Leaf::RECTANGLE_POINTS[node] };
        let local = child.in_parent.point_at(place);
        Vec3A::new(local.x, local.y, 0.0)
    }
}
