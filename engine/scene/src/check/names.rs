//! Checks for unused names and duplicate names.

use super::{Faults, Scope, format_location};
use crate::{
    FaultKind::{DuplicateName, UnusedName},
    Severity::{Note, Warning},
    description::{Location, MotionStep},
};
use std::collections::BTreeMap;

pub(super) fn check(scope: &Scope<'_>, faults: &mut Faults) {
    unused_materials(scope, faults);
    unused_paths(scope, faults);
    default_names(scope, faults);
    let scene = scope.scene;
    duplicates(scope, faults, "camera", scene.cameras.iter().map(|camera| (&*camera.name, camera.location)));
    duplicates(scope, faults, "medium", scene.media.iter().map(|medium| (&*medium.name, medium.location)));
    duplicates(scope, faults, "path", scene.paths.iter().map(|path| (&*path.name, path.location)));
}

/// Reports unused names. A name is unused when none of its definitions is on a surface, because MGF redefines materials freely.
fn unused_materials(scope: &Scope<'_>, faults: &mut Faults) {
    let mut named: BTreeMap<&str, (Location, bool)> = BTreeMap::new();
    for (material, used) in scope.scene.materials.iter().zip(&scope.used).filter(|(m, _)| !m.name.is_empty()) {
        named.entry(&material.name).or_insert((material.location, false)).1 |= used;
    }
    for (name, (location, _)) in named.into_iter().filter(|(_, (_, used))| !used) {
        let message = format!("material `{name}` is not used on any surface");
        faults.add(Note, UnusedName, location, message, "use it or remove it, unless it is a template");
    }
}

/// Name of unnamed objects and materials in a Cryptomatte, by its convention.
const UNNAMED: &str = "default";

/// Reports an object called `default` beside surfaces that belong to no object, and a material of that name beside the unnamed one.
fn default_names(scope: &Scope<'_>, faults: &mut Faults) {
    let scene = scope.scene;
    let surfaces = || {
        let faces = scene
            .groups
            .iter()
            .flat_map(|group| group.faces.iter().map(|face| (face.object, face.material, face.location)));
        faces.chain(
            scene.groups.iter().flat_map(|group| group.quadrics.iter().map(|it| (it.object, it.material, it.location))),
        )
    };
    let named = scene.objects.iter().position(|object| object.name == UNNAMED);
    let first = surfaces().filter(|(object, ..)| object.map(crate::ObjectId::index) == named).map(|it| it.2).min();
    if let (Some(_), Some(location), true) = (named, first, surfaces().any(|(object, ..)| object.is_none())) {
        let message = format!(
            "object `{UNNAMED}` has the same Cryptomatte id as surfaces outside of objects: both are selected together"
        );
        faults.add(Warning, DuplicateName, location, message, "rename it, or put all surfaces into objects");
    }
    let unnamed = surfaces().any(|(_, id, _)| scene.materials.get(id.index()).is_some_and(|it| it.name.is_empty()));
    let used = scene.materials.iter().zip(&scope.used).find(|(material, used)| **used && material.name == UNNAMED);
    if let (Some((material, _)), true) = (used, unnamed) {
        let message = format!(
            "material `{UNNAMED}` has the same Cryptomatte id as the unnamed material: both are selected together"
        );
        faults.add(
            Warning,
            DuplicateName,
            material.location,
            message,
            "rename it, or give every surface a named material",
        );
    }
}

fn unused_paths(scope: &Scope<'_>, faults: &mut Faults) {
    let scene = scope.scene;
    let steps = scene.groups.iter().flat_map(|group| &group.instances).flat_map(|instance| &instance.motion.steps);
    let along = steps.filter_map(|step| match step {
        MotionStep::Along(path) => Some(*path),
        MotionStep::Static(_) => None,
    });
    let mut used = vec![false; scene.paths.len()];
    for path in along.chain(scene.cameras.iter().filter_map(|camera| camera.along)) {
        if let Some(used) = used.get_mut(path.index()) {
            *used = true;
        }
    }
    for (path, _) in scene.paths.iter().zip(used).filter(|(_, used)| !used) {
        let message = format!("nothing moves along path `{}`", path.name);
        faults.add(
            Note,
            UnusedName,
            path.location,
            message,
            "use it in `xf -path` or a camera's `along`, or remove it",
        );
    }
}

fn duplicates<'a>(
    scope: &Scope<'_>,
    faults: &mut Faults,
    kind: &str,
    names: impl Iterator<Item = (&'a str, Location)>,
) {
    let mut first: BTreeMap<&str, Location> = BTreeMap::new();
    for (name, location) in names {
        if let Some(earlier) = first.get(name) {
            let message = format!("{kind} `{name}` is already defined at {}", format_location(scope.scene, *earlier));
            faults.add(Warning, DuplicateName, location, message, "rename one of them");
        } else {
            first.insert(name, location);
        }
    }
}
