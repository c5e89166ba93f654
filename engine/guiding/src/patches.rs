//! Search for bright patches: parts of the scene from which much more light comes than their size explains, such as the lit spot
//! of a ceiling, or a globe of glass around a lamp.

use crate::bins::{BIN_LEVELS, LeafBins};
use crate::sums::{PlaceSums, PositionGrid, SumsByBin, SumsByVoxel, VOXEL_LEVELS, VoxelSums};
use femc_field::{Cell, Field, Form, NONE, Outline, Parallelogram, Split, Target};
use femc_math::elementary::ln;
use femc_math::glam::Vec2;
use std::collections::BTreeMap;

/// Minimum gain of a patch: information about where light comes from, in nats for each direction by its light.
const MIN_GAIN: f64 = 0.005;
/// Minimum ratio of the density of light of a patch to that around it.
const MIN_LIFT: f64 = 1.5;
/// Minimum number of directions that reached a patch, and minimum of their effective number.
const MIN_DIRECTIONS: u64 = 32;
const MIN_EFFECTIVE_DIRECTIONS: f64 = 8.0;

/// A bright part of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Parallelogram or ball that contains the part.
    pub target: Target,
    /// Share of the light that directions found there, in 0..1.
    pub share: f32,
}

/// Sums over the directions of a round by the place that they reached.
#[derive(Default)]
pub struct Reached {
    /// Sums by leaf of a flat surface, and bin in it.
    bins: SumsByBin,
    /// Sums by voxel elsewhere.
    voxels: SumsByVoxel,
}

impl Reached {
    /// Adds the sums of a block.
    pub fn add(&mut self, bins: &SumsByBin, voxels: &SumsByVoxel) {
        for (&bin, more) in bins {
            let sums = self.bins.entry(bin).or_default();
            *sums = sums.with(more);
        }
        for (&voxel, more) in voxels {
            let sums = self.voxels.entry(voxel).or_default();
            *sums = sums.with(more);
        }
    }
}

/// A place of the tree in which patches are searched.
struct Place {
    /// Sums over the directions that reached the place, except for those that reached patches within it.
    sums: PlaceSums,
    /// Index of the place around this one, or NONE.
    parent: u32,
    part: Part,
    is_patch: bool,
}

/// Part of the scene at a place.
#[derive(Clone, Copy)]
enum Part {
    /// Part of a surface.
    Flat(Parallelogram),
    /// Voxels.
    Voxels(VoxelSums),
}

/// Finds the brightest patches, those that explain most first. Each is a cell of the field, a part of one, or a ball around voxels.
/// - `most`: maximum number of patches.
pub fn find_patches(field: &Field, grid: &PositionGrid, reached: &Reached, most: usize) -> Vec<Patch> {
    let mut tree = flat_places(field, grid, &reached.bins);
    add_voxels(&mut tree, &reached.voxels);
    let voxels = reached.voxels.values().map(|sums| &sums.place);
    let mut whole = reached.bins.values().chain(voxels).fold(PlaceSums::default(), |whole, it| whole.with(it));
    let all = whole.light();
    let mut out = Vec::new();
    while out.len() < most {
        let rated = tree.iter().enumerate().filter(|(_, place)| !place.is_patch).filter_map(|(at, place)| {
            let around = patch_around(&tree, place.parent);
            let around = tree.get(around as usize).map_or(&whole, |place| &place.sums);
            Some((gain(&place.sums, around, all)?, at))
        });
        let best = rated.fold(None::<(f64, usize)>, |best, it| match best {
            Some(best) if best.0 >= it.0 => Some(best),
            _ => Some(it),
        });
        let Some((_, at)) = best else { break };
        let Place { sums: found, parent, part, .. } = tree[at];
        tree[at].is_patch = true;
        let target = match part {
            Part::Flat(part) => Some(part.into()),
            Part::Voxels(sums) => grid.ball(&sums).map(Target::from),
        };
        out.extend(target.map(|target| Patch { target, share: (found.light() / all) as f32 }));
        let around = patch_around(&tree, parent);
        let mut above = parent;
        while above != around {
            tree[above as usize].sums = tree[above as usize].sums.without(&found);
            above = tree[above as usize].parent;
        }
        let around = tree.get_mut(around as usize).map_or(&mut whole, |place| &mut place.sums);
        *around = around.without(&found);
    }
    out
}

/// Returns the innermost patch that contains a place, which may be the place itself, or NONE.
fn patch_around(tree: &[Place], mut place: u32) -> u32 {
    while place != NONE && !tree[place as usize].is_patch {
        place = tree[place as usize].parent;
    }
    place
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
    let is_sure = place.count >= MIN_DIRECTIONS && place.effective_count() >= MIN_EFFECTIVE_DIRECTIONS;
    (is_sure && is_bright && gain.is_finite() && gain >= MIN_GAIN).then_some(gain)
}

