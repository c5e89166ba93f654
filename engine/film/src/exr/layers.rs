//! Reading of channels by name: besides the colors, features of each pixel and layers of light.

use super::read::{check_header, read_error};
use crate::{FilmError, Image};
use exr::meta::MetaData;
use exr::prelude::{FlatSamples, ReadChannels, ReadLayers, read as exr_read};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// All channels of a file, by name, as floats, row by row.
#[derive(Clone, Debug)]
pub struct Channels {
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    by_name: BTreeMap<String, Vec<f32>>,
}

impl Channels {
    /// Reads the file at `path`.
    /// - errors: the file is not a flat EXR file.
    pub fn read(path: &Path) -> Result<Self, FilmError> {
        let file = File::open(path).map_err(|cause| FilmError::File { path: path.into(), cause })?;
        Self::decode(BufReader::new(file)).map_err(|e| e.in_file(path))
    }

    /// Decodes the channels from a seekable source.
    pub fn decode(mut file: impl Read + Seek) -> Result<Self, FilmError> {
        let broken = |e: std::io::Error| FilmError::Format { what: "reading EXR", cause: e.to_string() };
        let length = file.seek(SeekFrom::End(0)).map_err(broken)?;
        file.rewind().map_err(broken)?;
        let meta = MetaData::read_from_buffered(&mut file, false).map_err(|e| read_error(&e))?;
        meta.headers.iter().try_for_each(|header| check_header(header, length))?;
        file.rewind().map_err(broken)?;
        let read =
            exr_read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer().all_attributes();
        let layer = read.non_parallel().from_buffered(file).map_err(|e| read_error(&e))?.layer_data;
        let (width, height) = (layer.size.width() as u32, layer.size.height() as u32);
        let floats = |samples: FlatSamples| match samples {
            FlatSamples::F16(values) => values.iter().map(|value| value.to_f32()).collect(),
            FlatSamples::F32(values) => values,
            FlatSamples::U32(values) => values.iter().map(|&value| value as f32).collect(),
        };
        let channels = layer.channel_data.list.into_iter();
        let named = channels.map(|channel| (channel.name.to_string(), floats(channel.sample_data))).collect();
        Ok(Self { width, height, by_name: named })
    }

    /// Returns the channel with this name.
    pub fn get(&self, name: &str) -> Option<&[f32]> {
        self.by_name.get(name).map(Vec::as_slice)
    }

    /// Returns the names of the color layers without their variances, in alphabetical order: those with channels `NAME.R`, `NAME.G`
    /// and `NAME.B`.
    pub fn color_layers(&self) -> Vec<&str> {
        let names = self.by_name.keys().filter_map(|name| name.strip_suffix(".R"));
        let is_variance = |name: &str| name == "variance" || name.ends_with(".variance");
        names.filter(|name| !is_variance(name) && self.layer_channels(name).is_some()).collect()
    }

    /// Returns the colors of a layer by its name; an empty name stands for the picture itself. `None`: the file has no such layer.
    pub fn color(&self, layer: &str) -> Option<Image> {
        let [r, g, b] = self.layer_channels(layer)?;
        let pixels = r.iter().zip(g).zip(b).map(|((r, g), b)| [*r, *g, *b]).collect();
        Some(Image { width: self.width, height: self.height, pixels })
    }

    fn layer_channels(&self, layer: &str) -> Option<[&[f32]; 3]> {
        let channel = |channel| match layer {
            "" => self.get(channel),
            _ => self.get(&format!("{layer}.{channel}")),
        };
        Some([channel("R")?, channel("G")?, channel("B")?])
    }
}

/// Reads the channels `names` of the file at `path`, as floats, row by row.
/// - returns: width, height, and the channels in the order of `names`;
/// - errors: the file has no such channel, or is not a flat EXR file.
pub fn read_channels<const N: usize>(path: &Path, names: [&str; N]) -> Result<(u32, u32, [Vec<f32>; N]), FilmError> {
    Channels::read(path).and_then(|channels| take_channels(channels, names).map_err(|e| e.in_file(path)))
}

/// Decodes the channels `names` from a seekable source.
pub fn decode_channels<const N: usize>(
    file: impl Read + Seek,
    names: [&str; N],
) -> Result<(u32, u32, [Vec<f32>; N]), FilmError> {
    take_channels(Channels::decode(file)?, names)
}

fn take_channels<const N: usize>(
    mut channels: Channels,
    names: [&str; N],
) -> Result<(u32, u32, [Vec<f32>; N]), FilmError> {
    let mut found = names.map(|_| Vec::new());
    for (name, values) in names.iter().zip(&mut found) {
        *values = channels.by_name.remove(*name).ok_or_else(|| FilmError::Format {
            what: "reading EXR",
            cause: format!("the file has no channel `{name}`, which all femc frames have"),
        })?;
    }
    Ok((channels.width, channels.height, found))
}
