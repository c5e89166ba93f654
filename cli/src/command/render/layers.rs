//! PNG files of layers, beside the file of layers: `FRAME.NAME.png`.

use super::sidecars::layers_path;
use crate::exit::{Failure, failed};
use crate::values::Exposure;
use femc_film::{Image, ToneCurve, exr, file::write_atomic};
use femc_pipeline::Layer;
use std::path::{Path, PathBuf};

/// Writes each layer of a frame as a PNG with the picture's exposure.
/// - `curve`: the picture's tone curve; `None`: the curve of `exposure` for the colors in the file.
pub fn write_pngs(
    frame: &Path,
    layers: &[Layer],
    curve: Option<ToneCurve>,
    exposure: Exposure,
) -> Result<Vec<PathBuf>, Failure> {
    if layers.is_empty() {
        return Ok(Vec::new());
    }
    let file = layers_path(frame);
    let curve = match curve {
        Some(curve) => curve,
        None => exposure.curve_of(&exr::read(&file).map_err(failed)?.image),
    };
    let one = |layer: &Layer| {
        let names = ["R", "G", "B"].map(|channel| format!("{}.{channel}", layer.name));
        let read = exr::read_channels(&file, [&*names[0], &*names[1], &*names[2]]);
        let (width, height, [r, g, b]) = read.map_err(failed)?;
        let pixels = r.into_iter().zip(g).zip(b).map(|((r, g), b)| [r, g, b]).collect();
        let picture = curve.picture(&Image { width, height, pixels });
        let path = frame.with_extension(format!("{}.png", layer.name));
        write_atomic(&path, &picture.to_png().map_err(failed)?).map_err(failed)?;
        Ok(path)
    };
    layers.iter().map(one).collect()
}
