//! Writing of EXR files: one part, scan lines, ZIP, 32-bit floats, channels and attributes in alphabetical order.
//!
//! The bytes are a function of the image and its provenance. The `exr` crate keeps custom attributes in a hash map, so the header
//! is sorted afterwards (attributes have no order in the format, and their total size does not change).

use crate::exr::{ATTRIBUTE_PREFIX, Threads};
use crate::file::write_atomic;
use crate::{BadSamples, FilmError, FrameError, FrameImage, LayerImage};
use exr::meta::attribute::{Chromaticities, Text};
use exr::prelude::{
    AnyChannel, AnyChannels, AttributeValue, Encoding, FlatSamples, Image, Layer, LayerAttributes, LineOrder, Vec2,
    WritableImage,
};
use exr::{compression::Compression, image::Blocks};
use std::io::Cursor;
use std::path::Path;

/// Origin of an image, written as string attributes `femc:...`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Provenance {
    /// Version of the renderer.
    pub version: String,
    /// Build of the engine.
    pub engine: String,
    /// Render settings, JSON.
    pub settings: String,
    /// Name of and reason for a biased method, whose pixels are wrong in the mean for any number of samples.
    pub bias: Option<String>,
    /// Division of the samples of a frame with a time limit, JSON. A render with this division gives the same pixels.
    pub allocation: Option<String>,
    /// Digest of the scene.
    pub scene: String,
    /// Frame of the clip, from 1.
    pub frame: u32,
    /// Computing time, seconds.
    pub seconds: f64,
    /// Mean samples per pixel.
    pub spp: f64,
    /// Reached error, block by block; written as the layer `relative_error.Y` and in numbers.
    pub error: FrameError,
    /// Samples left out of the image; written as `nan=2 infinite=0 negative=0 out-of-range=0 first=x,y,sample`.
    pub bad: BadSamples,
}

impl Provenance {
    fn attributes(&self) -> Vec<(String, String)> {
        let allocation = self.allocation.iter().map(|text| ("allocation", text.clone()));
        let bias = self.bias.iter().map(|text| ("bias", text.clone()));
        let always = [
            ("version", self.version.clone()),
            ("engine", self.engine.clone()),
            ("settings", self.settings.clone()),
            ("scene", self.scene.clone()),
            ("frame", self.frame.to_string()),
            ("seconds", self.seconds.to_string()),
            ("spp", self.spp.to_string()),
            ("relative_error", self.error.worst.to_string()),
            ("relative_error_mean", self.error.mean.to_string()),
            ("relative_error_floor", self.error.floor.to_string()),
            ("unlit_blocks", self.error.unlit.to_string()),
            ("bad_samples", bad_samples_text(&self.bad)),
        ];
        let named = |(name, value)| (format!("{ATTRIBUTE_PREFIX}{name}"), value);
        always.into_iter().chain(allocation).chain(bias).map(named).collect()
    }
}

/// Formats the text of `femc:bad_samples`.
fn bad_samples_text(bad: &BadSamples) -> String {
    let [nan, infinite, negative, large] = bad.counts;
    let counts = format!("nan={nan} infinite={infinite} negative={negative} out-of-range={large}");
    match bad.first {
        Some(first) => format!("{counts} first={},{},{}", first.x, first.y, first.sample),
        None => counts,
    }
}

/// Maximum length in bytes of a name in a file without long names; the next constant is the maximum with them.
const MAX_SHORT_NAME: usize = 31;
const MAX_NAME: usize = 255;
/// Index of the byte with the first flags after the version; the next constant is the bit of long names in it (bit 10 of the word).
const FLAGS_OFFSET: usize = 5;
const LONG_NAMES_FLAG: u8 = 1 << 2;

/// Value of `relative_error.Y` in a block that received no light.
pub const UNLIT: f32 = -1.0;

/// Encodes `R G B` (32-bit float, linear Rec.709, cd/m2) and the layers `albedo.R G B`, `depth.Z` (meters), `variance.R G B` and
/// `variance.Y` (of the luminance), `samples.Y` (32-bit integer), and `relative_error.Y`. The latter is the error of each block of
/// 16 x 16 pixels in `provenance`, or [`UNLIT`] if there is none.
pub fn encode(image: &FrameImage, provenance: &Provenance) -> Result<Vec<u8>, FilmError> {
    let mut channels = color("", &image.color.pixels);
    channels.extend(color("albedo.", &image.albedo));
    channels.extend(color("variance.", &image.variance));
    channels.push(floats("depth.Z", image.depth.iter().copied()));
    channels.push(floats("variance.Y", image.luminance_variance.iter().copied()));
    channels.push(floats("relative_error.Y", block_error_plane(&provenance.error, image).into_iter()));
    channels.push(AnyChannel::new("samples.Y", FlatSamples::U32(image.samples.clone())));
    encode_channels([image.color.width, image.color.height], channels, provenance.attributes())
}

