//! Render settings: the same on the command line, in job files and on the wire.

use crate::allocation::{Allocation, AllocationError};
use crate::budget::PILOT;
use femc_film::Filter;
use femc_layers::{Feature, Layer, LayerError};
use femc_scene::{Scene, SelectorError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Everything besides the scene that decides a frame's pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Camera by name; `None`: the scene's first.
    pub camera: Option<String>,
    /// Film size in pixels; `None`: the camera's.
    pub size: Option<[u32; 2]>,
    /// When a frame is done.
    pub stop: Stop,
    /// How light is computed.
    pub method: Method,
    /// Longest path in segments (what the camera sees directly is 1); 0: no bound.
    pub max_depth: u32,
    /// Pixel filter.
    pub filter: Filter,
    /// Key of all randomness.
    pub seed: u64,
    /// Scalars of the scene by selector, applied in order.
    pub overrides: Vec<(String, f64)>,
    /// Whether path statistics are collected.
    pub statistics: bool,
    /// Whether all samples are in the histograms of path statistics; else those that are recorded.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub full_statistics: bool,
    /// Layers of the light, beside the picture.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub layers: Vec<Layer>,
    /// Features, beside the picture: what the camera sees first.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub features: BTreeSet<Feature>,
    /// Of a frame that has a time: how its samples were divided when it was rendered first; `None`: by the clock.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub allocation: Option<Allocation>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            camera: None,
            size: None,
            stop: Stop::Error(0.05),
            method: Method::Auto,
            max_depth: 0,
            filter: Filter::Box,
            seed: 1,
            overrides: Vec::new(),
            statistics: false,
            full_statistics: false,
            layers: Vec::new(),
            features: BTreeSet::new(),
            allocation: None,
        }
    }
}

/// When a frame is done.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stop {
    /// At this many samples a pixel.
    Spp(u32),
    /// When every 16 x 16 block's mean luminance has at most this relative error (95 % confidence).
    Error(f64),
    /// This many seconds after the frame's first lease.
    Time(f64),
}

/// How light is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// The plan's choice.
    #[default]
    Auto,
    /// Path tracing alone.
    Pt,
    /// The finite-element first pass alone: its light ends the paths. Biased by the elements' errors.
    Fem,
    /// The finite-element first pass, then guided path tracing.
    Femc,
}

impl Method {
    /// Whether frames have a finite-element first pass.
    pub fn has_first_pass(self) -> bool {
        matches!(self, Self::Fem | Self::Femc)
    }

    /// What a method leaves in every pixel however many samples it draws; `None`: nothing.
    pub fn bias(self) -> Option<&'static str> {
        (self == Self::Fem)
            .then_some("fem: the elements' errors are in every pixel; variance and relative_error do not hold them")
    }
}

/// Why settings are refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SettingsError {
    /// A number is out of its domain.
    #[error("{setting} is {value}; it must be {domain}")]
    Domain {
        /// Name of the setting.
        setting: &'static str,
        /// Its value.
        value: String,
        /// What it may be.
        domain: &'static str,
    },
    /// Elements know no lengths of paths.
    #[error(
        "a longest path (`max-depth` {0}) cannot be asked of the method `fem`, whose light has come any number of ways; use `pt`"
    )]
    DepthOfElements(u32),
    /// Layers that no frame can have.
    #[error(transparent)]
    Layers(#[from] LayerError),
    /// Elements do not know by what ways their light has come.
    #[error(
        "layers cannot be had of the method `fem`, whose light has come by ways that are not known; use `pt` or `femc`"
    )]
    LayersOfElements,
    /// Samples that no frame is made of.
    #[error(transparent)]
    Allocation(#[from] AllocationError),
    /// An override failed.
    #[error(transparent)]
    Selector(#[from] SelectorError),
}

/// Most samples a pixel that can be asked for.
pub const MAX_SPP: u32 = 1 << 24;
/// Samples a pixel of the first round when the number is not known in advance: two of each replicate.
const FIRST_ROUND: u32 = 8;
/// Every other round doubles the samples; this many are the end even if the error asked for is not reached.
const LAST_ROUND_SPP: u32 = 1 << 16;

impl Settings {
    /// Refuses values outside their domains.
    pub fn check(&self) -> Result<(), SettingsError> {
        let refuse = |setting, value: String, domain| Err(SettingsError::Domain { setting, value, domain });
        match self.stop {
            Stop::Spp(n) if n == 0 || n > MAX_SPP => refuse("spp", n.to_string(), "from 1 to 16777216"),
            Stop::Error(e) if !(e > 0.0 && e < 10.0) => refuse("error", e.to_string(), "above 0 and below 10"),
            Stop::Time(t) if !(t > 0.0 && t.is_finite()) => refuse("time", t.to_string(), "a positive time"),
            _ => Ok(()),
        }?;
        if let Some([w, h]) = self.size
            && (w == 0 || h == 0 || w > 32768 || h > 32768)
        {
            return refuse("size", format!("{w}x{h}"), "from 1x1 to 32768x32768");
        }
        if self.method == Method::Fem && self.max_depth != 0 {
            return Err(SettingsError::DepthOfElements(self.max_depth));
        }
        femc_layers::parse_all(&self.layers)?;
        if self.method == Method::Fem && !self.layers.is_empty() {
            return Err(SettingsError::LayersOfElements);
        }
        Ok(self.allocation.as_ref().map_or(Ok(()), Allocation::check)?)
    }

    /// Whether frames have a file of layers or features.
    pub fn has_layers(&self) -> bool {
        !self.layers.is_empty() || !self.features.is_empty()
    }

    /// The settings as an image states them: they do not tell whether it was rendered by the clock or by the division that it states.
    pub fn stated(&self) -> Self {
        Self { allocation: None, ..self.clone() }
    }

    /// Applies the overrides to a scene.
    pub fn apply(&self, scene: &mut Scene) -> Result<(), SettingsError> {
        for (selector, value) in &self.overrides {
            scene.set(selector, *value)?;
        }
        Ok(())
    }

    /// Samples a pixel at the end of each round, ascending. With [`Stop::Error`] and [`Stop::Time`] a frame may end after any; with
    /// [`Stop::Time`] only the first number and the last are certain.
    pub fn rounds(&self) -> Vec<u32> {
        match (self.stop, &self.allocation) {
            (Stop::Spp(n), _) => vec![n],
            (Stop::Time(_), Some(allocation)) => allocation.rounds(),
            (Stop::Time(_), None) => {
                (0..).map(|round| PILOT.saturating_pow(round)).take_while(|n| *n <= MAX_SPP).collect()
            }
            (Stop::Error(_), _) => {
                // 8, 12, 16, 24 ..: of halves and replicates each has as many.
                let doubled = std::iter::successors(Some(FIRST_ROUND), |n| (*n < LAST_ROUND_SPP).then_some(n * 2));
                doubled.flat_map(|n| [n, n + n / 2]).take_while(|&n| n <= LAST_ROUND_SPP).collect()
            }
        }
    }
}
