//! Search for bright patches: parts of flat surfaces from which much more light comes than their size explains, such as the lit spot
//! of a ceiling.

use crate::sums::{PlaceSums, SumsByPlace};
use femc_field::{Cell, Field, NONE, Outline, Split, Target};
use femc_math::elementary::ln;
use femc_math::glam::Vec2;

/// Minimum gain of a patch: information about where light comes from, in nats for each direction by its light.
const MIN_GAIN: f64 = 0.02;
/// Minimum ratio of the density of light of a patch to that around it.
const MIN_LIFT: f64 = 2.0;
/// Minimum number of directions that reached a patch.
const MIN_DIRECTIONS: u64 = 32;

/// A bright part of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Parallelogram that contains the part.
    pub target: Target,
    /// Share of the light that directions found there, in 0..1.
    pub share: f32,
}

/// Finds the brightest patches, those that explain most first. Each is a cell of the field.
/// - `sums`: sums by leaf that directions reached;
/// - `most`: maximum number of patches.
pub fn find_patches(field: &Field, sums: &SumsByPlace, most: usize) -> Vec<Patch> {
    // Halves come after the cell that contains them.
    let mut places = vec![PlaceSums::default(); field.cells.len()];
    for (at, cell) in field.cells.iter().enumerate().rev() {
        places[at] = match cell.split {
            Split::None => sums.get(&cell.next).copied().unwrap_or_default(),
            _ => places[cell.next as usize].with(&places[cell.next as usize + 1]),
        };
    }
    let mut whole = sums.values().fold(PlaceSums::default(), |whole, it| whole.with(it));
    let all = whole.light();
    let mut parents = vec![NONE; field.cells.len()];
    for (at, cell) in field.cells.iter().enumerate().filter(|(_, cell)| cell.split != Split::None) {
        (0..2).for_each(|half| parents[cell.next as usize + half] = at as u32);
    }
    let polygons = cells_of_polygons(field);
    // Patch around each cell, or NONE. Patches can lie within others.
    let mut around = vec![NONE; field.cells.len()];
    let mut out = Vec::new();
    while out.len() < most {
        let rated = polygons.iter().filter_map(|&(cell, surface)| {
            let outer = around[cell as usize];
            let outer = if outer == NONE { &whole } else { &places[outer as usize] };
            Some((gain(&places[cell as usize], outer, all)?, cell, surface))
        });
        let best = rated.fold(None::<(f64, u32, u32)>, |best, it| match best {
            Some(best) if best.0 >= it.0 => Some(best),
            _ => Some(it),
        });
        let Some((_, cell, surface)) = best else { break };
        let found = places[cell as usize];
        out.push(Patch { target: outline_target(field, &parents, cell, surface), share: (found.light() / all) as f32 });
        let outer = around[cell as usize];
        let mut above = parents[cell as usize];
        while above != NONE && above != outer {
            places[above as usize] = places[above as usize].without(&found);
            above = parents[above as usize];
        }
        let outer = if outer == NONE { &mut whole } else { &mut places[outer as usize] };
        *outer = outer.without(&found);
        let mut within = vec![cell];
        while let Some(inner) = within.pop() {
            let Cell { split, next, .. } = field.cells[inner as usize];
            if split != Split::None {
                for half in [next, next + 1] {
                    // Cells of an inner patch keep it as their patch.
                    if around[half as usize] != half {
                        around[half as usize] = cell;
                        within.push(half);
                    }
                }
            }
        }
        // A patch is not chosen again.
        around[cell as usize] = cell;
    }
    out
}

/// Returns the gain when a place gets a density of directions of its own, apart from that of the rest around it. `None`: too little.
/// - `outer`: sums of the place and the rest;
/// - `all`: light of the whole scene.
fn gain(place: &PlaceSums, outer: &PlaceSums, all: f64) -> Option<f64> {
    let rest = outer.without(place);
    let density = |sums: &PlaceSums| sums.light() / sums.chance();
    let information = |sums: &PlaceSums| match sums.light() {
        light if light > 0.0 => light / all * f64::from(ln((density(sums) / density(outer)) as f32)),
        _ => 0.0,
    };
    let gain = information(place) + information(&rest);
    let is_bright = density(place) >= MIN_LIFT * density(outer);
    (place.count >= MIN_DIRECTIONS && is_bright && gain.is_finite() && gain >= MIN_GAIN).then_some(gain)
}

/// Returns the cells of polygons, each with its surface.
fn cells_of_polygons(field: &Field) -> Vec<(u32, u32)> {
    let mut out = Vec::new();
    for (surface, &root) in field.roots.iter().enumerate() {
        if root == NONE || !field.surfaces[surface].is_polygon() {
            continue;
        }
        let mut below = vec![root];
        while let Some(cell) = below.pop() {
            out.push((cell, surface as u32));
            let Cell { split, next, .. } = field.cells[cell as usize];
            if split != Split::None {
                below.extend([next, next + 1]);
            }
        }
    }
    out
}

