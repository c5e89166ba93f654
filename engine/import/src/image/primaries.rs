//! Conversion from the primaries of a file to those of Rec.709.
//!
//! The Bradford transform (\[lam1985\]) adapts the white point, so that the file's white becomes (1, 1, 1). A texture multiplies a
//! reflectance, and white must still reflect all light.

/// CIE x and y of red, green, blue and white.
pub(super) type Chromaticities = [[f64; 2]; 4];

/// Primaries and white of Rec.709 and sRGB.
pub(super) const REC709: Chromaticities = [[0.64, 0.33], [0.30, 0.60], [0.15, 0.06], [0.3127, 0.3290]];
/// Difference from Rec.709 that counts as rounding of digits.
const DIGITS: f64 = 1e-3;

const BRADFORD: [[f64; 3]; 3] = [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]];

/// A linear map of colors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Matrix([[f64; 3]; 3]);

impl Matrix {
    /// Returns the map from the primaries of a file to Rec.709. Returns `Ok(None)` if they are those of Rec.709, and an error if
    /// they span no color space.
    pub fn to_rec709(from: Chromaticities) -> Result<Option<Self>, DegeneratePrimaries> {
        let near = |a: [f64; 2], b: [f64; 2]| (0..2).all(|k| (a[k] - b[k]).abs() <= DIGITS);
        if (0..4).all(|i| near(from[i], REC709[i])) {
            return Ok(None);
        }
        let (source, target) = (to_xyz(from)?, to_xyz(REC709)?);
        let white = |xy: [f64; 2]| times(&BRADFORD, xyz(xy));
        let (from_white, to_white) = (white(from[3]), white(REC709[3]));
        let mut adapt = BRADFORD;
        for (k, row) in adapt.iter_mut().enumerate() {
            row.iter_mut().for_each(|x| *x *= to_white[k] / from_white[k]);
        }
        let adapted = product(&inverse(&BRADFORD)?, &adapt);
        let whole = product(&inverse(&target)?, &product(&adapted, &source));
        if whole.iter().flatten().all(|x| x.abs() < 1e6) { Ok(Some(Self(whole))) } else { Err(DegeneratePrimaries) }
    }

    /// Returns the color in Rec.709.
    pub fn apply(&self, color: [f32; 3]) -> [f32; 3] {
        times(&self.0, color.map(f64::from)).map(|x| x as f32)
    }
}

/// Error for primaries that span no color space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct DegeneratePrimaries;

/// Returns XYZ of a chromaticity at luminance 1.
fn xyz([x, y]: [f64; 2]) -> [f64; 3] {
    [x / y, 1.0, (1.0 - x - y) / y]
}

/// Returns the map from colors of these primaries to XYZ; (1, 1, 1) has the chromaticity of white.
fn to_xyz([red, green, blue, white]: Chromaticities) -> Result<[[f64; 3]; 3], DegeneratePrimaries> {
    let sum_one = |[x, y]: [f64; 2]| [x, y, 1.0 - x - y];
    let columns = [red, green, blue].map(sum_one);
    let rows: [[f64; 3]; 3] = std::array::from_fn(|k| columns.map(|column| column[k]));
    let scale = times(&inverse(&rows)?, xyz(white));
    let sound = white[1] > 0.0 && scale.iter().all(|x| x.is_finite() && *x != 0.0);
    if sound { Ok(rows.map(|row| [0, 1, 2].map(|k| row[k] * scale[k]))) } else { Err(DegeneratePrimaries) }
}

fn times(matrix: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

fn product(a: &[[f64; 3]; 3], b: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    a.map(|row| std::array::from_fn(|j| (0..3).map(|k| row[k] * b[k][j]).sum()))
}

fn inverse(m: &[[f64; 3]; 3]) -> Result<[[f64; 3]; 3], DegeneratePrimaries> {
    // Rows of cofactors. Cyclic indices give the signs.
    let cofactor = |i: usize, j: usize| {
        let (a, b, c, d) = ((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3);
        m[a][c] * m[b][d] - m[a][d] * m[b][c]
    };
    let determinant: f64 = (0..3).map(|j| m[0][j] * cofactor(0, j)).sum();
    if determinant.abs() < 1e-9 || !determinant.is_finite() {
        return Err(DegeneratePrimaries);
    }
    Ok(std::array::from_fn(|i| std::array::from_fn(|j| cofactor(j, i) / determinant)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn white_stays_white_and_rec_2020_has_its_known_matrix() {
        let rec2020 = [[0.708, 0.292], [0.170, 0.797], [0.131, 0.046], [0.3127, 0.3290]];
        let matrix = Matrix::to_rec709(rec2020).unwrap().unwrap();
        // ITU-R BT.2087.
        let known = [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]];
        for (row, wanted) in matrix.0.iter().flatten().zip(known.iter().flatten()) {
            assert!((row - wanted).abs() < 1e-4, "{:?}", matrix.0);
        }
        // ACES AP0 has a different white point.
        let aces = [[0.7347, 0.2653], [0.0, 1.0], [0.0001, -0.077], [0.32168, 0.33767]];
        let white = Matrix::to_rec709(aces).unwrap().unwrap().apply([1.0; 3]);
        assert!(white.iter().all(|x| (x - 1.0).abs() < 1e-6), "{white:?}");
    }

    #[test]
    fn rec_709_needs_no_matrix_and_collinear_primaries_have_none() {
        assert_eq!(Matrix::to_rec709(REC709), Ok(None));
        let digits = [[0.64, 0.33], [0.3, 0.6], [0.15, 0.06], [0.313, 0.329]];
        assert_eq!(Matrix::to_rec709(digits), Ok(None));
        for bad in [
            [[0.0; 2]; 4],
            [[0.3, 0.3], [0.3, 0.3], [0.1, 0.1], [0.3, 0.3]],
            [[0.6, 0.3], [0.3, 0.6], [0.1, 0.1], [0.3, 0.0]],
        ] {
            assert_eq!(Matrix::to_rec709(bad), Err(DegeneratePrimaries), "{bad:?}");
        }
    }
}
