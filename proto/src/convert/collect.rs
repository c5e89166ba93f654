//! Requests and replies of a garbage collection.

use super::{ConvertError, each, need};
use crate::server::{CollectMode, Collected, Volume};
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

impl From<Volume> for wire::collect_reply::Volume {
    fn from(Volume { artifacts, bytes }: Volume) -> Self {
        Self { artifacts, bytes }
    }
}

impl From<wire::collect_reply::Volume> for Volume {
    fn from(wire::collect_reply::Volume { artifacts, bytes }: wire::collect_reply::Volume) -> Self {
        Self { artifacts, bytes }
    }
}

impl From<Collected> for wire::CollectReply {
    fn from(collected: Collected) -> Self {
        let Collected { referenced, young, garbage, names } = collected;
        let [referenced, young, garbage] = [referenced, young, garbage].map(|volume| Some(volume.into()));
        Self { referenced, young, garbage, names: names.into_iter().map(Into::into).collect() }
    }
}

impl TryFrom<wire::CollectReply> for Collected {
    type Error = ConvertError;

    fn try_from(wire: wire::CollectReply) -> Result<Self, ConvertError> {
        Ok(Self {
            referenced: need("collect.referenced", wire.referenced)?.into(),
            young: need("collect.young", wire.young)?.into(),
            garbage: need("collect.garbage", wire.garbage)?.into(),
            names: each(wire.names)?,
        })
    }
}
