//! The targets of a frame as a JSON document: workers that render the frame read it, and so do viewers.
//!
//! Positions are relative to the origin of the prepared frame. Numbers come back to the bit.

use crate::learn::{Learned, packs};
use femc_field::{Ball, Field, PACK_TARGETS, Parallelogram, RegionTargets, Target, TargetGuide};
use femc_math::glam::{DVec3, Vec3A};
use serde::{Deserialize, Serialize};

/// Format of the document, with its version.
const FORMAT: &str = "femc targets 1";

/// Targets of a frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TargetDocument {
    /// Format and version: `femc targets 1`.
    pub format: String,
    /// World position of the origin of all positions, m.
    pub origin: [f64; 3],
    /// Number of pilot paths.
    pub paths: u32,
    /// Number of their rays.
    pub rays: u64,
    /// Targets: openings, then bright patches.
    pub targets: Vec<TargetRecord>,
    /// Targets, or parts of them, toward which paths are sampled, at most 8.
    pub parts: Vec<TargetShape>,
    /// Regions of surfaces.
    pub regions: Vec<RegionRecord>,
    /// Runs of leaves of the first pass with the same region: number of leaves, and index of the region.
    pub leaf_regions: Vec<[u32; 2]>,
}

/// A target and the light that it brings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TargetRecord {
    /// Kind of the target.
    pub kind: TargetKind,
    /// Share of the indirect light of the picture that passes through the opening, or comes from the patch, in 0..1.
    pub light: f32,
    /// Shape of the target.
    #[serde(flatten)]
    pub shape: TargetShape,
}

/// Kind of a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TargetKind {
    /// A gap through which light comes.
    Opening,
    /// A place from which much light comes.
    Patch,
}

/// Shape of a target.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "kebab-case")]
pub enum TargetShape {
    /// A parallelogram.
    Parallelogram {
        /// Corner, m.
        corner: [f32; 3],
        /// Edges from the corner, m.
        edges: [[f32; 3]; 2],
    },
    /// A ball.
    Ball {
        /// Center, m.
        center: [f32; 3],
        /// Radius, m.
        radius: f32,
    },
}

/// Targets of a region.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RegionRecord {
    /// Shares of the directions to sample toward each part, in [0, 1).
    pub shares: [f32; PACK_TARGETS],
    /// Ratio of the light of the region to that of the first pass, positive.
    pub light_scale: f32,
}

