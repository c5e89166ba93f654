//! The search for source patches, with a price on patches that are used often.
//!
//! A target patch pays the energy of its source patch plus a **price**. The price grows with the use of the source patch's pixels
//! by other target patches, relative to the mean use. A source patch that is the best for many is thus left to some of them, and
//! the whole painting is used (\[kaspar2015\]). A target patch tries the source patches that follow from those of its four
//! neighbors (\[ashikhmin2001\]). It also tries some that are drawn below nodes of a k-d tree of the source patches: from the leaf
//! that the target patch falls into, where patches are most similar to it, up to the root. Patches that look alike are all used
//! often, so a search for only the nearest patch would find nothing cheaper.
//!
//! Target patches change in turns. In a turn, every fourth patch of every fourth row makes a list of wishes, using the field and
//! the prices after the previous turn. The wishes are then granted one after the other, at prices that include the wishes granted
//! before. Threads therefore do not wait for each other and change no bit, and target patches that wish for the same source patch
//! do not all get it. Each grant lowers the sum of all energies and half of all prices.

use crate::basis::Basis;
use crate::tree::Tree;
use crate::{PatchField, PatchGrid, Patches};
use femc_math::hash::mix32;
use rayon::prelude::*;

/// Distance in columns and rows between target patches of a turn.
const STRIDE: usize = 4;
/// Offsets of the neighbors whose source patches are tried.
const NEIGHBORS: [[isize; 2]; 4] = [[-1, 0], [1, 0], [0, -1], [0, 1]];
/// Number of source patches that a target patch draws in a pass.
const DRAWS_PER_PASS: u32 = 2;
/// Number of wishes of a target patch.
const PROPOSALS: usize = 4;

/// The search state at a level of the pyramids: source, prices and the current field.
pub(crate) struct Search<'a> {
    source: &'a Patches,
    tree: Tree,
    /// Leaf of the tree that each target patch falls into.
    leaves: Vec<u32>,
    prices: Prices,
    field: PatchField,
    /// Source patches of the target patches in the previous frame; an invalid number means unknown.
    previous: Vec<u32>,
}

/// Takes the nearest source patch in the leaf that each target patch falls into.
pub(crate) fn first_guess(source: &Patches, target: &Patches) -> PatchField {
    let (tree, leaves) = index_patches(source, target);
    let nearest = |(q, &leaf): (usize, &u32)| {
        let energy = |&p: &u32| source.energy(p, target, q as u32, u32::MAX);
        tree.points_below(leaf, 0).iter().copied().min_by_key(energy).unwrap_or_default()
    };
    let patches = leaves.par_iter().enumerate().map(nearest).collect();
    PatchField { target: target.grid(), source: source.grid(), patches }
}

/// Returns the field after a number of passes for a fixed target.
/// - `price`: price of mean use, an energy.
pub fn search(source: &Patches, target: &Patches, price: f64, passes: u32) -> PatchField {
    let mut search = Search::new(source, target, first_guess(source, target), price, Vec::new());
    (1..=passes).for_each(|salt| search.pass(target, salt));
    search.field
}

fn index_patches(source: &Patches, target: &Patches) -> (Tree, Vec<u32>) {
    let basis = Basis::from_patches(source);
    let tree = Tree::new(&basis.points(source));
    let leaves = basis.points(target).par_iter().map(|point| tree.leaf(point)).collect();
    (tree, leaves)
}

impl<'a> Search<'a> {
    /// Starts from a field.
    /// - `target`: target patches with the image that the field paints;
    /// - `price`: price of mean use, an energy;
    /// - `previous`: a source patch that each target patch tries first; empty: none. Invalid numbers count as none.
    pub(crate) fn new(
        source: &'a Patches,
        target: &Patches,
        field: PatchField,
        price: f64,
        previous: Vec<u32>,
    ) -> Self {
        let (tree, leaves) = index_patches(source, target);
        let prices = Prices::new(&field, price);
        Self { source, tree, leaves, prices, field, previous }
    }

    /// Returns the field.
    pub(crate) fn field(&self) -> &PatchField {
        &self.field
    }

