//! Render settings, shared by the command line, job files and the wire format.

use crate::allocation::{AllocationError, SampleAllocation};
use crate::budget::PILOT_SPP;
use crate::measure::{MeasureRequest, RequestError};
use femc_film::Filter;
use femc_layers::{Feature, Layer, LayerError};
use femc_scene::{Scene, SelectorError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// All settings that determine a frame's pixels, besides the scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Camera by name; `None`: the scene's first.
    pub camera: Option<String>,
    /// Film size in pixels; `None`: the camera's.
    pub size: Option<[u32; 2]>,
    /// Condition under which a frame is done.
    pub stop: StopCondition,
    /// Method of computing light.
    pub method: Method,
    /// Maximum path length in segments (directly visible light is 1); 0: unlimited.
    pub max_depth: u32,
    /// Pixel filter.
    pub filter: Filter,
    /// Key of all randomness.
    pub seed: u64,
    /// Scalars of the scene by selector, applied in order.
    pub overrides: Vec<(String, f64)>,
    /// Whether path statistics are collected.
    pub statistics: bool,
    /// Whether the histograms of path statistics count all samples, not only the recorded ones.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub full_statistics: bool,
    /// Layers of the light, in addition to the picture.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub layers: Vec<Layer>,
    /// Features (AOVs) of the first visible surface, in addition to the picture.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub features: BTreeSet<Feature>,
    /// Measurement of light, in addition to the picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measure: Option<MeasureRequest>,
    /// Whether light is only measured: frames have no pictures.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub measure_only: bool,
    /// Division of the samples in the first render of a frame with a time limit. `None`: division by the clock.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub allocation: Option<SampleAllocation>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            camera: None,
            size: None,
            stop: StopCondition::Error(0.05),
            method: Method::Auto,
            max_depth: 0,
            filter: Filter::Box,
            seed: 1,
            overrides: Vec::new(),
            statistics: false,
            full_statistics: false,
            layers: Vec::new(),
            features: BTreeSet::new(),
            measure: None,
            measure_only: false,
            allocation: None,
        }
    }
}

/// Condition under which a frame is done.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StopCondition {
    /// This number of samples a pixel.
    Spp(u32),
    /// Maximum relative error of the mean luminance of every 16 x 16 block (95 % confidence).
    Error(f64),
    /// Seconds after the frame's first lease.
    Time(f64),
}

/// Method of computing light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Choice of the plan.
    #[default]
    Auto,
    /// Path tracing alone.
    Pt,
    /// Finite-element first pass alone: its light ends the paths. It is biased by the elements' errors.
    Fem,
    /// Finite-element first pass, then guided path tracing.
    Femc,
    /// Finite-element first pass, then path tracing guided as in the first version of the method, of 1998: by tables of the
    /// directions of light at the leaves that the camera sees. It is a baseline for measurements.
    #[serde(rename = "femc-1998")]
    Femc1998,
}

impl Method {
    /// Returns whether the paths of a frame are guided by learned targets.
    pub fn has_targets(self) -> bool {
        self == Self::Femc
    }

    /// Checks whether frames have a finite-element first pass.
    pub fn has_first_pass(self) -> bool {
        matches!(self, Self::Fem | Self::Femc | Self::Femc1998)
    }

    /// Describes the error of a method in every pixel that more samples do not reduce. `None`: there is none.
    pub fn bias(self) -> Option<&'static str> {
        (self == Self::Fem)
            .then_some("fem: the elements' errors are in every pixel; variance and relative_error do not hold them")
    }
}

