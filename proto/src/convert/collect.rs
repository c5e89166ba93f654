//! Requests and replies of a garbage collection.

use super::{ConvertError, convert_all, required};
use crate::server::{ArtifactTotals, CollectMode, CollectReport};
use crate::wire;

impl From<CollectMode> for wire::CollectMode {
    fn from(mode: CollectMode) -> Self {
        match mode {
            CollectMode::DryRun => Self::DryRun,
            CollectMode::Remove => Self::Remove,
        }
    }
}

pub(crate) fn collect_mode(value: i32) -> Result<CollectMode, ConvertError> {
    let unknown = ConvertError::Unknown { field: "collect.mode", value };
    match wire::CollectMode::try_from(value) {
        Ok(wire::CollectMode::DryRun) => Ok(CollectMode::DryRun),
        Ok(wire::CollectMode::Remove) => Ok(CollectMode::Remove),
        Ok(wire::CollectMode::Unspecified) | Err(_) => Err(unknown),
    }
}

impl From<ArtifactTotals> for wire::collect_reply::Volume {
    fn from(ArtifactTotals { artifacts, bytes }: ArtifactTotals) -> Self {
        Self { artifacts, bytes }
    }
}

impl From<wire::collect_reply::Volume> for ArtifactTotals {
    fn from(wire::collect_reply::Volume { artifacts, bytes }: wire::collect_reply::Volume) -> Self {
        Self { artifacts, bytes }
    }
}

impl From<CollectReport> for wire::CollectReply {
    fn from(report: CollectReport) -> Self {
        let CollectReport { referenced, young, garbage, names } = report;
        let [referenced, young, garbage] = [referenced, young, garbage].map(|volume| Some(volume.into()));
        Self { referenced, young, garbage, names: names.into_iter().map(Into::into).collect() }
    }
}

impl TryFrom<wire::CollectReply> for CollectReport {
    type Error = ConvertError;

    fn try_from(wire: wire::CollectReply) -> Result<Self, ConvertError> {
        Ok(Self {
            referenced: required("collect.referenced", wire.referenced)?.into(),
            young: required("collect.young", wire.young)?.into(),
            garbage: required("collect.garbage", wire.garbage)?.into(),
            names: convert_all(wire.names)?,
        })
    }
}