    /// Gives every target patch a turn.
    /// - `target`: target patches with the image painted so far;
    /// - `salt`: number of this pass, for its random draws.
    pub(crate) fn pass(&mut self, target: &Patches, salt: u32) {
        let patches = self.field.patches.par_iter().enumerate();
        let mut energies: Vec<u32> = patches.map(|(q, &p)| self.source.energy(p, target, q as u32, u32::MAX)).collect();
        let targets = self.field.target;
        for turn in 0..STRIDE * STRIDE {
            // Consecutive turns lie apart.
            let place = 5 * turn % (STRIDE * STRIDE);
            let rows: Vec<usize> = (place / STRIDE..targets.rows()).step_by(STRIDE).collect();
            let columns = || (place % STRIDE..targets.columns()).step_by(STRIDE);
            let wish = |x: usize, y: usize| self.propose(target, &energies, [x, y], salt);
            let of_row = |&y: &usize| columns().filter_map(|x| wish(x, y)).collect::<Vec<_>>();
            let wishes: Vec<Vec<Proposal>> = rows.par_iter().map(of_row).collect();
            wishes.iter().flatten().for_each(|wish| self.apply(wish, &mut energies));
        }
    }

    /// Returns source patches that would be cheaper for a target patch; `None`: there are none.
    fn propose(&self, target: &Patches, energies: &[u32], [x, y]: [usize; 2], salt: u32) -> Option<Proposal> {
        let PatchField { target: targets, source: sources, patches } = &self.field;
        let q = targets.at(x, y);
        let has = patches[q as usize];
        let mine = sources.corner(has);
        let pays = energies[q as usize].saturating_add(self.prices.price_excluding(has, mine));
        let mut wish = Proposal { q, best: [Candidate { cost: pays, p: has, energy: 0 }; PROPOSALS] };
        let mut consider = |p: u32| {
            if wish.best.iter().all(|known| known.p != p) {
                let (limit, price) = (wish.best[PROPOSALS - 1].cost, self.prices.price_excluding(p, mine));
                let energy = self.source.energy(p, target, q, limit.saturating_sub(price));
                wish.add(Candidate { cost: energy.saturating_add(price), p, energy });
            }
        };
        let before = self.previous.get(q as usize).filter(|&&p| (p as usize) < sources.count());
        before.into_iter().for_each(|&p| consider(p));
        for [dx, dy] in NEIGHBORS {
            if let Some(neighbor) = targets.neighbor([x, y], [dx, dy]) {
                let (u, v) = sources.corner(patches[neighbor as usize]);
                sources.neighbor([u, v], [-dx, -dy]).into_iter().for_each(&mut consider);
            }
        }
        for draw in 0..DRAWS_PER_PASS {
            let random = mix32(q ^ mix32(salt * DRAWS_PER_PASS + draw));
            let below = self.tree.points_below(self.leaves[q as usize], mix32(random) % (self.tree.height() + 1));
            consider(below[((u64::from(random) * below.len() as u64) >> 32) as usize]);
        }
        (wish.best[0].p != has).then_some(wish)
    }

    /// Assigns to a target patch the cheapest of its current source patch and its wishes.
    fn apply(&mut self, wish: &Proposal, energies: &mut [u32]) {
        let q = wish.q as usize;
        let has = self.field.patches[q];
        let mine = self.field.source.corner(has);
        let wished = wish.best.iter().filter(|candidate| candidate.p != has).map(|it| (it.p, it.energy));
        let pays = |&(p, energy): &(u32, u32)| energy.saturating_add(self.prices.price_excluding(p, mine));
        let Some((p, energy)) = [(has, energies[q])].into_iter().chain(wished).min_by_key(pays) else { return };
        if p != has {
            self.prices.move_use(has, p);
            (self.field.patches[q], energies[q]) = (p, energy);
        }
    }
}

/// A candidate source patch for a target patch.
#[derive(Clone, Copy)]
struct Candidate {
    cost: u32,
    p: u32,
    energy: u32,
}

/// Candidates that are cheaper for a target patch than its current source patch.
struct Proposal {
    q: u32,
    /// Candidates, the cheapest first; unused entries hold the current source patch.
    best: [Candidate; PROPOSALS],
}

impl Proposal {
    fn add(&mut self, candidate: Candidate) {
        let at = self.best.partition_point(|known| known.cost <= candidate.cost);
        if at < PROPOSALS {
            self.best[at..].rotate_right(1);
            self.best[at] = candidate;
        }
    }
}

/// Prices of source patches.
struct Prices {
    grid: PatchGrid,
    /// Load of each source patch: number of uses, summed over its pixels.
    loads: Vec<u32>,
    /// Price of a load of 1, times [`Self::ONE`].
    unit: u64,
}

impl Prices {
    const ONE: f64 = 65536.0;

