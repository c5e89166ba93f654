//! Animation entities: `time`, `path`, `key`, `vary`.

use super::{
    args::{Args, Result},
    reader::Reader,
    table::nearest,
    transform::{self, is_mirror, undefined_path},
};
use crate::{EntityKind, ImportError, ImportFault, WarningKind};
use femc_scene::{Clip, Interpolation, Key, MotionPath, PathId, Vary};

/// Maximum number of frames of a clip.
const MAX_FRAMES: f64 = 1e7;

impl Reader<'_> {
    /// Reads `time t0 t1 fps`.
    pub(super) fn time(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(3..=3, "t0 t1 fps")?;
        let start = args.number(0, "start (s)")?;
        let end = args.number_in(1, "end (s)", "at or after the start", |t| t >= start)?;
        let fps = args.number_in(2, "frames per second", "> 0", |f| f > 0.0)?;
        let within = (end - start) * fps <= MAX_FRAMES;
        if !within {
            return Err(args.fault(ImportFault::TooMany { what: "frames", limit: MAX_FRAMES as u64 }));
        }
        if self.scene.clip.replace(Clip { start, end, fps }).is_some() {
            self.warn(args, WarningKind::DefinitionReplaced { what: "time".into() });
        }
        Ok(())
    }

    /// Reads `path NAME = linear | spline`, or `path NAME`, which selects a path to add keys to.
    pub(super) fn path(&mut self, args: &Args<'_>) -> Result<()> {
        let expected = "NAME = linear | spline";
        if args.len() == 1 {
            self.path = Some(self.find_path(&args.text(0)).map_err(|fault| args.fault_at(0, fault))?);
            return Ok(());
        }
        args.check_count(3..=3, expected)?;
        let unexpected =
            |i, expected| args.fault_at(i, ImportFault::Unexpected { found: args.text(i).into_owned(), expected });
        if args.raw(1) != b"=" {
            return Err(unexpected(1, "`=`"));
        }
        let interpolation = match args.raw(2) {
            b"linear" => Interpolation::Linear,
            b"spline" => Interpolation::Spline,
            _ => return Err(unexpected(2, "linear or spline")),
        };
        let name = args.text(0).into_owned();
        let known = self.paths.get(&name);
        if let Some(known) = known.filter(|id| !self.faulty_paths.contains(id)) {
            let line = self.scene.paths[known.index()].location.line;
            return Err(args.fault_at(0, ImportFault::Redefined { kind: EntityKind::Path, name, line }));
        }
        let id = PathId(self.scene.paths.len() as u32);
        self.scene.paths.push(MotionPath {
            name: name.clone(),
            location: args.location(),
            interpolation,
            keys: vec![],
        });
        self.paths.insert(name, id);
        self.path = Some(id);
        Ok(())
    }

    /// Reads `key t [xf args]`.
    pub(super) fn key(&mut self, args: &Args<'_>) -> Result<()> {
        let Some(path) = self.path else {
            return Err(args.fault(ImportFault::NoContext { entity: "key".into(), kind: EntityKind::Path }));
        };
        args.check_count(1.., "a time and transform arguments")?;
        let time = args.number(0, "time (s)")?;
        let spec = {
            let find = |name: &str| self.find_path(name);
            transform::parse(args.tail(1), &find)?
        };
        if !spec.layers.is_empty() {
            let fault = ImportFault::Shape { what: "a key holds a single pose", advice: "remove -a and -path from it" };
            return Err(args.fault(fault));
        }
        if is_mirror(&spec.baked) {
            let fault = ImportFault::Shape {
                what: "a key cannot mirror: poses between keys are interpolated by rotation",
                advice: "mirror in the `xf` instead",
            };
            return Err(args.fault(fault));
        }
        let keys = &mut self.scene.paths[path.index()].keys;
        if let Some(last) = keys.last().filter(|last| last.time >= time) {
            return Err(args.fault_at(0, ImportFault::TimeOrder { time, previous: last.time }));
        }
        keys.push(Key { time, pose: spec.baked });
        Ok(())
    }

    /// Reads `vary SELECTOR = t v t v ...`. A later line for the same selector continues the earlier one.
    pub(super) fn vary(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(4.., "SELECTOR = t v t v ...")?;
        if args.raw(1) != b"=" {
            return Err(args.fault_at(1, ImportFault::Unexpected { found: args.text(1).into_owned(), expected: "`=`" }));
        }
        if !args.len().is_multiple_of(2) {
            args.check_count(0..0, "SELECTOR = and pairs of time and value")?;
        }
        let selector = args.text(0).into_owned();
        let known = self.scene.varies.iter_mut().position(|vary| vary.selector == selector);
        let mut keys = known.map_or(Vec::new(), |i| self.scene.varies[i].keys.clone());
        for i in (2..args.len()).step_by(2) {
            let (time, value) = (args.number(i, "time (s)")?, args.number(i + 1, "value")?);
            if let Some((previous, _)) = keys.last().filter(|(last, _)| *last >= time) {
                return Err(args.fault_at(i, ImportFault::TimeOrder { time, previous: *previous }));
            }
            keys.push((time, value));
        }
        match known {
            Some(i) => self.scene.varies[i].keys = keys,
            None => self.scene.varies.push(Vary { selector, location: args.location(), keys }),
        }
        Ok(())
    }

    /// Returns the path of that name.
    pub(super) fn find_path(&self, name: &str) -> std::result::Result<PathId, ImportFault> {
        self.paths.get(name).copied().ok_or_else(|| undefined_path(name, nearest(name, self.paths.keys())))
    }

    /// Checks that every path has a key.
    pub(super) fn finish_paths(&mut self) -> Result<()> {
        for (i, path) in self.scene.paths.iter().enumerate() {
            if path.keys.is_empty() && !self.faulty_paths.contains(&PathId(i as u32)) {
                let fault = ImportFault::Shape {
                    what: "this path has no keys",
                    advice: "add `key t [xf args]` lines after it",
                };
                self.errors.report(ImportError::new(self.position(path.location), fault))?;
            }
        }
        Ok(())
    }
}
