//! Camera contexts.

use super::{
    args::{Args, Result},
    reader::Reader,
    table::ContextChange,
};
use crate::{EntityKind, ImportError, ImportFault, Position, Warning, WarningKind};
use femc_math::glam::DVec3;
use femc_scene::{Camera, Location, default_camera as place_camera};

/// Maximum number of pixels along one side of the film.
const MAX_SIDE: u64 = 32_768;
/// Maximum number of pixels of the film.
const MAX_PIXELS: u64 = 1 << 28;
/// Minimum sine of the angle between view and up direction.
const PARALLEL: f64 = 1e-9;

/// Returns a camera with default fields: z up, 45 degrees, 640 x 480, pinhole, no motion blur.
pub(super) fn default_camera() -> Camera {
    Camera {
        name: String::new(),
        location: Location::default(),
        origin: DVec3::ZERO,
        target: DVec3::ZERO,
        up: DVec3::Z,
        fov: 45.0,
        film: [640, 480],
        lens_radius: 0.0,
        focus: 1.0,
        shutter_open: 0.0,
        shutter_close: 0.0,
        along: None,
    }
}

impl Reader<'_> {
    pub(super) fn camera(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(1..=3, "NAME [= [TEMPLATE]]")?;
        let replaced = args.len() > 1 && self.cameras.slot_of(&args.text(0)).is_some();
        if self.cameras.select(args, &mut self.errors)? == ContextChange::Selected {
            return Ok(());
        }
        let camera = self.cameras.current_mut();
        camera.name = args.text(0).into_owned();
        camera.location = args.location();
        if replaced {
            self.warn(args, WarningKind::DefinitionReplaced { what: format!("camera {}", args.text(0)) });
        }
        if self.is_transformed() {
            self.warn(args, WarningKind::NotTransformed { what: "camera" });
        }
        Ok(())
    }

    /// Reads `origin`, `target`, `up`, `fov`, `film`, `lens`, `shutter` or `along`.
    pub(super) fn camera_field(&mut self, entity: &[u8], args: &Args<'_>) -> Result<()> {
        if !self.cameras.is_named() {
            return Err(
                args.fault(ImportFault::NoContext { entity: args.entity().into_owned(), kind: EntityKind::Camera })
            );
        }
        let mut camera = self.cameras.current().clone();
        let vector = || {
            args.check_count(3..=3, "x y z")?;
            args.vector(0, "coordinate (m)")
        };
        match entity {
            b"origin" => camera.origin = vector()?,
            b"target" => camera.target = vector()?,
            b"up" => {
                camera.up = vector()?;
                if camera.up.try_normalize().is_none() {
                    let fault = ImportFault::Shape { what: "`up` has no direction", advice: "give it a length near 1" };
                    return Err(args.fault(fault));
                }
            }
            b"fov" => {
                args.check_count(1..=1, "an angle in degrees")?;
                camera.fov = args.number_in(0, "field of view (degrees)", "in (0, 180)", |a| a > 0.0 && a < 180.0)?;
            }
            b"film" => camera.film = film(args)?,
            b"lens" => {
                args.check_count(2..=2, "radius and focus")?;
                camera.lens_radius = args.number_in(0, "lens radius (m)", ">= 0", |r| r >= 0.0)?;
                camera.focus =
                    args.number_in(1, "focus distance (m)", "> 0", |f| f > 0.0 || camera.lens_radius == 0.0)?;
            }
            b"shutter" => {
                args.check_count(2..=2, "open and close")?;
                let unit = |i| args.number_in(i, "shutter time", "in [0, 1]", |x| (0.0..=1.0).contains(&x));
                (camera.shutter_open, camera.shutter_close) = (unit(0)?, unit(1)?);
                if camera.shutter_close < camera.shutter_open {
                    return Err(args.out_of_range(
                        1,
                        "closing time of the shutter",
                        camera.shutter_close,
                        "at or after the opening time",
                    ));
                }
            }
            _ => {
                args.check_count(1..=1, "the name of a path")?;
                camera.along = Some(self.find_path(&args.text(0)).map_err(|fault| args.fault_at(0, fault))?);
            }
        }
        *self.cameras.current_mut() = camera;
        Ok(())
    }

    /// Adds a default camera to a scene without cameras. Returns a note about it.
    pub(super) fn add_default_camera(&mut self) -> Option<Warning> {
        if !self.scene.cameras.is_empty() {
            return None;
        }
        let (camera, standpoint) = place_camera(&self.scene)?;
        let (origin, target) = (camera.origin.to_array(), camera.target.to_array());
        self.scene.cameras.push(camera);
        let at = Position { file: self.scene.files.first()?.clone(), line: 0, column: 0 };
        Some(Warning { at, kind: WarningKind::DefaultCamera { standpoint, origin, target } })
    }

    /// Checks constraints between fields and adds the cameras to the scene.
    pub(super) fn finish_cameras(&mut self) -> Result<()> {
        for camera in self.cameras.valid_contexts() {
            let [what, advice] = match (camera.target - camera.origin).try_normalize() {
                None => [
                    "this camera has no view direction: origin and target are the same point",
                    "set both to different points",
                ],
                Some(view) if view.cross(camera.up.normalize_or_zero()).length() < PARALLEL => {
                    ["this camera's `up` is parallel to its view direction", "choose another `up`"]
                }
                Some(_) => continue,
            };
            let error = ImportError::new(self.position(camera.location), ImportFault::Shape { what, advice });
            self.errors.report(error)?;
        }
        self.scene.cameras = self.cameras.named_contexts().cloned().collect();
        Ok(())
    }
}

fn film(args: &Args<'_>) -> Result<[u32; 2]> {
    args.check_count(2..=2, "width and height")?;
    let side = |i| args.whole_number(i, "film size (pixels)", [1, MAX_SIDE], "a whole number in [1, 32768]");
    let (width, height) = (side(0)?, side(1)?);
    if width * height > MAX_PIXELS {
        return Err(args.fault(ImportFault::TooMany { what: "pixels of film", limit: MAX_PIXELS }));
    }
    Ok([width as u32, height as u32])
}
