//! Pictures of a farm's frames. This crate connects the service, which has no rendering code, with the film.
//!
//! [`draw_frame`] is the function that [`femc_service::Site`] takes. It draws thumbnails as PNG, and pixels and light statistics as
//! planes of half floats. [`open_light`] answers questions about recorded light paths. [`PartialFrame`] is an unfinished frame. It
//! combines the available outputs as the farm will combine all of them.
#![deny(missing_docs)]

mod compare;
mod light;
mod partial_frame;
mod planes;
mod thumbnail;

use femc_film::{FilmError, exr};
use femc_model::Role;
use femc_service::{PictureKind, PictureSource};
use std::io::Cursor;

pub use compare::compare_pictures;
pub use light::open_light;
pub use partial_frame::PartialFrame;

/// Draws a frame as a thumbnail or as planes of its pixels.
/// - errors: the fault of the source.
pub fn draw_frame(source: PictureSource, wanted: PictureKind) -> Result<Vec<u8>, String> {
    try_draw(source, wanted).map_err(|error| error.to_string())
}

fn try_draw(source: PictureSource, wanted: PictureKind) -> Result<Vec<u8>, FilmError> {
    match (source, wanted) {
        (PictureSource::Statistics(bytes), PictureKind::Maps) => planes::encode_statistics(&bytes),
        (PictureSource::Statistics(bytes), PictureKind::FileMaps) => planes::encode_file(&bytes),
        (PictureSource::Statistics(_), _) => Err(FilmError::Corrupt("light statistics are not a picture")),
        (
            PictureSource::Image(_) | PictureSource::Preview(_) | PictureSource::Parts(..),
            PictureKind::Maps | PictureKind::FileMaps,
        ) => Err(FilmError::Corrupt("only light statistics have maps")),
        (PictureSource::Preview(png), PictureKind::Thumbnail { height }) => thumbnail::from_picture(&png, height),
        (PictureSource::Preview(_), PictureKind::Pixels) => {
            Err(FilmError::Corrupt("a preview contains no radiance values"))
        }
        (PictureSource::Image(bytes), PictureKind::Thumbnail { height }) => {
            thumbnail::from_image(&exr::decode(Cursor::new(bytes))?.image, height)
        }
        (PictureSource::Image(bytes), PictureKind::Pixels) => planes::encode_exr(&bytes),
        (PictureSource::Parts(parts, artifacts), wanted) => {
            let mut partial = PartialFrame::new(&parts)?;
            for (role, bytes) in artifacts {
                partial.insert(role, &bytes)?;
            }
            let image = partial.image()?;
            match wanted {
                PictureKind::Thumbnail { height } => thumbnail::from_image(&image.color, height),
                PictureKind::Pixels | PictureKind::Maps | PictureKind::FileMaps => Ok(planes::encode_frame(&image)),
            }
        }
    }
}

/// Returns whether an output of this role shows pixels of an unfinished frame.
pub fn shows_pixels(role: Role) -> bool {
    matches!(role, Role::Tile | Role::Sums | Role::Pixels)
}
