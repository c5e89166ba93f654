//! Built-in styles: paintings of `scenes/ball.mgf`, made by `scenes/painter`.

use crate::{ChannelImage, GuideFrame, StylizeError, frames};
use femc_film::{FilmError, Picture};
use std::io::Cursor;

/// Paintings by name.
const PAINTINGS: [(&str, &[u8]); 4] = [
    ("hatching", include_bytes!("../../../scenes/styles/hatching.png")),
    ("watercolor", include_bytes!("../../../scenes/styles/watercolor.png")),
    ("oil", include_bytes!("../../../scenes/styles/oil.png")),
    ("cel", include_bytes!("../../../scenes/styles/cel.png")),
];
/// Render that the paintings were painted from.
const BALL: &[u8] = include_bytes!("../../../scenes/styles/ball.layers.exr");

/// Returns the names of the styles.
pub fn names() -> impl Iterator<Item = &'static str> {
    PAINTINGS.iter().map(|(name, _)| *name)
}

/// Returns the painting with this name, as PNG.
pub fn png(name: &str) -> Option<&'static [u8]> {
    PAINTINGS.iter().find(|(known, _)| *known == name).map(|(_, png)| *png)
}

/// Returns the render that the paintings match pixel by pixel.
/// - errors: the program was built with another file in its place.
pub fn source() -> Result<GuideFrame, FilmError> {
    GuideFrame::decode(Cursor::new(BALL))
}

/// Returns the painting with this name; `None`: there is no such style.
/// - errors: as for [`source`].
pub fn painting(name: &str) -> Option<Result<ChannelImage, StylizeError>> {
    let picture = Picture::from_any_png(png(name)?).map_err(StylizeError::from);
    Some(picture.and_then(|picture| frames::image_from_picture(&picture)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_style_lies_over_the_source() {
        let source = source().expect("a frame");
        assert!(source.names().contains(&"full"), "{:?}", source.names());
        for name in names() {
            let painting = painting(name).expect("a style").expect("an image");
            assert_eq!([painting.width() as u32, painting.height() as u32], source.size(), "{name}");
        }
        assert!(painting("aquatint").is_none());
    }
}
