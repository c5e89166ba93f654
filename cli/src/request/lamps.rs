//! Warnings about lamps whose light is hard to find.

use super::asked::{Asked, shown};
use crate::output::{Say, human};
use femc_emission::{IntensityDistribution, PhotometryError, PhotometryKind};
use femc_pipeline::Method;
use femc_scene::{Fault, Photometry, PhotometryType, bent_light, lamps_without_light};

/// Number of lamps that are listed one by one; `femc check` lists all.
const NAMED: usize = 4;
/// Share of the lamps' light through solids and from mirrors above which the first pass is inexact.
const MUCH: f64 = 0.1;

impl Asked {
    /// Warns of lamps whose light the job's method does not find.
    pub fn warn_of_lost_light(&self, say: Say) {
        self.warn_of_hidden_lamps(say);
        if self.settings.method == Method::Fem {
            self.warn_of_bent_light(say);
        }
    }

    /// Warns of lamps whose light no method finds.
    fn warn_of_hidden_lamps(&self, say: Say) {
        if say.quiet() {
            return;
        }
        let scene = self.scene();
        let faults = lamps_without_light(scene);
        for Fault { location, message, advice, .. } in faults.iter().take(NAMED) {
            let file = scene.files.get(location.file as usize).map_or("", String::as_str);
            say.note(format!("warning: {}:{}: {message}; {advice}", shown(self.place(), file), location.line));
        }
        if let more @ 1.. = faults.len().saturating_sub(NAMED) {
            let (more, scene) = (human::count(more as u64, "more lamp"), self.path.display());
            say.note(format!("warning: rendering does not find the light of {more}; `femc check {scene}` lists them"));
        }
    }

    /// Warns of light that the first pass alone loses or puts in wrong places.
    pub fn warn_of_bent_light(&self, say: Say) {
        let bent = bent_light(self.scene(), &flux);
        if bent.share >= MUCH {
            say.warning(format!(
                "{} of the lamps' light ({:.0} lm) first passes through clear solids or comes from mirrors: the first pass \
                 finds it with few rays, loses a part and spreads the rest evenly over surfaces; render with `--method femc` or \
                 `--method pt`",
                human::percent(bent.share),
                bent.lumens
            ));
        }
    }
}

/// Returns the luminous flux of a photometric file, as the renderer reads it, lm.
pub fn flux(photometry: &Photometry) -> f64 {
    table_of(photometry).map_or(0.0, |table| table.flux())
}

/// Returns the intensities of a photometric file, as the renderer reads them.
pub fn table_of(photometry: &Photometry) -> Result<IntensityDistribution, PhotometryError> {
    let kind = match photometry.kind {
        PhotometryType::A => PhotometryKind::A,
        PhotometryType::B => PhotometryKind::B,
        PhotometryType::C => PhotometryKind::C,
    };
    IntensityDistribution::new(kind, &photometry.vertical, &photometry.horizontal, &photometry.candela)
}
