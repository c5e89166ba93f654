//! What can be wrong with a scene file, each with what to do about it.

mod advice;

use advice::{blank_name, left_over, path_advice, undefined_advice};
use std::fmt;

/// A place in a source file. Line and column (in bytes) count from 1; 0 where there is none.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Position {
    /// Path relative to the scene's root.
    pub file: String,
    /// Line, from 1; 0 = the file as a whole.
    pub line: u32,
    /// Column, from 1; 0 = the whole line.
    pub column: u32,
}

impl fmt::Display for Position {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.file)?;
        if self.line > 0 {
            write!(f, ":{}", self.line)?;
        }
        if self.column > 0 {
            write!(f, ":{}", self.column)?;
        }
        Ok(())
    }
}

/// A scene that cannot be imported: where, what, and what to do. Displays as `file:line:column: what; what to do`.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{at}: {fault}")]
pub struct ImportError {
    /// File, line and column of the fault.
    pub at: Position,
    /// What is wrong there.
    pub fault: Box<Fault>,
}

impl ImportError {
    pub(crate) fn new(at: Position, fault: Fault) -> Self {
        Self { at, fault: Box::new(fault) }
    }
}

/// All errors of a scene that were found, at least one.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{}", errors[0])]
pub struct ImportErrors {
    /// In order of place.
    pub errors: Vec<ImportError>,
    /// Whether the whole scene was read: false where the number of errors or a limit on memory ended the import.
    pub complete: bool,
}

/// What a name stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// A vertex, `v`.
    Vertex,
    /// A color, `c`.
    Color,
    /// A material, `m`.
    Material,
    /// A camera.
    Camera,
    /// A participating medium.
    Medium,
    /// A motion path.
    Path,
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Vertex => "vertex",
            Self::Color => "color",
            Self::Material => "material",
            Self::Camera => "camera",
            Self::Medium => "medium",
            Self::Path => "path",
        })
    }
}