/// Encodes the colors of `image`, `samples.Y`, the color `NAME.R G B` of each layer and its variance `NAME.variance.R G B`, and
/// other channels by name, such as features. The attributes leave out the computing time, so equal layers give equal bytes.
/// - `texts`: additional attributes, by name.
pub fn encode_layers(
    image: &FrameImage,
    layers: &[LayerImage],
    channels_by_name: &[(String, Vec<f32>)],
    texts: &[(String, String)],
    provenance: &Provenance,
) -> Result<Vec<u8>, FilmError> {
    let mut channels = color("", &image.color.pixels);
    channels.push(AnyChannel::new("samples.Y", FlatSamples::U32(image.samples.clone())));
    for LayerImage { name, color: mean, variance } in layers {
        channels.extend(color(&format!("{name}."), mean));
        channels.extend(color(&format!("{name}.variance."), variance));
    }
    channels.extend(channels_by_name.iter().map(|(name, values)| floats(name, values.iter().copied())));
    let seconds = format!("{ATTRIBUTE_PREFIX}seconds");
    let attributes = provenance.attributes().into_iter().filter(|(name, _)| *name != seconds);
    let attributes = attributes.chain(texts.iter().cloned()).collect();
    encode_channels([image.color.width, image.color.height], channels, attributes)
}

fn color(name: &str, pixels: &[[f32; 3]]) -> Vec<AnyChannel<FlatSamples>> {
    let channel = |(i, c)| floats(&format!("{name}{c}"), pixels.iter().map(|p: &[f32; 3]| p[i]));
    ["R", "G", "B"].into_iter().enumerate().map(channel).collect()
}

pub(super) fn encode_channels(
    [width, height]: [u32; 2],
    channels: Vec<AnyChannel<FlatSamples>>,
    texts: Vec<(String, String)>,
) -> Result<Vec<u8>, FilmError> {
    let names: Vec<Text> = channels.iter().map(|channel| channel.name.clone()).collect();
    if let Some(name) = names.iter().find(|name| name.as_slice().len() > MAX_NAME) {
        return Err(write_error(format!(
            "the name of channel `{name}` has {} bytes, but the format allows {MAX_NAME}; give the layer a shorter name",
            name.as_slice().len()
        )));
    }
    let has_long_names = names.iter().any(|name| name.as_slice().len() > MAX_SHORT_NAME);
    let mut attributes = LayerAttributes { white_luminance: Some(1.0), ..LayerAttributes::default() };
    for (name, value) in texts {
        // UTF-8 as in OpenEXR; the crate's own conversion would refuse text outside of Latin-1.
        let value = Text::from_slice_unchecked(value.as_bytes());
        attributes.other.insert(Text::from(name.as_str()), AttributeValue::Text(value));
    }
    let encoding =
        Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let size = Vec2(width as usize, height as usize);
    let layer = Layer::new(size, attributes, encoding, AnyChannels::sort(channels.into()));
    let mut file = Image::from_layer(layer);
    file.attributes.chromaticities = Some(Chromaticities {
        red: Vec2(0.64, 0.33),
        green: Vec2(0.30, 0.60),
        blue: Vec2(0.15, 0.06),
        white: Vec2(0.3127, 0.3290),
    });

    let mut bytes = Cursor::new(Vec::new());
    let written = match Threads::for_pixels(width as usize * height as usize) {
        Threads::One => file.write().non_parallel().to_buffered(&mut bytes),
        Threads::Many => file.write().to_buffered(&mut bytes),
    };
    written.map_err(|e| write_error(e.to_string()))?;
    let mut bytes = bytes.into_inner();
    // The `exr` crate sets this flag from the attribute names alone, but other programs need it to read long channel names.
    if let (true, Some(flags)) = (has_long_names, bytes.get_mut(FLAGS_OFFSET)) {
        *flags |= LONG_NAMES_FLAG;
    }
    sort_attributes(&mut bytes).ok_or_else(|| write_error("the header has an unknown form".into()))?;
    Ok(bytes)
}

/// Writes [`encode`]d bytes to `path` atomically.
pub fn write(path: &Path, image: &FrameImage, provenance: &Provenance) -> Result<(), FilmError> {
    write_atomic(path, &encode(image, provenance).map_err(|e| e.in_file(path))?)
}

/// Returns the relative error of each pixel's block, row by row; [`UNLIT`] where `error` has none.
pub fn block_error_plane(error: &FrameError, image: &FrameImage) -> Vec<f32> {
    let (width, height) = (image.color.width, image.color.height);
    let mut pixels = vec![UNLIT; width as usize * height as usize];
    for block in &error.blocks {
        let Some(relative) = block.relative else { continue };
        for (x, y) in block.rect.pixels().filter(|&(x, y)| x < width && y < height) {
            pixels[y as usize * width as usize + x as usize] = relative as f32;
        }
    }
    pixels
}

pub(super) fn floats(name: &str, values: impl Iterator<Item = f32>) -> AnyChannel<FlatSamples> {
    AnyChannel::new(name, FlatSamples::F32(values.collect()))
}

pub(super) fn write_error(cause: String) -> FilmError {
    FilmError::Format { what: "writing EXR", cause }
}

/// Sorts the attributes of a single-part file's header by name. An attribute is a name and a type, both closed by a zero byte, a
/// 32-bit size and the value; a zero byte closes the header.
fn sort_attributes(file: &mut [u8]) -> Option<()> {
    const START: usize = 8;
    let text = |at: usize| Some(at + file.get(at..)?.iter().position(|&b| b == 0)? + 1);
    let mut attributes = Vec::new();
    let mut at = START;
    while *file.get(at)? != 0 {
        let size_at = text(text(at)?)?;
        let size = u32::from_le_bytes(file.get(size_at..size_at + 4)?.try_into().ok()?) as usize;
        let end = size_at + 4 + size;
        attributes.push(file.get(at..end)?.to_vec());
        at = end;
    }
    attributes.sort_unstable();
    file.get_mut(START..at)?.copy_from_slice(&attributes.concat());
    Some(())
}
