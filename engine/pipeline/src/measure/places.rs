//! Places of readings: the points and cells of a request in a prepared frame.

use super::cells::{Cell, divide};
use super::request::{Area, Grid, MAX_PLACES, MeasureRequest, Points, Quantity, RequestError, SurfaceSide};
use femc_math::glam::Vec3A;
use femc_montecarlo::{Receiver, Sensitivity};
use femc_prepared::Prepared;
use femc_prepared::media::MediumStack;
use femc_scene::Scene;
use femc_scene::objects::is_name_within;
use serde::{Deserialize, Serialize};

/// Relative bound of the error of a given position: it is rounded to 24 bits, and so are the surfaces on which it may lie.
const POSITION_ERROR: f32 = 5e-7;

/// Receivers of a place.
#[derive(Clone)]
pub enum Reader {
    /// One receiver for all samples.
    Point(Receiver),
    /// A point of a cell for each sample.
    Cell {
        /// The cell.
        cell: Cell,
        /// Side of the surface that receives the light.
        is_back: bool,
        /// Media of the closed objects that contain the cell.
        medium_stack: MediumStack,
    },
}

/// Description of the place of a reading.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlaceInfo {
    /// Name of the part of the request.
    pub part: String,
    /// Number within the part, from 0. Points of a grid are numbered along the rows.
    pub number: u32,
    /// Quantity.
    pub quantity: Quantity,
    /// Position in the world, m; for cells a point of the cell.
    pub position: [f64; 3],
    /// Column and row in a grid.
    pub cell: Option<[u32; 2]>,
    /// Area of a cell, m2; `None` for a point.
    pub area: Option<f64>,
}

impl PlaceInfo {
    /// Returns the weight in means: the area of a cell, m2, or 1.
    pub fn weight(&self) -> f64 {
        self.area.unwrap_or(1.0)
    }
}

/// Place of a reading.
#[derive(Clone)]
pub struct Place {
    /// Description.
    pub info: PlaceInfo,
    /// Receivers.
    pub reader: Reader,
}

impl Reader {
    /// Returns the receiver of a sample from two numbers in [0, 1) and the time of the shutter.
    pub(super) fn receiver(&self, scene: &Prepared, u: [f32; 2], time: f32) -> Receiver {
        match self {
            Self::Point(receiver) => *receiver,
            Self::Cell { cell, is_back, medium_stack } => {
                let Some(point) = cell.point(scene, u, time) else { unreachable!("cells have pieces") };
                let normal = if *is_back { -point.normal } else { point.normal };
                let sensitivity = Sensitivity::Plane { normal };
                Receiver {
                    position: point.position,
                    error: point.error,
                    normal,
                    sensitivity,
                    medium_stack: *medium_stack,
                }
            }
        }
    }
}

/// Returns the places of a request: points, grids, then areas.
/// - errors: an unknown object, a point of view in its target, or too many cells.
pub fn resolve_places(scene: &Prepared, request: &MeasureRequest) -> Result<Vec<Place>, RequestError> {
    request.check()?;
    let mut places = Vec::new();
    for part in &request.points {
        let fault = |reason| RequestError::Part { name: part.name.clone(), reason };
        places.extend(points(scene, part).map_err(fault)?);
    }
    for part in &request.grid {
        let fault = |reason| RequestError::Part { name: part.name.clone(), reason };
        places.extend(grid(scene, part).map_err(fault)?);
    }
    for part in &request.area {
        let fault = |reason| RequestError::Part { name: part.name.clone(), reason };
        places.extend(area(scene, part).map_err(fault)?);
    }
    let count = places.len() as u64;
    if count > MAX_PLACES { Err(RequestError::TooMany(count)) } else { Ok(places) }
}

fn points(scene: &Prepared, part: &Points) -> Result<Vec<Place>, String> {
    let place = |(number, &position): (u32, &[f64; 3])| {
        let receiver = receiver(scene, position, part.quantity, part.direction, part.observer)?;
        let (name, quantity) = (part.name.clone(), part.quantity);
        let info = PlaceInfo { part: name, number, quantity, position, cell: None, area: None };
        Ok(Place { info, reader: Reader::Point(receiver) })
    };
    (0..).zip(&part.at).map(place).collect()
}

fn grid(scene: &Prepared, part: &Grid) -> Result<Vec<Place>, String> {
    let [columns, rows] = part.count;
    let direction = match part.quantity {
        Quantity::Illuminance => part.direction.or_else(|| part.normal()),
        _ => part.direction,
    };
    let place = |number: u32| {
        let cell = [number % columns, number / columns];
        let [s, t] = [0, 1].map(|axis| (f64::from(cell[axis]) + 0.5) / f64::from(part.count[axis]));
        let position = [0, 1, 2].map(|axis| part.corner[axis] + s * part.along[axis] + t * part.across[axis]);
        let receiver = receiver(scene, position, part.quantity, direction, part.observer)?;
        let (name, quantity) = (part.name.clone(), part.quantity);
        let info = PlaceInfo { part: name, number, quantity, position, cell: Some(cell), area: None };
        Ok(Place { info, reader: Reader::Point(receiver) })
    };
    (0..columns * rows).map(place).collect()
}

