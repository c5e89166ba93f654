//! Frames of a farm as pictures: where the service, which knows nothing of light, meets the film.
//!
//! [`draw`] is what [`femc_service::Site`] wants: thumbnails as PNG, pixels, and what light statistics know of
//! each, as planes of half floats. [`Partial`] is a frame in work,
//! the same union that the farm will make, of what is there.
#![deny(missing_docs)]

mod partial;
mod planes;
mod thumbnail;

use femc_film::{FilmError, exr};
use femc_model::Role;
use femc_service::{Source, Wanted};
use std::io::Cursor;

pub use partial::Partial;

/// Draws a frame as a thumbnail or as planes of its pixels.
/// - errors: what is wrong with the source.
pub fn draw(source: Source, wanted: Wanted) -> Result<Vec<u8>, String> {
    drawn(source, wanted).map_err(|error| error.to_string())
}

fn drawn(source: Source, wanted: Wanted) -> Result<Vec<u8>, FilmError> {
    match (source, wanted) {
        (Source::Statistics(bytes), Wanted::Maps) => planes::of_statistics(&bytes),
        (Source::Statistics(_), _) => Err(FilmError::Corrupt("light statistics are no picture")),
        (Source::Image(_) | Source::Preview(_) | Source::Parts(..), Wanted::Maps) => {
            Err(FilmError::Corrupt("only light statistics have maps"))
        }
        (Source::Preview(png), Wanted::Thumbnail { height }) => thumbnail::of_picture(&png, height),
        (Source::Preview(_), Wanted::Pixels) => Err(FilmError::Corrupt("a preview has no radiances")),
        (Source::Image(bytes), Wanted::Thumbnail { height }) => {
            thumbnail::of_image(&exr::decode(Cursor::new(bytes))?.image, height)
        }
        (Source::Image(bytes), Wanted::Pixels) => planes::of_exr(&bytes),
        (Source::Parts(parts, artifacts), wanted) => {
            let mut partial = Partial::new(&parts)?;
            for (role, bytes) in artifacts {
                partial.insert(role, &bytes)?;
            }
            let image = partial.image()?;
            match wanted {
                Wanted::Thumbnail { height } => thumbnail::of_image(&image.color, height),
                Wanted::Pixels | Wanted::Maps => Ok(planes::of_frame(&image)),
            }
        }
    }
}

/// Whether an output of this role shows pixels of a frame in work.
pub fn shows_pixels(role: Role) -> bool {
    matches!(role, Role::Tile | Role::Sums | Role::Pixels)
}
