//! Reader of EXR: selects the color channels and places them in the picture.

use super::{
    ImageFile, RawImage, Role,
    primaries::{Chromaticities, Matrix},
    printable,
};
use crate::ImportFault;
use exr::{
    compression::Compression,
    meta::{MetaData, header::Header},
    prelude::{self as exr_prelude, ReadChannels, ReadLayers, ReadSpecificChannel},
};
use std::io::Cursor;

/// Number of pixels up to which a picture may be mostly empty, and maximum ratio of a larger picture's area to its data. A file of
/// a few bytes must not fill the memory with black.
const FREE_AREA: usize = 1 << 22;
const MAX_EMPTY_RATIO: usize = 64;
/// Maximum number of channels that a remark names.
const MAX_NAMED_CHANNELS: usize = 8;

/// Names of the color channels.
#[derive(Clone, Debug, PartialEq)]
struct SelectedChannels {
    /// Red, green and blue; for gray images, the gray channel three times.
    names: [String; 3],
    alpha: String,
    /// Layer of the colors, if they belong to one.
    layer: Option<String>,
}

pub(super) fn open(file: &ImageFile<'_>) -> Result<RawImage, ImportFault> {
    let bytes = file.bytes;
    if bytes.get(5).is_some_and(|flags| flags & 0x08 != 0) {
        return Err(file.bad_file_with_advice("the file holds deep data", "flatten it to one color per pixel"));
    }
    let meta =
        MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(|error| file.bad_file(error.to_string()))?;
    for header in &meta.headers {
        file.check_size(header.layer_size.width(), header.layer_size.height())?;
        if matches!(header.compression, Compression::DWAA(_) | Compression::DWAB(_)) {
            return Err(file.bad_file(
                "the file is compressed with DWA, which decodes to different values on different processors",
            ));
        }
        if header.channels.list.iter().any(|channel| channel.sampling != exr_prelude::Vec2(1, 1)) {
            let names = channel_names(header);
            let names = list_names(names.iter().map(String::as_str));
            let reason = format!("the channels {names} are subsampled (luminance and chroma)");
            return Err(file.bad_file_with_advice(reason, "save it again with the channels R G B"));
        }
    }
    let parts: Vec<Vec<String>> = meta.headers.iter().map(channel_names).collect();
    let (part, selected) = select_channels(&parts, file.role).ok_or_else(|| {
        let names = list_names(parts.iter().flatten().map(String::as_str));
        let wanted = match file.role {
            Role::Color => "R G B, or Y for gray, without a layer (`R`, `.R`) or in a single one (`NAME.R`)",
            Role::Normals => "R G B, without a layer (`R`, `.R`) or in a single one (`NAME.R`)",
        };
        file.bad_file_with_advice(
            format!("the file has the channels {names}; expected {wanted}"),
            "save it again with these channels",
        )
    })?;
    let header = &meta.headers[part];
    let mut remarks = Vec::new();
    let (data, is_opaque) = read_pixels(file, &selected)?;
    if !is_opaque {
        remarks.push("alpha is not used: colors stay premultiplied".to_owned());
    }
    remarks.extend(unused_remarks(header, &meta.headers, &selected));
    let to_rec709 = primaries(header, file.role, &selected, &mut remarks);
    let (width, height, pixels) = place_in_display_window(file, header, data, &mut remarks)?;
    Ok(RawImage { width, height, pixels, to_rec709, remarks })
}

fn channel_names(header: &Header) -> Vec<String> {
    header.channels.list.iter().map(|channel| channel.name.to_string()).collect()
}

/// Lists the names of some channels and the number of the rest.
fn list_names<'n>(names: impl Iterator<Item = &'n str> + Clone) -> String {
    let shown: Vec<String> =
        names.clone().take(MAX_NAMED_CHANNELS).map(|name| format!("`{}`", printable(name))).collect();
    let more = names.count().saturating_sub(MAX_NAMED_CHANNELS);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{}{more}", shown.join(", "))
}