/// What is wrong.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Fault {
    /// A file is missing or cannot be read.
    #[error("cannot read `{path}`: {reason}; {}", path_advice(near.as_deref()))]
    Unreadable {
        /// The file, relative to the root.
        path: String,
        /// The system's reason.
        reason: String,
        /// Name of a file in the same folder that may be meant.
        near: Option<String>,
    },
    /// A quoted file name without its end.
    #[error("the file name has no closing double quote on this line; add it")]
    UnclosedQuote,
    /// Text directly after a quoted file name.
    #[error(
        "found `{found}` directly after the closing double quote; put a blank between them, or quote the whole name"
    )]
    AfterQuote {
        /// As written.
        found: String,
    },
    /// A file name with blanks that is not in quotes.
    #[error("{}", blank_name(entity, name, *exists))]
    BlankName {
        /// The entity.
        entity: String,
        /// The name with its blanks.
        name: String,
        /// Whether it is the name of a file.
        exists: bool,
    },
    /// An absolute path.
    #[error("`{path}` is an absolute path; give it relative to this file")]
    AbsolutePath {
        /// As written.
        path: String,
    },
    /// A path out of the scene's root folder.
    #[error("`{path}` leaves the scene's root folder; move the file below it, or choose a higher root (`--root DIR`)")]
    OutsideRoot {
        /// As written.
        path: String,
    },
    /// A scene file that is not below its root.
    #[error("this scene is not below the root folder `{root}`; choose a folder that holds the scene and all its files")]
    SceneOutsideRoot {
        /// The root, as given.
        root: String,
    },
    /// A path that some system would read differently.
    #[error("`{path}` is not a portable path: {reason}; separate folders by `/`")]
    UnportablePath {
        /// As written.
        path: String,
        /// Rule that the path breaks.
        reason: &'static str,
    },
    /// A file that includes itself, perhaps through others.
    #[error("`{path}` includes itself ({chain}); remove one of these includes")]
    IncludeCycle {
        /// The file.
        path: String,
        /// The way round.
        chain: String,
    },
    /// Too many nested includes.
    #[error("more than {limit} include levels; flatten the includes")]
    IncludeDepth {
        /// The limit.
        limit: usize,
    },
    /// Too much included text.
    #[error("the includes add up to more than {limit} {unit}; repeat geometry by an array (`xf -a`) instead")]
    IncludeVolume {
        /// The limit.
        limit: u64,
        /// Of what.
        unit: &'static str,
    },
    /// A text file beyond the limit.
    #[error("`{path}` has {size} bytes, a text file may have {limit}; split it by `i`")]
    TextTooLarge {
        /// The file.
        path: String,
        /// Its size, bytes.
        size: u64,
        /// The limit, bytes.
        limit: u64,
    },
    /// A joined line beyond the limit.
    #[error("line of more than {limit} characters (joined lines count as one); split it")]
    LineTooLong {
        /// The limit.
        limit: usize,
    },
    /// Too few or too many arguments.
    #[error("`{entity}` takes {expected}, found {found}")]
    ArgumentCount {
        /// The entity.
        entity: String,
        /// What it takes.
        expected: &'static str,
        /// How many are there.
        found: usize,
    },
    /// Text where a number should be.
    #[error("`{found}` is not a number; {expected} is needed here")]
    NotANumber {
        /// As written.
        found: String,
        /// The argument.
        expected: &'static str,
    },
    /// An infinite number or a NaN.
    #[error("{what} is not finite; write a finite number")]
    NotFinite {
        /// Of what.
        what: &'static str,
    },
    /// A number out of its domain.
    #[error("{what} is {value}; it must be {allowed}")]
    OutOfRange {
        /// Of what.
        what: &'static str,
        /// The number.
        value: f64,
        /// The domain.
        allowed: &'static str,
    },
    /// A name that stands for nothing.
    #[error("undefined {kind} `{name}`; {}", undefined_advice(*kind, name, nearest))]
    Undefined {
        /// Of what kind.
        kind: Kind,
        /// As written.
        name: String,
        /// Up to three names near to it, nearest first.
        nearest: Vec<String>,
    },
    /// A name defined twice that may be defined only once.
    #[error("{kind} `{name}` is defined already at line {line}; choose another name")]
    Redefined {
        /// Of what kind.
        kind: Kind,
        /// The name.
        name: String,
        /// Of the first definition.
        line: u32,
    },
    /// An entity that belongs in a context that is not open.
    #[error("`{entity}` outside a {kind} context; open one first: `{kind} NAME =`")]
    NoContext {
        /// The entity.
        entity: String,
        /// The context it needs.
        kind: Kind,
    },
    /// A wrong word.
    #[error("found `{found}`; expected {expected}")]
    Unexpected {
        /// As written.
        found: String,
        /// What could be here.
        expected: &'static str,
    },
    /// A closing `o` or `xf` too many.
    #[error("`{entity}` closes nothing: none is open in this file; remove it")]
    NothingToClose {
        /// `o` or `xf`.
        entity: &'static str,
    },
    /// Names nested too deep.
    #[error("objects are nested deeper than {limit} levels or 4096 characters of dotted name; close some")]
    ObjectDepth {
        /// The limit.
        limit: usize,
    },
    /// Too many primitives after expansion.
    #[error("{count} primitives after array expansion, at most {limit} are possible; use smaller arrays")]
    TooManyPrimitives {
        /// How many (saturated).
        count: u64,
        /// The limit.
        limit: u64,
    },
    /// Something else that is counted.
    #[error("too many {what}: at most {limit}; reduce them")]
    TooMany {
        /// Of what.
        what: &'static str,
        /// The limit.
        limit: u64,
    },
    /// A shape that cannot exist.
    #[error("{what}; {advice}")]
    Shape {
        /// What is wrong with it.
        what: &'static str,
        /// What to do.
        advice: &'static str,
    },
    /// Times out of order.
    #[error("time {time} does not follow {previous}; times must be strictly ascending")]
    TimeOrder {
        /// The time, s.
        time: f64,
        /// The one before it, s.
        previous: f64,
    },
    /// A file of photometry or an image that cannot be understood.
    #[error("`{path}`: {reason}; {advice}")]
    BadFile {
        /// The file.
        path: String,
        /// What is wrong with the file's content.
        reason: String,
        /// What to do.
        advice: &'static str,
    },
    /// A number of a photometric file with a decimal comma.
    #[error(
        "`{found}`: decimal commas cannot be read, as a comma separates two numbers in LM-63 files; write decimal points \
         (`0.5`), and a blank after a comma that separates"
    )]
    DecimalComma {
        /// As written.
        found: String,
    },
    /// More in a photometric file than it announces.
    #[error(
        "{} the last {last} that the file announces; correct its numbers of angles, or remove what does not belong to it",
        left_over(found, *numbers)
    )]
    LeftOver {
        /// The first field.
        found: String,
        /// Numbers that follow.
        numbers: u64,
        /// Name of the last number.
        last: &'static str,
    },
    /// A feature that is not there.
    #[error("{what} is not supported yet; {advice}")]
    Unsupported {
        /// The feature.
        what: &'static str,
        /// What to do.
        advice: &'static str,
    },
}

impl Fault {
    /// The file that cannot be used, relative to the root, where the fault is a file's and not its mention's.
    pub fn file(&self) -> Option<&str> {
        match self {
            Self::Unreadable { path, .. } | Self::TextTooLarge { path, .. } | Self::BadFile { path, .. } => Some(path),
            _ => None,
        }
    }
}
