//! Warnings about lamps whose light is hard to find.

use super::resolved::{ResolvedRequest, with_root_prefix};
use crate::output::{Printer, human};
use femc_emission::{IntensityDistribution, PhotometryError, PhotometryKind};
use femc_pipeline::Method;
use femc_scene::{Photometry, PhotometryType, SceneFault, estimate_caustic_flux, lamps_without_light};

/// Number of lamps that are listed one by one; `femc check` lists all.
const MAX_LISTED: usize = 4;
/// Share of the lamps' light through solids and from mirrors above which blurred bright spots matter.
const MIN_CAUSTIC_SHARE: f64 = 0.1;

impl ResolvedRequest {
    /// Warns of lamps whose light the job's method does not find.
    pub fn warn_of_lost_light(&self, printer: Printer) {
        self.warn_of_hidden_lamps(printer);
        if self.settings.method == Method::Fem {
            self.warn_of_caustics(printer);
        }
    }

    /// Warns of lamps whose light no method finds.
    fn warn_of_hidden_lamps(&self, printer: Printer) {
        if printer.quiet() {
            return;
        }
        let scene = self.scene();
        let faults = lamps_without_light(scene);
        for SceneFault { location, message, advice, .. } in faults.iter().take(MAX_LISTED) {
            let file = scene.files.get(location.file as usize).map_or("", String::as_str);
            printer.note(format!(
                "warning: {}:{}: {message}; {advice}",
                with_root_prefix(self.scene_path(), file),
                location.line
            ));
        }
        if let more @ 1.. = faults.len().saturating_sub(MAX_LISTED) {
            let (more, scene) = (human::counted_noun(more as u64, "more lamp"), self.path.display());
            printer
                .note(format!("warning: rendering does not find the light of {more}; `femc check {scene}` lists them"));
        }
    }

    /// Warns of light whose bright spots the first pass alone blurs.
    pub fn warn_of_caustics(&self, printer: Printer) {
        let bent = estimate_caustic_flux(self.scene(), &luminous_flux);
        if bent.share >= MIN_CAUSTIC_SHARE {
            printer.warning(format!(
                "{} of the lamps' light ({:.0} lm) first passes through clear solids or comes from mirrors: the first pass \
                 shows its bright spots only as sharply as its elements are small; for sharp ones, render with `--method femc` \
                 or `--method pt`",
                human::percent(bent.share),
                bent.lumens
            ));
        }
    }
}

/// Returns the luminous flux of a photometric file, as the renderer reads it, lm.
pub fn luminous_flux(photometry: &Photometry) -> f64 {
    intensity_distribution(photometry).map_or(0.0, |table| table.flux())
}

/// Returns the intensities of a photometric file, as the renderer reads them.
pub fn intensity_distribution(photometry: &Photometry) -> Result<IntensityDistribution, PhotometryError> {
    let kind = match photometry.kind {
        PhotometryType::A => PhotometryKind::A,
        PhotometryType::B => PhotometryKind::B,
        PhotometryType::C => PhotometryKind::C,
    };
    IntensityDistribution::new(kind, &photometry.vertical, &photometry.horizontal, &photometry.candela)
}
