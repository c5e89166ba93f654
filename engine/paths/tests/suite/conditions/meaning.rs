//! A second evaluator of conditions, with its own syntax tree. It follows the text of the manual, place by place, without stored
//! results, and reads the records itself.

use super::NAMES;
use femc_paths::{InteractionKind, LightPath, LightRecord, LightTechnique, Name, PathEnd};
use std::cmp::Ordering;

/// Kind of value of an attribute.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Number,
    Name,
    Ends,
    Interactions,
    Techniques,
}

/// All names in conditions.
pub(crate) const FIELDS: &[(&str, Kind)] = &[
    ("bounce", Kind::Number),
    ("position.x", Kind::Number),
    ("position.y", Kind::Number),
    ("position.z", Kind::Number),
    ("radiance.r", Kind::Number),
    ("radiance.g", Kind::Number),
    ("radiance.b", Kind::Number),
    ("throughput.r", Kind::Number),
    ("throughput.g", Kind::Number),
    ("throughput.b", Kind::Number),
    ("object", Kind::Name),
    ("material", Kind::Name),
    ("interaction", Kind::Interactions),
    ("light.radiance.r", Kind::Number),
    ("light.radiance.g", Kind::Number),
    ("light.radiance.b", Kind::Number),
    ("light", Kind::Name),
    ("occluder", Kind::Name),
    ("found", Kind::Techniques),
    ("pixel.x", Kind::Number),
    ("pixel.y", Kind::Number),
    ("path.radiance.r", Kind::Number),
    ("path.radiance.g", Kind::Number),
    ("path.radiance.b", Kind::Number),
    ("path.throughput.r", Kind::Number),
    ("path.throughput.g", Kind::Number),
    ("path.throughput.b", Kind::Number),
    ("depth", Kind::Number),
    ("end", Kind::Ends),
    ("sample", Kind::Number),
    ("first.x", Kind::Number),
    ("first.y", Kind::Number),
    ("first.z", Kind::Number),
    ("first.interaction", Kind::Interactions),
    ("first.object", Kind::Name),
    ("last.x", Kind::Number),
    ("last.y", Kind::Number),
    ("last.z", Kind::Number),
    ("last.interaction", Kind::Interactions),
    ("last.object", Kind::Name),
    ("brightest.radiance", Kind::Number),
    ("brightest.light", Kind::Name),
];

pub(crate) const ENDS: [&str; 5] = ["escaped", "absorbed", "roulette", "depth", "field"];
pub(crate) const INTERACTIONS: [&str; 8] =
    ["absorbed", "emission", "diffuse", "glossy", "reflection", "refraction", "straight", "volume"];
pub(crate) const TECHNIQUES: [&str; 6] = ["sight", "met", "surface", "airlight", "glow", "field"];

fn end_word(end: PathEnd) -> &'static str {
    match end {
        PathEnd::Escaped => "escaped",
        PathEnd::Absorbed => "absorbed",
        PathEnd::Roulette => "roulette",
        PathEnd::Depth => "depth",
        PathEnd::Field => "field",
    }
}

fn interaction_word(kind: InteractionKind) -> &'static str {
    match kind {
        InteractionKind::Absorbed => "absorbed",
        InteractionKind::Emission => "emission",
        InteractionKind::Diffuse => "diffuse",
        InteractionKind::Glossy => "glossy",
        InteractionKind::Reflection => "reflection",
        InteractionKind::Refraction => "refraction",
        InteractionKind::Straight => "straight",
        InteractionKind::Volume => "volume",
    }
}

fn technique_word(technique: LightTechnique) -> &'static str {
    match technique {
        LightTechnique::CameraNextEvent => "sight",
        LightTechnique::EmitterHit => "met",
        LightTechnique::NextEvent => "surface",
        LightTechnique::Airlight => "airlight",
        LightTechnique::Glow => "glow",
        LightTechnique::Field => "field",
    }
}