fn area(scene: &Prepared, part: &Area) -> Result<Vec<Place>, String> {
    let cells = divide(scene, &part.object, part.cells);
    if cells.is_empty() {
        return Err(unknown_object(&scene.scene, &part.object));
    }
    let sides: &[bool] = match part.side {
        SurfaceSide::Front => &[false],
        SurfaceSide::Back => &[true],
        SurfaceSide::Both => &[false, true],
    };
    let mut places = Vec::new();
    for &is_back in sides {
        for cell in &cells {
            let Some(middle) = cell.point(scene, [0.5; 2], 0.5) else { continue };
            let out = if is_back { -middle.normal } else { middle.normal };
            let outside = middle.position + out * (4.0 * middle.error.max_element());
            let info = PlaceInfo {
                part: part.name.clone(),
                number: places.len() as u32,
                quantity: Quantity::Illuminance,
                position: scene.to_world(middle.position),
                cell: None,
                area: Some(cell.area()),
            };
            let medium_stack = scene.media_at(outside);
            places.push(Place { info, reader: Reader::Cell { cell: cell.clone(), is_back, medium_stack } });
        }
    }
    Ok(places)
}

/// Checks that the scene has the objects of a request, without preparing it.
/// - errors: an unknown object.
pub fn check_objects(scene: &Scene, request: &MeasureRequest) -> Result<(), RequestError> {
    let is_known = |part: &&Area| scene.objects.iter().any(|object| is_name_within(&object.name, &part.object));
    let unknown = request.area.iter().find(|part| !is_known(part));
    unknown.map_or(Ok(()), |part| {
        let reason = unknown_object(scene, &part.object);
        Err(RequestError::Part { name: part.name.clone(), reason })
    })
}

/// Returns the error message for an object without surfaces, with the names that the scene has.
fn unknown_object(scene: &Scene, name: &str) -> String {
    const SHOWN: usize = 12;
    let mut known: Vec<&str> = scene.objects.iter().map(|object| object.name.as_str()).collect();
    known.retain(|name| !name.is_empty());
    known.sort_unstable();
    known.dedup();
    let more = known.len().saturating_sub(SHOWN);
    let list = known[..known.len() - more].join(", ");
    match (known.is_empty(), more) {
        (true, _) => format!("no object `{name}`: the scene names no objects (`o NAME` .. `o`)"),
        (_, 0) => format!("no visible object `{name}`; the objects are {list}"),
        _ => format!("no visible object `{name}`; the objects are {list}, and {more} more"),
    }
}

/// Creates the receiver of a point.
fn receiver(
    scene: &Prepared,
    position: [f64; 3],
    quantity: Quantity,
    direction: Option<[f64; 3]>,
    observer: Option<[f64; 3]>,
) -> Result<Receiver, String> {
    let unit = |v: [f64; 3]| super::request::unit(v).map(|v| Vec3A::from(v.map(|x| x as f32)).normalize());
    let direction = direction.and_then(unit).unwrap_or(Vec3A::Z);
    if let Some(observer) = observer {
        let toward = unit([0, 1, 2].map(|axis| position[axis] - observer[axis]));
        let Some(toward) = toward else { return Err("`observer` is at the point at which one looks".into()) };
        return Ok(point_in_space(scene, scene.from_world(observer), Sensitivity::Ray { toward }));
    }
    let origin = scene.from_world(position);
    Ok(match quantity {
        Quantity::Illuminance => {
            let size = position.iter().fold(0.0f64, |most, x| most.max(x.abs())) as f32;
            let error = POSITION_ERROR * size.max(origin.abs().max_element());
            let sensitivity = Sensitivity::Plane { normal: direction };
            Receiver {
                error: Vec3A::splat(error),
                normal: direction,
                // A point on the surface of a closed object receives light outside, on the side of the normal.
                medium_stack: scene.media_at(origin + direction * (4.0 * error)),
                ..point_in_space(scene, origin, sensitivity)
            }
        }
        Quantity::Cylindrical => point_in_space(scene, origin, Sensitivity::Cylinder { axis: direction }),
        Quantity::Spherical => point_in_space(scene, origin, Sensitivity::Sphere),
        Quantity::Luminance => point_in_space(scene, origin, Sensitivity::Ray { toward: direction }),
    })
}

fn point_in_space(scene: &Prepared, position: Vec3A, sensitivity: Sensitivity) -> Receiver {
    let medium_stack = scene.media_at(position);
    Receiver { position, error: Vec3A::ZERO, normal: Vec3A::ZERO, sensitivity, medium_stack }
}
