//! Error recovery: reading continues after a fault, so that one import lists all errors of a scene.
//!
//! A faulty entity is skipped. The name that it should define counts as defined but faulty. Further errors of an entity that uses a
//! faulty name are dropped, because they may follow from the first. With a limit of one error, the import stops at its first fault.

use super::{
    args::{Args, Result},
    reader::Reader,
    stack::Frame,
};
use crate::{EntityKind, ImportError, ImportErrors, ImportFault, Position};
use femc_scene::{Interpolation, Location, MotionPath, Object, PathId};
use std::collections::HashMap;

/// Errors of an import so far.
#[derive(Debug)]
pub(super) struct Errors {
    /// Errors in order of reading, without duplicates.
    errors: Vec<ImportError>,
    /// Number of errors that ends the import, >= 1.
    limit: usize,
    /// Whether the current entity uses a faulty name: its further errors are dropped.
    tainted: bool,
    /// Whether a memory limit was exceeded: nothing is read after it.
    ended: bool,
    /// Whether an include was skipped. Any name may be defined in it.
    lost_include: bool,
    /// Faults of unusable files, by path.
    unusable_files: HashMap<String, ImportFault>,
}

impl Errors {
    /// Creates an empty list. The import ends with error number `limit`.
    pub fn new(limit: usize) -> Self {
        let (errors, unusable_files) = (Vec::new(), HashMap::new());
        Self { errors, limit: limit.max(1), tainted: false, ended: false, lost_include: false, unusable_files }
    }

    /// Records an error. Fails with it if it reaches the limit.
    pub fn report(&mut self, error: ImportError) -> Result<()> {
        self.tainted = true;
        let again =
            |known: &ImportError| known.fault == error.fault && (known.at == error.at || known.fault.file().is_some());
        if !self.may_follow(&error.fault) && self.errors.len() < self.limit && !self.errors.iter().any(again) {
            self.errors.push(error.clone());
        }
        if self.is_over() { Err(error) } else { Ok(()) }
    }

    /// Reports that `name` is undefined. `nearest` returns similar names.
    pub fn report_undefined(
        &mut self,
        (at, kind, name): (Position, EntityKind, &str),
        nearest: impl FnOnce() -> Vec<String>,
    ) -> Result<()> {
        // A scene may use any number of names from a skipped include, so similar names are not searched.
        let nearest = if self.lost_include { Vec::new() } else { nearest() };
        self.report(ImportError::new(at, ImportFault::Undefined { kind, name: name.to_owned(), nearest }))
    }

    /// Returns whether an error may follow from a skipped include.
    fn may_follow(&self, fault: &ImportFault) -> bool {
        self.lost_include && matches!(fault, ImportFault::Undefined { .. } | ImportFault::NoContext { .. })
    }

    /// Drops further errors of the current entity.
    pub fn taint(&mut self) {
        self.tainted = true;
    }

    /// Makes the next error end the import.
    pub fn end_at_next_error(&mut self) {
        self.ended = true;
    }

    fn is_over(&self) -> bool {
        self.ended || self.errors.len() >= self.limit
    }

    /// Returns the fault of the file `path`, if it is unusable and was reported.
    pub fn fault_of_file(&self, path: &str) -> Option<&ImportFault> {
        self.unusable_files.get(path)
    }

    /// Returns the errors in order of position, if there are any. `files` are the source files in order of first use.
    pub fn finish(self, files: &[String]) -> std::result::Result<(), ImportErrors> {
        let mut errors = self.errors;
        let complete = !(self.ended || errors.len() >= self.limit);
        let file = |at: &Position| files.iter().position(|file| *file == at.file).unwrap_or(usize::MAX);
        errors.sort_by_key(|error| (file(&error.at), error.at.line, error.at.column));
        if errors.is_empty() { Ok(()) } else { Err(ImportErrors { errors, complete }) }
    }
}

