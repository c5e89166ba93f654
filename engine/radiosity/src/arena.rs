//! Tree of elements, which grows as links are refined.

use crate::bounds::NormalCone;
use crate::element::{Cluster, Curved, Element, Shape, SurfacePart};
use crate::scene::Scene;
use crate::tuning::{CURVED_NORMALS, LARGE_SURFACE_RATIO};
use femc_field::{Form, NONE, Outline, Split, SurfaceSpot};
use femc_math::Rgb;
use femc_math::glam::{Vec2, Vec3A};
use rayon::prelude::*;
use std::ops::Range;

/// All elements. A parent comes before its children.
#[derive(Clone, Debug, Default)]
pub struct Arena {
    pub elements: Vec<Element>,
    /// Number of clusters and balls.
    pub directional_count: usize,
    /// Element that contains all others.
    pub root: u32,
    /// Element that contains all surfaces, or [`NONE`].
    pub surfaces: u32,
    /// Root element by surface, or the cluster without parts that contains the surface, or [`NONE`].
    pub roots: Vec<u32>,
    /// Root of the fog, or [`NONE`].
    pub fog: u32,
    /// Elements that were split, in order. Together with the scene they reproduce the tree.
    pub splits: Vec<u32>,
    /// Surfaces in the order of the tree of clusters, in which the surfaces of a cluster are adjacent.
    members: Vec<Member>,
    /// Unit normals at evenly distributed points of curved surfaces and of their parts ([`curved_places`]).
    normals: Vec<[[f32; 3]; CURVED_NORMALS]>,
    /// Tree of clusters, depth first. A cluster becomes an element when its parent is split.
    nodes: Vec<Node>,
}

/// A surface as a part of a cluster.
#[derive(Clone, Copy, Debug)]
pub struct Member {
    pub surface: u32,
    /// Area, m2.
    pub area: f32,
    /// Unit normal at the middle.
    normal: [f32; 3],
    /// Index of the normals of a surface that is not flat, or [`NONE`].
    normals: u32,
}

impl Member {
    /// Returns the unit normal at the middle.
    pub fn normal(&self) -> Vec3A {
        Vec3A::from_array(self.normal)
    }
}

/// A cluster that may become an element.
#[derive(Clone, Copy, Debug, Default)]
struct Node {
    center: [f32; 3],
    radius: f32,
    low: [f32; 3],
    high: [f32; 3],
    area: f32,
    axis: [f32; 3],
    angle: f32,
    layers: f32,
    reflectance: [f32; 3],
    /// Number of members of the first part.
    first_part: u32,
}

/// Bounds of a surface or of a cluster, while the tree is built.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    center: Vec3A,
    radius: f32,
    low: Vec3A,
    high: Vec3A,
    area: f32,
    normals: NormalCone,
    layers: f32,
    reflectance: Rgb,
}

impl Bounds {
    fn new(element: &Element) -> Self {
        let Element { center, radius, box_center, half_extent, .. } = *element;
        Self {
            center,
            radius,
            low: box_center - half_extent,
            high: box_center + half_extent,
            area: element.size(),
            normals: element.normals(),
            layers: element.layers(),
            reflectance: element.surface_part().map_or(Rgb::ZERO, |part| part.reflectance),
        }
    }

    fn union(&self, other: &Self) -> Self {
        let (center, radius) = enclosing_sphere((self.center, self.radius), (other.center, other.radius));
        let area = self.area + other.area;
        Self {
            center,
            radius,
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            area,
            normals: self.normals.union(other.normals),
            layers: self.layers + other.layers,
            reflectance: (self.reflectance * self.area + other.reflectance * other.area) / area,
        }
    }
}

impl Node {
    fn new(bounds: &Bounds, first_part: u32) -> Self {
        Self {
            center: bounds.center.to_array(),
            radius: bounds.radius,
            low: bounds.low.to_array(),
            high: bounds.high.to_array(),
            area: bounds.area,
            axis: bounds.normals.axis.to_array(),
            angle: bounds.normals.angle,
            layers: bounds.layers,
            reflectance: bounds.reflectance.to_array(),
            first_part,
        }
    }
}

impl Arena {
    /// Number of bytes of a surface in the tree of clusters.
    pub const SURFACE_BYTES: usize = size_of::<(Member, Bounds)>() + size_of::<Member>() + size_of::<Node>();

