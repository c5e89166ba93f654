//! Tables of the directions from which the light of leaves comes: the guides of the method of 1998.
//!
//! Each leaf has the light of its links, and of the links of all elements above it. The light of a link is deposited in the cells of
//! the table in which points of the link's source lie.

use crate::arena::Arena;
use crate::element::Element;
use crate::gather::ElementLights;
use crate::link::Link;
use crate::solve::{fog_leaves, surface_leaves};
use femc_field::{DirectionTable, DirectionTables, NONE, TABLE_CELLS, TableCells, TableExtent};
use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use femc_math::{Frame, warp};
use rayon::prelude::*;
use std::f32::consts::PI;

/// Solid angle of a source for which one more direction is deposited, as a share of the sphere.
const STEP: f32 = 0.5 / TABLE_CELLS as f32;
/// Minimum and maximum number of directions of a disc.
const DIRECTIONS: [usize; 2] = [4, 64];

/// Computes the tables of all leaves.
/// - `links`: links by receiver, ascending.
pub fn direction_tables(arena: &Arena, lights: &ElementLights, links: &[Link]) -> DirectionTables {
    let table = |&leaf: &u32| leaf_table(arena, lights, links, leaf);
    let surfaces = surface_leaves(arena).par_iter().map(table).collect();
    DirectionTables::new(surfaces, fog_leaves(arena).par_iter().map(table).collect())
}

/// Returns the table of a leaf. `None`: no light arrives.
fn leaf_table(arena: &Arena, lights: &ElementLights, links: &[Link], leaf: u32) -> Option<DirectionTable> {
    let receiver = &arena.elements[leaf as usize];
    let patch = receiver.patch();
    let extent = patch.map_or(TableExtent::Sphere, |patch| TableExtent::Hemisphere(patch.normal));
    let cells = TableCells::new(extent);
    let mut light = [0.0; TABLE_CELLS];
    for_each_link(arena, lights, links, leaf, |source, amount| {
        let source = &arena.elements[source as usize];
        let Some(patch) = source.patch() else {
            let disc = Disc { center: source.center, squared_radius: (0.5 * source.radius * source.radius).min(1e30) };
            return deposit(&disc, receiver.center, amount, &cells, &mut light);
        };
        // Each node represents its share of the area.
        let nodes = patch.nodes();
        let squared_radius = patch.part.area / (PI * nodes.len() as f32);
        for node in nodes {
            let disc = Disc { center: node.position, squared_radius };
            deposit(&disc, receiver.center, amount / nodes.len() as f32, &cells, &mut light);
        }
    });
    DirectionTable::new(extent, &light)
}

/// Calls a function with the source of each link of a leaf and of all elements above it, and with the irradiance by the link,
/// positive.
fn for_each_link(arena: &Arena, lights: &ElementLights, links: &[Link], leaf: u32, mut receive: impl FnMut(u32, f32)) {
    let receiver = &arena.elements[leaf as usize];
    let mut at = leaf;
    while at != NONE {
        let p = &arena.elements[at as usize];
        let first = links.partition_point(|link| link.receiver < at);
        for link in links[first..].iter().take_while(|link| link.receiver == at) {
            let q = &arena.elements[link.source as usize];
            let dir = (q.center - p.center).normalize_or(Vec3A::Z);
            let sent = luminance(lights.sent_toward(link.source as usize, q, p.center));
            let factor = if p.is_directional() {
                link.factors[0] * cosine(receiver, dir)
            } else {
                link.factors[..p.node_count()].iter().sum::<f32>() / p.node_count() as f32
            };
            let amount = sent * factor;
            if amount > 0.0 && amount.is_finite() {
                receive(link.source, amount);
            }
        }
        at = p.parent;
    }
}

/// Returns the cosine at a receiver; for a curved one its mean.
fn cosine(receiver: &Element, dir: Vec3A) -> f32 {
    let normal = receiver.normal();
    if normal == Vec3A::ZERO { 0.25 } else { normal.dot(dir).max(0.0) }
}

/// A part of a source, as a disc across the view.
struct Disc {
    center: Vec3A,
    squared_radius: f32,
}

/// Adds the light of a disc to the cells in which it lies, seen from a point.
fn deposit(disc: &Disc, point: Vec3A, amount: f32, cells: &TableCells, light: &mut [f64; TABLE_CELLS]) {
    let way = disc.center - point;
    let distance2 = way.length_squared();
    if distance2 <= 0.0 || !distance2.is_finite() {
        return;
    }
    // A disc of radius r covers about pi r2 over the squared distance, at most the sphere.
    let covered = (0.25 * disc.squared_radius / distance2).min(1.0);
    let count = ((covered / STEP) as usize).clamp(DIRECTIONS[0], DIRECTIONS[1]);
    let frame = Frame::from_normal(way / distance2.sqrt());
    let radius = disc.squared_radius.sqrt();
    let amount = f64::from(amount) / count as f64;
    for k in 0..count {
        let place = warp::disc([(k as f32 + 0.5) / count as f32, (k as f32 * 0.618_034).fract()]);
        let dir = (way + frame.to_world(Vec3A::new(place.x, place.y, 0.0)) * radius).normalize_or(Vec3A::Z);
        if let Some(cell) = cells.find(dir) {
            light[cell] += amount;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disc overhead fills the cells around the pole; a small one to the side fills one cell.
    #[test]
    fn light_is_deposited_where_its_source_is_seen() {
        let extent = TableExtent::Hemisphere(Vec3A::Z);
        let deposited = |center: Vec3A, squared_radius| {
            let mut light = [0.0; TABLE_CELLS];
            deposit(&Disc { center, squared_radius }, Vec3A::ZERO, 3.0, &TableCells::new(extent), &mut light);
            light
        };
        // A disc of half the radius of its distance.
        let wide = deposited(Vec3A::new(0.0, 0.0, 2.0), 1.0);
        let half_angle_cosine = 0.8f32.sqrt();
        let filled = wide.iter().filter(|light| **light > 0.0).count();
        let expected = (1.0 - half_angle_cosine) * TABLE_CELLS as f32;
        assert!((filled as f32 / expected - 1.0).abs() < 0.35, "{filled} for {expected}");
        assert!((wide.iter().sum::<f64>() - 3.0).abs() < 1e-9);
        let dir = Vec3A::new(0.5, 0.33, 0.4);
        let narrow = deposited(dir, 1e-6);
        assert_eq!(narrow[TableCells::new(extent).find(dir.normalize()).expect("above")], 3.0);
        assert!(deposited(-dir, 1e-6).iter().all(|light| *light == 0.0), "below the surface");
        assert!(deposited(Vec3A::ZERO, 1.0).iter().all(|light| *light == 0.0));
    }
}
