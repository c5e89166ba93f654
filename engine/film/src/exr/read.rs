//! Reading of the colors of any flat EXR file: half or float, scan lines or tiles, and every compression that the `exr` crate
//! decodes. Sizes are checked in the header before memory of that size is allocated.

use super::Threads;
use crate::rect::MAX_FILM_PIXELS;
use crate::{FilmError, Image};
use exr::meta::{
    BlockDescription, MetaData,
    attribute::{AttributeValue, Text},
    header::Header,
};
use exr::prelude::{ReadChannels, ReadLayers, read as exr_read};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// Colors and text attributes of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct ExrFile {
    /// The channels R, G and B of the data window.
    pub image: Image,
    /// All string attributes by name.
    pub attributes: BTreeMap<String, String>,
}

/// Reads the file at `path`.
pub fn read(path: &Path) -> Result<ExrFile, FilmError> {
    let file = File::open(path).map_err(|cause| FilmError::File { path: path.into(), cause })?;
    decode(BufReader::new(file)).map_err(|e| e.in_file(path))
}

/// Reads only the string attributes of the file at `path`.
pub fn read_attributes(path: &Path) -> Result<BTreeMap<String, String>, FilmError> {
    let file = File::open(path).map_err(|cause| FilmError::File { path: path.into(), cause })?;
    let meta = MetaData::read_from_buffered(BufReader::new(file), false).map_err(|e| read_error(&e).in_file(path))?;
    Ok(text_attributes(&meta))
}

/// Reads an image from a seekable source.
pub fn decode(mut source: impl Read + Seek) -> Result<ExrFile, FilmError> {
    let broken = |e: std::io::Error| FilmError::Format { what: "reading EXR", cause: e.to_string() };
    let length = source.seek(SeekFrom::End(0)).map_err(broken)?;
    source.rewind().map_err(broken)?;
    let meta = MetaData::read_from_buffered(&mut source, false).map_err(|e| read_error(&e))?;
    let colors =
        meta.headers.iter().find(|h| has_colors(h)).ok_or_else(|| FilmError::NoColors { found: names(&meta) })?;
    for header in &meta.headers {
        check_header(header, length)?;
    }
    let (width, height) = (colors.layer_size.width(), colors.layer_size.height());
    source.rewind().map_err(broken)?;
    let file = exr_read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            move |_, _| vec![[0.0f32; 3]; width * height],
            move |pixels: &mut Vec<[f32; 3]>, at, (r, g, b): (f32, f32, f32)| {
                if let Some(pixel) = pixels.get_mut(at.y() * width + at.x()) {
                    *pixel = [r, g, b];
                }
            },
        )
        .first_valid_layer()
        .all_attributes();
    let found = match Threads::for_pixels(width * height) {
        Threads::One => file.non_parallel().from_buffered(source),
        Threads::Many => file.from_buffered(source),
    };
    let found = found.map_err(|e| read_error(&e))?;
    let pixels = found.layer_data.channel_data.pixels;
    let image = Image { width: width as u32, height: height as u32, pixels };
    Ok(ExrFile { image, attributes: text_attributes(&meta) })
}

fn has_colors(header: &Header) -> bool {
    let has = |name: &str| header.channels.list.iter().any(|c| c.name.eq_case_insensitive(name));
    !header.deep && ["R", "G", "B"].into_iter().all(has)
}

/// Refuses sizes beyond the limits, and more blocks than a file of `length` bytes can index.
pub(super) fn check_header(header: &Header, length: u64) -> Result<(), FilmError> {
    const MAX_CHANNELS: usize = 1024;
    const MAX_TILE_EDGE: usize = 1 << 14;
    let (width, height) = (header.layer_size.width() as u64, header.layer_size.height() as u64);
    if !width.checked_mul(height).is_some_and(|n| (1..=MAX_FILM_PIXELS).contains(&n)) {
        return Err(FilmError::Size { width, height, limit: MAX_FILM_PIXELS });
    }
    let tile_edge = match header.blocks {
        BlockDescription::ScanLines => 0,
        BlockDescription::Tiles(tiles) => tiles.tile_size.width().max(tiles.tile_size.height()),
    };
    let index = (header.chunk_count as u64).saturating_mul(8);
    if tile_edge > MAX_TILE_EDGE || header.channels.list.len() > MAX_CHANNELS || index > length {
        return Err(FilmError::Format {
            what: "reading EXR",
            cause: "header announces more than the file can hold".into(),
        });
    }
    Ok(())
}

fn names(meta: &MetaData) -> String {
    const SHOWN: usize = 16;
    let channels = meta.headers.iter().flat_map(|h| &h.channels.list).map(|c| c.name.to_string());
    channels.take(SHOWN).collect::<Vec<_>>().join(" ")
}

fn text_attributes(meta: &MetaData) -> BTreeMap<String, String> {
    let all = meta.headers.iter().flat_map(|h| h.own_attributes.other.iter().chain(&h.shared_attributes.other));
    all.filter_map(|(name, value)| match value {
        AttributeValue::Text(text) => Some((name.to_string(), utf8(text))),
        _ => None,
    })
    .collect()
}

/// Decodes UTF-8 text, or Latin-1 as in older files if it is not valid UTF-8.
fn utf8(text: &Text) -> String {
    std::str::from_utf8(text.as_slice()).map_or_else(|_| text.to_string(), str::to_owned)
}

pub(super) fn read_error(cause: &exr::error::Error) -> FilmError {
    FilmError::Format { what: "reading EXR", cause: cause.to_string() }
}