impl Reader<'_> {
    /// Processes one entity of a file. Fails only if the import ends.
    pub(super) fn process_entity(&mut self, entity: &[u8], args: &Args<'_>) -> Result<()> {
        let outer = std::mem::replace(&mut self.errors.tainted, false);
        let open = (self.frames.len(), self.objects.len());
        let outcome = match self.dispatch(entity, args) {
            Err(error) => self.recover(error, entity, args, open),
            Ok(()) => Ok(()),
        };
        if self.errors.tainted && entity != b"i" {
            self.mark_faulty(entity);
        }
        self.errors.tainted = outer;
        outcome
    }

    /// Restores the state after a faulty entity. `open` are the numbers of transforms and objects that were open before it.
    fn recover(&mut self, error: ImportError, entity: &[u8], args: &Args<'_>, open: (usize, usize)) -> Result<()> {
        let fault = error.fault.clone();
        if !self.errors.tainted || self.errors.is_over() {
            self.errors.report(error)?;
        }
        let (frames, objects) = open;
        if let Some(path) = fault.file() {
            self.errors.unusable_files.entry(path.to_owned()).or_insert_with(|| (*fault).clone());
        }
        match (*fault, entity) {
            (ImportFault::Undefined { kind: EntityKind::Path, name, .. }, _) => {
                self.define_faulty_path(&name, args.location());
            }
            (ImportFault::NoContext { kind, .. }, _) => match kind {
                EntityKind::Camera => self.cameras.define_faulty(None),
                EntityKind::Medium => self.media.define_faulty(None),
                _ => {
                    self.define_faulty_path("", args.location());
                    self.path = self.paths.get("").copied();
                }
            },
            _ => {}
        }
        let name = (args.len() > 0).then(|| args.text(0));
        match entity {
            b"v" => self.vertices.define_faulty(name.as_deref()),
            b"c" => self.colors.define_faulty(name.as_deref()),
            b"m" => self.materials.define_faulty(name.as_deref()),
            b"camera" => self.cameras.define_faulty(name.as_deref()),
            b"medium" => self.media.define_faulty(name.as_deref()),
            b"path" => {
                let name = name.unwrap_or_default();
                if !self.paths.contains_key(&*name) {
                    self.define_faulty_path(&name, args.location());
                }
                self.path = self.paths.get(&*name).copied();
            }
            b"i" => self.errors.lost_include = true,
            b"xf" if args.len() > 0 && self.frames.len() == frames => {
                let frame = Frame::with_transform_of(self.frame(), args.entity_position());
                self.frames.push(frame);
                return Ok(());
            }
            b"o" if args.len() > 0 && self.objects.len() == objects => {
                let id = self.add_object(Object { name: String::new(), parent: None, hidden: false }, None);
                self.objects.push((id, args.location()));
            }
            _ => {}
        }
        // These are transforms of `i` and `ies` themselves.
        while self.frames.len() > frames {
            // If this exceeds a limit, the next error ends the import.
            let _ = self.pop_frame();
        }
        Ok(())
    }

    /// Marks the context that a failed entity should have changed.
    fn mark_faulty(&mut self, entity: &[u8]) {
        match entity {
            b"p" | b"n" | b"uv" => self.vertices.mark_faulty(),
            b"cxy" | b"cspec" | b"cct" | b"cmix" | b"crgb" => self.colors.mark_faulty(),
            b"origin" | b"target" | b"up" | b"fov" | b"film" | b"lens" | b"shutter" | b"along" => {
                self.cameras.mark_faulty();
            }
            b"key" => self.faulty_paths.extend(self.path),
            _ => {}
        }
    }

    /// Defines the path `name` without keys.
    fn define_faulty_path(&mut self, name: &str, location: Location) {
        let id = PathId(self.scene.paths.len() as u32);
        let (name, interpolation) = (name.to_owned(), Interpolation::Linear);
        self.scene.paths.push(MotionPath { name: name.clone(), location, interpolation, keys: vec![] });
        self.paths.insert(name, id);
        self.faulty_paths.insert(id);
    }
}
