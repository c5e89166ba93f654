//! Guides from frame files: selects the guide layers and applies the exposure.

use crate::{ChannelImage, StylizeError};
use femc_film::exr::Channels;
use femc_film::{FilmError, Image, Picture, ToneCurve};
use std::io::{Read, Seek};
use std::path::Path;

/// A frame with its possible guide layers.
#[derive(Clone, Debug)]
pub struct GuideFrame {
    channels: Channels,
}

impl GuideFrame {
    /// Reads a file: `FRAME.layers.exr`, or any EXR with channels R, G and B.
    /// - errors: the file is not an EXR file.
    pub fn read(path: &Path) -> Result<Self, FilmError> {
        Channels::read(path).map(|channels| Self { channels })
    }

    /// Decodes the bytes of a file.
    pub fn decode(source: impl Read + Seek) -> Result<Self, FilmError> {
        Channels::decode(source).map(|channels| Self { channels })
    }

    /// Returns columns and rows.
    pub fn size(&self) -> [u32; 2] {
        [self.channels.width, self.channels.height]
    }

    /// Returns the names of possible guides: layers of light or, if there are none, the picture, whose name is empty.
    pub fn names(&self) -> Vec<&str> {
        // Albedo is a color but not light; Cryptomatte channels with color names hold ids and shares.
        let is_light = |name: &&str| *name != "albedo" && !name.starts_with("crypto_");
        let layers: Vec<&str> = self.channels.color_layers().into_iter().filter(is_light).collect();
        if layers.is_empty() && self.channels.color("").is_some() { vec![""] } else { layers }
    }

    /// Returns the image that decides the exposure: the picture or, if the file has none, the layer `full`, or the first one.
    pub fn exposure_image(&self) -> Option<Image> {
        let first = || self.names().first().and_then(|name| self.channels.color(name));
        self.channels.color("").or_else(|| self.channels.color("full")).or_else(first)
    }

    /// Returns guides as they are displayed, three channels each, 0..1.
    /// - errors: the frame has no such layer, or values that are not finite.
    pub fn guides(&self, names: &[&str], curve: ToneCurve) -> Result<ChannelImage, StylizeError> {
        let layer = |name: &&str| self.channels.color(name).ok_or_else(|| StylizeError::NoGuide((*name).to_owned()));
        let images = names.iter().map(layer).collect::<Result<Vec<Image>, _>>()?;
        let [width, height] = self.size();
        let pixels = 0..width as usize * height as usize;
        let unsound = |at: &usize| images.iter().any(|image| image.pixels[*at].iter().any(|value| !value.is_finite()));
        if let Some(at) = pixels.clone().find(unsound) {
            return Err(StylizeError::NotFinite { x: at as u32 % width, y: at as u32 / width });
        }
        let shown = pixels.flat_map(|at| images.iter().flat_map(move |image| curve.display(image.pixels[at])));
        ChannelImage::new(width, height, 3 * images.len(), shown.collect())
    }

    /// Returns the motion of each pixel to its position in the next frame, pixels along x and y; `None`: the file has no layer
    /// `motion`.
    pub fn motion(&self) -> Option<[&[f32]; 2]> {
        Some([self.channels.get("motion.X")?, self.channels.get("motion.Y")?])
    }

    /// Returns the depth of each pixel; `None`: the file has no layer `depth`.
    pub fn depth(&self) -> Option<&[f32]> {
        self.channels.get("depth.Z")
    }
}

/// Returns the guides that both frames have, in the order of the first one.
/// - errors: the frames have no guide in common.
pub fn common_guides<'a>(source: &'a GuideFrame, target: &GuideFrame) -> Result<Vec<&'a str>, StylizeError> {
    let others = target.names();
    let names: Vec<&str> = source.names().into_iter().filter(|name| others.contains(name)).collect();
    if !names.is_empty() {
        return Ok(names);
    }
    let list = |names: Vec<&str>| names.into_iter().map(str::to_owned).collect();
    Err(StylizeError::NothingInCommon { source_guides: list(source.names()), target_guides: list(others) })
}

/// Converts a painting to an image, 0..1.
pub fn image_from_picture(picture: &Picture) -> Result<ChannelImage, StylizeError> {
    let values = picture.pixels.as_flattened().iter().map(|&byte| f32::from(byte) / 255.0).collect();
    ChannelImage::new(picture.width, picture.height, 3, values)
}

/// Converts an image of three channels, 0..1, to a picture.
pub fn image_to_picture(image: &ChannelImage) -> Picture {
    let byte = |value: f32| (255.0 * value.clamp(0.0, 1.0) + 0.5) as u8;
    let pixels = image.values().as_chunks().0.iter().map(|pixel| pixel.map(byte)).collect();
    let [width, height] = image.size();
    Picture { width, height, pixels }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_film::exr::{NamedChannel, Precision, encode_named_channels};
    use std::collections::BTreeMap;
    use std::io::Cursor;

    #[test]
    fn light_layers_guide_and_first_hit_features_do_not() {
        let names = ["direct.R", "direct.G", "direct.B", "albedo.R", "albedo.G", "albedo.B", "normal.X", "coverage.A"];
        let mattes = ["R", "G", "B", "A"].map(|part| format!("crypto_object00.{part}"));
        let names: Vec<&str> = names.into_iter().chain(mattes.iter().map(String::as_str)).collect();
        let channel = |name| NamedChannel { name, values: &[0.5], precision: Precision::Float };
        let channels: Vec<NamedChannel<'_>> = names.into_iter().map(channel).collect();
        let bytes = encode_named_channels([1, 1], &channels, &BTreeMap::new()).unwrap();
        assert_eq!(GuideFrame::decode(Cursor::new(bytes)).unwrap().names(), ["direct"]);
    }
}
