//! Web pages of a farm.

use femc_coordinator::{PageFiles, Site};

/// Returns the pages, and the renderer of their pictures.
pub fn site() -> Site {
    #[cfg(feature = "ui")]
    let files = PageFiles(femc_web::FILES);
    #[cfg(not(feature = "ui"))]
    let files = PageFiles::default();
    Site {
        files,
        engine: femc_worker::engine().to_owned(),
        draw: Some(femc_pictures::draw_frame),
        compare: Some(femc_pictures::compare_pictures),
        open_light: Some(femc_pictures::open_light),
        light_files: Vec::new(),
    }
}
