//! Text for the error of a frame. A block in which no sample met light has no error.

use super::human;
use femc_model::BlockCounts;

/// Returns text like `relative error 3.2 %, 2 of 4 blocks met no light`; `None`: nothing was measured.
pub fn error_text(relative_error: Option<f64>, blocks: Option<BlockCounts>) -> Option<String> {
    let is_dark = blocks.is_some_and(BlockCounts::is_dark);
    let error = relative_error.filter(|error| error.is_finite() && !is_dark);
    let error = error.map(|error| format!("relative error {}", human::percent(error)));
    let parts = [error, blocks.and_then(unlit_text)];
    let text = parts.into_iter().flatten().collect::<Vec<_>>().join(", ");
    (!text.is_empty()).then_some(text)
}

/// Returns text about blocks without light; `None`: all blocks have some.
pub fn unlit_text(BlockCounts { all, unlit }: BlockCounts) -> Option<String> {
    match (unlit, all) {
        (0, _) => None,
        (1, 1) => Some("no sample met light".to_owned()),
        _ if unlit == all => Some(format!("no sample met light in any of the {all} blocks")),
        _ => Some(format!("{unlit} of {all} blocks met no light")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_without_light_has_no_error() {
        let of = |error, unlit, all| error_text(error, Some(BlockCounts { all, unlit })).unwrap_or_default();
        assert_eq!(of(Some(0.0), 4, 4), "no sample met light in any of the 4 blocks");
        assert_eq!(of(None, 1, 1), "no sample met light");
        assert_eq!(of(Some(0.05), 2, 4), "relative error 5.00 %, 2 of 4 blocks met no light");
        assert_eq!(of(Some(0.05), 0, 4), "relative error 5.00 %");
        assert_eq!(of(Some(f64::INFINITY), 0, 4), "");
        assert_eq!(
            [error_text(None, None), error_text(Some(0.05), None)],
            [None, Some("relative error 5.00 %".to_owned())]
        );
    }
}
