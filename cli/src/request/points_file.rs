//! The file of points, and the work plane that can replace it.

use crate::exit::{Failure, usage};
use crate::values::TextPosition;
use femc_pipeline::measure::{MeasureRequest, WorkPlane, check_objects};
use femc_scene::Scene;
use std::path::Path;
use std::str::FromStr;

/// Reads and checks a file of points.
/// - errors: with file, line and column.
pub fn load(path: &Path) -> Result<MeasureRequest, Failure> {
    let shown = path.display();
    let text = std::fs::read_to_string(path).map_err(|error| usage(format!("{shown}: {error}")))?;
    let request: MeasureRequest = toml::from_str(&text).map_err(|error| {
        let TextPosition { line, column } = TextPosition::from_offset(&text, error.span().map_or(0, |span| span.start));
        usage(format!("{shown}:{line}:{column}: {}", error.message().replace('\n', ", ")))
    })?;
    request.check().map_err(|error| usage(format!("{shown}: {error}")))?;
    Ok(request)
}

/// Reads and checks a file of points for a scene.
/// - errors: with file, line and column, or with the name of an object that the scene does not have.
pub fn load_for(path: &Path, scene: &Scene) -> Result<MeasureRequest, Failure> {
    let request = load(path)?;
    check_objects(scene, &request).map_err(|error| usage(format!("{}: {error}", path.display())))?;
    Ok(request)
}

/// `--where height=0.75,border=0.5,spacing=0.5`: a horizontal work plane over the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorkPlaneArg(pub WorkPlane);

impl FromStr for WorkPlaneArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let example = "write height=0.75,border=0.5,spacing=0.5 (m); each of the three can be left out";
        let mut plane = WorkPlane::default();
        for part in text.split(',') {
            let (key, value) = part.split_once('=').ok_or_else(|| format!("`{part}` has no value; {example}"))?;
            let meters = value.trim().parse::<f64>().ok().filter(|meters| meters.is_finite());
            let Some(meters) = meters else { return Err(format!("`{value}` is not a number of meters; {example}")) };
            match key.trim() {
                "height" => plane.height = meters,
                "border" if meters >= 0.0 => plane.border = meters,
                "spacing" if meters > 0.0 => plane.spacing = meters,
                "border" | "spacing" => return Err(format!("`{part}` is not positive; {example}")),
                other => return Err(format!("unknown key `{other}`; {example}")),
            }
        }
        Ok(Self(plane))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_work_plane_has_three_lengths() {
        let default = WorkPlane::default();
        assert_eq!("height=0.85".parse(), Ok(WorkPlaneArg(WorkPlane { height: 0.85, ..default })));
        let all = WorkPlane { height: 0.0, border: 0.0, spacing: 0.25 };
        assert_eq!("spacing=0.25, border = 0,height=0".parse(), Ok(WorkPlaneArg(all)));
        for (text, said) in [
            ("desk", "`desk` has no value"),
            ("height=high", "`high` is not a number of meters"),
            ("spacing=0", "`spacing=0` is not positive"),
            ("border=-1", "`border=-1` is not positive"),
            ("hight=1", "unknown key `hight`"),
        ] {
            let error = text.parse::<WorkPlaneArg>().expect_err("an error");
            assert!(error.starts_with(said) && error.contains("height=0.75"), "{text}: {error}");
        }
    }
}