/// Reason why settings are invalid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SettingsError {
    /// A number is out of its domain.
    #[error("{setting} is {value}; it must be {domain}")]
    Domain {
        /// Name of the setting.
        setting: &'static str,
        /// Value of the setting.
        value: String,
        /// Domain of the setting.
        domain: &'static str,
    },
    /// Elements have no path lengths.
    #[error(
        "the method `fem` does not support `max-depth` {0}: the light of its elements has no path lengths; use `pt`"
    )]
    MaxDepthWithFem(u32),
    /// Invalid layers.
    #[error(transparent)]
    Layers(#[from] LayerError),
    /// The light of elements has no paths.
    #[error("the method `fem` does not support layers: the paths of its light are not known; use `pt` or `femc`")]
    LayersWithFem,
    /// Invalid measurement.
    #[error(transparent)]
    Measure(#[from] RequestError),
    /// There is nothing to make.
    #[error("`measure-only` needs a measurement: give `measure`")]
    NothingToMeasure,
    /// Invalid allocation of samples.
    #[error(transparent)]
    Allocation(#[from] AllocationError),
    /// An override failed.
    #[error(transparent)]
    Selector(#[from] SelectorError),
}

/// Maximum number of samples a pixel.
pub const MAX_SPP: u32 = 1 << 24;
/// Number of samples a pixel of the first round if the total is not known in advance: two of each replicate.
const FIRST_ROUND: u32 = 8;
/// Number of samples a pixel at which a frame ends even if the requested error is not reached. Every other round doubles the
/// samples.
const LAST_ROUND_SPP: u32 = 1 << 16;

impl Settings {
    /// Checks that all values are in their domains.
    pub fn check(&self) -> Result<(), SettingsError> {
        let refuse = |setting, value: String, domain| Err(SettingsError::Domain { setting, value, domain });
        match self.stop {
            StopCondition::Spp(n) if n == 0 || n > MAX_SPP => refuse("spp", n.to_string(), "from 1 to 16777216"),
            StopCondition::Error(e) if !(e > 0.0 && e < 10.0) => refuse("error", e.to_string(), "above 0 and below 10"),
            StopCondition::Time(t) if !(t > 0.0 && t.is_finite()) => refuse("time", t.to_string(), "a positive time"),
            _ => Ok(()),
        }?;
        if let Some([w, h]) = self.size
            && (w == 0 || h == 0 || w > 32768 || h > 32768)
        {
            return refuse("size", format!("{w}x{h}"), "from 1x1 to 32768x32768");
        }
        if self.method == Method::Fem && self.max_depth != 0 {
            return Err(SettingsError::MaxDepthWithFem(self.max_depth));
        }
        femc_layers::parse_layers(&self.layers)?;
        if self.method == Method::Fem && !self.layers.is_empty() {
            return Err(SettingsError::LayersWithFem);
        }
        match &self.measure {
            Some(request) => request.check()?,
            None if self.measure_only => return Err(SettingsError::NothingToMeasure),
            None => {}
        }
        Ok(self.allocation.as_ref().map_or(Ok(()), SampleAllocation::check)?)
    }

    /// Checks whether frames have a file of layers or features.
    pub fn has_layers(&self) -> bool {
        !self.layers.is_empty() || !self.features.is_empty()
    }

    /// Returns the settings as stated in an image. They do not distinguish a render by the clock from a render with the stated
    /// division, nor a render with measurements from one without.
    pub fn of_image(&self) -> Self {
        Self { allocation: None, measure: None, ..self.clone() }
    }

    /// Returns the settings with which a frame is prepared for its measurement. They do not depend on the picture, so a frame with
    /// and without a picture has equal readings.
    pub fn of_measurement(&self) -> Self {
        Self { overrides: self.overrides.clone(), ..Self::default() }
    }

    /// Applies the overrides to a scene.
    pub fn apply(&self, scene: &mut Scene) -> Result<(), SettingsError> {
        for (selector, value) in &self.overrides {
            scene.set(selector, *value)?;
        }
        Ok(())
    }

    /// Returns the samples a pixel at the end of each round, ascending. With [`StopCondition::Error`] and [`StopCondition::Time`] a
    /// frame may end after any round. With [`StopCondition::Time`] only the first number and the last are certain.
    pub fn rounds(&self) -> Vec<u32> {
        match (self.stop, &self.allocation) {
            (StopCondition::Spp(n), _) => vec![n],
            (StopCondition::Time(_), Some(allocation)) => allocation.rounds(),
            (StopCondition::Time(_), None) => {
                (0..).map(|round| PILOT_SPP.saturating_pow(round)).take_while(|n| *n <= MAX_SPP).collect()
            }
            (StopCondition::Error(_), _) => {
                // 8, 12, 16, 24 ..: all halves and replicates have equal numbers.
                let doubled = std::iter::successors(Some(FIRST_ROUND), |n| (*n < LAST_ROUND_SPP).then_some(n * 2));
                doubled.flat_map(|n| [n, n + n / 2]).take_while(|&n| n <= LAST_ROUND_SPP).collect()
            }
        }
    }
}
