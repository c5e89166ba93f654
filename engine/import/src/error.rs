//! Errors of a scene file, each with advice.

mod advice;

use advice::{blank_name, left_over, path_advice, undefined_advice};
use std::fmt;

/// A position in a source file. Line and column (in bytes) count from 1; 0 means none.
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

/// An error of a scene that cannot be imported. Displays as `file:line:column: fault; advice`.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{at}: {fault}")]
pub struct ImportError {
    /// File, line and column of the fault.
    pub at: Position,
    /// Kind of the fault, with its details.
    pub fault: Box<ImportFault>,
}

impl ImportError {
    pub(crate) fn new(at: Position, fault: ImportFault) -> Self {
        Self { at, fault: Box::new(fault) }
    }
}

/// Errors found in a scene, at least one.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{}", errors[0])]
pub struct ImportErrors {
    /// Errors in order of position.
    pub errors: Vec<ImportError>,
    /// Whether the whole scene was read. False if the number of errors or a memory limit ended the import.
    pub complete: bool,
}

/// Kind of a named entity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum EntityKind {
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

impl fmt::Display for EntityKind {
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

/// A fault of a scene file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ImportFault {
    /// A file that is missing or cannot be read.
    #[error("cannot read `{path}`: {reason}; {}", path_advice(near.as_deref()))]
    Unreadable {
        /// Path of the file, relative to the root.
        path: String,
        /// Reason given by the system.
        reason: String,
        /// Name of a file in the same folder that may be meant.
        near: Option<String>,
    },
    /// A quoted file name without a closing quote.
    #[error("the file name has no closing double quote on this line; add it")]
    UnclosedQuote,
    /// Text directly after a quoted file name.
    #[error(
        "found `{found}` directly after the closing double quote; put a space between them, or quote the whole name"
    )]
    AfterQuote {
        /// Text as written.
        found: String,
    },
    /// An unquoted file name with blanks.
    #[error("{}", blank_name(entity, name, *exists))]
    BlankName {
        /// Name of the entity.
        entity: String,
        /// Name with its blanks.
        name: String,
        /// Whether a file with this name exists.
        exists: bool,
    },
    /// An absolute path.
    #[error("`{path}` is an absolute path; give it relative to this file")]
    AbsolutePath {
        /// Path as written.
        path: String,
    },
    /// A path that leaves the scene's root folder.
    #[error("`{path}` leaves the scene's root folder; move the file below it, or choose a higher root (`--root DIR`)")]
    OutsideRoot {
        /// Path as written.
        path: String,
    },
    /// A scene file that is not below its root folder.
    #[error("this scene is not below the root folder `{root}`; choose a folder that holds the scene and all its files")]
    SceneOutsideRoot {
        /// The root, as given.
        root: String,
    },
    /// A path that some systems interpret differently.
    #[error("`{path}` is not a portable path: {reason}; separate folders with `/`")]
    UnportablePath {
        /// Path as written.
        path: String,
        /// Rule that the path violates.
        reason: &'static str,
    },
    /// A file that includes itself, directly or through other files.
    #[error("`{path}` includes itself ({chain}); remove one of these includes")]
    IncludeCycle {
        /// Path of the file.
        path: String,
        /// Cycle of includes.
        chain: String,
    },
    /// Too many nested includes.
    #[error("includes are nested deeper than {limit} levels; flatten them")]
    IncludeDepth {
        /// The limit.
        limit: usize,
    },
    /// Too much included text.
    #[error("the includes add up to more than {limit} {unit}; repeat geometry with an array (`xf -a`) instead")]
    IncludeVolume {
        /// The limit.
        limit: u64,
        /// Unit of the limit.
        unit: &'static str,
    },
    /// A text file larger than the limit.
    #[error("`{path}` has {size} bytes; the limit for text files is {limit} bytes; split it with `i`")]
    TextTooLarge {
        /// Path of the file.
        path: String,
        /// Size, bytes.
        size: u64,
        /// Limit, bytes.
        limit: u64,
    },
    /// A joined line longer than the limit.
    #[error("the line has more than {limit} characters (joined lines count as one); split it")]
    LineTooLong {
        /// The limit.
        limit: usize,
    },
    /// Too few or too many arguments.
    #[error("`{entity}` takes {expected}, found {found}")]
    ArgumentCount {
        /// Name of the entity.
        entity: String,
        /// Expected arguments.
        expected: &'static str,
        /// Number of arguments found.
        found: usize,
    },
    /// Text in place of a number.
    #[error("`{found}` is not a number; expected a number: {expected}")]
    NotANumber {
        /// Text as written.
        found: String,
        /// Name of the argument.
        expected: &'static str,
    },
    /// An infinite number or a NaN.
    #[error("{what} is not finite; write a finite number")]
    NotFinite {
        /// Name of the number.
        what: &'static str,
    },
    /// A number outside its domain.
    #[error("{what} is {value}; it must be {allowed}")]
    OutOfRange {
        /// Name of the number.
        what: &'static str,
        /// The number.
        value: f64,
        /// The domain.
        allowed: &'static str,
    },
    /// An undefined name.
    #[error("undefined {kind} `{name}`; {}", undefined_advice(*kind, name, nearest))]
    Undefined {
        /// Kind of the name.
        kind: EntityKind,
        /// Name as written.
        name: String,
        /// Up to three similar names, nearest first.
        nearest: Vec<String>,
    },
    /// A second definition of a name that may be defined only once.
    #[error("{kind} `{name}` is already defined at line {line}; choose another name")]
    Redefined {
        /// Kind of the name.
        kind: EntityKind,
        /// The name.
        name: String,
        /// Line of the first definition.
        line: u32,
    },
    /// An entity outside the context that it needs.
    #[error("`{entity}` outside a {kind} context; open one first: `{kind} NAME =`")]
    NoContext {
        /// Name of the entity.
        entity: String,
        /// Kind of context that it needs.
        kind: EntityKind,
    },
    /// An unexpected word.
    #[error("found `{found}`; expected {expected}")]
    Unexpected {
        /// Word as written.
        found: String,
        /// Expected words.
        expected: &'static str,
    },
    /// A closing `o` or `xf` that closes nothing.
    #[error("`{entity}` closes nothing: nothing is open in this file; remove it")]
    NothingToClose {
        /// `o` or `xf`.
        entity: &'static str,
    },
    /// Objects nested too deep.
    #[error(
        "objects are nested deeper than {limit} levels, or their dotted name is longer than 4096 characters; close some"
    )]
    ObjectDepth {
        /// The limit.
        limit: usize,
    },
    /// Too many primitives after array expansion.
    #[error("the scene has {count} primitives after array expansion; the limit is {limit}; use smaller arrays")]
    TooManyPrimitives {
        /// Number of primitives (saturated).
        count: u64,
        /// The limit.
        limit: u64,
    },
    /// Too many of another counted item.
    #[error("too many {what}: at most {limit}; reduce them")]
    TooMany {
        /// Name of the item.
        what: &'static str,
        /// The limit.
        limit: u64,
    },
    /// An impossible shape.
    #[error("{what}; {advice}")]
    Shape {
        /// Description of the fault.
        what: &'static str,
        /// Advice.
        advice: &'static str,
    },
    /// Times out of order.
    #[error("time {time} is not later than {previous}; times must be strictly ascending")]
    TimeOrder {
        /// The time, s.
        time: f64,
        /// Preceding time, s.
        previous: f64,
    },
    /// A photometric file or an image that cannot be decoded.
    #[error("`{path}`: {reason}; {advice}")]
    BadFile {
        /// Path of the file.
        path: String,
        /// Fault of the file's content.
        reason: String,
        /// Advice.
        advice: &'static str,
    },
    /// A number with a decimal comma in a photometric file.
    #[error(
        "`{found}`: decimal commas are not supported, because a comma separates two numbers in LM-63 files; write decimal \
         points (`0.5`), and a space after a separating comma"
    )]
    DecimalComma {
        /// Number as written.
        found: String,
    },
    /// More data in a photometric file than it announces.
    #[error(
        "{} the last {last} that the file announces; correct its numbers of angles, or remove the extra data",
        left_over(found, *numbers)
    )]
    LeftOver {
        /// First extra field.
        found: String,
        /// Number of extra numbers.
        numbers: u64,
        /// Name of the last expected number.
        last: &'static str,
    },
    /// An unsupported feature.
    #[error("{what} is not supported yet; {advice}")]
    Unsupported {
        /// Name of the feature.
        what: &'static str,
        /// Advice.
        advice: &'static str,
    },
}

impl ImportFault {
    /// Returns the file that cannot be used, relative to the root, if the fault is in the file and not in the place that names it.
    pub fn file(&self) -> Option<&str> {
        match self {
            Self::Unreadable { path, .. } | Self::TextTooLarge { path, .. } | Self::BadFile { path, .. } => Some(path),
            _ => None,
        }
    }
}
