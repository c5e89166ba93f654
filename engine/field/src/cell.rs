use crate::NONE;
use femc_math::glam::Vec2;

/// Split of a cell in two.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// No split: a leaf.
    None,
    /// Split of a rectangle at the middle of its first (0) or second (1) parameter.
    Half(u8),
    /// Split of a triangle from its first corner to the middle of the opposite edge.
    Bisection,
}

/// A corner and two edges over a surface's parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outline {
    /// Corner.
    pub corner: Vec2,
    /// Edges from the corner.
    pub edges: [Vec2; 2],
}

impl Outline {
    /// Outline of a whole surface.
    pub const WHOLE: Self = Self { corner: Vec2::ZERO, edges: [Vec2::X, Vec2::Y] };

    /// Returns the point with these coordinates along the edges.
    pub fn point_at(&self, local: Vec2) -> Vec2 {
        self.corner + self.edges[0] * local.x + self.edges[1] * local.y
    }

    /// Returns the coordinates of a point along the edges.
    pub fn local(&self, point: Vec2) -> Vec2 {
        let ([a, b], p) = (self.edges, point - self.corner);
        Vec2::new(p.perp_dot(b), a.perp_dot(p)) / a.perp_dot(b)
    }

    /// Converts an outline from this one's coordinates.
    pub fn compose(&self, inner: &Self) -> Self {
        let edge = |edge: Vec2| self.edges[0] * edge.x + self.edges[1] * edge.y;
        Self { corner: self.point_at(inner.corner), edges: inner.edges.map(edge) }
    }

    /// Returns the two halves, in coordinates of the whole. The halves of a triangle are oriented so that the edge opposite to the
    /// corner is the longest by `length` of (from, to) in these coordinates.
    pub fn halves(split: Split, length: impl Fn(Vec2, Vec2) -> f32) -> [Self; 2] {
        let half = 0.5;
        match split {
            Split::None | Split::Half(0) => {
                [0.0, half].map(|x| Self { corner: Vec2::new(x, 0.0), edges: [Vec2::new(half, 0.0), Vec2::Y] })
            }
            Split::Half(_) => {
                [0.0, half].map(|y| Self { corner: Vec2::new(0.0, y), edges: [Vec2::X, Vec2::new(0.0, half)] })
            }
            Split::Bisection => {
                let middle = Vec2::splat(half);
                [[Vec2::ZERO, Vec2::X, middle], [Vec2::ZERO, middle, Vec2::Y]]
                    .map(|corners| Self::across_longest(corners, &length))
            }
        }
    }

    /// Creates a triangle whose corner is opposite to its longest edge.
    pub fn across_longest(corners: [Vec2; 3], length: &impl Fn(Vec2, Vec2) -> f32) -> Self {
        let edge = |k: usize| length(corners[(k + 1) % 3], corners[(k + 2) % 3]);
        let first = (1..3).fold(0, |best, k| if edge(k) > edge(best) { k } else { best });
        let [a, b, c] = [0, 1, 2].map(|k| corners[(first + k) % 3]);
        Self { corner: a, edges: [b - a, c - a] }
    }
}

/// A part of a surface.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    /// Outline in the coordinates of the parent cell; for a root, in the surface's parameters.
    pub outline: Outline,
    /// Split of the cell.
    pub split: Split,
    /// Index of the first of its two halves, which are adjacent; for a leaf, index of its data.
    pub next: u32,
}

impl Cell {
    /// Returns the leaf that contains a point, and the point's coordinates in it. `None` for a surface without cells.
    pub fn find(cells: &[Self], root: u32, point: Vec2) -> Option<(u32, Vec2)> {
        if root == NONE {
            return None;
        }
        let mut cell = &cells[root as usize];
        let mut local = cell.outline.local(point);
        loop {
            let Some(half) = cell.half(local) else { return Some((cell.next, local)) };
            cell = &cells[half as usize];
            local = cell.outline.local(local);
        }
    }

    /// Returns the index of the half that contains a point, from its coordinates in the cell. `None` for a leaf.
    #[inline]
    pub fn half(&self, local: Vec2) -> Option<u32> {
        let second = match self.split {
            Split::None => return None,
            Split::Half(0) => local.x >= 0.5,
            Split::Half(_) => local.y >= 0.5,
            Split::Bisection => local.y > local.x,
        };
        Some(self.next + u32::from(second))
    }
}