/// Selects the part and the channels to read: names without a layer, names that begin with a dot, or those of the file's only layer
/// with colors.
fn select_channels(parts: &[Vec<String>], role: Role) -> Option<(usize, SelectedChannels)> {
    for prefix in ["", "."] {
        let found = parts.iter().enumerate().find_map(|(i, names)| Some((i, select_in_layer(names, prefix, role)?)));
        if found.is_some() {
            return found;
        }
    }
    let mut found: Vec<(usize, SelectedChannels)> = Vec::new();
    for (i, names) in parts.iter().enumerate() {
        let layers: std::collections::BTreeSet<&str> =
            names.iter().filter_map(|name| name.rfind('.').map(|dot| &name[..=dot])).collect();
        for prefix in layers.into_iter().filter(|prefix| *prefix != ".") {
            let layer = Some(prefix[..prefix.len() - 1].to_owned());
            found.extend(
                select_in_layer(names, prefix, role).map(|selected| (i, SelectedChannels { layer, ..selected })),
            );
        }
    }
    if found.len() == 1 { found.pop() } else { None }
}

/// Returns the color channels whose names begin with `prefix`.
fn select_in_layer(names: &[String], prefix: &str, role: Role) -> Option<SelectedChannels> {
    let named = |wanted: &str| {
        let is = |name: &&String, exact: bool| {
            let rest = name.strip_prefix(prefix);
            rest.is_some_and(|rest| rest == wanted || !exact && rest.eq_ignore_ascii_case(wanted))
        };
        names.iter().find(|name| is(name, true)).or_else(|| names.iter().find(|name| is(name, false)))
    };
    let alpha = named("A").cloned().unwrap_or_else(|| format!("{prefix}A"));
    if let (Some(r), Some(g), Some(b)) = (named("R"), named("G"), named("B")) {
        return Some(SelectedChannels { names: [r, g, b].map(Clone::clone), alpha, layer: None });
    }
    let y = named("Y").filter(|_| role == Role::Color)?;
    // Y beside chroma channels is not gray, and beside X it is a coordinate.
    let is_gray = ["RY", "BY", "X"].iter().all(|other| named(other).is_none());
    is_gray.then(|| SelectedChannels { names: [y, y, y].map(Clone::clone), alpha, layer: None })
}

/// A width and its pixels.
type PixelData = (usize, Vec<[f32; 3]>);

/// Reads the pixels of the data window. Also returns whether all of them are opaque.
fn read_pixels(file: &ImageFile<'_>, selected: &SelectedChannels) -> Result<(PixelData, bool), ImportFault> {
    let fault = |error: exr::error::Error| file.bad_file(error.to_string());
    let reader = exr_prelude::read().no_deep_data().largest_resolution_level();
    let input = Cursor::new(file.bytes);
    let [r, g, b] = selected.names.each_ref().map(String::as_str);
    let storage = if r == g {
        let channels = reader.specific_channels().required(r).optional(selected.alpha.as_str(), 1.0f32);
        let layer = channels.collect_pixels(
            |size, _: &_| Storage::new(size),
            |storage: &mut Storage, at, (y, a): (f32, f32)| storage.set(at, [y; 3], a),
        );
        let image = layer.first_valid_layer().all_attributes().non_parallel().from_buffered(input);
        image.map_err(fault)?.layer_data.channel_data.pixels
    } else {
        let channels = reader.specific_channels().required(r).required(g).required(b);
        let layer = channels.optional(selected.alpha.as_str(), 1.0f32).collect_pixels(
            |size, _: &_| Storage::new(size),
            |storage: &mut Storage, at, (r, g, b, a): (f32, f32, f32, f32)| storage.set(at, [r, g, b], a),
        );
        let image = layer.first_valid_layer().all_attributes().non_parallel().from_buffered(input);
        image.map_err(fault)?.layer_data.channel_data.pixels
    };
    Ok(((storage.width, storage.pixels), storage.is_opaque))
}

/// Pixels while they are read.
struct Storage {
    width: usize,
    pixels: Vec<[f32; 3]>,
    /// Whether all pixels are opaque.
    is_opaque: bool,
}

impl Storage {
    fn new(size: exr_prelude::Vec2<usize>) -> Self {
        Self { width: size.width(), pixels: vec![[0.0; 3]; size.area()], is_opaque: true }
    }

    fn set(&mut self, at: exr_prelude::Vec2<usize>, rgb: [f32; 3], alpha: f32) {
        self.pixels[at.y() * self.width + at.x()] = rgb;
        self.is_opaque &= alpha == 1.0;
    }
}

