//! Iteration over the leaves of a surface.

use crate::{Field, NONE, Outline, Split};

impl Field {
    /// Returns all leaves of a surface with their outlines over its parameters; none for a surface without cells. They cover the
    /// surface without overlap.
    pub fn leaves_of(&self, surface: u32) -> Vec<(u32, Outline)> {
        let mut leaves = Vec::new();
        let mut pending = match self.roots[surface as usize] {
            NONE => Vec::new(),
            root => vec![(root, Outline::WHOLE)],
        };
        while let Some((index, around)) = pending.pop() {
            let cell = &self.cells[index as usize];
            let outline = around.compose(&cell.outline);
            if cell.split == Split::None {
                leaves.push((cell.next, outline));
            } else {
                pending.extend([cell.next + 1, cell.next].map(|half| (half, outline)));
            }
        }
        leaves
    }
}
