//! A frame in work as a picture: the same union that the farm will make, of what is there.

use super::client::Farm;
use crate::exit::{Failure, failed};
use femc_film::{Frame, Provenance, Tile, Tiling, exr};
use femc_model::FrameParts;
use std::path::Path;

/// Write what there is of a frame; false if it went on meanwhile, and its parts are gone.
pub async fn write(farm: &Farm, parts: FrameParts, path: &Path) -> Result<bool, Failure> {
    let [width, height] = parts.grid.film;
    let mut frame = Frame::new(Tiling::new(width, height, parts.grid.tile).map_err(failed)?);
    let mut insert = |tile: Tile| frame.insert(tile).map(drop).map_err(failed);
    if let Some(sums) = parts.sums {
        let Some(bytes) = farm.get_if_there(&sums).await? else { return Ok(false) };
        femc_worker::decode_sums(&bytes).map_err(failed)?.into_iter().try_for_each(&mut insert)?;
    }
    for tile in &parts.tiles {
        let Some(bytes) = farm.get_if_there(tile).await? else { return Ok(false) };
        insert(Tile::decode(&bytes).map_err(failed)?)?;
    }
    let image = frame.resolve();
    let provenance = Provenance {
        version: env!("CARGO_PKG_VERSION").into(),
        settings: String::new(),
        scene: String::new(),
        frame: parts.frame,
        seconds: 0.0,
        spp: frame.mean_spp(),
        relative_error: image.error().worst,
        bad: frame.bad(),
    };
    femc_film::file::write_atomic(path, &exr::encode(&image, &provenance).map_err(failed)?).map_err(failed)?;
    Ok(true)
}