    fn new(field: &PatchField, price: f64) -> Self {
        let (grid, patch) = (field.source, field.source.patch() as f64);
        let mut uses = vec![0; grid.count()];
        field.patches.iter().for_each(|&p| uses[p as usize] += 1);
        let mean = field.patches.len() as f64 / grid.count() as f64 * patch.powi(4);
        let unit = (price / mean * Self::ONE).round() as u64;
        let mut prices = Self { grid, loads: vec![0; grid.count()], unit };
        prices.count_loads(&uses);
        prices
    }

    fn move_use(&mut self, from: u32, to: u32) {
        self.add(from, u32::wrapping_sub);
        self.add(to, u32::wrapping_add);
    }

    /// Adds or removes a use of a patch, depending on `operation`.
    fn add(&mut self, p: u32, operation: impl Fn(u32, u32) -> u32) {
        let ((x, y), patch) = (self.grid.corner(p), self.grid.patch());
        let near = |at: usize, end: usize| at.saturating_sub(patch - 1)..(at + patch).min(end);
        for v in near(y, self.grid.rows()) {
            let high = (patch - v.abs_diff(y)) as u32;
            for u in near(x, self.grid.columns()) {
                let load = &mut self.loads[self.grid.at(u, v) as usize];
                *load = operation(*load, high * (patch - u.abs_diff(x)) as u32);
            }
        }
    }

    /// Computes the loads of all uses.
    fn count_loads(&mut self, uses: &[u32]) {
        // Two patches share (patch - |dx|) (patch - |dy|) pixels.
        let (columns, patch) = (self.grid.columns(), self.grid.patch());
        let mut along = vec![0; uses.len()];
        for (uses, row) in uses.chunks(columns).zip(along.chunks_mut(columns)) {
            tent(uses, 1, row, patch);
        }
        for column in 0..columns {
            tent(&along[column..], columns, &mut self.loads[column..], patch);
        }
    }

    /// Returns the price of `p` for a target patch whose current source patch has its corner at `own_corner`; this use does not
    /// count.
    #[inline]
    fn price_excluding(&self, p: u32, own_corner: (usize, usize)) -> u32 {
        let (x, y) = self.grid.corner(p);
        let beside = |a: usize, b: usize| self.grid.patch().saturating_sub(a.abs_diff(b)) as u32;
        let others = self.loads[p as usize] - beside(x, own_corner.0) * beside(y, own_corner.1);
        (u64::from(others).saturating_mul(self.unit) >> 16).min(u64::from(u32::MAX)) as u32
    }
}

/// Filters every `step`th value with a tent of `2 patch - 1` values.
fn tent(values: &[u32], step: usize, out: &mut [u32], patch: usize) {
    let count = values.len().div_ceil(step);
    let value = |at: usize| if at < count { values[at * step] } else { 0 };
    // The weight of value i at position o is patch - |i - o|: weights ahead grow by 1 per step, weights behind fall by 1.
    let mut sum: u32 = (0..patch - 1).map(|i| (patch - 1 - i) as u32 * value(i)).sum();
    let mut ahead: u32 = (0..patch - 1).map(value).sum();
    let mut behind = 0;
    for at in 0..count {
        ahead += value(at + patch - 1);
        sum = sum + ahead - behind;
        out[at * step] = sum;
        ahead -= value(at);
        behind += value(at);
        if at >= patch {
            behind -= value(at - patch);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loads_are_pixels_that_patches_share_also_after_changes() {
        let grid = PatchGrid::new(13, 11, 5);
        let patches: Vec<u32> = (0..40u32).map(|at| mix32(at) % grid.count() as u32).collect();
        let field = PatchField { target: PatchGrid::new(44, 5, 5), source: grid, patches };
        let mut prices = Prices::new(&field, 1.0);
        let mut field = field;
        for q in [3, 17, 30] {
            let to = mix32(1000 + q) % grid.count() as u32;
            prices.move_use(std::mem::replace(&mut field.patches[q as usize], to), to);
        }
        let shared = |a: u32, b: u32| {
            let ((x, y), (u, v)) = (grid.corner(a), grid.corner(b));
            (5usize.saturating_sub(x.abs_diff(u)) * 5usize.saturating_sub(y.abs_diff(v))) as u32
        };
        for p in 0..grid.count() as u32 {
            let load: u32 = field.patches.iter().map(|&other| shared(p, other)).sum();
            assert_eq!(prices.loads[p as usize], load, "patch {p}");
        }
    }
}
