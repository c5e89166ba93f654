//! Medium contexts and the regions of media: `medium`, `mbox`, `mglobal`.

use super::{
    args::{Args, Result},
    reader::Reader,
    stack::NoWorldTransforms,
    table::ContextChange,
};
use crate::{EntityKind, ImportFault};
use femc_scene::{Density, Location, Medium, MediumId, MediumRegion, Phase, RegionBounds};

/// Maximum number of regions after array expansion.
const MAX_REGIONS: u64 = 1_000_000;

/// Current state of a medium.
#[derive(Clone, Debug)]
pub(super) struct MediumState {
    medium: Medium,
    /// Entry in the scene, unless the medium has changed since.
    entry: Option<MediumId>,
}

impl Default for MediumState {
    fn default() -> Self {
        let medium = Medium {
            name: String::new(),
            location: Location::default(),
            sigma_s: 0.0,
            color: [1.0; 3],
            sigma_a: 0.0,
            absorption_color: [1.0; 3],
            phase: Phase::default(),
            glow: 0.0,
            glow_color: [1.0; 3],
            density: Density::default(),
        };
        Self { medium, entry: None }
    }
}

impl Reader<'_> {
    pub(super) fn medium(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(1..=3, "NAME [= [TEMPLATE]]")?;
        self.seal_medium()?;
        (self.medium_colored, self.absorption_colored) = (false, false);
        if self.media.select(args, &mut self.errors)? != ContextChange::Selected {
            let state = self.media.current_mut();
            state.medium.name = args.text(0).into_owned();
            state.medium.location = args.location();
            state.entry = None;
        }
        Ok(())
    }

    /// Reads `sigma_s`, `sigma_a`, `phase`, `glow` or `density`.
    pub(super) fn medium_field(&mut self, entity: &[u8], args: &Args<'_>) -> Result<()> {
        if !self.media.is_named() {
            return Err(
                args.fault(ImportFault::NoContext { entity: args.entity().into_owned(), kind: EntityKind::Medium })
            );
        }
        let color = if self.medium_colored { *self.colors.current() } else { super::color::Color::default() };
        let tint = if color.raw { color.rgb } else { [1.0; 3] };
        let coefficient = |what| {
            args.check_count(1..=1, "one number")?;
            args.number_in(0, what, ">= 0", |x| x >= 0.0)
        };
        let mut medium = self.media.current().medium.clone();
        match entity {
            b"sigma_s" => {
                medium.sigma_s = coefficient("scattering coefficient (1/m)")?;
                medium.color = tint;
                // A color before `sigma_s` tints only scattering.
                self.absorption_colored = false;
            }
            b"sigma_a" => {
                medium.sigma_a = coefficient("absorption coefficient (1/m)")?;
                medium.absorption_color = if self.absorption_colored { tint } else { [1.0; 3] };
            }
            b"glow" => {
                medium.glow = coefficient("emission (lm/m3)")?;
                medium.glow_color = if self.medium_colored { self.used_color().rgb } else { color.rgb };
            }
            b"phase" => medium.phase = phase(args)?,
            _ => medium.density = density(args)?,
        }
        let state = self.media.current_mut();
        (state.medium, state.entry) = (medium, None);
        Ok(())
    }

    /// Makes an entry of the current medium before another one is selected.
    pub(super) fn seal_medium(&mut self) -> Result<()> {
        if self.media.is_named() && self.media.current().entry.is_none() {
            let medium = self.media.current().medium.clone();
            let id = self.medium_entry(medium);
            self.media.current_mut().entry = Some(id);
        }
        Ok(())
    }

    /// Returns the entry of the current state of the medium that argument `i` names.
    pub(super) fn medium_named(&mut self, args: &Args<'_>, i: usize) -> Result<MediumId> {
        self.seal_medium()?;
        let slot = self.media.index(args, i, &mut self.errors)?;
        let state = self.media.get(slot);
        // Only the current medium can lack an entry, and it has just received one.
        match state.entry {
            Some(entry) => Ok(entry),
            None => Ok(self.medium_entry(state.medium.clone())),
        }
    }

    fn medium_entry(&mut self, medium: Medium) -> MediumId {
        let entries = self.medium_entries.entry(medium.name.clone()).or_default();
        let equal = |id: &&MediumId| {
            let known = &self.scene.media[id.index()];
            Medium { location: known.location, ..medium.clone() } == *known
        };
        if let Some(&id) = entries.iter().rev().take(8).find(equal) {
            return id;
        }
        let id = MediumId(self.scene.media.len() as u32);
        entries.push(id);
        self.scene.media.push(medium);
        id
    }

    /// Reads `mbox NAME x0 y0 z0 x1 y1 z1`, which adds one region for each copy that the enclosing transforms make.
    pub(super) fn mbox(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(7..=7, "NAME x0 y0 z0 x1 y1 z1")?;
        let medium = self.medium_named(args, 0)?;
        let (a, b) = (args.vector(1, "coordinate (m)")?, args.vector(4, "coordinate (m)")?);
        let (min, max) = (a.min(b), a.max(b));
        if !(max - min).cmpgt(Default::default()).all() || !(max - min).is_finite() {
            let fault = ImportFault::Shape {
                what: "this box has no volume",
                advice: "use two corners that differ in x, y and z",
            };
            return Err(args.fault(fault));
        }
        let left = MAX_REGIONS - (self.scene.regions.len() as u64).min(MAX_REGIONS);
        let transforms = self.world_transforms(left).map_err(|reason| {
            args.fault(match reason {
                NoWorldTransforms::Moving => ImportFault::Unsupported {
                    what: "a medium box that moves along a path",
                    advice: "move it out of the `xf -path`",
                },
                NoWorldTransforms::TooMany => {
                    ImportFault::TooMany { what: "regions of media after array expansion", limit: MAX_REGIONS }
                }
            })
        })?;
        for to_world in transforms {
            if !to_world.is_finite() {
                return Err(args.fault(ImportFault::NotFinite { what: "a transformed coordinate" }));
            }
            let bounds = RegionBounds::Box { min, max, to_world };
            self.scene.regions.push(MediumRegion { medium, bounds, location: args.location() });
        }
        Ok(())
    }

    pub(super) fn mglobal(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(1..=1, "the name of a medium")?;
        let medium = self.medium_named(args, 0)?;
        self.scene.regions.push(MediumRegion { medium, bounds: RegionBounds::Everywhere, location: args.location() });
        Ok(())
    }
}

