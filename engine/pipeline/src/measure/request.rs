//! Requests for measurements: what is measured, and where.

use super::reading::{FIRST_SAMPLES, MAX_SAMPLES};
use crate::settings::StopCondition;
use femc_scene::Scene;
use serde::{Deserialize, Serialize};

/// Maximum number of readings of a request.
pub const MAX_PLACES: u64 = 1 << 20;
/// Typical number of samples of a reading with [`DEFAULT_ERROR`]: 15,600 on a work plane of the gallery
/// (`femc measure scenes/gallery.mgf --where height=0.75,spacing=0.6 --csv`).
const TYPICAL_SAMPLES: f64 = 16384.0;
/// Number of cells of an area if the request gives none.
const DEFAULT_CELLS: u32 = 64;

/// Quantity to measure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Quantity {
    /// Illuminance of a plane, lx.
    #[default]
    Illuminance,
    /// Mean illuminance of the curved side of a small cylinder, lx.
    Cylindrical,
    /// Mean illuminance of a small sphere, lx.
    Spherical,
    /// Luminance in a direction, cd/m2.
    Luminance,
}

impl Quantity {
    /// Returns the word for it in requests and tables.
    pub fn word(self) -> &'static str {
        match self {
            Self::Illuminance => "illuminance",
            Self::Cylindrical => "cylindrical",
            Self::Spherical => "spherical",
            Self::Luminance => "luminance",
        }
    }

    /// Returns its unit.
    pub fn unit(self) -> &'static str {
        if self == Self::Luminance { "cd/m2" } else { "lx" }
    }
}

/// Single points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Points {
    /// Name.
    pub name: String,
    /// Quantity.
    #[serde(default)]
    pub quantity: Quantity,
    /// Positions in the world, m.
    pub at: Vec<[f64; 3]>,
    /// Normal of the plane, or axis of the cylinder; upward if it is not given. For the luminance: direction in which one looks.
    #[serde(default)]
    pub direction: Option<[f64; 3]>,
    /// For the luminance, instead of a direction: position from which one looks at the points, m.
    #[serde(default)]
    pub observer: Option<[f64; 3]>,
}

/// A grid of points at the centers of the cells of a parallelogram.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Grid {
    /// Name.
    pub name: String,
    /// Quantity.
    #[serde(default)]
    pub quantity: Quantity,
    /// Corner in the world, m.
    pub corner: [f64; 3],
    /// Edge from the corner along the columns, m.
    pub along: [f64; 3],
    /// Edge from the corner along the rows, m.
    pub across: [f64; 3],
    /// Number of points along and across.
    pub count: [u32; 2],
    /// As for [`Points::direction`]; without it, the normal `along` x `across` for the illuminance.
    #[serde(default)]
    pub direction: Option<[f64; 3]>,
    /// As for [`Points::observer`].
    #[serde(default)]
    pub observer: Option<[f64; 3]>,
}

/// Side of a surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SurfaceSide {
    /// Front side.
    #[default]
    Front,
    /// Back side.
    Back,
    /// Both sides, as separate cells.
    Both,
}

/// Illuminance of the surfaces of objects, as the means of cells of nearly equal area.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Area {
    /// Name.
    pub name: String,
    /// Name of an object, or of a parent of objects.
    pub object: String,
    /// Side that receives the light.
    #[serde(default)]
    pub side: SurfaceSide,
    /// Number of cells of each side.
    #[serde(default = "default_cells")]
    pub cells: u32,
}

fn default_cells() -> u32 {
    DEFAULT_CELLS
}

/// Maximum relative error of readings if the request gives neither an error nor a number of samples.
pub const DEFAULT_ERROR: f64 = 0.02;

/// Request for measurements: the contents of a file of points.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct MeasureRequest {
    /// Maximum relative error of each reading (95 % confidence), above 0 and at most 1.
    #[serde(default)]
    pub error: Option<f64>,
    /// Number of samples of each reading, 1 to [`MAX_SAMPLES`], instead of an error.
    #[serde(default)]
    pub spp: Option<u32>,
    /// Whether the light of each lamp is measured, too.
    #[serde(default)]
    pub by_lamp: bool,
    /// Single points.
    #[serde(default)]
    pub points: Vec<Points>,
    /// Grids.
    #[serde(default)]
    pub grid: Vec<Grid>,
    /// Surfaces of objects.
    #[serde(default)]
    pub area: Vec<Area>,
}

