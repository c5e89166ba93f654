//! Measurements of light: illuminance and luminance at points, on grids and over the surfaces of objects.
//!
//! Paths begin at the points ([`femc_montecarlo::Receiver`]). The samples of a reading are divided into [`REPLICATES`] independent
//! replicates, whose means give its interval. A reading is a function of only the scene, the request, and its own number. So it does
//! not depend on threads, nor on the other readings.

mod cells;
mod message;
mod places;
mod reading;
mod request;
mod rows;
mod summary;

pub use message::{FrameReadings, Measured, MeasurementId, MessageError, ReadingBlock, ReadingShare, join_blocks};
pub use places::{Place, PlaceInfo, Reader, check_objects, resolve_places};
pub use reading::{LampShare, MAX_SAMPLES, MeasureSettings, REPLICATES, Reading, measure};
#[cfg(test)]
pub(crate) use request::test_request;
pub use request::{
    Area, DEFAULT_ERROR, Grid, MAX_PLACES, MeasureRequest, Points, Quantity, RequestError, SurfaceSide, WorkPlane,
    work_plane,
};
pub use rows::{ReadingRow, SummaryRow};
pub use summary::{Interval, Summary, summarize};
