//! Material contexts.
//!
//! A surface uses the current state of the material at its line. The state becomes an entry of the scene when a surface uses it or
//! when another material is selected. A state equal to an existing entry of the same name reuses that entry, so files that repeat a
//! definition create only one.

use super::{
    args::{Args, Result},
    reader::Reader,
    spectrum::luminance,
    table::ContextChange,
};
use crate::WarningKind;
use femc_scene::{Ior, Location, Material, MaterialId, ScatteringPart, Sides, TintedScalar};

/// Tolerance of the sum of the reflectances, for decimal fractions that add up to 1.
const SUM_TOLERANCE: f64 = 1e-6;
/// Sum in one channel above which a warning is given. Chromaticities have few digits.
const CHANNEL: f64 = 1.005;
/// Number of entries of one name that are searched for an equal entry.
const MAX_SEARCHED_ENTRIES: usize = 8;

/// Current state of a material.
#[derive(Clone, Debug, Default)]
pub(super) struct MaterialState {
    pub material: Material,
    /// Entry in the scene, unless the material has changed since.
    entry: Option<MaterialId>,
    /// Location of the last entity that changed a reflectance.
    reflectance_at: Location,
}

/// Returns the luminance that a surface reflects or transmits of unit light: the amount itself, unless the color is raw.
fn returned_luminance(tinted: &TintedScalar) -> f64 {
    tinted.amount * luminance(tinted.color)
}

impl Reader<'_> {
    pub(super) fn m(&mut self, args: &Args<'_>) -> Result<()> {
        self.seal_material();
        let change = self.materials.select(args, &mut self.errors)?;
        if change != ContextChange::Selected {
            let state = self.materials.current_mut();
            state.material.location = args.location();
            state.material.name = args.text(0).into_owned();
            state.reflectance_at = args.location();
            state.entry = None;
        }
        Ok(())
    }

    /// Returns the entry of the current material.
    pub(super) fn current_material(&mut self) -> MaterialId {
        let state = self.materials.current();
        if let Some(entry) = state.entry {
            return entry;
        }
        let mut material = state.material.clone();
        let parts = ScatteringPart::ALL.iter();
        let sum = parts.clone().map(|part| returned_luminance(part.fraction(&material))).sum::<f64>();
        if sum > 1.0 + SUM_TOLERANCE {
            let at = self.position(state.reflectance_at);
            let name = if material.name.is_empty() { "(unnamed)".into() } else { material.name.clone() };
            parts.for_each(|part| part.fraction_mut(&mut material).amount /= sum);
            self.warnings.push(at, WarningKind::TooBright { material: name, sum });
        }
        let id = self.material_entry(material);
        self.materials.current_mut().entry = Some(id);
        id
    }

    /// Makes an entry of the current named material before another one is selected.
    pub(super) fn seal_material(&mut self) {
        if self.materials.is_named() {
            self.current_material();
        }
    }

    fn material_entry(&mut self, material: Material) -> MaterialId {
        let entries = self.material_entries.entry(material.name.clone()).or_default();
        let equal = |id: &&MaterialId| {
            let known = &self.scene.materials[id.index()];
            Material { location: known.location, ..material.clone() } == *known
        };
        if let Some(&id) = entries.iter().rev().take(MAX_SEARCHED_ENTRIES).find(equal) {
            return id;
        }
        let id = MaterialId(self.scene.materials.len() as u32);
        entries.push(id);
        let brightest = (0..3).map(|channel| material.channel_demand(channel)).fold(0.0, f64::max);
        if brightest > CHANNEL {
            let at = self.position(material.location);
            self.warnings.push(at, WarningKind::ChannelAboveOne { sum: brightest });
        }
        self.scene.materials.push(material);
        id
    }

    /// Returns the current material for a change.
    pub(super) fn current_material_mut(&mut self) -> &mut Material {
        let state = self.materials.current_mut();
        state.entry = None;
        &mut state.material
    }

    pub(super) fn sides(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(1..=1, "1 or 2")?;
        self.current_material_mut().sides = match args.whole_number(0, "number of sides", [1, 2], "1 or 2")? {
            1 => Sides::One,
            _ => Sides::Two,
        };
        Ok(())
    }

    /// Reads a fraction, and the roughness of a specular part: `rd r`, `td t`, `rs r a` or `ts t a`.
    pub(super) fn reflectance(&mut self, part: ScatteringPart, args: &Args<'_>) -> Result<()> {
        let specular = part.roughness_name().is_some();
        if specular {
            args.check_count(2..=2, "a fraction and a roughness")?;
        } else {
            args.check_count(1..=1, "a fraction")?;
        }
        let unit = |i, what| args.number_in(i, what, "in [0, 1]", |x| (0.0..=1.0).contains(&x));
        let amount = unit(0, "reflectance or transmittance")?;
        let alpha = if specular { unit(1, "roughness")? } else { 0.0 };
        let tinted = self.used_color().tint(amount);
        let material = self.current_material_mut();
        *part.fraction_mut(material) = tinted;
        if let Some(roughness) = part.roughness_mut(material) {
            *roughness = alpha;
        }
        self.materials.current_mut().reflectance_at = args.location();
        Ok(())
    }

    pub(super) fn ir(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(2..=2, "the real and the imaginary part")?;
        let re = args.number_in(0, "real index of refraction", "> 0", |x| x > 0.0)?;
        let im = args.number_in(1, "imaginary index of refraction", ">= 0", |x| x >= 0.0)?;
        self.current_material_mut().ior = Some(Ior { re, im });
        Ok(())
    }

    pub(super) fn ed(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(1..=1, "an emittance in lm/m2")?;
        let emittance = args.number_in(0, "emittance (lm/m2)", ">= 0", |x| x >= 0.0)?;
        let tinted = self.used_color().tint(emittance);
        self.current_material_mut().ed = tinted;
        Ok(())
    }

    pub(super) fn lobe(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(1..=1, "an exponent")?;
        let n = args.number_in(0, "exponent of the lobe", "in [0, 1e6]", |n| (0.0..=1e6).contains(&n))?;
        self.current_material_mut().lobe = Some(n);
        Ok(())
    }

    pub(super) fn inside(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(1..=1, "the name of a medium")?;
        let medium = self.medium_named(args, 0)?;
        self.current_material_mut().inside = Some(medium);
        Ok(())
    }
}
