//! Guide file that styles are painted from and matched with: five layers of light in half floats, albedo and depth.

use crate::PainterError;
use femc_film::FilmError;
use femc_film::exr::{self, NamedChannel, Precision};
use std::collections::BTreeMap;
use std::path::Path;

/// Layers of `--layers guides`.
pub const LAYERS: [&str; 5] = ["full", "direct_diffuse", "direct_specular", "two_diffuse", "diffuse_interreflection"];

/// Layers of a render, row by row; light in cd/m2.
#[derive(Clone, Debug, PartialEq)]
pub struct Guides {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Layers in the order of [`LAYERS`].
    pub layers: [Vec<[f32; 3]>; 5],
    /// Albedo of the first surface, 0..1.
    pub albedo: Vec<[f32; 3]>,
    /// Depth of the first surface along the view, meters.
    pub depth: Vec<f32>,
}

impl Guides {
    /// Reads guides from a file that [`Guides::encode`] made.
    pub fn read(path: &Path) -> Result<Self, PainterError> {
        let (layers, size) = read_layers(path)?;
        let SurfaceLayers { albedo, depth, .. } = read_surface_layers(path)?;
        Ok(Self { width: size.0, height: size.1, layers, albedo, depth })
    }

    /// Reads a frame `NAME.exr`, and `NAME.layers.exr` beside it.
    pub fn from_frame(frame: &Path) -> Result<Self, PainterError> {
        let (layers, size) = read_layers(&frame.with_extension("layers.exr"))?;
        let SurfaceLayers { albedo, depth, size: found } = read_surface_layers(frame)?;
        if found != size {
            return Err(PainterError::OtherSize { frame: frame.into(), found, expected: size });
        }
        Ok(Self { width: size.0, height: size.1, layers, albedo, depth })
    }

    /// Encodes all guides in one file: light and albedo in half floats, as precise as a render's noise, and depth in floats,
    /// because its slopes are used.
    /// - `attributes`: text attributes, such as those of the render.
    pub fn encode(&self, attributes: &BTreeMap<String, String>) -> Result<Vec<u8>, FilmError> {
        let mut planes: Vec<(String, Vec<f32>, Precision)> = Vec::new();
        for (name, colors) in LAYERS.iter().zip(&self.layers).chain([(&"albedo", &self.albedo)]) {
            for (i, channel) in ["R", "G", "B"].into_iter().enumerate() {
                let values = colors.iter().map(|color| color[i]).collect();
                planes.push((format!("{name}.{channel}"), values, Precision::Half));
            }
        }
        planes.push(("depth.Z".into(), self.depth.clone(), Precision::Float));
        let named = planes.iter().map(|(name, values, precision)| NamedChannel { name, values, precision: *precision });
        let named: Vec<_> = named.collect();
        exr::encode_named_channels([self.width, self.height], &named, attributes)
    }
}

type Layers = [Vec<[f32; 3]>; 5];

fn read_layers(path: &Path) -> Result<(Layers, (u32, u32)), FilmError> {
    let mut size = (0, 0);
    let mut read = Layers::default();
    for (name, layer) in LAYERS.iter().zip(&mut read) {
        let (width, height, colors) = read_color_layer(path, name)?;
        (size, *layer) = ((width, height), colors);
    }
    Ok((read, size))
}

struct SurfaceLayers {
    albedo: Vec<[f32; 3]>,
    depth: Vec<f32>,
    size: (u32, u32),
}

fn read_surface_layers(path: &Path) -> Result<SurfaceLayers, FilmError> {
    let (_, _, albedo) = read_color_layer(path, "albedo")?;
    let (width, height, [depth]) = exr::read_channels(path, ["depth.Z"])?;
    Ok(SurfaceLayers { albedo, depth, size: (width, height) })
}

fn read_color_layer(path: &Path, layer: &str) -> Result<(u32, u32, Vec<[f32; 3]>), FilmError> {
    let names = ["R", "G", "B"].map(|channel| format!("{layer}.{channel}"));
    let (width, height, [r, g, b]) = exr::read_channels(path, [&names[0], &names[1], &names[2]])?;
    let colors = r.into_iter().zip(g).zip(b).map(|((r, g), b)| [r, g, b]);
    Ok((width, height, colors.collect()))
}
