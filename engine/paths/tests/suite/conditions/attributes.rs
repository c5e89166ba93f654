//! Law of attributes: a condition on an attribute reads its own value and no other one.

use super::meaning::{ENDS, FIELDS, INTERACTIONS, Kind, TECHNIQUES};
use super::{intersection, light, light_path, object, selected};
use femc_paths::attribute::Attribute;
use femc_paths::{InteractionKind, LightPath, LightTechnique, Name, NameKind, PathEnd, PathKey};
use std::collections::BTreeSet;

/// Values of an attribute: one of the path, or one for each of its three intersections, or for each of its four lights.
enum Values {
    Path(&'static str),
    Intersections([&'static str; 3]),
    Lights([&'static str; 4]),
}
use Values::{Intersections, Lights, Path};

/// A path in which no two attributes have the same value, except those that are the same by definition.
fn specimen() -> LightPath {
    let mut path = light_path(
        vec![intersection(0, "ball"), intersection(1, "door"), intersection(1, "room.floor")],
        vec![light(2, 0.0), light(1, 0.0), light(3, 0.0), light(1, 0.0)],
    );
    path.key = PathKey { frame: 3, pixel: 23, sample: 11 };
    path.radiance = [101.5, 102.5, 103.5];
    path.throughput = [0.25, 0.375, 0.4375];
    path.depth = 4;
    path.end = PathEnd::Roulette;
    let kinds = [InteractionKind::Reflection, InteractionKind::Emission, InteractionKind::Volume];
    for (number, (it, kind)) in (0u16..).zip(path.intersections.iter_mut().zip(kinds)) {
        let base = 20.0 * f32::from(number);
        it.bounce = 5 + 2 * u32::from(number);
        it.position = [1.25, 2.25, 3.25].map(|axis| f64::from(axis + base));
        it.radiance = [4.25, 5.25, 6.25].map(|channel| channel + base);
        it.throughput = [7.25, 8.25, 9.25].map(|channel| channel + base);
        it.material = Name::new(NameKind::Material, ["chrome", "chrome.dull", "ball"][usize::from(number)]);
        it.interaction = kind;
    }
    let techniques =
        [LightTechnique::Airlight, LightTechnique::EmitterHit, LightTechnique::Glow, LightTechnique::CameraNextEvent];
    let lamps = ["lamp", "lamp a", "lamp a/bulb", "lamp"];
    for (number, it) in path.lights.iter_mut().enumerate() {
        let base = 20.0 * number as f32;
        it.radiance = [200.5, 201.5, 202.5].map(|channel| channel + base);
        it.technique = techniques[number];
        it.light = Name::new(NameKind::Lamp, lamps[number]);
    }
    path.lights[0].occluder = Some(object("roomy"));
    path.lights[2].occluder = Some(object("room.a"));
    // Only red, so that the luminance is a single product.
    path.lights[2].radiance = [2000.0, 0.0, 0.0];
    path
}

/// Values of the specimen, written by hand.
const TABLE: &[(&str, Values)] = &[
    ("bounce", Intersections(["5", "7", "9"])),
    ("position.x", Intersections(["1.25", "21.25", "41.25"])),
    ("position.y", Intersections(["2.25", "22.25", "42.25"])),
    ("position.z", Intersections(["3.25", "23.25", "43.25"])),
    ("radiance.r", Intersections(["4.25", "24.25", "44.25"])),
    ("radiance.g", Intersections(["5.25", "25.25", "45.25"])),
    ("radiance.b", Intersections(["6.25", "26.25", "46.25"])),
    ("throughput.r", Intersections(["7.25", "27.25", "47.25"])),
    ("throughput.g", Intersections(["8.25", "28.25", "48.25"])),
    ("throughput.b", Intersections(["9.25", "29.25", "49.25"])),
    ("object", Intersections(["ball", "door", "room.floor"])),
    ("material", Intersections(["chrome", "chrome.dull", "ball"])),
    ("interaction", Intersections(["reflection", "emission", "volume"])),
    ("light.radiance.r", Lights(["200.5", "220.5", "2000", "260.5"])),
    ("light.radiance.g", Lights(["201.5", "221.5", "0", "261.5"])),
    ("light.radiance.b", Lights(["202.5", "222.5", "0", "262.5"])),
    ("light", Lights(["lamp", "\"lamp a\"", "\"lamp a/bulb\"", "lamp"])),
    ("occluder", Lights(["roomy", "", "room.a", ""])),
    ("found", Lights(["airlight", "met", "glow", "sight"])),
    ("pixel.x", Path("2")),
    ("pixel.y", Path("3")),
    ("path.radiance.r", Path("101.5")),
    ("path.radiance.g", Path("102.5")),
    ("path.radiance.b", Path("103.5")),
    ("path.throughput.r", Path("0.25")),
    ("path.throughput.g", Path("0.375")),
    ("path.throughput.b", Path("0.4375")),
    ("depth", Path("4")),
    ("end", Path("roulette")),
    ("sample", Path("11")),
    ("first.x", Path("1.25")),
    ("first.y", Path("2.25")),
    ("first.z", Path("3.25")),
    ("first.interaction", Path("reflection")),
    ("first.object", Path("ball")),
    ("last.x", Path("41.25")),
    ("last.y", Path("42.25")),
    ("last.z", Path("43.25")),
    ("last.interaction", Path("volume")),
    ("last.object", Path("room.floor")),
    // 2000 times 0.212639, as a 32-bit number.
    ("brightest.radiance", Path("425.27801513671875")),
    ("brightest.light", Path("\"lamp a/bulb\"")),
];

#[test]
fn every_attribute_has_a_row_in_both_tables() {
    let known: BTreeSet<&str> = Attribute::all().map(|it| it.field).collect();
    let rows: BTreeSet<&str> = TABLE.iter().map(|(field, _)| *field).collect();
    let fields: BTreeSet<&str> = FIELDS.iter().map(|(field, _)| *field).collect();
    assert_eq!(known, rows);
    assert_eq!(known, fields);
    assert_eq!((TABLE.len(), FIELDS.len()), (rows.len(), fields.len()));
}

#[test]
fn a_condition_reads_its_own_attribute_alone() {
    let path = specimen();
    let vertices = [2usize, 1, 3, 1];
    let texts = |values: &Values| match values {
        Path(one) => vec![*one],
        Intersections(all) => all.to_vec(),
        Lights(all) => all.to_vec(),
    };
    let kind_of = |field: &str| FIELDS.iter().find(|it| it.0 == field).unwrap().1;
    for (field, own) in TABLE {
        let kind = kind_of(field);
        // All values of the specimen that the attribute could have.
        let mut candidates: BTreeSet<&str> = match kind {
            Kind::Ends => ENDS.to_vec(),
            Kind::Interactions => INTERACTIONS.to_vec(),
            Kind::Techniques => TECHNIQUES.to_vec(),
            _ => TABLE.iter().filter(|it| kind_of(it.0) == kind).flat_map(|it| texts(&it.1)).collect(),
        }
        .into_iter()
        .collect();
        candidates.remove("");
        for value in candidates {
            let (plain, is_name) = (value.trim_matches('"'), kind == Kind::Name);
            let is_value = |own: &str| {
                let own = own.trim_matches('"');
                // A name of the specimen that lies in another one.
                own == plain
                    || is_name && [("lamp a/bulb", "lamp a"), ("chrome.dull", "chrome")].contains(&(own, plain))
            };
            let expected: Vec<u32> = (0..3u32)
                .filter(|at| match own {
                    Path(one) => is_value(one),
                    Intersections(all) => is_value(all[*at as usize]),
                    Lights(all) => {
                        vertices.iter().zip(all).any(|(vertex, own)| *vertex == *at as usize + 1 && is_value(own))
                    }
                })
                .collect();
            let text = format!("{field} == {value}");
            let found = selected(&text, &path).map_or(Vec::new(), |it| it.intersections);
            assert_eq!(found, expected, "{text}");
            let text = format!("{field} != {value}");
            let others: Vec<u32> = (0..3).filter(|at| !expected.contains(at)).collect();
            let found = selected(&text, &path).map_or(Vec::new(), |it| it.intersections);
            assert_eq!(found, others, "{text}");
        }
    }
}
