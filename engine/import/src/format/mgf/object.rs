//! Named objects: `o`.

use super::{
    args::{Args, Result},
    reader::Reader,
};
use crate::{ImportFault, Position, WarningKind};
use femc_scene::{Object, ObjectId};

/// Maximum depth of nested objects.
const MAX_DEPTH: usize = 256;
/// Maximum length of a dotted name, bytes.
const MAX_NAME: usize = 4096;

impl Reader<'_> {
    /// Reads `o [name]`. An object that is opened again under the same full name is the same object.
    pub(super) fn o(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(..=1, "a name, or nothing to close an object")?;
        if args.len() == 0 {
            if self.objects.len() <= self.current_file().objects {
                return Err(args.fault(ImportFault::NothingToClose { entity: "o" }));
            }
            self.objects.pop();
            return Ok(());
        }
        let parent = self.current_object();
        let name = match parent {
            Some(outer) => format!("{}.{}", self.scene.objects[outer.index()].name, args.text(0)),
            None => args.text(0).into_owned(),
        };
        if self.objects.len() >= MAX_DEPTH || name.len() > MAX_NAME {
            return Err(args.fault(ImportFault::ObjectDepth { limit: MAX_DEPTH }));
        }
        let id = match self.object_ids.get(&name) {
            Some(&id) => {
                self.warn_reopened(id, args);
                id
            }
            None => {
                let id =
                    self.add_object(Object { name: name.clone(), parent, hidden: false }, Some(args.entity_position()));
                self.object_ids.insert(name, id);
                id
            }
        };
        self.objects.push((id, args.location()));
        Ok(())
    }

    /// Adds an object to the scene.
    /// - `position`: position that opens it; `None` if opening it again needs no warning.
    pub(super) fn add_object(&mut self, object: Object, position: Option<Position>) -> ObjectId {
        let id = ObjectId(self.scene.objects.len() as u32);
        self.scene.objects.push(object);
        self.object_positions.push(position);
        id
    }

    /// Warns once about an object name that two places of the scene open. Copies made by an array or by a repeated include are
    /// opened in one place.
    fn warn_reopened(&mut self, id: ObjectId, args: &Args<'_>) {
        let line = args.location().line;
        let Some(position) = self.object_positions.get_mut(id.index()) else { return };
        if let Some(first) = position.take_if(|first| first.line != line || first.file != args.file) {
            let name = self.scene.objects[id.index()].name.clone();
            self.warn(args, WarningKind::ObjectReopened { name, first });
        }
    }

    /// Returns the innermost open object.
    pub(super) fn current_object(&self) -> Option<ObjectId> {
        self.objects.last().map(|(id, _)| *id)
    }

    /// Closes the objects that the current file left open.
    pub(super) fn close_objects(&mut self) {
        for (_, location) in self.objects.split_off(self.current_file().objects) {
            let at = self.position(location);
            self.warnings.push(at, WarningKind::LeftOpen { entity: "o" });
        }
    }
}
