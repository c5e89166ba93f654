//! Names in the description for the numbers that the kernels use.

use crate::compile::{Emitter, EmitterShape};
use crate::frame::Prepared;
use femc_math::glam::{DVec3, Vec3A};
use femc_scene::{LampKind, Location, ObjectId};

/// A lamp in the terms of `femc check`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LampName {
    /// Kind of lamp.
    pub kind: LampKind,
    /// Dotted name of the innermost object that contains it; empty if there is none.
    pub object: String,
    /// Location in the file.
    pub location: Location,
}

impl Prepared {
    /// Returns the innermost object that contains a primitive of an instance.
    pub fn object_of(&self, instance: u32, primitive: u32) -> Option<ObjectId> {
        let objects = &self.instances[instance as usize].compiled.objects;
        let next = objects.partition_point(|(first, _)| *first <= primitive);
        next.checked_sub(1).and_then(|at| objects[at].1)
    }

    /// Returns the dotted name of an object; empty for none.
    pub fn object_name(&self, object: Option<ObjectId>) -> &str {
        object.and_then(|object| self.scene.objects.get(object.index())).map_or("", |object| &object.name)
    }

    /// Returns the name of a material; empty for the unnamed material, and for the black body behind the opening of a luminaire.
    pub fn material_name(&self, material: u32) -> &str {
        self.scene.materials.get(material as usize).map_or("", |material| &material.name)
    }

    /// Returns the name of a medium.
    pub fn medium_name(&self, medium: u16) -> &str {
        self.scene.media.get(usize::from(medium)).map_or("", |medium| &medium.name)
    }

    /// Returns name and location of a light.
    pub fn lamp_name(&self, light: u32) -> LampName {
        let Emitter { ref shape, material, object, location } = *self.emitter(light);
        let kind = match shape {
            EmitterShape::Photometric(luminaire) => {
                let file = self.scene.photometry.get(luminaire.photometry.index());
                LampKind::Luminaire { path: file.map(|file| file.path.clone()).unwrap_or_default() }
            }
            _ => LampKind::Surface { material: self.material_name(material).to_owned() },
        };
        LampName { kind, object: self.object_name(object).to_owned(), location }
    }

    /// Returns the label of a light: the object that holds it, and its material or photometric file.
    pub fn lamp_label(&self, light: u32) -> String {
        let lamp = self.lamp_name(light);
        let kind = match lamp.kind {
            LampKind::Surface { material } => material,
            LampKind::Luminaire { path } => path,
            LampKind::Medium { medium } => medium,
        };
        format!("{}/{kind}", lamp.object)
    }

    fn emitter(&self, light: u32) -> &Emitter {
        let next = self.instances.partition_point(|instance| instance.first_light <= light);
        let instance = &self.instances[next.saturating_sub(1)];
        &instance.compiled.emitters[(light - instance.first_light) as usize]
    }

    /// Converts a point of the prepared frame to the world, m.
    pub fn to_world(&self, point: Vec3A) -> [f64; 3] {
        (self.origin + point.as_dvec3()).to_array()
    }

    /// Converts a point of the world to the prepared frame, m.
    pub fn from_world(&self, point: [f64; 3]) -> Vec3A {
        (DVec3::from(point) - self.origin).as_vec3a()
    }
}
