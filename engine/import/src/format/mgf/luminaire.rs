//! Luminaires with measured photometry: `ies path [-m f] [xf args]`.

use super::{
    args::{Args, Result},
    reader::Reader,
    spectrum,
};
use crate::{
    ImportFault, WarningKind, files,
    format::ies::{self, Tilt},
};
use femc_math::{elementary::double as elementary, glam::DVec3};
use femc_scene::{Luminaire, PhotometryId};

impl Reader<'_> {
    pub(super) fn ies(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(1.., "path [-m factor] [transform arguments]")?;
        let path = self.resolve(args)?;
        let (photometry, tilt) = self.photometry(args, &path)?;
        let (multiplier, first) = match args.raw(1) {
            b"-m" if args.len() > 2 => (args.number_in(2, "multiplier", ">= 0", |m| m >= 0.0)?, 3),
            b"-m" => {
                let fault = ImportFault::ArgumentCount { entity: "-m".into(), expected: "one number", found: 0 };
                return Err(args.fault_at(1, fault));
            }
            _ => (1.0, 1),
        };
        if first == 1
            && let Some((at, what)) = self.normalization_hints.remove(&photometry)
        {
            self.notes.push(at, WarningKind::Photometry { what });
        }
        if args.len() <= first {
            return self.add_luminaire(args, photometry, multiplier, tilt.as_ref());
        }
        self.push_frame(args, first)?;
        self.add_luminaire(args, photometry, multiplier, tilt.as_ref())?;
        self.pop_frame()
    }

    fn add_luminaire(
        &mut self,
        args: &Args<'_>,
        photometry: PhotometryId,
        multiplier: f64,
        tilt: Option<&Tilt>,
    ) -> Result<()> {
        let fault = ImportFault::Shape { what: "the current color is black", advice: "choose a color before `ies`" };
        let color = spectrum::with_unit_luminance(self.used_color().rgb).ok_or_else(|| args.fault(fault))?;
        let multiplier = multiplier * tilt.map_or(1.0, |tilt| self.tilt_factor(args, tilt));
        if !multiplier.is_finite() {
            return Err(args.fault(ImportFault::NotFinite { what: "multiplier" }));
        }
        let to_group = self.frame().to_group;
        let (object, location) = (self.current_object(), args.location());
        let luminaire = Luminaire { photometry, to_group, multiplier, color, object, location };
        self.scene.groups[self.group.index()].luminaires.push(luminaire);
        self.count_primitives(self.group, 1).map_err(|fault| args.fault(fault))
    }

    /// Returns the lamp's factor at the angle between the luminaire's axis and the vertical.
    fn tilt_factor(&mut self, args: &Args<'_>, tilt: &Tilt) -> f64 {
        let poses = self.world_transforms(1).unwrap_or_default();
        let [pose] = poses[..] else {
            let what = "tilt factors ignore arrays and paths: the factor for the upright position is used";
            self.warn(args, WarningKind::Photometry { what: what.into() });
            return tilt.factor(0.0);
        };
        let axis = pose.transform_vector3(DVec3::Z).normalize_or_zero();
        let angle = elementary::atan2(DVec3::new(axis.x, axis.y, 0.0).length(), axis.z).to_degrees();
        tilt.factor(angle)
    }

    /// Returns the photometry of a file. Each file is read once.
    fn photometry(&mut self, args: &Args<'_>, path: &str) -> Result<(PhotometryId, Option<Tilt>)> {
        if let Some(known) = self.photometries.get(path) {
            return Ok(known.clone());
        }
        let text = self.text(path).map_err(|fault| args.fault_at(0, fault))?;
        self.file_index(path);
        let read = ies::parse(path, &text, &mut |named| {
            let path = files::resolve(path, named)?;
            let text = self.text(&path)?;
            Ok((path, text))
        })?;
        for (at, what) in read.remarks.warnings {
            self.warnings.push(at, WarningKind::Photometry { what });
        }
        for (at, what) in read.remarks.notes {
            self.notes.push(at, WarningKind::Photometry { what });
        }
        let id = PhotometryId(self.scene.photometry.len() as u32);
        self.normalization_hints.extend(read.normalization_hint.map(|hint| (id, hint)));
        let mut photometry = read.photometry;
        photometry.location = args.location();
        self.scene.photometry.push(photometry);
        self.photometries.insert(path.into(), (id, read.tilt.clone()));
        Ok((id, read.tilt))
    }
}
