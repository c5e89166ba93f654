//! Attributes, names and totals of recorded light, as JSON.

use super::{RecordedLight, counts_by_table};
use femc_paths::NameKind;
use femc_paths::attribute::Attribute;
use femc_paths::histogram::Table;
use femc_paths::schema::{self, FINE_BINS, Scale, Words};
use serde_json::{Map, Value, json};

/// Encodes the schema of recorded light.
pub fn encode_schema(light: &RecordedLight) -> Vec<u8> {
    let paths = &light.paths;
    let frames = paths.frames();
    let films = || frames.iter().map(|frame| frame.scope.film);
    // Frames of different films are shown on the greatest one.
    let film = films().fold([0, 0], |[width, height]: [u32; 2], own| [width.max(own[0]), height.max(own[1])]);
    let tables = Table::ALL.map(|table| {
        let axes = table.attributes().iter().map(describe_axis).collect();
        (table.name().to_owned(), Value::Array(axes))
    });
    let edges = |edge: fn(u8) -> f64| (0..FINE_BINS as u8).map(edge).collect::<Vec<f64>>();
    let names = paths.names().entries();
    let schema = json!({
        "tag": light.tag,
        "version": schema::VERSION,
        "growing": light.is_growing,
        "frames": frames.iter().map(|frame| frame.scope.frame).collect::<Vec<_>>(),
        "film": film,
        "box": paths.bounds(),
        "samples": frames.iter().map(|frame| frame.samples).sum::<u64>(),
        "bad_samples": frames.iter().map(|frame| frame.bad_samples).sum::<u64>(),
        "share": paths.share(),
        "recorded": paths.totals()[0],
        "full_histograms": paths.has_full_histograms(),
        "counts": counts_by_table(paths.totals()),
        "tables": Map::from_iter(tables),
        "names": names.iter().map(|(_, text)| text.as_str()).collect::<Vec<_>>(),
        "kinds": names.iter().map(|(kind, _)| kind_word(*kind)).collect::<Vec<_>>(),
        "words": { "end": Words::End.list(), "interaction": Words::Interaction.list(), "found": Words::Technique.list() },
        "radiance_edges": edges(schema::radiance_edge),
        "throughput_edges": edges(schema::throughput_edge),
    });
    schema.to_string().into_bytes()
}

fn describe_axis(attribute: &Attribute) -> Value {
    let mut axis = json!({ "name": attribute.name, "scale": attribute.scale.word(), "field": attribute.field });
    if let Scale::Class(words) = attribute.scale {
        axis["words"] = json!(words.list());
    }
    axis
}

fn kind_word(kind: NameKind) -> &'static str {
    match kind {
        NameKind::Object => "object",
        NameKind::Material => "material",
        NameKind::Medium => "medium",
        NameKind::Lamp => "light",
    }
}