    /// Creates a cluster of all surfaces, and the fog beside them.
    pub fn new(scene: &Scene<'_>) -> Self {
        let (surfaces, fog) = (NONE, NONE);
        let mut arena = Self { roots: vec![NONE; scene.surfaces.len()], surfaces, fog, ..Self::default() };
        let mut roots = roots(scene);
        if !roots.is_empty() {
            arena.build_clusters(&mut roots);
        }
        arena.members = roots.into_iter().map(|(member, _)| member).collect();
        arena.find_normals_of_members(scene);
        let fog = scene.fog.map(|bounds| Element::from_fog(scene, None, bounds, 0));
        let has_surfaces = !arena.members.is_empty();
        let parent = if fog.is_some() && has_surfaces { arena.push(Element::cluster(NONE, 1)) } else { NONE };
        if has_surfaces {
            let count = arena.members.len() as u32;
            arena.surfaces = arena.push_members(scene, parent, 2, 0..count, 0);
        }
        if let Some(fog) = fog {
            arena.fog = arena.push(Element { parent, ..fog });
            if let Some(whole) = arena.elements.get_mut(parent as usize) {
                (whole.children, whole.radius) = ([arena.surfaces, arena.fog], f32::INFINITY);
            }
        }
        arena.root = if arena.elements.is_empty() { NONE } else { 0 };
        arena
    }

    fn push(&mut self, mut element: Element) -> u32 {
        if let Shape::Cluster(Cluster { directional, .. }) | Shape::Curved(Curved { directional, .. }) =
            &mut element.shape
        {
            *directional = self.directional_count as u32;
            self.directional_count += 1;
        }
        self.elements.push(element);
        self.elements.len() as u32 - 1
    }

    /// Creates the element of some adjacent members: a surface, or a cluster without parts.
    /// - `node`: index of the cluster in the tree.
    fn push_members(&mut self, scene: &Scene<'_>, parent: u32, key: u64, range: Range<u32>, node: u32) -> u32 {
        let element = if range.len() == 1 {
            let member = &self.members[range.start as usize];
            let mut root = root_element(scene, member.surface, parent);
            if let Shape::Curved(curved) = &mut root.shape {
                curved.normals = member.normals;
            }
            root
        } else {
            let it = &self.nodes[node as usize];
            let [low, high] = [it.low, it.high].map(Vec3A::from_array);
            Element {
                center: Vec3A::from_array(it.center),
                radius: it.radius,
                box_center: 0.5 * (low + high),
                half_extent: 0.5 * (high - low),
                shape: Shape::Cluster(Cluster {
                    area: it.area,
                    normals: NormalCone { axis: Vec3A::from_array(it.axis), angle: it.angle },
                    layers: it.layers,
                    reflectance: Rgb::from_array(it.reflectance),
                    members: range.clone(),
                    node,
                    directional: NONE,
                }),
                ..Element::cluster(parent, key)
            }
        };
        let index = self.push(element);
        for member in &self.members[range.start as usize..range.end as usize] {
            self.roots[member.surface as usize] = index;
        }
        index
    }

    /// Builds a tree over some roots. Each cluster is split at the median of the centers along the axis of their greatest extent.
    fn build_clusters(&mut self, roots: &mut [(Member, Bounds)]) -> Bounds {
        if let [(_, bounds)] = roots {
            return *bounds;
        }
        let index = self.nodes.len();
        let (mut low, mut high) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        for (_, root) in roots.iter() {
            (low, high) = (low.min(root.center), high.max(root.center));
        }
        let extent = high - low;
        let axis = (1..3).fold(0, |best, axis| if extent[axis] > extent[best] { axis } else { best });
        let place = |root: &(Member, Bounds)| root.1.center[axis];
        roots.sort_by(|a, b| place(a).total_cmp(&place(b)).then(a.0.surface.cmp(&b.0.surface)));
        // A large surface among small ones is separated from them first.
        let largest = roots
            .iter()
            .enumerate()
            .fold(0, |best, (k, root)| if root.1.radius > roots[best].1.radius { k } else { best });
        let rest =
            roots.iter().enumerate().filter(|(k, _)| *k != largest).map(|(_, root)| root.1.radius).fold(0.0, f32::max);
        let (a, b) = if roots[largest].1.radius > LARGE_SURFACE_RATIO * rest {
            roots.swap(0, largest);
            roots.split_at_mut(1)
        } else {
            let middle = roots.len() / 2;
            roots.split_at_mut(middle)
        };
        let first_part = a.len() as u32;
        self.nodes.push(Node { first_part, ..Node::default() });
        let a = self.build_clusters(a);
        let bounds = a.union(&self.build_clusters(b));
        self.nodes[index] = Node::new(&bounds, first_part);
        bounds
    }

    /// Returns the surfaces of a leaf that is a cluster; none for other elements.
    pub fn members(&self, element: &Element) -> &[Member] {
        match &element.shape {
            Shape::Cluster(cluster) if element.is_leaf() => {
                &self.members[cluster.members.start as usize..cluster.members.end as usize]
            }
            _ => &[],
        }
    }

