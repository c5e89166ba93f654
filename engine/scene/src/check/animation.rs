//! Checks motion that cannot be followed, and the selectors of `vary`.

use super::{Faults, Scope, WHOLE_SCENE, format_location};
use crate::{
    FaultKind::{Animation, BadSelector, DuplicateName},
    SelectorError,
    Severity::{Error, Warning},
    description::{MotionPath, Vary},
};
use std::collections::BTreeMap;

const ADD_TIME: &str = "add `time t0 t1 fps`";

pub(super) fn check(scope: &Scope<'_>, faults: &mut Faults) {
    if let Some(clip) = scope.scene.clip
        && !(clip.fps > 0.0 && clip.end >= clip.start)
    {
        faults.add(
            Error,
            Animation,
            WHOLE_SCENE,
            "the clip has no frames",
            "give `time t0 t1 fps` with t1 >= t0 and fps > 0",
        );
    }
    scope.scene.paths.iter().for_each(|path| check_path(scope, path, faults));
    check_varies(scope, faults);
}

fn check_path(scope: &Scope<'_>, path: &MotionPath, faults: &mut Faults) {
    let name = &path.name;
    let hands: Vec<f64> = path.keys.iter().map(|key| key.pose.matrix3.determinant()).collect();
    if hands.iter().any(|hand| *hand == 0.0 || !hand.is_finite()) {
        let message = format!("path `{name}` has a key with a scale of 0");
        faults.add(Error, Animation, path.location, message, "give its `-s` a factor other than 0");
    } else if hands.windows(2).any(|pair| (pair[0] < 0.0) != (pair[1] < 0.0)) {
        let message = format!(
            "path `{name}` is mirrored at some keys only: poses between mirrored and unmirrored keys are undefined"
        );
        faults.add(Error, Animation, path.location, message, "mirror all of its keys or none");
    }
    if scope.scene.clip.is_none() && !path.is_constant() {
        let message = format!("path `{name}` moves, but the scene has no clip: everything stays as at 0 s");
        faults.add(Warning, Animation, path.location, message, ADD_TIME);
    }
}

fn check_varies(scope: &Scope<'_>, faults: &mut Faults) {
    let scene = scope.scene;
    let mut first: BTreeMap<&str, &Vary> = BTreeMap::new();
    for vary in &scene.varies {
        if let Some(earlier) = first.insert(&vary.selector, vary) {
            let message =
                format!("`{}` varies twice, also at {}", vary.selector, format_location(scene, earlier.location));
            faults.add(Warning, DuplicateName, vary.location, message, "keep one; the last one is used");
        }
        if scene.clip.is_none() && vary.keys.iter().any(|key| key.1 != vary.keys[0].1) {
            let message = format!("`{}` varies, but the scene has no clip: everything stays as at 0 s", vary.selector);
            faults.add(Warning, Animation, vary.location, message, ADD_TIME);
        }
    }
    // Values are checked as frames use them: all together, at the time of every key of every `vary`.
    let mut times: Vec<f64> = scene.varies.iter().flat_map(|vary| vary.keys.iter().map(|key| key.0)).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    let unknown: Vec<SelectorError> = scene.varies.iter().filter_map(|vary| scene.get(&vary.selector).err()).collect();
    let refused = if unknown.is_empty() {
        times.iter().find_map(|time| scene.scalars_at(*time).err()).into_iter().collect()
    } else {
        unknown
    };
    for error in refused {
        let (SelectorError::Unknown { selector, .. }
        | SelectorError::Refused { selector, .. }
        | SelectorError::Timeless { selector }) = &error;
        let location =
            scene.varies.iter().find(|vary| vary.selector == *selector).map_or(WHOLE_SCENE, |vary| vary.location);
        let advice = match error {
            SelectorError::Unknown { .. } => "use the name of a scalar of the scene",
            SelectorError::Refused { .. } => "change the keys",
            SelectorError::Timeless { .. } => "set it once instead",
        };
        faults.add(Error, BadSelector, location, error.to_string(), advice);
    }
}
