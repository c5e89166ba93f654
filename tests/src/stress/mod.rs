//! Scenes at the edges of what a scene may be, each beside what is true of it: `cargo run --release -p femc-tests --example stress`.
//!
//! A group is a file with one function that lists its cases; a case is a scene, a measurement and a number (or a count of faults
//! that must be 0). To add a case, add one to a list; to add a group, a file and a line of [`GROUPS`].
//!
//! Means are held against the truth by independent renderings (`measure`): three standard errors. What is farther away is
//! measured twice again, with four times the samples and from other seeds, and fails when it is too far away all three times. By Student's
//! distribution with 63 degrees of freedom that is a chance of (0.4 %)^3 = 6e-8 a line: under 2e-5 for a table of 300 lines.

mod faces;
mod furnace;
mod gloss;
mod lamps;
mod lights;
mod line;
mod measure;
mod media;
mod peaks;
mod quadrature;
mod room;
mod same;
mod slab;
mod sources;
mod spheres;
mod tight;

pub use line::{Line, Verdict};
pub use measure::{Case, Effort, Measured};

/// A list of lines.
#[derive(Clone, Copy)]
pub struct Group {
    /// Word by which it is chosen.
    pub name: &'static str,
    /// What it is about.
    pub about: &'static str,
    run: fn(&Effort, &mut dyn FnMut(Line)),
}

/// All groups, in the order of the table.
pub const GROUPS: &[Group] = &[
    Group {
        name: "peaks",
        about: "phase functions that are nearly a delta, and lamps as small as their peaks",
        run: peaks::run,
    },
    Group {
        name: "furnace",
        about: "closed rooms of one radiance: albedo, size, radiance, field of view",
        run: furnace::run,
    },
    Group {
        name: "media",
        about: "closed rooms of one radiance, filled: optical thickness, albedo, phase",
        run: media::run,
    },
    Group { name: "gloss", about: "white furnaces of rough mirrors", run: gloss::run },
    Group { name: "faces", about: "needles, faces without area, faces twice, faces in one plane", run: faces::run },
    Group { name: "lamps", about: "lamps by their form factors (T4): size, distance, intensity", run: lamps::run },
    Group { name: "lights", about: "very many lamps, beside their sum (T15)", run: lights::run },
    Group { name: "spheres", about: "integrating spheres (T6), spheres of gas (T7)", run: spheres::run },
    Group { name: "sources", about: "point sources in endless media (T8, T9)", run: sources::run },
    Group { name: "slabs", about: "half spaces and slabs (T10 to T14)", run: slab::run },
    Group {
        name: "same",
        about: "scaled, moved, permuted, by other threads: the same image (T16, T17)",
        run: same::run,
    },
    Group { name: "tight", about: "grazing rays through edges and vertices of closed meshes", run: tight::run },
];

impl Group {
    /// Measures the group's cases and tells each line as soon as it is known.
    pub fn run(&self, effort: &Effort, mut tell: impl FnMut(Line)) {
        (self.run)(effort, &mut tell);
    }
}