/// Minimum longest edge of a flat triangle, relative to the extent of the scene.
const MIN_TRIANGLE: f32 = 1.0 / 16.0;

/// A cell of a parallelogram or of a large triangle.
struct FlatCell {
    outline: Parallelogram,
    /// Index of the cell around it in the list, or NONE.
    parent: u32,
    /// Leaf of the field, if it is one.
    leaf: Option<u32>,
}

/// Lists the cells of all parallelograms and large triangles. The outline of a triangle is the parallelogram with its edges: mostly,
/// the other half is a triangle, too. Halves come after the cell that contains them.
/// - `extent`: largest extent of the scene, m.
fn flat_cells(field: &Field, extent: f32) -> Vec<FlatCell> {
    let mut out = Vec::new();
    for (surface, &root) in field.surfaces.iter().zip(&field.roots) {
        let [corner, a, b] = match surface.form {
            Form::Parallelogram(form) => form,
            Form::Triangle(form) if form[1].length().max(form[2].length()) >= MIN_TRIANGLE * extent => form,
            Form::Triangle(_) | Form::Curved { .. } => continue,
        };
        let point = |at: Vec2| corner + a * at.x + b * at.y;
        let mut below = if root == NONE { Vec::new() } else { vec![(root, NONE, Outline::WHOLE)] };
        while let Some((cell, parent, around)) = below.pop() {
            let Cell { outline, split, next } = field.cells[cell as usize];
            let outline = around.compose(&outline);
            let origin = point(outline.corner);
            let edges = outline.edges.map(|edge| point(outline.corner + edge) - origin);
            let leaf = (split == Split::None).then_some(next);
            if leaf.is_none() {
                below.extend([0, 1].map(|half| (next + half, out.len() as u32, outline)));
            }
            out.push(FlatCell { outline: Parallelogram { corner: origin, edges }, parent, leaf });
        }
    }
    out
}

/// Returns the bins by leaf of a field. `None` for leaves of curved surfaces and of small triangles.
pub fn leaf_bins(field: &Field, grid: &PositionGrid) -> Vec<Option<LeafBins>> {
    let mut out = vec![None; field.leaves.len()];
    for FlatCell { outline, leaf, .. } in flat_cells(field, grid.extent()) {
        if let Some(leaf) = leaf {
            out[leaf as usize] = Some(LeafBins::new(outline));
        }
    }
    out
}

/// Returns the places of flat surfaces: their cells, and parts of leaves down to bins that directions reached.
/// Parts come after the place that contains them.
fn flat_places(field: &Field, grid: &PositionGrid, sums: &SumsByBin) -> Vec<Place> {
    let mut out = Vec::new();
    let cells = flat_cells(field, grid.extent());
    for FlatCell { outline, parent, .. } in &cells {
        let sums = PlaceSums::default();
        out.push(Place { sums, parent: *parent, part: Part::Flat(*outline), is_patch: false });
    }
    for (cell, FlatCell { outline, leaf, .. }) in cells.iter().enumerate() {
        let Some(leaf) = *leaf else { continue };
        let bins = LeafBins::new(*outline);
        let mut places = BTreeMap::from([((0, 0), cell as u32)]);
        for (&(_, bin), sums) in sums.range((leaf, 0)..(leaf + 1, 0)) {
            let mut parent = cell as u32;
            for level in 1..=BIN_LEVELS {
                let first = bin >> (BIN_LEVELS - level);
                parent = *places.entry((level, first)).or_insert_with(|| {
                    let part = Part::Flat(bins.part(level, first));
                    out.push(Place { sums: PlaceSums::default(), parent, part, is_patch: false });
                    out.len() as u32 - 1
                });
            }
            out[parent as usize].sums = *sums;
        }
    }
    for at in (0..out.len()).rev() {
        let Place { sums, parent, .. } = out[at];
        if let Some(parent) = out.get_mut(parent as usize) {
            parent.sums = parent.sums.with(&sums);
        }
    }
    out
}

