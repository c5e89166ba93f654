//! Reader of the two lists of angles.

use super::{Remarks, numbers::Numbers};
use crate::{ImportError, ImportFault};
use femc_scene::PhotometryType;

pub(super) fn vertical(
    numbers: &mut Numbers<'_>,
    kind: PhotometryType,
    count: usize,
    remarks: &mut Remarks,
) -> Result<Vec<f64>, ImportError> {
    let what = "vertical angle";
    let (angles, whole) = match kind {
        PhotometryType::C => {
            let angles = numbers.ascending_numbers(
                count,
                what,
                0.0,
                180.0,
                "in [0, 180] and greater than the previous angle",
            )?;
            let whole = matches!(angles[..], [0.0 | 90.0, .., 90.0 | 180.0]);
            (angles, whole)
        }
        PhotometryType::A | PhotometryType::B => {
            let angles = numbers.ascending_numbers(
                count,
                what,
                -90.0,
                90.0,
                "in [-90, 90] and greater than the previous angle",
            )?;
            let whole = matches!(angles[..], [-90.0 | 0.0, .., 90.0]);
            (angles, whole)
        }
    };
    if !whole {
        let what = "vertical angles cover neither a quadrant nor a half: used unchanged, with no light beyond them";
        remarks.warn(numbers.position(), what);
    }
    Ok(angles)
}

/// Reads the horizontal angles. Also returns whether 360 was added to close the circle.
pub(super) fn horizontal(
    numbers: &mut Numbers<'_>,
    kind: PhotometryType,
    count: usize,
    remarks: &mut Remarks,
) -> Result<(Vec<f64>, bool), ImportError> {
    let what = "horizontal angle";
    if let PhotometryType::A | PhotometryType::B = kind {
        let angles =
            numbers.ascending_numbers(count, what, -90.0, 90.0, "in [-90, 90] and greater than the previous angle")?;
        if !matches!(angles[..], [0.0] | [-90.0 | 0.0, .., 90.0]) {
            let what =
                "horizontal angles cover neither a quadrant nor a half: used unchanged, with no light beyond them";
            remarks.warn(numbers.position(), what);
        }
        return Ok((angles, false));
    }
    numbers.peek_field();
    let start = numbers.position();
    let mut angles =
        numbers.ascending_numbers(count, what, 0.0, 360.0, "in [0, 360] and greater than the previous angle")?;
    let mut wrap = false;
    let closes = "horizontal angles do not cover a full turn: the first plane closes the circle";
    match angles[..] {
        [_] | [0.0, .., 90.0 | 180.0 | 360.0] | [90.0, .., 270.0] => {}
        [0.0, .., last] if last > 180.0 => {
            remarks.warn(numbers.position(), closes);
            angles.push(360.0);
            wrap = true;
        }
        [0.0, .., last] => {
            let end = if last < 90.0 { 90 } else { 180 };
            remarks.warn(
                numbers.position(),
                format!("horizontal angles end at {last}: the last plane is used up to {end}"),
            );
        }
        // The table itself closes the circle.
        [first, .., last] if last - first > 180.0 => remarks.warn(numbers.position(), closes),
        [first, ..] => {
            let allowed = "0, because no other first angle defines how the planes repeat (except 90 to 270)";
            return Err(ImportError::new(
                start,
                ImportFault::OutOfRange { what: "first horizontal angle", value: first, allowed },
            ));
        }
        [] => {}
    }
    Ok((angles, wrap))
}
