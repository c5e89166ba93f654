//! The film: samples of the renderer, the merge of partial results into an image, and storage and comparison of images.
//!
//! A [`Tile`] holds exact sums of the samples of its pixels (see [`tile`] for the form and its cost). Tiles of any sample ranges,
//! in any order, merge into a [`Frame`] with the same bits. A frame resolves to a [`FrameImage`] of floats, which is written as
//! OpenEXR ([`exr`]), measured against a reference ([`metrics`]), and shown through a tone curve ([`tone`]) as PNG, contact sheet
//! or animated image ([`picture`], [`animation`]).
#![deny(missing_docs)]

pub mod animation;
pub mod codec;
pub mod convergence;
pub mod error;
pub mod error_statistics;
pub mod exr;
pub mod features;
pub mod file;
pub mod filter;
pub mod frame;
pub mod image;
pub mod layers;
pub mod metrics;
pub mod picture;
pub mod piece;
pub mod pixel_error;
pub mod rect;
pub mod sample;
pub mod sampling_state;
pub mod sheet;
pub mod sums;
pub mod thumbnail;
pub mod tile;
pub mod tone;

pub use animation::Animation;
pub use convergence::{Block, BlockError, FrameError};
pub use error::FilmError;
pub use error_statistics::{ErrorStatistics, HalfBlock, TileBlock, TileErrors};
pub use exr::Provenance;
pub use features::{AovPiece, AovTile, FeatureImage, FeatureLayout, FeaturePiece, FeatureSums, FeatureTile};
pub use filter::Filter;
pub use frame::{Frame, InsertOutcome};
pub use image::{FrameImage, Image, pixel_digest};
pub use layers::{LayerImage, LayerPiece, LayerSetLight, LayerTile, LightBuffer, LightSums};
pub use metrics::{Comparison, compare_images};
pub use picture::{Picture, contact_sheet};
pub use piece::ImagePiece;
pub use pixel_error::{PixelChannels, PixelError, pixel_errors};
pub use rect::{Rect, Tiling};
pub use sample::{BadKind, BadSample, BadSamples, Sample};
pub use sampling_state::{SamplingState, TimedProgress};
pub use sheet::{SheetCell, SheetRow, labeled_sheet};
pub use thumbnail::LuminanceLevels;
pub use tile::{SampleRange, Tile};
pub use tone::ToneCurve;
