use femc_math::Rgb;
use femc_math::glam::Vec3A;

/// A box of fog.
#[derive(Clone, Copy, Debug)]
pub struct FogCell {
    /// Lower corner, prepared frame, m.
    pub min: Vec3A,
    /// Upper corner.
    pub max: Vec3A,
    /// Index of the first of its two halves, which follow each other; 0: a leaf.
    pub next: u32,
    /// Of a leaf: mean radiance from all around, cd/m2, without what comes straight from light sources, at the middle; and its
    /// change from one side to the other by axis.
    pub mean: [Rgb; 4],
}

/// Boxes of fog; the first holds all.
#[derive(Clone, Debug, Default)]
pub struct FogTree(pub Vec<FogCell>);

impl FogTree {
    /// Mean radiance from all around a point, cd/m2, without what comes straight from light sources; 0 outside of the boxes.
    pub fn mean_radiance(&self, point: Vec3A) -> Rgb {
        let Some(mut cell) = self.0.first() else { return Rgb::ZERO };
        if point.cmplt(cell.min).any() || point.cmpgt(cell.max).any() {
            return Rgb::ZERO;
        }
        while cell.next != 0 {
            let second = &self.0[cell.next as usize + 1];
            cell = if point.cmplt(second.min).any() { &self.0[cell.next as usize] } else { second };
        }
        let local = (point - cell.min) / (cell.max - cell.min) - 0.5;
        let [middle, x, y, z] = cell.mean;
        (middle + x * local.x + y * local.y + z * local.z).max(Rgb::ZERO)
    }
}
