//! Solution: the light of elements as a field.

use super::{SolveReport, SolverState};
use crate::arena::{Arena, root_outline};
use crate::census::Census;
use crate::element::{Cluster, Element, Shape};
use crate::gather::{ElementLights, FROM_ELEMENTS, FROM_LAMPS};
use crate::link::Link;
use crate::scene::Scene;
use femc_field::{Cell, Field, Form, Harmonics, Leaf, NONE, Split};
use femc_math::glam::Vec2;

/// Light of a scene, with a report.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Light of the scene, with its direct light.
    pub field: Field,
    /// Report on the solution.
    pub report: SolveReport,
}

impl SolverState {
    /// Creates the solution.
    pub(crate) fn finish(&self, scene: Scene<'_>) -> Solution {
        let elements = &self.arena.elements;
        let report = if self.arena.root == NONE {
            SolveReport::default()
        } else {
            SolveReport {
                elements: elements.iter().filter(|element| element.is_leaf() || !element.is_cluster()).count(),
                leaves: elements.iter().filter(|element| element.is_leaf()).count(),
                links: self.links.len(),
                bytes: self.bytes(self.links.len()) + self.max_ray_bytes,
                census: Census::new(elements, &self.links),
                ..self.report
            }
        };
        let (field, fog) = build_field(scene, &self.arena, &self.lights, &self.links);
        // `Solution::verify` rejects NaN.
        let residual = if fog == FogLight::Valid { report.residual } else { f32::NAN };
        let report = SolveReport { residual, ..report };
        Solution { field, report }
    }
}

/// Returns the leaves of surfaces, in the order of the field. A cluster without parts is the leaf of each of its surfaces.
pub(crate) fn surface_leaves(arena: &Arena) -> Vec<u32> {
    arena.roots.iter().flat_map(|&root| leaves_below(arena, root)).collect()
}

/// Returns the leaves of fog, in the order of the field.
pub(crate) fn fog_leaves(arena: &Arena) -> Vec<u32> {
    leaves_below(arena, arena.fog)
}

/// Returns the leaves below an element, breadth first. [`NONE`] has no leaves.
fn leaves_below(arena: &Arena, root: u32) -> Vec<u32> {
    let mut order: Vec<u32> = [root].into_iter().filter(|root| *root != NONE).collect();
    let mut leaves = Vec::new();
    let mut at = 0;
    while at < order.len() {
        let element = &arena.elements[order[at] as usize];
        if element.is_leaf() {
            leaves.push(order[at]);
        } else {
            order.extend(element.children);
        }
        at += 1;
    }
    leaves
}

/// State of the fog's light in a solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FogLight {
    /// Finite and not negative, or without fog.
    Valid,
    /// Not finite, or negative: the field has no fog.
    Invalid,
}

/// Creates the field of a solution, without tables.
fn build_field(scene: Scene<'_>, arena: &Arena, lights: &ElementLights, links: &[Link]) -> (Field, FogLight) {
    let mut field = Field { roots: vec![NONE; scene.surfaces.len()], ..Field::default() };
    for (surface, &root) in arena.roots.iter().enumerate() {
        if root == NONE {
            continue;
        }
        // Breadth first, so that two halves are adjacent.
        let first = field.cells.len() as u32;
        field.roots[surface] = first;
        let mut order = vec![root];
        let mut at = 0;
        while at < order.len() {
            let element = &arena.elements[order[at] as usize];
            let next = if element.is_leaf() {
                let leaf = |from: usize| match element.shape {
                    Shape::Cluster(Cluster { directional, .. }) => {
                        let light = lights.directional_irradiance(directional as usize, order[at] as usize, from);
                        surface_leaf(&scene, surface, light)
                    }
                    _ => field_leaf(element, order[at], lights, from),
                };
                field.leaves.push(leaf(FROM_ELEMENTS));
                field.errors.push(lights.errors[order[at] as usize]);
                field.direct.push(leaf(FROM_LAMPS));
                field.leaves.len() as u32 - 1
            } else {
                order.extend(element.children);
                first + order.len() as u32 - 2
            };
            field.cells.push(match element.surface_part() {
                Some(part) => Cell {
                    outline: part.in_parent,
                    split: if element.is_leaf() { Split::None } else { part.split },
                    next,
                },
                None => Cell { outline: root_outline(&scene, surface as u32), split: Split::None, next },
            });
            at += 1;
        }
    }
    let mut fog = FogLight::Valid;
    if arena.fog != NONE {
        match crate::fog::fog_tree(&scene, arena, lights, links) {
            Some(tree) => field.fog = tree,
            None => fog = FogLight::Invalid,
        }
    }
    (field.surfaces, field.sides) = (scene.surfaces, scene.sides);
    (field, fog)
}

/// Returns the leaf of a whole surface.
/// - `light`: arriving light by direction.
fn surface_leaf(scene: &Scene<'_>, surface: usize, light: Harmonics) -> Leaf {
    let source = &scene.surfaces[surface];
    let irradiance = || light.cosine_integral(source.point_at(Vec2::splat(1.0 / 3.0)).normal);
    match source.form {
        Form::Triangle(_) => Leaf::Triangle([irradiance(); 3]),
        Form::Parallelogram(_) => Leaf::Rectangle([irradiance(); 4]),
        Form::Curved { .. } => Leaf::Curved(light),
    }
}

fn field_leaf(element: &Element, index: u32, lights: &ElementLights, from: usize) -> Leaf {
    if let Shape::Curved(curved) = &element.shape {
        return Leaf::Curved(lights.directional_irradiance(curved.directional as usize, index as usize, from));
    }
    let values = lights.node_irradiance(index as usize, from);
    if element.is_triangle() { Leaf::Triangle([values[0], values[1], values[2]]) } else { Leaf::Rectangle(values) }
}