/// Reason why a request is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RequestError {
    /// There is nothing to measure.
    #[error("no [[points]], [[grid]] or [[area]]: there is nothing to measure")]
    Empty,
    /// The accuracy is invalid.
    #[error("{0}")]
    Accuracy(String),
    /// Two parts have the same name.
    #[error("`{0}`: two parts have this name")]
    DuplicateName(String),
    /// A part is invalid.
    #[error("`{name}`: {reason}")]
    Part {
        /// Name of the part.
        name: String,
        /// Reason.
        reason: String,
    },
    /// There are too many readings.
    #[error("{0} readings; at most {MAX_PLACES} are possible")]
    TooMany(u64),
}

impl MeasureRequest {
    /// Checks everything that does not need the scene.
    pub fn check(&self) -> Result<(), RequestError> {
        let names = self.points.iter().map(|it| &it.name).chain(self.grid.iter().map(|it| &it.name));
        let mut names: Vec<&String> = names.chain(self.area.iter().map(|it| &it.name)).collect();
        if names.is_empty() {
            return Err(RequestError::Empty);
        }
        self.check_accuracy().map_err(RequestError::Accuracy)?;
        names.sort();
        if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(RequestError::DuplicateName(pair[0].clone()));
        }
        for part in &self.points {
            part.check().map_err(|reason| RequestError::Part { name: part.name.clone(), reason })?;
        }
        for part in &self.grid {
            part.check().map_err(|reason| RequestError::Part { name: part.name.clone(), reason })?;
        }
        for part in &self.area {
            part.check().map_err(|reason| RequestError::Part { name: part.name.clone(), reason })?;
        }
        let count = self.count();
        if count > MAX_PLACES { Err(RequestError::TooMany(count)) } else { Ok(()) }
    }

    fn check_accuracy(&self) -> Result<(), String> {
        match (self.error, self.spp) {
            (Some(_), Some(_)) => Err("`error` and `spp` exclude each other: keep one of them".into()),
            (Some(error), None) if !(error > 0.0 && error <= 1.0) => {
                Err(format!("`error` is {error}; it must be above 0 and at most 1, like 0.02 for 2 %"))
            }
            (None, Some(spp)) if spp == 0 || spp > MAX_SAMPLES => {
                Err(format!("`spp` is {spp}; it must be from 1 to {MAX_SAMPLES}"))
            }
            _ => Ok(()),
        }
    }

    /// Returns the condition under which a reading is done.
    pub fn stop(&self) -> StopCondition {
        self.spp.map_or(StopCondition::Error(self.error.unwrap_or(DEFAULT_ERROR)), StopCondition::Spp)
    }

    /// Returns the number of samples that a reading is expected to need. It decides how many tasks there are, and no value.
    pub(super) fn expected_samples(&self) -> u64 {
        match self.stop() {
            StopCondition::Spp(samples) => u64::from(samples.max(1)),
            StopCondition::Error(error) => {
                let samples = TYPICAL_SAMPLES * (DEFAULT_ERROR / error).powi(2);
                (samples as u64).clamp(FIRST_SAMPLES.into(), MAX_SAMPLES.into())
            }
            StopCondition::Time(_) => FIRST_SAMPLES.into(),
        }
    }

    /// Returns the number of readings. A surface of many pieces may have fewer or more cells than requested.
    pub fn count(&self) -> u64 {
        let points = self.points.iter().map(|part| part.at.len() as u64);
        let grids = self.grid.iter().map(|part| u64::from(part.count[0]) * u64::from(part.count[1]));
        points.chain(grids).chain(self.area.iter().map(|part| u64::from(part.cells))).sum()
    }
}

impl Points {
    fn check(&self) -> Result<(), String> {
        if self.at.is_empty() {
            return Err("`at` has no points".into());
        }
        self.at.iter().try_for_each(|point| check_finite("at", point))?;
        check_directions(self.quantity, self.direction.as_ref(), self.observer.as_ref())
    }
}

impl Grid {
    fn check(&self) -> Result<(), String> {
        for (key, value) in [("corner", &self.corner), ("along", &self.along), ("across", &self.across)] {
            check_finite(key, value)?;
        }
        if self.count.contains(&0) {
            return Err("`count` is 0; give the number of points along and across".into());
        }
        let needs_normal = self.quantity == Quantity::Illuminance && self.direction.is_none();
        if needs_normal && unit(cross(self.along, self.across)).is_none() {
            return Err("`along` and `across` are parallel or 0, so the grid has no normal; give `direction`".into());
        }
        check_directions(self.quantity, self.direction.as_ref(), self.observer.as_ref())
    }