    fn find_normals_of_members(&mut self, scene: &Scene<'_>) {
        let normals = |member: &Member| {
            let surface = &scene.surfaces[member.surface as usize];
            (!surface.is_flat()).then(|| curved_places().map(|place| surface.point_at(place).normal.to_array()))
        };
        let found: Vec<_> = self.members.par_iter().map(normals).collect();
        for (member, found) in self.members.iter_mut().zip(found) {
            if let Some(normals) = found {
                member.normals = self.normals.len() as u32;
                self.normals.push(normals);
            }
        }
    }

    /// Returns unit normals at evenly distributed points of a curved element.
    pub fn curved_normals(&self, curved: &Curved) -> impl Iterator<Item = Vec3A> + '_ {
        self.normals[curved.normals as usize].iter().copied().map(Vec3A::from_array)
    }

    /// Visits the normals of the surfaces of a leaf that is a cluster, each with the number of its surface and the area that it
    /// represents, m2.
    pub fn for_each_normal(&self, element: &Element, mut each: impl FnMut(u32, Vec3A, f32)) {
        for member in self.members(element) {
            match self.normals.get(member.normals as usize) {
                Some(normals) => normals.iter().for_each(|&normal| {
                    each(member.surface, Vec3A::from_array(normal), member.area / CURVED_NORMALS as f32);
                }),
                None => each(member.surface, member.normal(), member.area),
            }
        }
    }

    /// Returns a point of a surface of a cluster.
    /// - `u`: number in [0, 1), which selects the surface, by area;
    /// - `place`: numbers in [0, 1), which select the point.
    pub fn point_of_cluster(&self, scene: &Scene<'_>, cluster: &Cluster, mut u: f32, place: Vec2) -> SurfaceSpot {
        let (mut range, mut node) = (cluster.members.clone(), cluster.node);
        while range.len() > 1 {
            let [first, second] = self.parts(&range, node);
            let area = |(range, node): &(Range<u32>, u32)| match range.len() {
                1 => self.members[range.start as usize].area,
                _ => self.nodes[*node as usize].area,
            };
            let share = area(&first) / (area(&first) + area(&second));
            let is_first = u < share;
            u = if is_first { u / share } else { (u - share) / (1.0 - share) };
            (range, node) = if is_first { first } else { second };
        }
        let surface = &scene.surfaces[self.members[range.start as usize].surface as usize];
        let is_beyond = matches!(surface.form, Form::Triangle(_)) && place.x + place.y > 1.0;
        surface.point_at(if is_beyond { Vec2::ONE - place } else { place })
    }

    /// Returns the members and the nodes of the parts of a cluster.
    fn parts(&self, members: &Range<u32>, node: u32) -> [(Range<u32>, u32); 2] {
        let count = self.nodes[node as usize].first_part;
        let middle = members.start + count;
        // The first part has one node less than members.
        [(members.start..middle, node + 1), (middle..members.end, node + count)]
    }

    /// Descends to the part of a surface that contains a point: the first part that is a leaf or not larger than `min_size`, m2.
    /// - `point`: the point, in the surface's parameters;
    /// - returns the part, and the point in the part's parameters.
    pub fn element_at(&self, root: u32, point: Vec2, min_size: f32) -> (u32, Vec2) {
        let mut found = (root, point);
        for (index, local) in self.parts_at(root, point) {
            found = (index, local);
            if self.elements[index as usize].surface_part().is_some_and(|part| part.area <= min_size) {
                break;
            }
        }
        found
    }

    /// Returns the parts of a surface that contain a point, from the whole to a leaf, each with the point in the part's parameters.
    /// - `point`: the point, in the surface's parameters.
    pub fn parts_at(&self, root: u32, point: Vec2) -> impl Iterator<Item = (u32, Vec2)> + '_ {
        let inside = |index: u32, local: Vec2| {
            let SurfacePart { in_parent, .. } = self.elements.get(index as usize)?.surface_part()?;
            Some((index, in_parent.local(local)))
        };
        std::iter::successors(inside(root, point), move |&(index, local)| {
            let element = &self.elements[index as usize];
            let second = match element.surface_part()?.split {
                Split::Half(0) | Split::None => local.x >= 0.5,
                Split::Half(_) => local.y >= 0.5,
                Split::Bisection => local.y > local.x,
            };
            inside(element.children[usize::from(second)], local)
        })
    }

    /// Returns the smallest box of fog that contains a point, m; `None` outside of the fog.
    pub fn fog_at(&self, point: Vec3A) -> Option<u32> {
        let mut index = self.fog;
        if index == NONE {
            return None;
        }
        let whole = &self.elements[index as usize];
        if (point - whole.center).abs().cmpgt(whole.half_extent).any() {
            return None;
        }
        loop {
            let element = &self.elements[index as usize];
            if element.is_leaf() {
                return Some(index);
            }
            let second = &self.elements[element.children[1] as usize];
            let is_first = point.cmplt(second.center - second.half_extent).any();
            index = element.children[usize::from(!is_first)];
        }
    }

    /// Returns the children of an element, and creates them if necessary.
    /// - returns whether they are new.
    pub fn ensure_children(&mut self, scene: &Scene<'_>, index: u32) -> ([u32; 2], bool) {
        let element = &self.elements[index as usize];
        if !element.is_leaf() {
            return (element.children, false);
        }
        if let Shape::Cluster(cluster) = &element.shape {
            let (key, parts) = (element.key, self.parts(&cluster.members, cluster.node));
            let mut part = 0;
            let children = parts.map(|(range, node)| {
                part += 1;
                self.push_members(scene, index, key.wrapping_mul(2).wrapping_add(part - 1), range, node)
            });
            self.elements[index as usize].children = children;
            self.splits.push(index);
            return (children, true);
        }
        let mut made: [Element; 2] = match element.surface_part() {
            None => {
                let half = element.half_extent;
                let axis = (1..3).fold(0, |best, axis| if half[axis] > half[best] { axis } else { best });
                let (min, max) = (element.center - half, element.center + half);
                let (mut low_max, mut high_min) = (max, min);
                (low_max[axis], high_min[axis]) = (element.center[axis], element.center[axis]);
                let parent = Some((index, element.key));
                [([min, low_max], 0), ([high_min, max], 1)].map(|(part, k)| Element::from_fog(scene, parent, part, k))
            }
            Some(&SurfacePart { surface, outline, split, .. }) => {
                let source = &scene.surfaces[surface as usize];
                let at = |local: Vec2| source.point_at(outline.point_at(local)).position;
                let halves = Outline::halves(split, |from, to| at(from).distance(at(to)));
                let mut part = 0;
                halves.map(|half| {
                    part += 1;
                    Element::from_surface(scene, surface, Some((index, element)), half, part)
                })
            }
        };
        for child in &mut made {
            if let Shape::Curved(curved) = &mut child.shape {
                curved.normals = self.normals.len() as u32;
                self.normals.push(curved_places().map(|place| curved.part.point_at(scene, place).normal.to_array()));
            }
        }
        let children = made.map(|child| self.push(child));
        self.elements[index as usize].children = children;
        self.splits.push(index);
        (children, true)
    }
}