/// Returns the parallelogram of a cell.
fn outline_target(field: &Field, parents: &[u32], cell: u32, surface: u32) -> Target {
    let mut outline = field.cells[cell as usize].outline;
    let mut around = parents[cell as usize];
    while around != NONE {
        outline = field.cells[around as usize].outline.compose(&outline);
        around = parents[around as usize];
    }
    let Outline { corner, edges } = outline;
    let point = |at: Vec2| field.surfaces[surface as usize].point_at(at).position;
    let origin = point(corner);
    Target { corner: origin, edges: edges.map(|edge| point(corner + edge) - origin) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_field::{Form, Leaf, Side, Surface};
    use femc_math::Rgb;
    use femc_math::glam::Vec3A;

    /// A square of 4 m with 16 leaves, cut along its parameters in turn.
    fn square() -> Field {
        let (mut outlines, mut cells, mut leaves) = (vec![(Outline::WHOLE, 0)], Vec::new(), Vec::new());
        while let Some(&(outline, depth)) = outlines.get(cells.len()) {
            let split = if depth < 4 { Split::Half(depth % 2) } else { Split::None };
            let next = if split == Split::None {
                leaves.push(Leaf::Triangle([Rgb::ONE; 3]));
                leaves.len() - 1
            } else {
                outlines.extend(Outline::halves(split, |a, b| (b - a).length()).map(|half| (half, depth + 1)));
                outlines.len() - 2
            };
            cells.push(Cell { outline, split, next: next as u32 });
        }
        let form = Form::Parallelogram([Vec3A::new(-2.0, -2.0, 1.0), Vec3A::X * 4.0, Vec3A::Y * 4.0]);
        let surface = Surface { instance: 0, primitives: [0; 2], material: 0, side: Side::Front, form };
        Field { surfaces: vec![surface], roots: vec![0], cells, leaves, ..Field::default() }
    }

    /// Returns sums of 100 directions to each leaf, whose light depends on the leaf.
    fn sums(light: impl Fn(u32) -> f32) -> SumsByPlace {
        let of_leaf = |leaf| {
            let mut sums = PlaceSums::default();
            (0..100).for_each(|_| sums.add_direction([light(leaf), 1.1 * light(leaf)], 1.0));
            (leaf, sums)
        };
        (0..16).map(of_leaf).collect()
    }

    #[test]
    fn the_bright_part_of_a_surface_is_found() {
        let field = square();
        let leaf_at = |x: f32, y: f32| Cell::find(&field.cells, 0, Vec2::new(x, y)).expect("a leaf").0;
        // A quarter of the square, and within it a brighter leaf.
        let quarter: Vec<u32> = [0.6, 0.9].iter().flat_map(|x| [0.1, 0.4].map(|y| leaf_at(*x, y))).collect();
        let peak = leaf_at(0.9, 0.4);
        let light = |leaf: u32| match leaf {
            leaf if leaf == peak => 20.0,
            leaf if quarter.contains(&leaf) => 5.0,
            _ => 0.5,
        };
        let found = find_patches(&field, &sums(light), 8);
        let near = |target: &Target, corner: [f32; 3], size: f32| {
            target.corner.abs_diff_eq(corner.into(), 1e-5)
                && target.edges[0].abs_diff_eq(Vec3A::X * size, 1e-5)
                && target.edges[1].abs_diff_eq(Vec3A::Y * size, 1e-5)
        };
        assert_eq!(found.len(), 2, "{found:?}");
        let quarters = found.iter().filter(|patch| near(&patch.target, [0.0, -2.0, 1.0], 2.0));
        let peaks = found.iter().filter(|patch| near(&patch.target, [1.0, -1.0, 1.0], 1.0));
        assert_eq!((quarters.count(), peaks.count()), (1, 1), "{found:?}");
        assert_eq!(find_patches(&field, &sums(light), 1).len(), 1);
    }

    #[test]
    fn even_light_and_few_directions_make_no_patch() {
        let field = square();
        assert_eq!(find_patches(&field, &sums(|_| 1.0), 8), []);
        assert_eq!(find_patches(&field, &sums(|leaf| 1.0 + (leaf % 3) as f32), 8), []);
        assert_eq!(find_patches(&field, &SumsByPlace::new(), 8), []);
        let few = |(leaf, _)| {
            let mut sums = PlaceSums::default();
            sums.add_direction([if leaf == 3 { 90.0 } else { 1.0 }; 2], 1.0);
            (leaf, sums)
        };
        assert_eq!(find_patches(&field, &sums(|_| 1.0).into_iter().map(few).collect(), 8), []);
    }
}
