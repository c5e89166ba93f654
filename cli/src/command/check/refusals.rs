//! Reasons why `femc render` and `femc submit` would refuse the scene with any settings. The check makes the same plan as they do.

use crate::output::faults::FaultLine;
use crate::request::{intensity_distribution, with_root_prefix};
use femc_import::ScenePath;
use femc_pipeline::{PlanError, PrepareError, Settings, plan_job};
use femc_scene::{Location, Scene, Severity};
use std::collections::BTreeSet;

/// Returns an error for each camera for which no frame can be planned, for a scene without a camera, and for unusable photometry.
pub fn plan_refusals(root: &ScenePath, scene: &Scene) -> Vec<FaultLine> {
    let line = |location: Location, kind: &str, message: String, advice: &str| {
        let file = scene.files.get(location.file as usize).map_or("", String::as_str);
        let (kind, advice) = (kind.to_owned(), advice.to_owned());
        FaultLine {
            severity: Severity::Error,
            kind,
            file: with_root_prefix(root, file),
            line: location.line,
            column: None,
            message,
            advice,
        }
    };
    let whole = Location { file: 0, line: 1, column: 0 };
    let settings = |camera: Option<&str>| Settings { camera: camera.map(str::to_owned), ..Settings::default() };
    let plan_error = |camera: Option<&str>| plan_job(scene, &settings(camera), None).err();
    let mut all = Vec::new();
    if scene.cameras.is_empty() {
        all.extend(plan_error(None).map(|error| line(whole, "camera", error.to_string(), "")));
    }
    for camera in &scene.cameras {
        let advice = match plan_error(Some(&camera.name)) {
            None => continue,
            Some(PlanError::Film(error)) => {
                (error.to_string(), "give it a smaller `film`, or `--size` for each render")
            }
            // The check of motion reports these, with their location.
            Some(PlanError::NoFrames { .. } | PlanError::Camera(PrepareError::Selector(_))) => continue,
            Some(error) => (error.to_string(), ""),
        };
        let (error, advice) = advice;
        all.push(line(camera.location, "camera", format!("camera `{}`: {error}", camera.name), advice));
    }
    let luminaires = scene.groups.iter().flat_map(|group| &group.luminaires);
    let mut seen = BTreeSet::new();
    for luminaire in luminaires.filter(|luminaire| seen.insert(luminaire.photometry)) {
        let Some(photometry) = scene.photometry.get(luminaire.photometry.index()) else { continue };
        if let Err(error) = intensity_distribution(photometry) {
            let message = format!("the photometry of `{}` cannot be used: {error}", photometry.path);
            all.push(line(luminaire.location, "photometry", message, "repair the file, or take another lamp"));
        }
    }
    all
}
