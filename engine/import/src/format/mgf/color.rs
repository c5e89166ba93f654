//! Color contexts: `c`, `cxy`, `cspec`, `cct`, `cmix`, `crgb`.
//!
//! A color keeps its chromaticity even outside Rec.709, because mixtures of such colors may lie inside. It is clipped when a
//! material, a medium or a lamp uses it, and the warning is given then.

use super::{
    args::{Args, Result},
    reader::Reader,
    spectrum::{self, ClippedColor},
};
use crate::{ImportFault, WarningKind};
use femc_scene::{Location, TintedScalar};

/// Current state of a color.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Color {
    /// Linear Rec.709; luminance 1 unless `raw`.
    pub rgb: [f64; 3],
    /// Whether the color was given by `crgb`, which is used without scaling.
    pub raw: bool,
    /// Like `rgb`, but not clipped to Rec.709.
    unclipped: [f64; 3],
    /// Location of the color, if it had to be clipped.
    clipped_at: Option<Location>,
}

impl Default for Color {
    fn default() -> Self {
        Self { rgb: [1.0; 3], raw: false, unclipped: [1.0; 3], clipped_at: None }
    }
}

impl Color {
    /// Returns `amount` in this color.
    pub fn tint(&self, amount: f64) -> TintedScalar {
        TintedScalar { amount, color: self.rgb }
    }
}

impl Reader<'_> {
    pub(super) fn cxy(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(2..=2, "x y")?;
        let x = args.number_in(0, "x", "in [0, 1]", |x| (0.0..=1.0).contains(&x))?;
        let y = args.number_in(1, "y", "in [0, 1]", |y| (0.0..=1.0).contains(&y))?;
        if x + y > 1.0 + 1e-9 {
            return Err(args.out_of_range(0, "x + y", x + y, "at most 1"));
        }
        if y > 0.0 {
            return self.set_color(args, spectrum::from_xy(x, y));
        }
        let [near_x, near_y] = spectrum::nearest_visible([x, y]);
        self.warn(args, WarningKind::NoLuminance { x, taken: [near_x, near_y] });
        // The ends of the spectrum lie outside Rec.709, but one warning is enough.
        let color = spectrum::from_xy(near_x, near_y).map(|color| ClippedColor { clipped: false, ..color });
        self.set_color(args, color)
    }

    pub(super) fn cspec(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(4.., "l0 l1 and at least two values")?;
        let first = args.number_in(0, "first wavelength (nm)", "> 0", |x| x > 0.0)?;
        let last = args.number(1, "last wavelength (nm)")?;
        if last <= first {
            return Err(args.out_of_range(1, "last wavelength (nm)", last, "greater than the first wavelength"));
        }
        let value = |i| args.number(i, "spectral value");
        let mut samples = (2..args.len()).map(value).collect::<Result<Vec<f64>>>()?;
        let negative = samples.iter().filter(|x| **x < 0.0).count();
        if negative > 0 {
            self.warn(args, WarningKind::NegativeSpectrum { count: negative });
            samples.iter_mut().for_each(|x| *x = x.max(0.0));
        }
        let color = spectrum::from_samples(first, last, &samples);
        self.set_color(args, color)
    }

    pub(super) fn cct(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(1..=1, "a temperature in kelvin")?;
        let kelvin = args.number_in(0, "temperature (K)", "in [100, 1e9]", |t| (100.0..=1e9).contains(&t))?;
        let color = spectrum::from_temperature(kelvin);
        self.set_color(args, color)
    }

    /// Reads a mixture with weights by relative luminance.
    pub(super) fn cmix(&mut self, args: &Args<'_>) -> Result<()> {
        if args.len() < 2 || !args.len().is_multiple_of(2) {
            args.check_count(0..0, "pairs of weight and color name")?;
        }
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for i in (0..args.len()).step_by(2) {
            let weight = args.number_in(i, "weight", ">= 0", |w| w >= 0.0)?;
            let slot = self.colors.index(args, i + 1, &mut self.errors)?;
            let color = *self.colors.get(slot);
            let what =
                ImportFault::Shape { what: "a black color has no chromaticity to mix", advice: "use a brighter color" };
            let unit = spectrum::with_unit_luminance(color.unclipped).ok_or_else(|| args.fault_at(i + 1, what))?;
            for k in 0..3 {
                sum[k] += weight * unit[k];
            }
            total += weight;
        }
        if total <= 0.0 {
            return Err(args.out_of_range(0, "sum of the weights", total, "> 0"));
        }
        self.set_color(args, ClippedColor::new(sum))
    }

    pub(super) fn crgb(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(3..=3, "r g b")?;
        let channel = |i| args.number_in(i, "color component", ">= 0", |x| x >= 0.0);
        self.note_color();
        let rgb = [channel(0)?, channel(1)?, channel(2)?];
        *self.colors.current_mut() = Color { rgb, raw: true, unclipped: rgb, clipped_at: None };
        Ok(())
    }

    /// Returns the current color for use. Warns once per defining line if the color was clipped.
    pub(super) fn used_color(&mut self) -> Color {
        if self.colors.is_faulty() {
            self.errors.taint();
        }
        let color = *self.colors.current();
        if let Some(location) = color.clipped_at
            && self.clipped_colors.insert(location)
        {
            self.warnings.push(self.position(location), WarningKind::OutOfGamut);
        }
        color
    }

    /// Records that a color was given, so that it tints the next coefficient of the current medium.
    pub(super) fn note_color(&mut self) {
        (self.medium_colored, self.absorption_colored) = (true, true);
    }

    fn set_color(&mut self, args: &Args<'_>, color: Option<ClippedColor>) -> Result<()> {
        let fault = ImportFault::Shape {
            what: "this color has no visible light",
            advice: "use values with a finite luminance",
        };
        let ClippedColor { rgb, unclipped, clipped } = color.ok_or_else(|| args.fault(fault))?;
        self.note_color();
        let clipped_at = clipped.then(|| args.location());
        *self.colors.current_mut() = Color { rgb, raw: false, unclipped, clipped_at };
        Ok(())
    }
}
