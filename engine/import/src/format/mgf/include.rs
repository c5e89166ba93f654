//! Source files: reading, caching, nesting.

use super::{
    args::{Args, Result},
    lexer::{Lexer, MAX_LINE},
    reader::Reader,
};
use crate::{FileSource, ImportError, ImportFault, Position, WarningKind, files, text};
use std::sync::Arc;

/// Maximum depth of nested files.
const MAX_DEPTH: usize = 64;
/// Maximum number of includes in a scene. Nesting alone would allow 2^64.
const MAX_INCLUDES: u64 = 1_000_000;
/// Maximum size of a scene's text, counting repeated includes, bytes.
const MAX_VOLUME: u64 = 4 << 30;
/// Maximum number of arguments that are joined to one file name with blanks.
const MAX_PARTS: usize = 16;
/// Maximum size of a text file, bytes.
pub(super) const MAX_TEXT: u64 = 256 << 20;

/// A file being read.
pub(super) struct OpenFile {
    pub path: String,
    /// Number of transforms open when the file began.
    pub frames: usize,
    /// Number of objects open when the file began.
    pub objects: usize,
}

/// Returns the fault of a file that cannot be read.
pub(super) fn unreadable(files: &dyn FileSource, path: &str, reason: &std::io::Error) -> ImportFault {
    ImportFault::Unreadable {
        path: path.to_owned(),
        reason: reason.to_string(),
        near: files::similar_name(files, path),
    }
}

impl Reader<'_> {
    /// Reads `i path [xf args]`.
    pub(super) fn i(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(1.., "a path and transform arguments")?;
        let path = self.resolve(args)?;
        if args.len() == 1 {
            return self.read_file(&path, args.argument_at(0));
        }
        self.push_frame(args, 1)?;
        self.read_file(&path, args.argument_at(0))?;
        self.pop_frame()
    }

    /// Returns the path, from the root, of the file that the first argument names. Warns once per file outside the scene's folder.
    pub(super) fn resolve(&mut self, args: &Args<'_>) -> Result<String> {
        args.check_quotes()?;
        let resolved = files::resolve(args.file, &args.text(0));
        if let Ok(path) = &resolved
            && let Some(fault) = self.errors.fault_of_file(path).cloned()
        {
            // The fault is already listed.
            self.errors.taint();
            return Err(args.fault_at(0, fault));
        }
        self.check_blanks(args, resolved.as_deref().ok())?;
        let path = resolved.map_err(|fault| args.fault_at(0, fault))?;
        if !path.starts_with(&self.folder) && self.reported_outside.insert(path.clone()) {
            self.warnings.push(args.argument_at(0), WarningKind::OutsideFolder { path: path.clone() });
        }
        Ok(path)
    }

    /// Fails if the arguments are parts of an unquoted file name with blanks: either a file with the joined name exists, or the
    /// text after the first part cannot be an option.
    /// - `path`: path of the first argument, if it is valid.
    fn check_blanks(&self, args: &Args<'_>, path: Option<&str>) -> Result<()> {
        let is_there = |path: &str| self.texts.contains_key(path) || self.files.size(path).is_ok();
        let may_be_option = args.raw(1).first().is_none_or(|&byte| byte == b'-');
        if args.is_quoted() || args.len() < 2 || may_be_option && path.is_some_and(is_there) {
            return Ok(());
        }
        let parts = args.len().min(MAX_PARTS);
        let is_file = |name: &String| files::resolve(args.file, name).is_ok_and(|path| is_there(&path));
        let name = (2..=parts).rev().map(|n| args.joined(n)).find(is_file);
        let entity = args.entity().into_owned();
        match name {
            Some(name) => Err(args.fault_at(0, ImportFault::BlankName { entity, name, exists: true })),
            None if may_be_option => Ok(()),
            None => {
                let parts = (1..parts).find(|&i| args.raw(i).starts_with(b"-")).unwrap_or(parts);
                let name = args.joined(parts);
                Err(args.fault_at(0, ImportFault::BlankName { entity, name, exists: false }))
            }
        }
    }

    /// Returns the transforms and objects that were open when the current file began.
    pub(super) fn current_file(&self) -> &OpenFile {
        self.open_files.last().expect("entities come from an open file")
    }

    /// Reads the file `path`, which is named at `named_at`.
    pub(super) fn read_file(&mut self, path: &str, named_at: Position) -> Result<()> {
        if let Some(first) = self.open_files.iter().position(|file| file.path == path) {
            let chain =
                self.open_files[first..].iter().map(|file| file.path.as_str()).chain([path]).collect::<Vec<_>>();
            return Err(ImportError::new(
                named_at,
                ImportFault::IncludeCycle { path: path.into(), chain: chain.join(" > ") },
            ));
        }
        if self.open_files.len() > MAX_DEPTH {
            return Err(ImportError::new(named_at, ImportFault::IncludeDepth { limit: MAX_DEPTH }));
        }
        let text = self.text(path).map_err(|fault| ImportError::new(named_at.clone(), fault))?;
        self.includes += 1;
        self.included_bytes += text.len() as u64;
        if self.includes > MAX_INCLUDES {
            self.errors.end_at_next_error();
            return Err(ImportError::new(named_at, ImportFault::IncludeVolume { limit: MAX_INCLUDES, unit: "files" }));
        }
        if self.included_bytes > MAX_VOLUME {
            self.errors.end_at_next_error();
            return Err(ImportError::new(named_at, ImportFault::IncludeVolume { limit: MAX_VOLUME, unit: "bytes" }));
        }
        let index = self.file_index(path);
        self.open_files.push(OpenFile { path: path.into(), frames: self.frames.len(), objects: self.objects.len() });
        let (mut lexer, mut tokens) = (Lexer::new(&text), Vec::new());
        loop {
            match lexer.next_line(&mut tokens) {
                Ok(true) => self.process_entity(tokens[0].text, &Args::new(path, index, &tokens))?,
                Ok(false) => break,
                Err(long) => {
                    let at = Position { file: path.into(), line: long.line, column: 0 };
                    self.errors.report(ImportError::new(at, ImportFault::LineTooLong { limit: MAX_LINE }))?;
                }
            }
        }
        self.close_frames()?;
        self.close_objects();
        self.open_files.pop();
        Ok(())
    }

    /// Returns the decoded text of a file. Each file is read once, after a check of its size.
    pub(super) fn text(&mut self, path: &str) -> std::result::Result<Arc<Vec<u8>>, ImportFault> {
        if let Some(text) = self.texts.get(path) {
            return Ok(text.clone());
        }
        let files = self.files;
        let size = files.size(path).map_err(|e| unreadable(files, path, &e))?;
        if size > MAX_TEXT {
            return Err(ImportFault::TextTooLarge { path: path.into(), size, limit: MAX_TEXT });
        }
        let bytes = files.read(path).map_err(|e| unreadable(files, path, &e))?;
        self.note_read(path);
        let text = Arc::new(text::decode(path, bytes)?);
        self.texts.insert(path.into(), text.clone());
        Ok(text)
    }

    /// Records that `path` belongs to the scene.
    pub(super) fn note_read(&mut self, path: &str) {
        if !self.files_read.iter().any(|known| known == path) {
            self.files_read.push(path.into());
        }
    }

    /// Returns the index of a source file for locations.
    pub(super) fn file_index(&mut self, path: &str) -> u32 {
        if let Some(&index) = self.file_indices.get(path) {
            return index;
        }
        let index = self.scene.files.len() as u32;
        self.scene.files.push(path.into());
        self.file_indices.insert(path.into(), index);
        index
    }
}
