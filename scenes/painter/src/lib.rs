//! Paints a render in the manner of an artist: default styles for users without an artist.
//!
//! [`RenderView`] is the painter's view of a render: light, half shadow, highlight, bounced light, forms. A style is a file of
//! `style/` with one function from that to a picture, and a line of [`STYLES`]. Everything is drawn on a [`Canvas`] of twice the
//! size. Random numbers come from hashes of the drawn objects, so that equal images give equal bytes on every machine.
#![deny(missing_docs)]

pub mod canvas;
pub mod guides;
pub mod outline;
pub mod random;
pub mod render_view;
pub mod style;

pub use canvas::Canvas;
pub use guides::Guides;
pub use render_view::RenderView;

use femc_film::Picture;

/// A style. Its name is that of its file.
#[derive(Clone, Copy, Debug)]
pub struct Style {
    /// Name, as in `scenes/styles/NAME.png`.
    pub name: &'static str,
    /// Function that paints a picture of the size of the render.
    pub paint: fn(&RenderView) -> Picture,
}

/// All styles.
pub const STYLES: [Style; 4] = [
    Style { name: "hatching", paint: style::hatching::paint },
    Style { name: "watercolor", paint: style::watercolor::paint },
    Style { name: "oil", paint: style::oil::paint },
    Style { name: "cel", paint: style::cel::paint },
];

/// Error of the painter.
#[derive(Debug, thiserror::Error)]
pub enum PainterError {
    /// A file cannot be read or written, or lacks channels.
    #[error(transparent)]
    Film(#[from] femc_film::FilmError),
    /// Two files of one frame with different sizes.
    #[error("{frame} has {found:?} pixels, but its layers have {expected:?}: render both with one command")]
    OtherSize {
        /// File of the frame.
        frame: std::path::PathBuf,
        /// Width and height of the frame.
        found: (u32, u32),
        /// Width and height of the layers.
        expected: (u32, u32),
    },
    /// A frame without direct light.
    #[error("the layer `direct_diffuse` contains no light, so there is nothing to paint")]
    Dark,
}
