//! Attributes of records: one table each for paths, intersections and lights. Histograms, conditions, columns and plots follow from
//! these tables, so a new attribute is one row. A change of the rows that have bins requires a new [`VERSION`](crate::schema::VERSION).
//!
//! A row has the name in histograms and columns, the name in conditions, the [`Scale`] with its unit and bins, the value, and a
//! description.

use crate::record::{Intersection, LightPath, LightRecord, Name, luminance};
use crate::schema::Scale::{self, Class, Count, Film, Name as Named, Radiance, Throughput, World};
use crate::schema::{FINE_BINS, Value, Words};
use crate::statistics::Scope;

/// A table of records.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Table {
    /// Paths.
    Paths,
    /// Intersections of paths.
    Intersections,
    /// Lights of paths.
    Lights,
}

impl Table {
    /// All tables.
    pub const ALL: [Self; 3] = [Self::Paths, Self::Intersections, Self::Lights];

    /// Returns the name of the table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paths => "paths",
            Self::Intersections => "intersections",
            Self::Lights => "lights",
        }
    }

    /// Returns the names of each pair of its attributes, in the order of [`Histograms::pairs`](crate::histogram::Histograms::pairs).
    pub fn pairs(self) -> impl Iterator<Item = [&'static str; 2]> + use<> {
        let attributes = self.attributes();
        (0..attributes.len()).flat_map(move |a| attributes[a + 1..].iter().map(move |b| [attributes[a].name, b.name]))
    }

    /// Returns the attributes of the table.
    pub fn attributes(self) -> &'static [Attribute] {
        match self {
            Self::Paths => &PATH_ATTRIBUTES,
            Self::Intersections => &INTERSECTION_ATTRIBUTES,
            Self::Lights => &LIGHT_ATTRIBUTES,
        }
    }
}

/// Function that reads the value from a record; `None`: the record lacks it.
#[derive(Clone, Copy, Debug)]
pub enum Getter {
    /// Reads a path. The scope has the width of the film.
    Path(fn(&Scope, &LightPath) -> Option<Value>),
    /// Reads an intersection.
    Intersection(fn(&Scope, &Intersection) -> Option<Value>),
    /// Reads a light.
    Light(fn(&Scope, &LightRecord) -> Option<Value>),
}

/// An attribute of a record.
#[derive(Clone, Copy, Debug)]
pub struct Attribute {
    /// Name of the attribute in histograms and columns; unique in its table.
    pub name: &'static str,
    /// Name of the attribute in conditions; unique.
    pub field: &'static str,
    /// Scale, with unit and bins.
    pub scale: Scale,
    /// Description.
    pub about: &'static str,
    /// Function that reads the value.
    pub getter: Getter,
}

impl PartialEq for Attribute {
    fn eq(&self, other: &Self) -> bool {
        self.field == other.field
    }
}

impl Eq for Attribute {}

impl Attribute {
    /// Returns the attribute with this name in conditions.
    pub fn from_field(field: &str) -> Option<&'static Self> {
        Self::all().find(|attribute| attribute.field == field)
    }

    /// Returns all attributes: attributes with bins, and attributes that only conditions use.
    pub fn all() -> impl Iterator<Item = &'static Self> {
        [&INTERSECTION_ATTRIBUTES[..], &INTERSECTION_FIELDS, &LIGHT_ATTRIBUTES, &PATH_ATTRIBUTES, &PATH_FIELDS]
            .into_iter()
            .flatten()
    }

    /// Returns the table of its records.
    pub fn table(&self) -> Table {
        match self.getter {
            Getter::Path(_) => Table::Paths,
            Getter::Intersection(_) => Table::Intersections,
            Getter::Light(_) => Table::Lights,
        }
    }

    /// Returns its values for all records of a path, in order.
    pub fn values<'a>(&self, scope: &'a Scope, path: &'a LightPath) -> impl Iterator<Item = Option<Value>> + use<'a> {
        let (of_path, of_intersections, of_lights) = match self.getter {
            Getter::Path(get) => (Some(get(scope, path)), None, None),
            Getter::Intersection(get) => (None, Some(path.intersections.iter().map(move |it| get(scope, it))), None),
            Getter::Light(get) => (None, None, Some(path.lights.iter().map(move |it| get(scope, it)))),
        };
        of_path.into_iter().chain(of_intersections.into_iter().flatten()).chain(of_lights.into_iter().flatten())
    }
}