/// Returns the text of a name; empty for no name.
fn text_of(name: Name) -> &'static str {
    NAMES.get(&name).map_or("", |(_, text)| text)
}

/// A condition.
#[derive(Clone, Debug)]
pub(crate) enum Meaning {
    And(Box<Self>, Box<Self>),
    Or(Box<Self>, Box<Self>),
    Not(Box<Self>),
    /// Name, sign and number.
    Number(&'static str, &'static str, f64),
    /// Name, sign and word.
    Word(&'static str, &'static str, &'static str),
    /// `any`, `all`, `light` or `lights`.
    Each(&'static str, Box<Self>),
    Then(Vec<&'static str>),
    InBox([f64; 6]),
    InLasso(Vec<[f64; 2]>),
}

/// A place at which a condition is examined.
#[derive(Clone, Copy)]
struct Place<'a> {
    path: &'a LightPath,
    width: u32,
    /// Index of the intersection.
    at: Option<usize>,
    light: Option<&'a LightRecord>,
    is_alone: bool,
}

/// A value of a record.
#[derive(PartialEq)]
pub(crate) enum Own {
    Number(f64),
    Text(&'static str),
}

/// Checks whether a name is `parent` or lies in it.
fn is_text_in(text: &str, parent: &str) -> bool {
    match text.len().cmp(&parent.len()) {
        Ordering::Less => false,
        Ordering::Equal => text == parent,
        Ordering::Greater => {
            let (begin, end) = text.split_at(parent.len());
            begin == parent && (end.starts_with('.') || end.starts_with('/'))
        }
    }
}

pub(crate) fn luminance([r, g, b]: [f32; 3]) -> f32 {
    0.212_639 * r + 0.715_168_7 * g + 0.072_192_32 * b
}

impl<'a> Place<'a> {
    fn lights(&self) -> Vec<&'a LightRecord> {
        let vertex = self.at.map_or(0, |at| at as u32 + 1);
        match self.light {
            Some(light) => vec![light],
            None => self.path.lights.iter().filter(|it| it.vertex == vertex).collect(),
        }
    }

    /// Returns the values that a name means here. A missing value is not among them.
    fn values(&self, field: &str) -> Vec<Own> {
        let number = |value: f32| Own::Number(f64::from(value));
        let channel = |rgb: [f32; 3]| number(rgb["rgb".find(&field[field.len() - 1..]).unwrap()]);
        let axis =
            |it: &femc_paths::Intersection| Own::Number(it.position["xyz".find(&field[field.len() - 1..]).unwrap()]);
        let path = self.path;
        let pixel = [path.key.pixel % self.width, path.key.pixel / self.width].map(|it| Own::Number(f64::from(it)));
        let [x, y] = pixel;
        let here = self.at.map(|at| &path.intersections[at]).into_iter();
        let (first, last) = (path.intersections.first().into_iter(), path.intersections.last().into_iter());
        let mut brightest: Option<&LightRecord> = None;
        for light in &path.lights {
            if brightest.is_none_or(|it| luminance(it.radiance) <= luminance(light.radiance)) {
                brightest = Some(light);
            }
        }
        let lights = self.lights().into_iter();
        let all: Vec<Own> = match field {
            "bounce" => here.map(|it| Own::Number(f64::from(it.bounce))).collect(),
            "position.x" | "position.y" | "position.z" => here.map(axis).collect(),
            "radiance.r" | "radiance.g" | "radiance.b" => here.map(|it| channel(it.radiance)).collect(),
            "throughput.r" | "throughput.g" | "throughput.b" => here.map(|it| channel(it.throughput)).collect(),
            "object" => here.map(|it| Own::Text(text_of(it.object))).collect(),
            "material" => here.map(|it| Own::Text(text_of(it.material))).collect(),
            "interaction" => here.map(|it| Own::Text(interaction_word(it.interaction))).collect(),
            "light.radiance.r" | "light.radiance.g" | "light.radiance.b" => {
                lights.map(|it| channel(it.radiance)).collect()
            }
            "light" => lights.map(|it| Own::Text(text_of(it.light))).collect(),
            "occluder" => lights.filter_map(|it| it.occluder).map(|it| Own::Text(text_of(it))).collect(),
            "found" => lights.map(|it| Own::Text(technique_word(it.technique))).collect(),
            "pixel.x" => vec![x],
            "pixel.y" => vec![y],
            "path.radiance.r" | "path.radiance.g" | "path.radiance.b" => vec![channel(path.radiance)],
            "path.throughput.r" | "path.throughput.g" | "path.throughput.b" => vec![channel(path.throughput)],
            "depth" => vec![Own::Number(f64::from(path.depth))],
            "end" => vec![Own::Text(end_word(path.end))],
            "sample" => vec![Own::Number(f64::from(path.key.sample))],
            "first.x" | "first.y" | "first.z" => first.map(axis).collect(),
            "last.x" | "last.y" | "last.z" => last.map(axis).collect(),
            "first.interaction" => first.map(|it| Own::Text(interaction_word(it.interaction))).collect(),
            "last.interaction" => last.map(|it| Own::Text(interaction_word(it.interaction))).collect(),
            "first.object" => first.map(|it| Own::Text(text_of(it.object))).collect(),
            "last.object" => last.map(|it| Own::Text(text_of(it.object))).collect(),
            "brightest.radiance" => brightest.into_iter().map(|it| number(luminance(it.radiance))).collect(),
            "brightest.light" => brightest.into_iter().map(|it| Own::Text(text_of(it.light))).collect(),
            _ => panic!("{field} has no meaning here"),
        };
        all.into_iter().filter(|value| *value != Own::Text("")).collect()
    }

    /// Returns the objects from the camera to an intersection.
    fn branch(&self, to: usize) -> Vec<&'static str> {
        let it = &self.path.intersections[to];
        let mut all = if it.parent == 0 { Vec::new() } else { self.branch(it.parent as usize - 1) };
        all.push(text_of(it.object));
        all
    }
}

/// Checks whether some of the texts, in their order, lie in the objects one after the other. It tries all ways.
fn visits(texts: &[&str], objects: &[&str]) -> bool {
    let Some((object, later)) = objects.split_first() else { return true };
    (0..texts.len()).any(|at| is_text_in(texts[at], object) && visits(&texts[at + 1..], later))
}

/// Counts the edges above a point. An odd count means that the point is inside.
fn is_surrounded(points: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let mut count = 0;
    for (at, [x0, y0]) in points.iter().enumerate() {
        let [x1, y1] = points[(at + 1) % points.len()];
        let (left, right) = (x0.min(x1), x0.max(x1));
        if left < x && x < right && y0 + (x - x0) * (y1 - y0) / (x1 - x0) < y {
            count += 1;
        }
    }
    count % 2 == 1
}

impl Meaning {
    fn holds(&self, place: &Place<'_>) -> bool {
        let path = place.path;
        match self {
            Self::And(a, b) => a.holds(place) & b.holds(place),
            Self::Or(a, b) => a.holds(place) | b.holds(place),
            Self::Not(inner) => !inner.holds(place),
            Self::Number(field, sign, wanted) => {
                let has = |fits: fn(f64, f64) -> bool| {
                    place.values(field).iter().any(|it| matches!(it, Own::Number(own) if fits(*own, *wanted)))
                };
                match *sign {
                    "==" => has(|own, wanted| own == wanted),
                    "!=" => !has(|own, wanted| own == wanted),
                    "<" => has(|own, wanted| own < wanted),
                    "<=" => has(|own, wanted| own <= wanted),
                    ">" => has(|own, wanted| own > wanted),
                    ">=" => has(|own, wanted| own >= wanted),
                    _ => panic!("{sign}"),
                }
            }
            Self::Word(field, sign, wanted) => {
                let is_name = FIELDS.contains(&(field, Kind::Name));
                let fits = |own: &str| if is_name { is_text_in(own, wanted) } else { own == *wanted };
                let has = place.values(field).iter().any(|it| matches!(it, Own::Text(own) if fits(own)));
                has == (*sign == "==")
            }
            Self::Each(_, inner) if place.is_alone && place.light.is_some() => inner.holds(place),
            Self::Each("any" | "all", inner) if place.is_alone => inner.holds(place),
            Self::Each(word, inner) => {
                let places: Vec<Place<'_>> = if word.starts_with("light") {
                    let all =
                        path.lights.iter().map(|light| Place { light: Some(light), at: parent(path, light), ..*place });
                    let own =
                        |it: &Place<'_>| !place.is_alone || it.at == place.at && is_recorded(path, it.light.unwrap());
                    all.filter(own).collect()
                } else {
                    places(path).into_iter().map(|at| Place { at, light: None, ..*place }).collect()
                };
                let count = places.iter().filter(|place| inner.holds(place)).count();
                if matches!(*word, "any" | "light") { count > 0 } else { count == places.len() }
            }
            Self::Then(objects) => (0..path.intersections.len()).any(|to| visits(&place.branch(to), objects)),
            Self::InBox([a, b, c, d, e, f]) => place.at.is_some_and(|at| {
                let [x, y, z] = path.intersections[at].position;
                *a <= x && x <= *d && *b <= y && y <= *e && *c <= z && z <= *f
            }),
            Self::InLasso(points) => {
                let [x, y] = [path.key.pixel % place.width, path.key.pixel / place.width];
                is_surrounded(points, [f64::from(x) + 0.5, f64::from(y) + 0.5])
            }
        }
    }

