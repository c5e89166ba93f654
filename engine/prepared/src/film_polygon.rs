//! Convex polygons on the film, pixels.

/// Maximum number of corners of a polygon: four, and one for each side of a clipping rectangle.
const MAX_CORNERS: usize = 8;

/// A convex polygon with either orientation.
#[derive(Clone, Copy, Debug)]
pub struct FilmPolygon {
    corners: [[f32; 2]; MAX_CORNERS],
    count: usize,
}

impl FilmPolygon {
    /// Creates a polygon.
    /// - `corners`: at most four.
    pub(crate) fn new(corners: &[[f32; 2]]) -> Self {
        let mut outline = Self { corners: [[0.0; 2]; MAX_CORNERS], count: corners.len().min(4) };
        outline.corners.iter_mut().zip(corners.iter().take(4)).for_each(|(mine, corner)| *mine = *corner);
        outline
    }

    /// Returns the corners.
    pub(crate) fn corners(&self) -> &[[f32; 2]] {
        &self.corners[..self.count]
    }

    /// Returns the part within a rectangle (\[sutherland1974\]).
    /// - `self`: a polygon of at most four corners.
    #[inline]
    pub fn clip(&self, low: [f32; 2], high: [f32; 2]) -> Self {
        let mut rest = *self;
        for axis in 0..2 {
            rest = rest.clip_side(axis, 1.0, low[axis]).clip_side(axis, -1.0, -high[axis]);
        }
        rest
    }

    /// Returns the part whose coordinate times `sign` is at least `least`.
    #[inline]
    fn clip_side(&self, axis: usize, sign: f32, least: f32) -> Self {
        let mut part = Self { corners: [[0.0; 2]; MAX_CORNERS], count: 0 };
        let mut push = |corner: [f32; 2]| {
            if part.count < MAX_CORNERS {
                part.corners[part.count] = corner;
                part.count += 1;
            }
        };
        for (at, &to) in self.corners().iter().enumerate() {
            let from = self.corners[(at + self.count - 1) % self.count];
            let [a, b] = [from, to].map(|corner| sign * corner[axis] - least);
            if (a < 0.0) != (b < 0.0) {
                let share = a / (a - b);
                let mut cut = [0, 1].map(|i| from[i] + share * (to[i] - from[i]));
                cut[axis] = sign * least;
                push(cut);
            }
            if b >= 0.0 {
                push(to);
            }
        }
        part
    }

    /// Returns twice the signed area of the triangle of the first corner and the side from corner `at`.
    #[inline]
    fn twice_signed_area(&self, at: usize) -> f32 {
        let [o, a, b] = [self.corners[0], self.corners[at], self.corners[at + 1]];
        (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])
    }

    /// Returns the area, pixels2.
    #[inline]
    pub fn area(&self) -> f32 {
        (1..self.count.max(2) - 1).map(|at| 0.5 * self.twice_signed_area(at)).sum::<f32>().abs()
    }

    /// Returns a point that is uniform over the area for `u` in [0, 1)^2; `None` without area.
    #[inline]
    pub fn sample(&self, u: [f32; 2]) -> Option<[f32; 2]> {
        let area = self.area();
        let mut rest = u[0] * area;
        for at in 1..self.count.max(2) - 1 {
            let part = 0.5 * self.twice_signed_area(at).abs();
            if rest < part || at + 2 == self.count && part > 0.0 {
                let [b1, b2] = femc_math::warp::triangle([(rest / part).min(1.0), u[1]]);
                let [o, a, b] = [self.corners[0], self.corners[at], self.corners[at + 1]];
                return Some([0, 1].map(|i| o[i] + b1 * (a[i] - o[i]) + b2 * (b[i] - o[i])));
            }
            rest -= part;
        }
        None
    }

    /// Returns whether a point is inside or on the border.
    #[inline]
    pub fn contains(&self, point: [f32; 2]) -> bool {
        let side = |at: usize| {
            let [a, b] = [self.corners[at], self.corners[(at + 1) % self.count]];
            (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0])
        };
        let (mut left, mut right) = (true, true);
        for at in 0..self.count {
            let side = side(at);
            left &= side >= 0.0;
            right &= side <= 0.0;
        }
        self.count > 2 && (left || right)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_math::SampleStream;

    const LAMP: [[f32; 2]; 4] = [[0.3, 0.2], [2.6, 0.5], [2.4, 1.9], [0.1, 1.2]];

    #[test]
    fn polygon_parts_add_up_to_its_area_and_contain_their_samples() {
        let mirrored = LAMP.map(|[x, y]| [-x, y]);
        for corners in [&LAMP[..], &LAMP[..3], &mirrored] {
            let whole = FilmPolygon::new(corners);
            let mut sum = 0.0;
            for (x, y) in (-4..4).flat_map(|x| (-1..3).map(move |y| (x as f32, y as f32))) {
                let part = whole.clip([x, y], [x + 1.0, y + 1.0]);
                sum += part.area();
                for sample in 0..64 {
                    let u = SampleStream::new(1, 0, 0, sample).next_2d();
                    let Some([px, py]) = part.sample(u) else { continue };
                    let slack = 1e-5;
                    assert!((x - slack..x + 1.0 + slack).contains(&px) && (y - slack..y + 1.0 + slack).contains(&py));
                    let inward = [px + 1e-4 * (x + 0.5 - px), py + 1e-4 * (y + 0.5 - py)];
                    assert!(part.area() < 1e-3 || whole.contains([px, py]) || whole.contains(inward), "{px} {py}");
                }
            }
            assert!((sum - whole.area()).abs() < 1e-5, "{sum} {}", whole.area());
        }
    }

    #[test]
    fn points_are_drawn_uniformly() {
        let part = FilmPolygon::new(&LAMP).clip([0.0, 0.0], [2.0, 1.5]);
        let left = part.clip([0.0, 0.0], [1.0, 1.5]).area() / part.area();
        let n = 4096;
        let found = (0..n).filter(|&i| part.sample(SampleStream::new(2, 0, i, 0).next_2d()).unwrap()[0] < 1.0).count();
        let deviation = (left * (1.0 - left) / n as f32).sqrt();
        assert!((found as f32 / n as f32 - left).abs() < 4.0 * deviation, "{found} of {n}, {left}");
    }

    #[test]
    fn what_is_outside_is_empty_and_a_line_has_no_points() {
        let nothing = FilmPolygon::new(&LAMP).clip([5.0, 5.0], [6.0, 6.0]);
        assert_eq!((nothing.area(), nothing.sample([0.5; 2]), nothing.contains([5.5; 2])), (0.0, None, false));
        assert_eq!(FilmPolygon::new(&[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]).sample([0.5; 2]), None);
        assert!(FilmPolygon::new(&LAMP).contains([1.0, 1.0]) && !FilmPolygon::new(&LAMP).contains([0.0, 0.0]));
    }
}
