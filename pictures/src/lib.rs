//! Pictures of a farm's frames. This crate connects the service, which has no rendering code, with the film.
//!
//! [`draw`] is the function that [`femc_service::Site`] takes. It draws thumbnails as PNG, and pixels and light statistics as
//! planes of half floats. [`Partial`] is an unfinished frame. It combines the available outputs as the farm will combine all of
//! them.
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
/// - errors: the fault of the source.
pub fn draw(source: Source, wanted: Wanted) -> Result<Vec<u8>, String> {
    drawn(source, wanted).map_err(|error| error.to_string())
}

fn drawn(source: Source, wanted: Wanted) -> Result<Vec<u8>, FilmError> {
    match (source, wanted) {
        (Source::Statistics(bytes), Wanted::Maps) => planes::of_statistics(&bytes),
        (Source::Statistics(_), _) => Err(FilmError::Corrupt("light statistics are not a picture")),
        (Source::Image(_) | Source::Preview(_) | Source::Parts(..), Wanted::Maps) => {
            Err(FilmError::Corrupt("only light statistics have maps"))
        }
        (Source::Preview(png), Wanted::Thumbnail { height }) => thumbnail::of_picture(&png, height),
        (Source::Preview(_), Wanted::Pixels) => Err(FilmError::Corrupt("a preview contains no radiance values")),
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

/// Returns whether an output of this role shows pixels of an unfinished frame.
pub fn shows_pixels(role: Role) -> bool {
    matches!(role, Role::Tile | Role::Sums | Role::Pixels)
}