/// Reason why a document has no targets for a frame.
#[derive(Debug, thiserror::Error)]
pub enum TargetError {
    /// The bytes are not such a document.
    #[error("damaged targets: {0}")]
    Json(#[from] serde_json::Error),
    /// The format or its version is another one.
    #[error("the targets have format {0:?}, but this program reads format {FORMAT:?}")]
    Format(String),
    /// The frame has no light of a first pass.
    #[error("the frame of the targets has no first pass")]
    NoFirstPass,
    /// The targets belong to another first pass: the number of leaves differs.
    #[error("the targets belong to another first pass than the frame's")]
    Leaves,
    /// A value is outside of its range.
    #[error("invalid targets: {0}")]
    Value(&'static str),
}

impl From<Target> for TargetShape {
    fn from(target: Target) -> Self {
        match target {
            Target::Parallelogram(Parallelogram { corner, edges }) => {
                Self::Parallelogram { corner: corner.into(), edges: edges.map(Into::into) }
            }
            Target::Ball(Ball { center, radius }) => Self::Ball { center: center.into(), radius },
        }
    }
}

impl From<TargetShape> for Target {
    fn from(shape: TargetShape) -> Self {
        match shape {
            TargetShape::Parallelogram { corner, edges } => {
                Parallelogram { corner: Vec3A::from(corner), edges: edges.map(Vec3A::from) }.into()
            }
            TargetShape::Ball { center, radius } => Ball { center: Vec3A::from(center), radius }.into(),
        }
    }
}

impl TargetDocument {
    /// Creates the document of learned targets.
    /// - `origin`: world position of the prepared frame's origin, m.
    pub fn new(learned: &Learned, origin: DVec3) -> Self {
        let openings = learned.openings.iter().map(|it| (TargetKind::Opening, it.target.into()));
        let patches = learned.patches.iter().map(|it| (TargetKind::Patch, it.target));
        let targets = openings.chain(patches).zip(&learned.light);
        let targets = targets.map(|((kind, target), &light)| TargetRecord { kind, light, shape: target.into() });
        let runs = learned.region_by_leaf.chunk_by(|a, b| a == b);
        Self {
            format: FORMAT.into(),
            origin: origin.into(),
            paths: learned.paths,
            rays: learned.rays,
            targets: targets.collect(),
            parts: learned.parts.iter().map(|&part| part.into()).collect(),
            regions: learned.by_region.iter().map(RegionRecord::from).collect(),
            leaf_regions: runs.map(|run| [run.len() as u32, run[0]]).collect(),
        }
    }

    /// Encodes the document.
    pub fn encode(&self) -> Result<Vec<u8>, TargetError> {
        Ok(serde_json::to_vec(self)?)
    }

    /// Decodes and checks a document.
    pub fn decode(bytes: &[u8]) -> Result<Self, TargetError> {
        let document: Self = serde_json::from_slice(bytes)?;
        if document.format != FORMAT {
            return Err(TargetError::Format(document.format));
        }
        document.check().map(|()| document)
    }

    /// Checks that all values are in their ranges.
    fn check(&self) -> Result<(), TargetError> {
        let check = |is_sound, error| if is_sound { Ok(()) } else { Err(TargetError::Value(error)) };
        check(self.parts.len() <= PACK_TARGETS, "more than 8 parts")?;
        check(self.origin.iter().all(|at| at.is_finite()), "the origin is not finite")?;
        let shapes = self.targets.iter().map(|it| &it.shape).chain(&self.parts);
        check(shapes.into_iter().all(TargetShape::is_finite), "a shape is not finite")?;
        let are_shares = |shares: &[f32; PACK_TARGETS]| {
            shares.iter().all(|share| (0.0..1.0).contains(share)) && shares.iter().sum::<f32>() < 1.0
        };
        check(self.regions.iter().all(|it| are_shares(&it.shares)), "the shares of a region are not in [0, 1)")?;
        let is_scale = |it: &RegionRecord| it.light_scale > 0.0 && it.light_scale.is_finite();
        check(self.regions.iter().all(is_scale), "the light of a region is not positive")?;
        let regions = self.regions.len();
        check(self.leaf_regions.iter().all(|it| (it[1] as usize) < regions), "a leaf has no region")
    }

    /// Returns the guide of paths by the targets.
    /// - `field`: field of the frame;
    /// - errors: the leaves of the field are others.
    pub fn guide(&self, field: &Field) -> Result<TargetGuide, TargetError> {
        let leaves: u64 = self.leaf_regions.iter().map(|run| u64::from(run[0])).sum();
        if leaves != field.leaves.len() as u64 {
            return Err(TargetError::Leaves);
        }
        let parts: Vec<Target> = self.parts.iter().map(|&part| part.into()).collect();
        let by_leaf = self.leaf_regions.iter().flat_map(|&[count, region]| std::iter::repeat_n(region, count as usize));
        let by_leaf: Vec<u32> = by_leaf.collect();
        let by_region = self.regions.iter().map(RegionTargets::from).collect();
        Ok(TargetGuide::new(field, packs(&parts), by_region, &by_leaf))
    }
}

impl TargetShape {
    /// Returns the center, m.
    pub fn center(&self) -> [f32; 3] {
        match *self {
            Self::Parallelogram { corner, edges: [a, b] } => {
                [0, 1, 2].map(|axis| corner[axis] + (a[axis] + b[axis]) * 0.5)
            }
            Self::Ball { center, .. } => center,
        }
    }

    fn is_finite(&self) -> bool {
        let finite = |values: &[f32]| values.iter().all(|value| value.is_finite());
        match self {
            Self::Parallelogram { corner, edges } => finite(corner) && finite(edges.as_flattened()),
            Self::Ball { center, radius } => finite(center) && radius.is_finite(),
        }
    }
}

impl From<&RegionTargets> for RegionRecord {
    fn from(region: &RegionTargets) -> Self {
        Self { shares: region.shares, light_scale: region.light_scale }
    }
}

impl From<&RegionRecord> for RegionTargets {
    fn from(region: &RegionRecord) -> Self {
        Self { pack: 0, shares: region.shares, light_scale: region.light_scale }
    }
}
