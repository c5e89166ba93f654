//! `[regions]` and `[contrasts]`: measurements in every frame of a sweep.

use super::fault::Fault;
use crate::values::TextPosition;
use serde::Deserialize as _;
use std::collections::BTreeMap;
use toml::Spanned;
use toml::de::{DeValue, ValueDeserializer};

/// A rectangle of the film.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Region {
    /// Name of the region.
    pub name: String,
    /// Left, top, right and bottom border, in pixels from the upper left corner; right and bottom are exclusive.
    pub bounds: [u32; 4],
    /// Location in the job file.
    pub position: TextPosition,
}

/// Weber contrast of one region against another: (L - Lb) / Lb.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Contrast {
    /// Name of the contrast.
    pub name: String,
    /// Region of the object.
    pub target: String,
    /// Region of the background.
    pub background: String,
}

/// Measurements besides the whole film.
#[derive(Clone, Debug, Default)]
pub struct Measures {
    /// Regions in the order of the file.
    pub regions: Vec<Region>,
    /// Contrasts in the order of the file.
    pub contrasts: Vec<Contrast>,
}

type Entry<'a> = (String, usize, &'a Spanned<DeValue<'a>>);

impl Measures {
    /// Reads both tables.
    pub(super) fn read(
        regions: Option<&Spanned<DeValue<'_>>>,
        contrasts: Option<&Spanned<DeValue<'_>>>,
        text: &str,
    ) -> Result<Self, Fault> {
        let mut measures = Self::default();
        for (name, _, value) in entries(regions, "[regions] must have lines like sign = [10, 20, 30, 40]")? {
            measures.regions.push(region(name, value, text)?);
        }
        let known: BTreeMap<&str, ()> = measures.regions.iter().map(|region| (region.name.as_str(), ())).collect();
        for (name, _, value) in entries(contrasts, "[contrasts] must have lines like seen = [\"sign\", \"road\"]")? {
            let at = value.span().start;
            let pair = <[String; 2]>::deserialize(ValueDeserializer::from(value.clone()));
            let [target, background] = pair.map_err(|_| {
                Fault::new(
                    at,
                    format!("`{name}`: a contrast must be [\"REGION\", \"BACKGROUND\"], two names of [regions]"),
                )
            })?;
            if let Some(lost) = [&target, &background].into_iter().find(|name| !known.contains_key(name.as_str())) {
                return Err(Fault::new(at, format!("`{name}`: unknown region `{lost}`; define it in [regions]")));
            }
            measures.contrasts.push(Contrast { name, target, background });
        }
        Ok(measures)
    }
}

/// Returns the lines of a table in the order of the file.
fn entries<'a>(table: Option<&'a Spanned<DeValue<'a>>>, form: &str) -> Result<Vec<Entry<'a>>, Fault> {
    let Some(table) = table else { return Ok(Vec::new()) };
    let DeValue::Table(entries) = table.get_ref() else { return Err(Fault::new(table.span().start, form)) };
    let mut entries: Vec<Entry<'a>> =
        entries.iter().map(|(key, value)| (key.get_ref().to_string(), key.span().start, value)).collect();
    entries.sort_by_key(|(_, offset, _)| *offset);
    Ok(entries)
}

fn region(name: String, value: &Spanned<DeValue<'_>>, text: &str) -> Result<Region, Fault> {
    let at = value.span().start;
    let form = || Fault::new(at, format!("`{name}`: a region must be [x0, y0, x1, y1] in pixels, x1 and y1 excluded"));
    let bounds = <[u32; 4]>::deserialize(ValueDeserializer::from(value.clone())).map_err(|_| form())?;
    let [x0, y0, x1, y1] = bounds;
    if x0 >= x1 || y0 >= y1 {
        return Err(Fault::new(at, format!("`{name}`: the region contains no pixel; it needs x0 < x1 and y0 < y1")));
    }
    Ok(Region { name, bounds, position: TextPosition::from_offset(text, at) })
}
