//! Paints a render as an artist might, by program: styles to begin with where there is no artist.
//!
//! [`Sight`] is what a painter sees in a render: light, half shadow, highlight, light thrown back, forms. A style is a
//! file of `style/` with one function from that to a picture, and a line of [`STYLES`]. Everything is drawn on a
//! [`Canvas`] of twice the size, and chance comes from hashes of what is drawn, so that the same image gives the same
//! bytes everywhere.
#![deny(missing_docs)]

pub mod canvas;
pub mod chance;
pub mod guides;
pub mod outline;
pub mod sight;
pub mod style;

pub use canvas::Canvas;
pub use guides::Guides;
pub use sight::Sight;

use femc_film::Picture;

/// A style by its name, which is that of its file.
#[derive(Clone, Copy, Debug)]
pub struct Style {
    /// As in `scenes/styles/NAME.png`.
    pub name: &'static str,
    /// Paints a picture of the size of what is seen.
    pub paint: fn(&Sight) -> Picture,
}

/// All styles.
pub const STYLES: [Style; 4] = [
    Style { name: "hatching", paint: style::hatching::paint },
    Style { name: "watercolor", paint: style::watercolor::paint },
    Style { name: "oil", paint: style::oil::paint },
    Style { name: "cel", paint: style::cel::paint },
];

/// What can go wrong.
#[derive(Debug, thiserror::Error)]
pub enum PainterError {
    /// A file cannot be read, written or has not the channels.
    #[error(transparent)]
    Film(#[from] femc_film::FilmError),
    /// Two files of one frame that do not fit.
    #[error("{frame} has {found:?} pixels, and its layers have {expected:?}: render both by one command")]
    OtherSize {
        /// The frame's file.
        frame: std::path::PathBuf,
        /// Its width and height.
        found: (u32, u32),
        /// Those of the layers.
        expected: (u32, u32),
    },
    /// A frame in which nothing is seen.
    #[error("the layer `direct_diffuse` has no light at all: there is nothing to paint")]
    Dark,
}