fn phase(args: &Args<'_>) -> Result<Phase> {
    args.check_count(1..=2, "iso, hg G, schlick K or rayleigh")?;
    let parameter = || {
        args.check_count(2..=2, "the phase function and its parameter")?;
        args.number_in(1, "phase function parameter", "in (-1, 1)", |x| x > -1.0 && x < 1.0)
    };
    match args.raw(0) {
        b"hg" => Ok(Phase::HenyeyGreenstein { g: parameter()? }),
        b"schlick" => Ok(Phase::Schlick { k: parameter()? }),
        b"iso" => args.check_count(1..=1, "iso without a parameter").map(|()| Phase::Isotropic),
        b"rayleigh" => args.check_count(1..=1, "rayleigh without a parameter").map(|()| Phase::Rayleigh),
        _ => {
            let expected = "iso, hg G, schlick K or rayleigh";
            Err(args.fault_at(0, ImportFault::Unexpected { found: args.text(0).into_owned(), expected }))
        }
    }
}

fn density(args: &Args<'_>) -> Result<Density> {
    args.check_count(1..=3, "uniform, height Z0 H or vdb FILE [GRID]")?;
    match args.raw(0) {
        b"uniform" => args.check_count(1..=1, "uniform without a parameter").map(|()| Density::Uniform),
        b"height" => {
            args.check_count(3..=3, "height Z0 H")?;
            let z0 = args.number(1, "height of full density (m)")?;
            let scale = args.number_in(2, "scale height (m)", "> 0", |h| h > 0.0)?;
            Ok(Density::Height { z0, scale })
        }
        b"vdb" => {
            let advice = "use `density uniform` or `density height Z0 H`";
            Err(args.fault_at(0, ImportFault::Unsupported { what: "a grid medium (density vdb)", advice }))
        }
        _ => {
            let expected = "uniform, height Z0 H or vdb FILE [GRID]";
            Err(args.fault_at(0, ImportFault::Unexpected { found: args.text(0).into_owned(), expected }))
        }
    }
}
