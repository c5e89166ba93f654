//! Names of the parts of a scene in light statistics.

use femc_paths::record::Names;
use femc_paths::{Kind, Name};
use femc_prepared::Prepared;
use femc_scene::{LampKind, ObjectId};
use std::sync::OnceLock;

/// Keys of the names of a scene's parts, each created on first use.
pub(super) struct SceneNames<'a> {
    pub(super) prepared: &'a Prepared,
    objects: Vec<OnceLock<Name>>,
    materials: Vec<OnceLock<Name>>,
    media: Vec<OnceLock<Name>>,
    lamps: Vec<OnceLock<Name>>,
}

impl<'a> SceneNames<'a> {
    pub(super) fn new(prepared: &'a Prepared) -> Self {
        let room = |count: usize| (0..count).map(|_| OnceLock::new()).collect();
        Self {
            prepared,
            objects: room(prepared.scene.objects.len()),
            materials: room(prepared.materials.len()),
            media: room(prepared.scene.media.len()),
            lamps: room(prepared.lights.len()),
        }
    }

    pub(super) fn object(&self, object: Option<ObjectId>) -> Name {
        let Some(object) = object else { return Name::NONE };
        name(&self.objects, object.index(), || Name::of(Kind::Object, self.prepared.object_name(Some(object))))
    }

    pub(super) fn material(&self, material: u32) -> Name {
        name(&self.materials, material as usize, || Name::of(Kind::Material, self.prepared.material_name(material)))
    }

    pub(super) fn medium(&self, medium: u16) -> Name {
        name(&self.media, usize::from(medium), || Name::of(Kind::Medium, self.prepared.medium_name(medium)))
    }

    pub(super) fn lamp(&self, light: u32) -> Name {
        name(&self.lamps, light as usize, || Name::of(Kind::Lamp, &self.lamp_text(light)))
    }

    /// Returns the name of a lamp: the object that holds it, and its material or file.
    fn lamp_text(&self, light: u32) -> String {
        let lamp = self.prepared.lamp_name(light);
        let kind = match lamp.kind {
            LampKind::Surface { material } => material,
            LampKind::Luminaire { path } => path,
            LampKind::Medium { medium } => medium,
        };
        format!("{}/{kind}", lamp.object)
    }

    /// Returns the texts of all used names.
    pub(super) fn texts(&self) -> Names {
        let prepared = self.prepared;
        let object = |index: usize| prepared.scene.objects[index].name.clone();
        let material = |index: usize| prepared.material_name(index as u32).to_owned();
        let medium = |index: usize| prepared.medium_name(index as u16).to_owned();
        let mut texts = Names::new();
        known(&mut texts, Kind::Object, &self.objects, object);
        known(&mut texts, Kind::Material, &self.materials, material);
        known(&mut texts, Kind::Medium, &self.media, medium);
        known(&mut texts, Kind::Lamp, &self.lamps, |index| self.lamp_text(index as u32));
        texts
    }
}

fn known(texts: &mut Names, kind: Kind, names: &[OnceLock<Name>], text: impl Fn(usize) -> String) {
    let wanted = names.iter().enumerate().filter_map(|(index, name)| Some((index, *name.get()?)));
    texts.extend(wanted.filter(|(_, name)| *name != Name::NONE).map(|(index, name)| (name, (kind, text(index)))));
}

fn name(known: &[OnceLock<Name>], index: usize, make: impl FnOnce() -> Name) -> Name {
    known.get(index).map_or(Name::NONE, |name| *name.get_or_init(make))
}
