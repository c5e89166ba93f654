//! Reading channels by name, besides the colors: what the renderer knows of each pixel.

use super::read::{check, failed};
use crate::FilmError;
use exr::meta::MetaData;
use exr::prelude::{FlatSamples, ReadChannels, ReadLayers, read as exr_read};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// Reads the channels `names` of the file at `path`, as floats, row by row.
/// - returns: width, height, and the channels in the order of `names`;
/// - errors: the file has no such channel, or is no flat EXR file.
pub fn read_channels<const N: usize>(path: &Path, names: [&str; N]) -> Result<(u32, u32, [Vec<f32>; N]), FilmError> {
    let file = File::open(path).map_err(|cause| FilmError::File { path: path.into(), cause })?;
    decode_channels(BufReader::new(file), names).map_err(|e| e.in_file(path))
}

/// The same from a seekable source.
pub fn decode_channels<const N: usize>(
    mut file: impl Read + Seek,
    names: [&str; N],
) -> Result<(u32, u32, [Vec<f32>; N]), FilmError> {
    let broken = |e: std::io::Error| FilmError::Format { what: "reading EXR", cause: e.to_string() };
    let length = file.seek(SeekFrom::End(0)).map_err(broken)?;
    file.rewind().map_err(broken)?;
    let meta = MetaData::read_from_buffered(&mut file, false).map_err(|e| failed(&e))?;
    meta.headers.iter().try_for_each(|header| check(header, length))?;
    file.rewind().map_err(broken)?;
    let read = exr_read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer().all_attributes();
    let layer = read.non_parallel().from_buffered(file).map_err(|e| failed(&e))?.layer_data;
    let mut found = names.map(|_| Vec::new());
    for (name, values) in names.iter().zip(&mut found) {
        let channel = layer.channel_data.list.iter().find(|channel| channel.name.to_string() == *name);
        let channel = channel.ok_or_else(|| FilmError::Format {
            what: "reading EXR",
            cause: format!("it has no channel `{name}`, which femc's frames have"),
        })?;
        *values = match &channel.sample_data {
            FlatSamples::F16(values) => values.iter().map(|value| value.to_f32()).collect(),
            FlatSamples::F32(values) => values.clone(),
            FlatSamples::U32(values) => values.iter().map(|&value| value as f32).collect(),
        };
    }
    Ok((layer.size.width() as u32, layer.size.height() as u32, found))
}