    /// Returns the normal `along` x `across`, unit; `None`: the edges are parallel.
    pub(super) fn normal(&self) -> Option<[f64; 3]> {
        unit(cross(self.along, self.across))
    }
}

impl Area {
    fn check(&self) -> Result<(), String> {
        match self.cells {
            0 => Err("`cells` is 0".into()),
            _ => Ok(()),
        }
    }
}

fn check_finite(key: &str, value: &[f64; 3]) -> Result<(), String> {
    if value.iter().all(|x| x.is_finite()) { Ok(()) } else { Err(format!("`{key}` is not finite")) }
}

fn check_directions(
    quantity: Quantity,
    direction: Option<&[f64; 3]>,
    observer: Option<&[f64; 3]>,
) -> Result<(), String> {
    if let Some(observer) = observer {
        check_finite("observer", observer)?;
    }
    match (quantity, direction, observer) {
        (Quantity::Luminance, Some(_), Some(_)) => Err("give `direction` or `observer`, not both".into()),
        (Quantity::Luminance, None, None) => {
            Err("the luminance needs `direction`, in which one looks, or `observer`, from where one looks".into())
        }
        (Quantity::Luminance, ..) | (_, _, None) => match direction.map(|it| unit(*it)) {
            Some(None) => Err("`direction` has no length".into()),
            _ => Ok(()),
        },
        (_, _, Some(_)) => Err("only the luminance has an `observer`".into()),
    }
}

pub(super) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Returns a unit vector; `None`: the length is 0 or not finite.
pub(super) fn unit(v: [f64; 3]) -> Option<[f64; 3]> {
    let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    (length > 0.0 && length.is_finite()).then(|| v.map(|x| x / length))
}

/// A horizontal work plane over the floor plan of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorkPlane {
    /// Height above the lowest point of the scene, m.
    pub height: f64,
    /// Width of the border without points, m.
    pub border: f64,
    /// Maximum distance of neighboring points, m.
    pub spacing: f64,
}

impl Default for WorkPlane {
    /// Work plane of offices: 0.75 m above the floor, without a border of 0.5 m (\[en12464\]).
    fn default() -> Self {
        Self { height: 0.75, border: 0.5, spacing: 0.5 }
    }
}

/// Returns the request for the horizontal illuminance on a work plane. It covers the box around the scene's surfaces.
pub fn work_plane(scene: &Scene, plane: &WorkPlane) -> Result<MeasureRequest, RequestError> {
    let fault = |reason: String| RequestError::Part { name: "work plane".into(), reason };
    let Some([low, high]) = femc_scene::survey::survey_scene(scene, &|_| 0.0).bounds else {
        return Err(fault("the scene has no surfaces".into()));
    };
    let sides = [high.x - low.x - 2.0 * plane.border, high.y - low.y - 2.0 * plane.border];
    if sides.iter().any(|side| *side <= 0.0) {
        let [x, y] = [high.x - low.x, high.y - low.y];
        return Err(fault(format!("a border of {} m leaves nothing of {x:.2} m x {y:.2} m", plane.border)));
    }
    let grid = Grid {
        name: "work plane".into(),
        quantity: Quantity::Illuminance,
        corner: [low.x + plane.border, low.y + plane.border, low.z + plane.height],
        along: [sides[0], 0.0, 0.0],
        across: [0.0, sides[1], 0.0],
        count: sides.map(|side| (side / plane.spacing).ceil().clamp(1.0, 4096.0) as u32),
        direction: None,
        observer: None,
    };
    let request = MeasureRequest { grid: vec![grid], ..MeasureRequest::default() };
    request.check().map(|()| request)
}

/// Returns a request for this number of readings, for tests.
#[cfg(test)]
pub(crate) fn test_request(readings: u32) -> MeasureRequest {
    let at = (0..readings).map(|x| [f64::from(x), 0.0, 1.0]).collect();
    let part = Points { name: "points".into(), quantity: Quantity::Illuminance, at, direction: None, observer: None };
    MeasureRequest { points: vec![part], ..MeasureRequest::default() }
}
