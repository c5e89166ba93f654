//! Isolines of a grid of values: lines along which the value, interpolated between the points, is constant.

/// A point in columns and rows; the first point of the grid is at (0, 0).
pub type GridPoint = [f64; 2];

/// Values at the points of a grid.
#[derive(Clone, Copy, Debug)]
pub struct ValueGrid<'a> {
    /// Number of columns.
    pub columns: usize,
    /// Values, row after row.
    pub values: &'a [f64],
}

impl ValueGrid<'_> {
    fn at(&self, column: usize, row: usize) -> f64 {
        self.values[row * self.columns + column]
    }

    /// Returns the segments of the isoline of a value: in each square between four points, the line on which linear interpolation
    /// along the sides has the value (marching squares). In a saddle, the mean of the four points decides which sides belong
    /// together.
    pub fn isoline(&self, level: f64) -> Vec<[GridPoint; 2]> {
        let rows = self.values.len() / self.columns.max(1);
        let mut segments = Vec::new();
        for row in 0..rows.saturating_sub(1) {
            for column in 0..self.columns.saturating_sub(1) {
                self.add_square(column, row, level, &mut segments);
            }
        }
        segments
    }

    fn add_square(&self, column: usize, row: usize, level: f64, out: &mut Vec<[GridPoint; 2]>) {
        // Corners and sides counterclockwise; side k begins at corner k.
        let corners = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[x, y]| [column + x, row + y]);
        let values = corners.map(|[x, y]| self.at(x, y));
        let is_above = values.map(|value| value >= level);
        let crossing = |side: usize| {
            let next = (side + 1) % 4;
            let share = (level - values[side]) / (values[next] - values[side]);
            let point = |axis: usize| {
                let [from, to] = [side, next].map(|corner| corners[corner][axis] as f64);
                from + share * (to - from)
            };
            [point(0), point(1)]
        };
        let crossed: Vec<usize> = (0..4).filter(|side| is_above[*side] != is_above[(side + 1) % 4]).collect();
        match crossed[..] {
            [a, b] => out.push([crossing(a), crossing(b)]),
            [a, b, c, d] => {
                // Sides 0 and 1 meet at corner 1, and sides 2 and 3 at corner 3. These corners are cut off unless the center is on
                // their side of the level.
                let is_center_above = values.iter().sum::<f64>() / 4.0 >= level;
                let pairs = if is_center_above == is_above[1] { [[a, d], [b, c]] } else { [[a, b], [c, d]] };
                out.extend(pairs.map(|[x, y]| [crossing(x), crossing(y)]));
            }
            _ => {}
        }
    }
}

/// Returns about six round values strictly between two values: equal steps of 1, 2 or 5 times a power of ten.
pub fn levels(least: f64, greatest: f64) -> Vec<f64> {
    const WANTED: f64 = 6.0;
    let range = greatest - least;
    if !(range > 0.0 && range.is_finite()) {
        return Vec::new();
    }
    let decade = 10_f64.powi((range / WANTED).log10().floor() as i32);
    let step = [1.0, 2.0, 5.0, 10.0].map(|digit| digit * decade).into_iter().find(|step| range / step <= WANTED);
    let step = step.unwrap_or(10.0 * decade);
    let first = (least / step).floor() as i64 + 1;
    (first..).map(|number| number as f64 * step).take_while(|level| *level < greatest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(columns: usize, rows: usize, value: impl Fn(f64, f64) -> f64) -> Vec<f64> {
        (0..rows * columns).map(|at| value((at % columns) as f64, (at / columns) as f64)).collect()
    }

    #[test]
    fn isolines_of_a_plane_are_straight_and_whole() {
        let value = |x: f64, y: f64| 3.0 * x + 4.0 * y;
        let values = grid(9, 7, value);
        let segments = ValueGrid { columns: 9, values: &values }.isoline(20.5);
        assert!(segments.iter().flatten().all(|[x, y]| (value(*x, *y) - 20.5).abs() < 1e-9));
        let length: f64 = segments.iter().map(|[a, b]| (a[0] - b[0]).hypot(a[1] - b[1])).sum();
        // From the left side at (0, 5.125) to the lower side at (6.833, 0).
        assert!((length - 5.125f64.hypot(20.5 / 3.0)).abs() < 1e-9, "{length}");
    }

    #[test]
    fn isolines_around_a_peak_are_closed_circles() {
        let values = grid(41, 41, |x, y| -(x - 20.0).hypot(y - 20.0));
        let segments = ValueGrid { columns: 41, values: &values }.isoline(-12.3);
        let mut ends: Vec<[u64; 2]> = segments.iter().flatten().map(|point| point.map(f64::to_bits)).collect();
        ends.sort_unstable();
        assert!(ends.chunks(2).all(|pair| pair.len() == 2 && pair[0] == pair[1]), "each end belongs to two segments");
        let length: f64 = segments.iter().map(|[a, b]| (a[0] - b[0]).hypot(a[1] - b[1])).sum();
        assert!((length / (12.3 * std::f64::consts::TAU) - 1.0).abs() < 0.01, "{length}");
    }

    /// Two opposite corners are above the level. The center is above it, too, or not.
    #[test]
    fn saddles_connect_what_their_center_connects() {
        let cut = |values: [f64; 4]| ValueGrid { columns: 2, values: &values }.isoline(0.0);
        let connected = cut([3.0, -1.0, -1.0, 3.0]);
        assert_eq!(connected.len(), 2);
        // The corners below the level are cut off: each segment is near one of them.
        let near = |segment: &[GridPoint; 2], corner: GridPoint| {
            segment.iter().all(|point| (point[0] - corner[0]).abs() + (point[1] - corner[1]).abs() < 0.3)
        };
        assert!(
            [[1.0, 0.0], [0.0, 1.0]].iter().all(|corner| connected.iter().any(|it| near(it, *corner))),
            "{connected:?}"
        );
        let separate = cut([1.0, -3.0, -3.0, 1.0]);
        assert!(
            [[0.0, 0.0], [1.0, 1.0]].iter().all(|corner| separate.iter().any(|it| near(it, *corner))),
            "{separate:?}"
        );
    }

    #[test]
    fn levels_are_round_and_inside() {
        assert_eq!(levels(9.8, 101.3), [20.0, 40.0, 60.0, 80.0, 100.0]);
        assert_eq!(levels(0.0, 1.0), [0.2, 0.4, 0.6000000000000001, 0.8]);
        assert_eq!(levels(-3.0, 3.0), [-2.0, -1.0, 0.0, 1.0, 2.0]);
        assert!(levels(2.0, 2.0).is_empty() && levels(1.0, f64::NAN).is_empty());
        for (least, greatest) in [(0.013, 0.77), (1e5, 1.1e5), (3.0, 4000.0)] {
            let levels = levels(least, greatest);
            assert!((2..=6).contains(&levels.len()), "{levels:?}");
            assert!(levels.iter().all(|level| (least..greatest).contains(level)));
        }
    }
}