/// Returns remarks on the data and attributes of the file that are not used.
fn unused_remarks(header: &Header, parts: &[Header], selected: &SelectedChannels) -> Vec<String> {
    let mut remarks = Vec::new();
    if parts.len() > 1 {
        let name = header
            .own_attributes
            .layer_name
            .as_ref()
            .map_or_else(String::new, |name| format!(", `{}`", printable(&name.to_string())));
        remarks.push(format!("the file has {} parts: only one is read{name}", parts.len()));
    }
    if let Some(layer) = &selected.layer {
        remarks.push(format!("the only layer with colors is read: `{}`", printable(layer)));
    }
    let names = channel_names(header);
    let others: Vec<&str> = names.iter().map(String::as_str).collect();
    let others =
        others.into_iter().filter(|name| *name != selected.alpha && !selected.names.iter().any(|used| used == name));
    let others: Vec<&str> = others.collect();
    if !others.is_empty() {
        remarks.push(format!("channels that are not used: {}", list_names(others.into_iter())));
    }
    let own = &header.own_attributes;
    if let Some(white) = own.white_luminance.filter(|&white| white != 1.0) {
        remarks.push(format!("whiteLuminance {white} is not used: values are factors"));
    }
    let aspect = header.shared_attributes.pixel_aspect;
    if aspect != 1.0 {
        remarks.push(format!("pixelAspectRatio {aspect} is not used: texture coordinates span the image"));
    }
    if let Some(mode) = &own.wrap_mode_name {
        let mode = printable(&mode.to_string());
        if mode != "periodic" {
            remarks.push(format!("wrap mode `{mode}` is not used: textures repeat"));
        }
    }
    if own.view_name.is_some() || own.multi_view_names.is_some() {
        remarks.push("the file has several views: only one is read".to_owned());
    }
    remarks
}

/// Returns the matrix from the file's primaries to Rec.709.
fn primaries(header: &Header, role: Role, selected: &SelectedChannels, remarks: &mut Vec<String>) -> Option<Matrix> {
    let stated = header.shared_attributes.chromaticities?;
    if role == Role::Normals || selected.names[0] == selected.names[1] {
        return None;
    }
    let xy = |v: exr_prelude::Vec2<f32>| [f64::from(v.x()), f64::from(v.y())];
    let chromaticities: Chromaticities = [stated.red, stated.green, stated.blue, stated.white].map(xy);
    Matrix::to_rec709(chromaticities).unwrap_or_else(|_| {
        remarks.push("the chromaticities are degenerate: they are not used".to_owned());
        None
    })
}

/// Places the data window into the display window. Pixels outside the data window are black, and data outside the display window is
/// dropped.
fn place_in_display_window(
    file: &ImageFile<'_>,
    header: &Header,
    (data_width, data): PixelData,
    remarks: &mut Vec<String>,
) -> Result<(u32, u32, Vec<[f32; 3]>), ImportFault> {
    let display = header.shared_attributes.display_window;
    let (width, height) = file.check_size(display.size.width(), display.size.height())?;
    let offset = |data: i32, display: i32| i64::from(data) - i64::from(display);
    let position = header.own_attributes.layer_position;
    let (left, top) = (offset(position.x(), display.position.x()), offset(position.y(), display.position.y()));
    if (left, top) == (0, 0) && header.layer_size == display.size {
        return Ok((width, height, data));
    }
    let area = width as usize * height as usize;
    if area > FREE_AREA && area / data.len() > MAX_EMPTY_RATIO {
        let reason = format!(
            "the display window of {width} x {height} pixels has data in less than 1/{MAX_EMPTY_RATIO} of its area"
        );
        return Err(file.bad_file_with_advice(reason, "crop the image to its data"));
    }
    let mut pixels = vec![[0.0; 3]; area];
    let mut is_empty = true;
    for (i, row) in data.chunks_exact(data_width).enumerate() {
        let y = top + i as i64;
        let first = left.clamp(0, i64::from(width));
        let end = (left + data_width as i64).clamp(0, i64::from(width));
        if !(0..i64::from(height)).contains(&y) || first >= end {
            continue;
        }
        let start = y as usize * width as usize;
        let from = &row[(first - left) as usize..(end - left) as usize];
        pixels[start + first as usize..start + end as usize].copy_from_slice(from);
        is_empty = false;
    }
    if is_empty {
        remarks.push("the data window is outside the display window: the image is black".to_owned());
    }
    Ok((width, height, pixels))
}
