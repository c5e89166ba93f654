//! Tree of elements, which grows as links are refined.

use crate::element::{Cluster, Curved, Element, Shape, SurfacePart};
use crate::scene::Scene;
use crate::tuning::LARGE_SURFACE_RATIO;
use femc_field::{NONE, Outline, Split};
use femc_math::glam::{Vec2, Vec3A};

/// All elements. A parent comes before its children.
#[derive(Clone, Debug, Default)]
pub struct Arena {
    pub elements: Vec<Element>,
    /// Number of clusters and balls.
    pub directional_count: usize,
    /// Element that contains all others.
    pub root: u32,
    /// Root element by surface, or [`NONE`].
    pub roots: Vec<u32>,
    /// Root of the fog, or [`NONE`].
    pub fog: u32,
    /// Elements that were split, in order. Together with the scene they reproduce the tree.
    pub splits: Vec<u32>,
}

impl Arena {
    /// Creates the roots of all surfaces in a tree of clusters, and the fog beside them.
    pub fn new(scene: &Scene<'_>) -> Self {
        let mut arena = Self { roots: vec![NONE; scene.surfaces.len()], fog: NONE, ..Self::default() };
        let mut roots: Vec<(u32, Element)> = (0..scene.surfaces.len() as u32)
            .filter(|&surface| scene.surfaces[surface as usize].area() > 0.0)
            .map(|surface| (surface, Element::from_surface(scene, surface, None, root_outline(scene, surface), 0)))
            .filter(|(_, element)| element.radius.is_finite() && element.radius > 0.0)
            .collect();
        let fog = scene.fog.map(|bounds| Element::from_fog(scene, None, bounds, 0));
        let parent = if fog.is_some() && !roots.is_empty() { arena.push(Element::cluster(NONE, 1)) } else { NONE };
        let surfaces = if roots.is_empty() { NONE } else { arena.build_clusters(&mut roots, parent, 2) };
        if let Some(fog) = fog {
            arena.fog = arena.push(Element { parent, ..fog });
            if let Some(whole) = arena.elements.get_mut(parent as usize) {
                (whole.children, whole.radius) = ([surfaces, arena.fog], f32::INFINITY);
            }
        } else {
            arena.root = surfaces;
        }
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

    /// Builds a tree over some roots. Each cluster is split at the median of the centers along the axis of their greatest extent.
    fn build_clusters(&mut self, roots: &mut [(u32, Element)], parent: u32, key: u64) -> u32 {
        if let [(surface, root)] = roots {
            let index = self.push(Element { parent, ..root.clone() });
            self.roots[*surface as usize] = index;
            return index;
        }
        let index = self.push(Element::cluster(parent, key));
        let (mut low, mut high) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        for (_, root) in roots.iter() {
            (low, high) = (low.min(root.center), high.max(root.center));
        }
        let extent = high - low;
        let axis = (1..3).fold(0, |best, axis| if extent[axis] > extent[best] { axis } else { best });
        let place = |root: &(u32, Element)| root.1.center[axis];
        roots.sort_by(|a, b| place(a).total_cmp(&place(b)).then(a.0.cmp(&b.0)));
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
        let children = [self.build_clusters(a, index, key * 2), self.build_clusters(b, index, key * 2 + 1)];
        let [a, b] = children.map(|child| &self.elements[child as usize]);
        let (normals, layers) = (a.normals().union(b.normals()), a.layers() + b.layers());
        let (center, radius) = enclosing_sphere((a.center, a.radius), (b.center, b.radius));
        let area = a.size() + b.size();
        let low = (a.box_center - a.half_extent).min(b.box_center - b.half_extent);
        let high = (a.box_center + a.half_extent).max(b.box_center + b.half_extent);
        let cluster = &mut self.elements[index as usize];
        (cluster.box_center, cluster.half_extent) = (0.5 * (low + high), 0.5 * (high - low));
        (cluster.children, cluster.center, cluster.radius) = (children, center, radius);
        if let Shape::Cluster(cluster) = &mut cluster.shape {
            (cluster.area, cluster.normals, cluster.layers) = (area, normals, layers);
        }
        index
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
        let made: [Element; 2] = match element.surface_part() {
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
        let children = made.map(|child| self.push(child));
        self.elements[index as usize].children = children;
        self.splits.push(index);
        (children, true)
    }
}

fn root_outline(scene: &Scene<'_>, surface: u32) -> Outline {
    let source = &scene.surfaces[surface as usize];
    if !matches!(source.form, femc_field::Form::Triangle(_)) {
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
