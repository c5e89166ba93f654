//! Names of the parts of a scene in light statistics.

use femc_paths::record::Names;
use femc_paths::{Name, NameKind};
use femc_prepared::Prepared;
use femc_scene::ObjectId;
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
        get_or_make(&self.objects, object.index(), || {
            Name::new(NameKind::Object, self.prepared.object_name(Some(object)))
        })
    }

    pub(super) fn material(&self, material: u32) -> Name {
        get_or_make(&self.materials, material as usize, || {
            Name::new(NameKind::Material, self.prepared.material_name(material))
        })
    }

    pub(super) fn medium(&self, medium: u16) -> Name {
        get_or_make(&self.media, usize::from(medium), || Name::new(NameKind::Medium, self.prepared.medium_name(medium)))
    }

    pub(super) fn lamp(&self, light: u32) -> Name {
        get_or_make(&self.lamps, light as usize, || Name::new(NameKind::Lamp, &self.prepared.lamp_label(light)))
    }

    /// Returns the texts of all used names.
    pub(super) fn used_names(&self) -> Names {
        let prepared = self.prepared;
        let object = |index: usize| prepared.scene.objects[index].name.clone();
        let material = |index: usize| prepared.material_name(index as u32).to_owned();
        let medium = |index: usize| prepared.medium_name(index as u16).to_owned();
        let mut texts = Names::new();
        collect_used(&mut texts, NameKind::Object, &self.objects, object);
        collect_used(&mut texts, NameKind::Material, &self.materials, material);
        collect_used(&mut texts, NameKind::Medium, &self.media, medium);
        collect_used(&mut texts, NameKind::Lamp, &self.lamps, |index| prepared.lamp_label(index as u32));
        texts
    }
}

fn collect_used(texts: &mut Names, kind: NameKind, names: &[OnceLock<Name>], text: impl Fn(usize) -> String) {
    let wanted = names.iter().enumerate().filter_map(|(index, name)| Some((index, *name.get()?)));
    texts.extend(wanted.filter(|(_, name)| *name != Name::NONE).map(|(index, name)| (name, (kind, text(index)))));
}

fn get_or_make(known: &[OnceLock<Name>], index: usize, make: impl FnOnce() -> Name) -> Name {
    known.get(index).map_or(Name::NONE, |name| *name.get_or_init(make))
}