fn number(value: impl Into<f64>) -> Option<Value> {
    Some(Value::Number(value.into()))
}

fn name(name: Name) -> Option<Value> {
    Some(Value::Name(name))
}

fn pixel(scope: &Scope, path: &LightPath) -> [u32; 2] {
    let width = scope.film[0].max(1);
    [path.key.pixel % width, path.key.pixel / width]
}

macro_rules! attributes {
    ($(#[$doc:meta])* $visibility:vis const $list:ident, $getter:ident($scope:ident, $record:ident);
     $($name:literal, $field:literal, $scale:expr, $value:expr, $about:literal;)+) => {
        $(#[$doc])*
        $visibility const $list: [Attribute; [$($name),+].len()] = [$(Attribute {
            name: $name,
            field: $field,
            scale: $scale,
            about: $about,
            getter: Getter::$getter(|$scope, $record| { let _ = $scope; $value }),
        }),+];
    };
    ($(#[$doc:meta])* $visibility:vis const $list:ident, $getter:ident($scope:ident, $record:ident: $type:ty);
     $(#[$bins_doc:meta])* fn $bins:ident;
     $($name:literal, $field:literal, $scale:expr, $value:expr, $about:literal;)+) => {
        attributes! {
            $(#[$doc])* $visibility const $list, $getter($scope, $record);
            $($name, $field, $scale, $value, $about;)+
        }

        // The values are written out, and not called by the table: millions of paths are counted.
        $(#[$bins_doc])*
        #[inline]
        pub fn $bins($scope: &Scope, $record: &$type) -> [u8; $list.len()] {
            [$($scale.bin($scope, $value)),+]
        }
    };
}

attributes! {
    /// Attributes of a path, in the order of the axes of a parallel coordinates plot. `first` and `last` are its intersections,
    /// `light` is the light that contributed the most.
    pub const PATH_ATTRIBUTES, Path(scope, path: LightPath);
    /// Returns the fine bins of a path.
    fn path_bins;
    "pixel.x", "pixel.x", Film(0), number(pixel(scope, path)[0]), "column of the pixel";
    "pixel.y", "pixel.y", Film(1), number(pixel(scope, path)[1]), "row of the pixel";
    "radiance.r", "path.radiance.r", Radiance, number(path.radiance[0]), "contribution to the pixel";
    "radiance.g", "path.radiance.g", Radiance, number(path.radiance[1]), "contribution to the pixel";
    "radiance.b", "path.radiance.b", Radiance, number(path.radiance[2]), "contribution to the pixel";
    "throughput.r", "path.throughput.r", Throughput, number(path.throughput[0]), "throughput at the end of the path";
    "throughput.g", "path.throughput.g", Throughput, number(path.throughput[1]), "throughput at the end of the path";
    "throughput.b", "path.throughput.b", Throughput, number(path.throughput[2]), "throughput at the end of the path";
    "depth", "depth", Count, number(path.depth), "number of intersections";
    "end", "end", Class(Words::End), Some(Value::Word(path.end as u8)), "reason why the path ended";
    "first.x", "first.x", World(0), path.intersections.first().and_then(|it| number(it.position[0])), "first intersection";
    "first.y", "first.y", World(1), path.intersections.first().and_then(|it| number(it.position[1])), "first intersection";
    "first.z", "first.z", World(2), path.intersections.first().and_then(|it| number(it.position[2])), "first intersection";
    "first.interaction", "first.interaction", Class(Words::Interaction),
        path.intersections.first().map(|it| Value::Word(it.interaction as u8)), "interaction at the first intersection";
    "first.object", "first.object", Named, path.intersections.first().and_then(|it| name(it.object)),
        "object at the first intersection";
    "last.x", "last.x", World(0), path.intersections.last().and_then(|it| number(it.position[0])),
        "last recorded intersection";
    "last.y", "last.y", World(1), path.intersections.last().and_then(|it| number(it.position[1])),
        "last recorded intersection";
    "last.z", "last.z", World(2), path.intersections.last().and_then(|it| number(it.position[2])),
        "last recorded intersection";
    "light.radiance", "brightest.radiance", Radiance,
        path.brightest_light().and_then(|it| number(luminance(it.radiance))), "luminance of the brightest light";
    "light", "brightest.light", Named, path.brightest_light().and_then(|it| name(it.light)),
        "lamp of the brightest light";
}

attributes! {
    /// Values of a path in conditions, without bins.
    const PATH_FIELDS, Path(scope, path);
    "sample", "sample", Count, number(path.key.sample), "number of the sample in its pixel";
    "last.interaction", "last.interaction", Class(Words::Interaction),
        path.intersections.last().map(|it| Value::Word(it.interaction as u8)),
        "interaction at the last recorded intersection";
    "last.object", "last.object", Named, path.intersections.last().and_then(|it| name(it.object)),
        "object at the last recorded intersection";
}

attributes! {
    /// Attributes of an intersection.
    pub const INTERSECTION_ATTRIBUTES, Intersection(scope, it: Intersection);
    /// Returns the fine bins of an intersection.
    fn intersection_bins;
    "bounce", "bounce", Count, number(it.bounce), "index of the segment that ends there, 0: the camera's";
    "position.x", "position.x", World(0), number(it.position[0]), "position";
    "position.y", "position.y", World(1), number(it.position[1]), "position";
    "position.z", "position.z", World(2), number(it.position[2]), "position";
    "radiance.r", "radiance.r", Radiance, number(it.radiance[0]), "light that leaves it along the path";
    "radiance.g", "radiance.g", Radiance, number(it.radiance[1]), "light that leaves it along the path";
    "radiance.b", "radiance.b", Radiance, number(it.radiance[2]), "light that leaves it along the path";
    "object", "object", Named, name(it.object), "object";
    "material", "material", Named, name(it.material), "material or medium";
    "interaction", "interaction", Class(Words::Interaction), Some(Value::Word(it.interaction as u8)),
        "interaction with which the path continued";
}

attributes! {
    /// Values of an intersection in conditions, without bins.
    const INTERSECTION_FIELDS, Intersection(scope, it);
    "throughput.r", "throughput.r", Throughput, number(it.throughput[0]), "throughput on arrival";
    "throughput.g", "throughput.g", Throughput, number(it.throughput[1]), "throughput on arrival";
    "throughput.b", "throughput.b", Throughput, number(it.throughput[2]), "throughput on arrival";
}

attributes! {
    /// Attributes of a light record.
    pub const LIGHT_ATTRIBUTES, Light(scope, it: LightRecord);
    /// Returns the fine bins of a light.
    fn light_bins;
    "radiance.r", "light.radiance.r", Radiance, number(it.radiance[0]), "contribution to the sample";
    "radiance.g", "light.radiance.g", Radiance, number(it.radiance[1]), "contribution to the sample";
    "radiance.b", "light.radiance.b", Radiance, number(it.radiance[2]), "contribution to the sample";
    "light", "light", Named, name(it.light), "lamp, or medium that emits";
    "occluder", "occluder", Named, it.occluder.and_then(name), "nearest object that hides the lamp";
    "found", "found", Class(Words::Technique), Some(Value::Word(it.technique as u8)), "technique that found the light";
}

/// Numbers of attributes of paths, intersections and lights.
pub const ATTRIBUTE_COUNTS: [usize; 3] = [PATH_ATTRIBUTES.len(), INTERSECTION_ATTRIBUTES.len(), LIGHT_ATTRIBUTES.len()];
/// Number of bins of all attributes.
pub const ALL_BINS: usize = FINE_BINS * (ATTRIBUTE_COUNTS[0] + ATTRIBUTE_COUNTS[1] + ATTRIBUTE_COUNTS[2]);

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn names_and_fields_are_unique() {
        let fields: BTreeSet<&str> = Attribute::all().map(|it| it.field).collect();
        assert_eq!(fields.len(), Attribute::all().count());
        for table in Table::ALL {
            let names: BTreeSet<&str> = table.attributes().iter().map(|it| it.name).collect();
            assert_eq!(names.len(), table.attributes().len());
            assert!(table.attributes().iter().all(|it| it.table() == table));
        }
    }

    #[test]
    fn every_fine_bin_has_a_coarse_one_and_none_is_empty() {
        for attribute in Attribute::all() {
            let coarse: Vec<u8> = (0..FINE_BINS as u8).map(|fine| attribute.scale.coarse(fine)).collect();
            assert!(coarse.is_sorted() && coarse[0] == 0 && coarse[63] == 9, "{attribute:?}");
            assert!(coarse.windows(2).all(|pair| pair[1] - pair[0] <= 1), "{attribute:?}");
        }
    }
}
