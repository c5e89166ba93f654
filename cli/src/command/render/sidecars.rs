//! Files beside a frame's picture: light statistics, layers and readings of light. A frame that is only measured has the document of
//! its readings instead of a picture.

use crate::command::client::FarmClient;
use crate::command::readings::{self, readings_path, table_path};
use crate::exit::{Failure, failed};
use femc_model::FrameRecord;
use femc_pipeline::Settings;
use std::path::{Path, PathBuf};

/// Returns the path of a frame's light statistics.
pub fn statistics_path(path: &Path) -> PathBuf {
    path.with_extension("paths")
}

/// Returns the path of a frame's layers.
pub fn layers_path(path: &Path) -> PathBuf {
    path.with_extension("layers.exr")
}

/// Kinds of files that the frames have beside their pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SidecarKinds {
    statistics: bool,
    layers: bool,
    readings: bool,
}

impl SidecarKinds {
    /// Returns the kinds for frames with these settings.
    pub fn from_settings(settings: &Settings) -> Self {
        let has_picture = !settings.measure_only;
        Self {
            statistics: has_picture && settings.statistics,
            layers: has_picture && settings.has_layers(),
            readings: settings.measure.is_some(),
        }
    }

    /// Returns the paths of the files beside a picture.
    pub fn paths(self, path: &Path) -> impl Iterator<Item = PathBuf> {
        let statistics = self.statistics.then(|| statistics_path(path));
        let readings = self.readings.then(|| [table_path(path), readings_path(path)]);
        statistics.into_iter().chain(self.layers.then(|| layers_path(path))).chain(readings.into_iter().flatten())
    }

    /// Returns whether all of these files exist.
    pub fn all_exist(self, path: &Path) -> bool {
        self.paths(path).all(|file| file.is_file())
    }
}

/// Contents of the files beside the picture of one frame.
#[derive(Debug, Default)]
pub struct Sidecars {
    statistics: Option<Vec<u8>>,
    layers: Option<Vec<u8>>,
    readings: Option<Vec<u8>>,
}

impl Sidecars {
    /// Fetches the files from a farm; `None`: one of them is damaged or gone.
    pub async fn fetch(farm: &FarmClient, record: &FrameRecord) -> Result<Option<Self>, Failure> {
        let mut sidecars = Self::default();
        let wanted = [
            (record.statistics(), &mut sidecars.statistics),
            (record.layers(), &mut sidecars.layers),
            (record.readings(), &mut sidecars.readings),
        ];
        for (artifact, place) in wanted {
            if let Some(artifact) = artifact {
                *place = farm.get_if_present(&artifact).await?;
                if place.is_none() {
                    return Ok(None);
                }
            }
        }
        Ok(Some(sidecars))
    }

    /// Writes the files beside a picture. They must be written before the picture, so that a picture always has them.
    pub fn write(&self, path: &Path) -> Result<(), Failure> {
        let files = [(&self.statistics, statistics_path(path)), (&self.layers, layers_path(path))];
        for (bytes, file) in files {
            if let Some(bytes) = bytes {
                femc_film::file::write_atomic(&file, bytes).map_err(failed)?;
            }
        }
        self.readings.as_ref().map_or(Ok(()), |bytes| readings::write(path, bytes))
    }
}