    fn has_each(&self) -> bool {
        match self {
            Self::And(a, b) | Self::Or(a, b) => a.has_each() || b.has_each(),
            Self::Not(inner) => inner.has_each(),
            Self::Each(..) => true,
            _ => false,
        }
    }

    /// Returns the selected intersections and lights; `None`: the path is not selected.
    pub(crate) fn select(&self, path: &LightPath, width: u32) -> Option<[Vec<u32>; 2]> {
        let whole = Place { path, width, at: None, light: None, is_alone: false };
        if !places(path).into_iter().any(|at| self.holds(&Place { at, ..whole })) {
            return None;
        }
        let alone = Place { is_alone: true, ..whole };
        let intersections = (0..path.intersections.len())
            .filter(|&at| self.holds(&Place { at: Some(at), ..alone }))
            .map(|at| at as u32);
        let is_lit = |light: &LightRecord| {
            !self.has_each() || self.holds(&Place { at: parent(path, light), light: Some(light), ..alone })
        };
        let lights = (0u32..).zip(&path.lights).filter(|(_, light)| is_lit(light)).map(|(at, _)| at);
        Some([intersections.collect(), lights.collect()])
    }
}

/// Returns the places of a path: its intersections, or once none.
fn places(path: &LightPath) -> Vec<Option<usize>> {
    if path.intersections.is_empty() { vec![None] } else { (0..path.intersections.len()).map(Some).collect() }
}

fn parent(path: &LightPath, light: &LightRecord) -> Option<usize> {
    if light.vertex == 0 || !is_recorded(path, light) { None } else { Some(light.vertex as usize - 1) }
}

fn is_recorded(path: &LightPath, light: &LightRecord) -> bool {
    light.vertex as usize <= path.intersections.len()
}

/// Returns the value of an attribute of a path, of one of its intersections, or of one of its lights.
pub(crate) fn value_of(
    path: &LightPath,
    width: u32,
    field: &str,
    at: Option<usize>,
    light: Option<&LightRecord>,
) -> Option<Own> {
    let place = Place { path, width, at, light, is_alone: true };
    place.values(field).into_iter().next()
}
