//! Painted light: a picture of a target scene in the style of a painted example, guided by light (\[fiser2016\]).
//!
//! The example has two parts. The **guides** of the source are a rendering of a source scene and layers of its light. The **style**
//! is a painting of this rendering, pixel on pixel. Given guides of a target, [`stylize`] finds a source patch for each target
//! patch such that guides are alike and neighboring patches agree in what they paint:
//!
//! ```text
//! E(p, q) = |A'(p) - B'(q)|^2 + mu |A(p) - B(q)|^2      A: guides of the source, A': style, p: a source patch
//!                                                       B: guides of the target, B': result, q: a target patch
//! ```
//!
//! Squares are summed over the pixels and channels of a patch. Search and average voting ([`PatchField::vote`]) alternate, from the
//! coarsest level of Gaussian pyramids to the finest. [`Method::Balanced`] puts a price on source patches that are used often, so
//! that the whole painting is used (module `search`). [`Method::Em`] finds the best source patch of each target patch by brute
//! force; it is the baseline.
//!
//! The result is a function of images and settings: the number of threads changes no bit. The crate does not depend on scenes or a
//! farm.
#![deny(missing_docs)]

mod basis;
mod brushwork;
mod brute;
mod channel_image;
mod error;
pub mod frames;
mod patch_field;
mod patches;
mod previous_frame;
mod quality;
mod search;
mod settings;
pub mod styles;
mod synthesis;
mod tree;

pub use brushwork::Brushwork;
pub use brute::nearest as brute_force;
pub use channel_image::ChannelImage;
pub use error::StylizeError;
pub use frames::GuideFrame;
pub use patch_field::{PatchField, PatchGrid};
pub use patches::{Patches, Weights};
pub use previous_frame::PreviousFrame;
pub use quality::QualityMetrics;
pub use search::search;
pub use settings::{Method, Settings};
pub use synthesis::{Checkpoint, Example, Progress, ProgressObserver, StylizedImage, stylize};