/// Adds an octree of voxels. Parts come after the place that contains them.
fn add_voxels(tree: &mut Vec<Place>, voxels: &SumsByVoxel) {
    // The level of the voxels is the last.
    let mut levels = vec![voxels.clone()];
    for _ in 0..VOXEL_LEVELS {
        let mut coarser = SumsByVoxel::new();
        for (voxel, sums) in levels.last().into_iter().flatten() {
            let around = coarser.entry(voxel >> 3).or_default();
            *around = around.with(sums);
        }
        levels.push(coarser);
    }
    let mut around = BTreeMap::new();
    for level in levels.iter().rev() {
        let mut places = BTreeMap::new();
        for (&voxel, sums) in level {
            places.insert(voxel, tree.len() as u32);
            let parent = around.get(&(voxel >> 3)).copied().unwrap_or(NONE);
            tree.push(Place { sums: sums.place, parent, part: Part::Voxels(*sums), is_patch: false });
        }
        around = places;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_field::{Ball, Leaf, Side, Surface};
    use femc_geometry::Aabb;
    use femc_math::Rgb;
    use femc_math::glam::Vec3A;
    use femc_math::hash::{mix64, unit_f32};
    use femc_math::warp;

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

    /// Returns sums of two directions to each of the 64 bins of each leaf, whose light depends on the leaf.
    fn sums(light: impl Fn(u32) -> f32) -> SumsByBin {
        let bin = |at: u32| {
            let mut sums = PlaceSums::default();
            (0..2).for_each(|_| sums.add_direction([light(at / 64), 1.1 * light(at / 64)], 1.0));
            ((at / 64, at % 64), sums)
        };
        (0..16 * 64).map(bin).collect()
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
        let find = |most| find_patches(&field, &grid(), &Reached { bins: sums(light), ..Reached::default() }, most);
        let found = find(8);
        let near = |target: &Parallelogram, corner: [f32; 3], size: f32| {
            target.corner.abs_diff_eq(corner.into(), 1e-5)
                && target.edges[0].abs_diff_eq(Vec3A::X * size, 1e-5)
                && target.edges[1].abs_diff_eq(Vec3A::Y * size, 1e-5)
        };
        assert_eq!(found.len(), 2, "{found:?}");
        let found: Vec<Parallelogram> = found.iter().filter_map(|patch| patch.target.parallelogram()).collect();
        let quarters = found.iter().filter(|patch| near(patch, [0.0, -2.0, 1.0], 2.0));
        let peaks = found.iter().filter(|patch| near(patch, [1.0, -1.0, 1.0], 1.0));
        assert_eq!((quarters.count(), peaks.count()), (1, 1), "{found:?}");
        assert_eq!(find(1).len(), 1);
    }

    fn grid() -> PositionGrid {
        PositionGrid::new(Aabb { min: Vec3A::splat(-2.0), max: Vec3A::splat(2.0) })
    }

    /// A globe of glass that shines in a dim room.
    #[test]
    fn a_bright_ball_is_found() {
        let field = square();
        let globe = Ball { center: Vec3A::new(0.7, -0.3, 0.4), radius: 0.15 };
        let mut voxels = SumsByVoxel::new();
        for k in 0..4000u64 {
            let number = |n: u64| unit_f32((mix64(2 * k + n) >> 32) as u32);
            let end = globe.center + globe.radius * warp::sphere([number(0), number(1)]);
            voxels.entry(grid().voxel(end)).or_default().add_direction(&grid(), end, [1.0; 2], 0.02);
        }
        let mut reached = Reached::default();
        reached.add(&sums(|_| 0.5), &SumsByVoxel::new());
        reached.add(&SumsByBin::new(), &voxels);
        let found = find_patches(&field, &grid(), &reached, 8);
        let [Patch { target: Target::Ball(ball), share }] = found[..] else { panic!("{found:?}") };
        assert!(ball.center.abs_diff_eq(globe.center, 0.01) && (ball.radius - 0.15).abs() < 0.01, "{ball:?}");
        assert!(share > 0.75, "{share}");
    }

    /// Light of a sixteenth of a leaf.
    #[test]
    fn a_patch_is_smaller_than_a_leaf() {
        let field = square();
        let mut bins = sums(|_| 0.5);
        for bin in 16..20 {
            (0..10).for_each(|_| bins.entry((5, bin)).or_default().add_direction([50.0; 2], 1.0));
        }
        let found = find_patches(&field, &grid(), &Reached { bins, ..Reached::default() }, 8);
        let [Patch { target: Target::Parallelogram(part), .. }] = found[..] else { panic!("{found:?}") };
        assert!((part.area() - 1.0 / 16.0).abs() < 1e-5, "{part:?}");
    }

    #[test]
    fn even_light_and_few_directions_make_no_patch() {
        let field = square();
        let find = |bins| find_patches(&field, &grid(), &Reached { bins, ..Reached::default() }, 8);
        assert_eq!(find(sums(|_| 1.0)), []);
        assert_eq!(find(sums(|leaf| 1.0 + 0.2 * (leaf % 3) as f32)), []);
        assert_eq!(find(SumsByBin::new()), []);
        let few = |(at, _)| {
            let mut sums = PlaceSums::default();
            sums.add_direction([if at == (3, 7) { 9e4 } else { 1.0 }; 2], 1.0);
            (at, sums)
        };
        assert_eq!(find(sums(|_| 1.0).into_iter().map(few).collect()), []);
    }
}