/// Returns the surfaces with an area.
fn roots(scene: &Scene<'_>) -> Vec<(Member, Bounds)> {
    let root = |surface: u32| {
        if scene.surfaces[surface as usize].area() <= 0.0 {
            return None;
        }
        let element = root_element(scene, surface, NONE);
        let normal = element.normals().axis.to_array();
        (element.radius.is_finite() && element.radius > 0.0)
            .then(|| (Member { surface, area: element.size(), normal, normals: NONE }, Bounds::new(&element)))
    };
    (0..scene.surfaces.len() as u32).into_par_iter().filter_map(root).collect()
}

/// Returns evenly distributed points of a curved element, in its coordinates.
fn curved_places() -> [Vec2; CURVED_NORMALS] {
    std::array::from_fn(|k| Vec2::new((k % 4) as f32 + 0.5, (k / 4) as f32 + 0.5) * 0.25)
}

/// Creates the root element of a surface.
fn root_element(scene: &Scene<'_>, surface: u32, parent: u32) -> Element {
    Element { parent, ..Element::from_surface(scene, surface, None, root_outline(scene, surface), 0) }
}

/// Returns the outline of a surface's root element in the surface's parameters.
pub fn root_outline(scene: &Scene<'_>, surface: u32) -> Outline {
    let source = &scene.surfaces[surface as usize];
    if !matches!(source.form, Form::Triangle(_)) {
        return Outline::WHOLE;
    }
    let length = |from: Vec2, to: Vec2| source.point_at(from).position.distance(source.point_at(to).position);
    Outline::across_longest([Vec2::ZERO, Vec2::X, Vec2::Y], &length)
}

/// Returns a sphere around two spheres.
fn enclosing_sphere(a: (Vec3A, f32), b: (Vec3A, f32)) -> (Vec3A, f32) {
    let distance = a.0.distance(b.0);
    if distance + b.1 <= a.1 {
        return a;
    }
    if distance + a.1 <= b.1 {
        return b;
    }
    let radius = 0.5 * (distance + a.1 + b.1);
    (a.0 + (b.0 - a.0) * ((radius - a.1) / distance), radius)
}
