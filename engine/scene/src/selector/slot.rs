//! Slots: a slot is one scalar of one entity. A selector resolves to the slots of all entities with its name.

use super::{
    Constraint, ScalarsView, ScalarsViewMut,
    field::{CameraField, MaterialField, MediumField, either, finite, not_negative, positive, require},
};
use crate::{
    description::{Camera, Material, ObjectId},
    objects::inherited_flags,
};
use std::collections::BTreeSet;

/// One scalar of one entity. Numbers are indices in the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Slot {
    Material(usize, MaterialField),
    Medium(usize, MediumField),
    Camera(usize, CameraField),
    Hidden(usize),
    Multiplier { group: usize, luminaire: usize },
    Key { path: usize, key: usize, field: KeyField },
    Clip(ClipField),
}

/// A scalar of a key of a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum KeyField {
    Time,
    Translation(usize),
}

impl KeyField {
    const ALL: [(&'static str, Self); 4] =
        [("time", Self::Time), ("x", Self::Translation(0)), ("y", Self::Translation(1)), ("z", Self::Translation(2))];
}

/// A scalar of the clip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ClipField {
    Start,
    End,
    Rate,
}

impl ClipField {
    const ALL: [(&'static str, Self); 3] = [("t0", Self::Start), ("t1", Self::End), ("fps", Self::Rate)];
}

impl Slot {
    /// Reads the value; `None` if the entity lacks the scalar.
    pub(super) fn read(&self, view: &ScalarsView<'_>) -> Option<f64> {
        match *self {
            Self::Material(index, field) => field.read(&view.materials[index]),
            Self::Medium(index, field) => field.read(&view.media[index]),
            Self::Camera(index, field) => Some(field.read(&view.cameras[index])),
            Self::Hidden(index) => Some(f64::from(u8::from(view.objects[index].hidden))),
            Self::Multiplier { group, luminaire } => Some(view.luminaires[group][luminaire].multiplier),
            Self::Key { path, key, field } => {
                let key = &view.paths[path].keys[key];
                Some(match field {
                    KeyField::Time => key.time,
                    KeyField::Translation(axis) => key.pose.translation[axis],
                })
            }
            Self::Clip(field) => view.clip.map(|clip| match field {
                ClipField::Start => clip.start,
                ClipField::End => clip.end,
                ClipField::Rate => clip.fps,
            }),
        }
    }

    /// Writes the value.
    /// - `value`: a value that [`Self::check_value`] accepts.
    pub(super) fn write(&self, view: &mut ScalarsViewMut<'_>, value: f64) {
        match *self {
            Self::Material(index, field) => field.write(&mut view.materials[index], value),
            Self::Medium(index, field) => field.write(&mut view.media[index], value),
            Self::Camera(index, field) => field.write(&mut view.cameras[index], value),
            Self::Hidden(index) => view.objects[index].hidden = value != 0.0,
            Self::Multiplier { group, luminaire } => view.luminaires[group][luminaire].multiplier = value,
            Self::Key { path, key, field } => {
                let key = &mut view.paths[path].keys[key];
                match field {
                    KeyField::Time => key.time = value,
                    KeyField::Translation(axis) => key.pose.translation[axis] = value,
                }
            }
            Self::Clip(field) => {
                if let Some(clip) = &mut view.clip {
                    match field {
                        ClipField::Start => clip.start = value,
                        ClipField::End => clip.end = value,
                        ClipField::Rate => clip.fps = value,
                    }
                }
            }
        }
    }

    /// Checks the value on its own, without regard to other scalars.
    pub(super) fn check_value(&self, value: f64) -> Result<(), Constraint> {
        match self {
            Self::Material(_, field) => field.check_value(value),
            Self::Medium(_, field) => field.check_value(value),
            Self::Camera(_, field) => field.check_value(value),
            Self::Hidden(_) => either(value, 0, 1),
            Self::Multiplier { .. } => not_negative(value),
            Self::Clip(ClipField::Rate) => positive(value),
            Self::Key { .. } | Self::Clip(ClipField::Start | ClipField::End) => finite(value),
        }
    }

    /// Checks the constraints that join several scalars of the slot's entity.
    pub(super) fn check_consistency(&self, view: &ScalarsView<'_>) -> Result<(), Constraint> {
        match *self {
            Self::Material(index, MaterialField::Amount(_) | MaterialField::Channel(..)) => {
                check_energy(&view.materials[index])
            }
            Self::Camera(index, _) => check_framing(&view.cameras[index]),
            Self::Key { path, field: KeyField::Time, .. } => {
                let keys = &view.paths[path].keys;
                require(keys.windows(2).all(|pair| pair[0].time < pair[1].time), Constraint::KeyOrder)
            }
            Self::Clip(_) => require(view.clip.is_none_or(|clip| clip.start <= clip.end), Constraint::ClipOrder),
            Self::Material(..) | Self::Medium(..) | Self::Hidden(_) | Self::Multiplier { .. } | Self::Key { .. } => {
                Ok(())
            }
        }
    }

    /// Returns whether the scalar has only two values.
    pub(super) fn is_switch(&self) -> bool {
        matches!(self, Self::Hidden(_) | Self::Material(_, MaterialField::Sides))
    }

    /// Returns whether the scalar holds for the whole clip and so cannot vary over time.
    pub(super) fn is_timeless(&self) -> bool {
        matches!(self, Self::Clip(_) | Self::Camera(_, CameraField::Film(_)))
    }
}

fn check_energy(material: &Material) -> Result<(), Constraint> {
    let sum = material.reflectance_sum();
    require(sum <= Material::SUM_LIMIT, Constraint::Energy(sum))
}

fn check_framing(camera: &Camera) -> Result<(), Constraint> {
    require(camera.shutter_open <= camera.shutter_close, Constraint::Shutter)?;
    let view = camera.target - camera.origin;
    // |view x up| = |view| |up| sin: the angle between them must be more than a rounding error.
    let crossed = view.cross(camera.up).length();
    require(crossed > 1e-12 * view.length() * camera.up.length(), Constraint::View)
}

/// Returns all slots that `selector` names; empty if there are none.
pub(super) fn resolve(view: &ScalarsView<'_>, selector: &str) -> Vec<Slot> {
    let mut slots = Vec::new();
    let Some((kind, rest)) = selector.split_once('.') else { return slots };
    match kind {
        "material" => {
            for (index, field) in matches(view.materials.iter().map(|m| &*m.name), rest, MaterialField::all()) {
                slots.push(Slot::Material(index, field));
            }
        }
        "medium" => {
            for (index, field) in matches(view.media.iter().map(|m| &*m.name), rest, &MediumField::ALL) {
                slots.push(Slot::Medium(index, field));
            }
        }
        "camera" => {
            for (index, field) in matches(view.cameras.iter().map(|c| &*c.name), rest, &CameraField::ALL) {
                slots.push(Slot::Camera(index, field));
            }
        }
        "object" => {
            if let Some(name) = rest.strip_suffix(".hidden").filter(|name| !name.is_empty()) {
                slots.extend((0..view.objects.len()).filter(|&i| view.objects[i].name == name).map(Slot::Hidden));
            } else if let Some(name) = rest.strip_suffix(".multiplier").filter(|name| !name.is_empty()) {
                multipliers_of_object(view, name, &mut slots);
            }
        }
        "ies" => {
            if let Some(file) = rest.strip_suffix(".multiplier") {
                multipliers_of_file(view, file, &mut slots);
            }
        }
        "path" => keys(view, rest, &mut slots),
        "time" if view.clip.is_some() => {
            let fields = ClipField::ALL.iter().filter(|(name, _)| *name == rest);
            slots.extend(fields.map(|(_, field)| Slot::Clip(*field)));
        }
        _ => {}
    }
    slots.retain(|slot| slot.read(view).is_some());
    slots
}

/// Returns the entities and fields that `rest` = "NAME.field" names.
fn matches<'a, N: AsRef<str>, F: Copy>(
    names: impl Iterator<Item = &'a str>,
    rest: &str,
    fields: &[(N, F)],
) -> Vec<(usize, F)> {
    let field_of = |name: &str| {
        let field = rest.strip_prefix(name)?.strip_prefix('.')?;
        fields.iter().find(|(known, _)| known.as_ref() == field).map(|(_, field)| *field)
    };
    let named = names.enumerate().filter(|(_, name)| !name.is_empty());
    named.filter_map(|(index, name)| Some((index, field_of(name)?))).collect()
}

fn multipliers_of_object(view: &ScalarsView<'_>, name: &str, slots: &mut Vec<Slot>) {
    let inside = inherited_flags(view.objects, |object| object.name == name);
    let holds = |object: Option<ObjectId>| object.is_some_and(|object| inside.get(object.index()) == Some(&true));
    for (group, luminaires) in view.luminaires.iter().enumerate() {
        let held = (0..luminaires.len()).filter(|&index| holds(luminaires[index].object));
        slots.extend(held.map(|luminaire| Slot::Multiplier { group, luminaire }));
    }
}

fn multipliers_of_file(view: &ScalarsView<'_>, file: &str, slots: &mut Vec<Slot>) {
    for (group, luminaires) in view.luminaires.iter().enumerate() {
        for (luminaire, described) in luminaires.iter().enumerate() {
            if view.photometry.get(described.photometry.index()).is_some_and(|photometry| photometry.path == file) {
                slots.push(Slot::Multiplier { group, luminaire });
            }
        }
    }
}

fn keys(view: &ScalarsView<'_>, rest: &str, slots: &mut Vec<Slot>) {
    for (path, described) in view.paths.iter().enumerate() {
        let Some(of_key) = rest.strip_prefix(&*described.name).and_then(|rest| rest.strip_prefix('.')) else {
            continue;
        };
        let Some((number, field)) = of_key.split_once('.') else { continue };
        let key = number.parse::<usize>().ok().filter(|&key| (1..=described.keys.len()).contains(&key));
        let field = KeyField::ALL.iter().find(|(name, _)| *name == field);
        if let (Some(key), Some((_, field))) = (key, field) {
            slots.push(Slot::Key { path, key: key - 1, field: *field });
        }
    }
}

/// Returns the names of all slots, in the order of the scene, each once.
pub(super) fn names(view: &ScalarsView<'_>) -> Vec<String> {
    let (mut seen, mut names) = (BTreeSet::new(), Vec::new());
    let mut add = |name: String| {
        if seen.insert(name.clone()) {
            names.push(name);
        }
    };
    for camera in view.cameras {
        CameraField::ALL.iter().for_each(|(field, _)| add(format!("camera.{}.{field}", camera.name)));
    }
    for material in view.materials.iter().filter(|material| !material.name.is_empty()) {
        let has = MaterialField::all().iter().filter(|(_, field)| field.read(material).is_some());
        has.for_each(|(field, _)| add(format!("material.{}.{field}", material.name)));
    }
    for medium in view.media {
        let has = MediumField::ALL.iter().filter(|(_, field)| field.read(medium).is_some());
        has.for_each(|(field, _)| add(format!("medium.{}.{field}", medium.name)));
    }
    let lit = objects_with_luminaires(view);
    for (index, object) in view.objects.iter().enumerate().filter(|(_, object)| !object.name.is_empty()) {
        add(format!("object.{}.hidden", object.name));
        if lit.contains(&index) {
            add(format!("object.{}.multiplier", object.name));
        }
    }
    for luminaire in view.luminaires.iter().copied().flatten() {
        if let Some(photometry) = view.photometry.get(luminaire.photometry.index()) {
            add(format!("ies.{}.multiplier", photometry.path));
        }
    }
    for path in view.paths {
        for key in 1..=path.keys.len() {
            KeyField::ALL.iter().for_each(|(field, _)| add(format!("path.{}.{key}.{field}", path.name)));
        }
    }
    if view.clip.is_some() {
        ClipField::ALL.iter().for_each(|(field, _)| add(format!("time.{field}")));
    }
    names
}

/// Returns the objects that contain a luminaire, directly or nested.
fn objects_with_luminaires(view: &ScalarsView<'_>) -> BTreeSet<usize> {
    let mut lit = BTreeSet::new();
    for luminaire in view.luminaires.iter().copied().flatten() {
        let mut at = luminaire.object;
        while let Some(index) = at.map(ObjectId::index).filter(|&index| index < view.objects.len()) {
            if !lit.insert(index) {
                break;
            }
            at = view.objects[index].parent;
        }
    }
    lit
}
