//! Measurements of light: illuminance and luminance at points, on grids and over the surfaces of objects.
//!
//! Paths begin at the points ([`femc_montecarlo::Receiver`]). The samples of a reading are divided into [`REPLICATES`] independent
//! replicates, whose means give its interval. A reading is a function of only the scene, the request, and its own number. So it does
//! not depend on threads, nor on the other readings.

mod cells;
mod places;
mod reading;
mod request;
mod summary;

pub use places::{Place, Reader, resolve_places};
pub use reading::{LampShare, MAX_SAMPLES, MeasureSettings, REPLICATES, Reading, measure};
pub use request::{
    Area, Grid, MAX_PLACES, MeasureRequest, Points, Quantity, RequestError, SurfaceSide, WorkPlane, work_plane,
};
pub use summary::{Interval, Summary, summarize};
