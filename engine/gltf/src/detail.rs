//! Detail of the objects within limits on the numbers of triangles and objects.

use crate::objects::ObjectSurfaces;

/// Factors of the deviation that are tried, in this order.
const COARSER: [f64; 5] = [1.0, 2.0, 4.0, 8.0, 16.0];
/// Triangles of a box.
const BOX_TRIANGLES: u64 = 12;
/// Boxes at all places of an object must have fewer triangles than this share of the object's.
const PLACED_BOX_SHARE: u64 = 8;

/// Representation of an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Detail {
    /// All its surfaces.
    Full,
    /// A box at each place.
    PlacedBoxes,
    /// One box around all places.
    OneBox,
    /// Nothing.
    LeftOut,
}

/// Limits of a file.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DetailLimits {
    /// Maximum number of triangles. The triangles of a mesh count once for each copy of it.
    pub triangles: u64,
    /// Maximum number of objects.
    pub objects: usize,
}

/// Details of all objects.
pub(crate) struct DetailPlan {
    /// Deviation of triangles from their shape, as a share of the shape's diagonal.
    pub share: f64,
    /// By object, in the given order: its detail, and the triangles of its full detail at all places.
    pub objects: Vec<(Detail, u64)>,
}

impl DetailPlan {
    /// Chooses the smallest deviation at which all objects are within the limit. If there is none, the objects with the most
    /// triangles become boxes, one after another. Objects with equally many become boxes in their order. Before that, of too many
    /// objects, those with the fewest triangles are left out.
    pub(crate) fn new(objects: &[ObjectSurfaces<'_>], share: f64, limits: DetailLimits) -> Self {
        let mut plan = Self { share, objects: Vec::new() };
        for factor in COARSER {
            plan.share = share * factor;
            plan.objects = objects.iter().map(|object| (Detail::Full, count(object, plan.share))).collect();
            plan.leave_out(limits.objects);
            if plan.sum() <= limits.triangles {
                return plan;
            }
        }
        plan.reduce(objects, limits.triangles);
        plan
    }

    /// Returns the number of triangles if no object becomes a box.
    fn sum(&self) -> u64 {
        let shown = self.objects.iter().filter(|(detail, _)| *detail == Detail::Full);
        shown.fold(0, |sum, (_, triangles)| sum.saturating_add(*triangles))
    }

    /// Returns the objects by falling number of triangles.
    fn order(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.objects.len()).collect();
        order.sort_by_key(|&index| (std::cmp::Reverse(self.objects[index].1), index));
        order
    }

    fn leave_out(&mut self, max_objects: usize) {
        if self.objects.len() > max_objects {
            for index in self.order().into_iter().skip(max_objects) {
                self.objects[index].0 = Detail::LeftOut;
            }
        }
    }

    fn reduce(&mut self, objects: &[ObjectSurfaces<'_>], limit: u64) {
        let order = self.order();
        let mut sum = self.sum();
        // Each pass may free more than the pass before.
        for detail in [Detail::PlacedBoxes, Detail::OneBox, Detail::LeftOut] {
            for &index in &order {
                if sum <= limit {
                    return;
                }
                let (before, full) = self.objects[index];
                let places: u64 = objects[index].pieces.iter().map(|piece| piece.places.len() as u64).sum();
                let chosen = match detail {
                    Detail::PlacedBoxes if places * BOX_TRIANGLES * PLACED_BOX_SHARE > full => Detail::OneBox,
                    other => other,
                };
                let [now, then] = [before, chosen].map(|detail| drawn(detail, places, full));
                if then < now {
                    self.objects[index].0 = chosen;
                    sum = sum - now + then;
                }
            }
        }
    }
}

/// Returns the triangles of an object in some detail.
fn drawn(detail: Detail, places: u64, full: u64) -> u64 {
    match detail {
        Detail::Full => full,
        Detail::PlacedBoxes => places * BOX_TRIANGLES,
        Detail::OneBox => BOX_TRIANGLES,
        Detail::LeftOut => 0,
    }
}

/// Returns the triangles of an object at all its places.
fn count(object: &ObjectSurfaces<'_>, share: f64) -> u64 {
    let pieces = object.pieces.iter();
    pieces.fold(0, |sum, piece| sum.saturating_add(piece.triangles(share).saturating_mul(piece.places.len() as u64)))
}
