//! Extreme scenes, each compared with its known truth: `cargo run --release -p femc-tests --example stress`.
//!
//! A group is a file with one function that lists its cases. A case is a scene, a measurement and a number (or a count of faults
//! that must be 0). To add a case, extend a list. To add a group, add a file and a line of [`GROUPS`].
//!
//! Independent renderings (`measure`) compare means with the truth, with a limit of three standard errors. A mean beyond the limit
//! is measured twice again, with four times the samples and other seeds. It fails if it is too far away all three times. By
//! Student's distribution with 63 degrees of freedom, the probability of this is (0.4 %)^3 = 6e-8 per line: under 2e-5 for a table
//! of 300 lines.

mod equivalence;
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
mod slab;
mod sources;
mod spheres;
mod watertight;

pub use line::{ResultLine, Verdict};
pub use measure::{Case, Effort, MeasuredMean};

/// A group of cases.
#[derive(Clone, Copy)]
pub struct Group {
    /// Name on the command line.
    pub name: &'static str,
    /// Subject of the group.
    pub about: &'static str,
    run: fn(&Effort, &mut dyn FnMut(ResultLine)),
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
        about: "closed rooms of uniform radiance: albedo, size, radiance, field of view",
        run: furnace::run,
    },
    Group {
        name: "media",
        about: "closed rooms of uniform radiance with a medium: optical thickness, albedo, phase",
        run: media::run,
    },
    Group { name: "gloss", about: "white furnaces of rough mirrors", run: gloss::run },
    Group { name: "faces", about: "needles, faces without area, duplicate faces, coplanar faces", run: faces::run },
    Group {
        name: "lamps",
        about: "lamps compared with their form factors (T4): size, distance, intensity",
        run: lamps::run,
    },
    Group { name: "lights", about: "very many lamps, compared with their sum (T15)", run: lights::run },
    Group { name: "spheres", about: "integrating spheres (T6), spheres of gas (T7)", run: spheres::run },
    Group { name: "sources", about: "point sources in infinite media (T8, T9)", run: sources::run },
    Group { name: "slabs", about: "half spaces and slabs (T10 to T14)", run: slab::run },
    Group {
        name: "same",
        about: "the same image when scaled, moved, permuted, or rendered by other numbers of threads (T16, T17)",
        run: equivalence::run,
    },
    Group { name: "tight", about: "grazing rays through edges and vertices of closed meshes", run: watertight::run },
];

/// Returns the cases with light sources and slabs in media, by law of the algorithm brief (T8 to T14).
pub fn media_laws() -> Vec<(&'static str, Vec<Case>)> {
    [sources::laws(), slab::laws()].concat()
}

impl Group {
    /// Measures the group's cases and reports each line as soon as it is known.
    pub fn run(&self, effort: &Effort, mut report: impl FnMut(ResultLine)) {
        (self.run)(effort, &mut report);
    }
}
