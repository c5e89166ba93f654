//! Web pages of a farm.

use femc_coordinator::{Files, Site};

/// Returns the pages, and the renderer of their pictures.
pub fn site() -> Site {
    #[cfg(feature = "ui")]
    let files = Files(femc_web::FILES);
    #[cfg(not(feature = "ui"))]
    let files = Files::default();
    Site { files, engine: femc_worker::engine().to_owned(), draw: Some(femc_pictures::draw) }
}
