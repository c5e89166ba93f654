//! Named objects: `o`.

use super::{
    args::{Args, Result},
    reader::Reader,
};
use crate::{Fault, Oddity, Position};
use femc_scene::{Object, ObjectId};

/// Maximum depth of nested objects.
const MAX_DEPTH: usize = 256;
/// Maximum length of a dotted name, bytes.
const MAX_NAME: usize = 4096;

impl Reader<'_> {
    /// Reads `o [name]`. An object that is opened again under the same full name is the same object.
    pub(super) fn o(&mut self, args: &Args<'_>) -> Result<()> {
        args.count(..=1, "a name, or nothing to close an object")?;
        if args.len() == 0 {
            if self.objects.len() <= self.open_at_start().objects {
                return Err(args.fault(Fault::NothingToClose { entity: "o" }));
            }
            self.objects.pop();
            return Ok(());
        }
        let parent = self.object();
        let name = match parent {
            Some(outer) => format!("{}.{}", self.scene.objects[outer.index()].name, args.text(0)),
            None => args.text(0).into_owned(),
        };
        if self.objects.len() >= MAX_DEPTH || name.len() > MAX_NAME {
            return Err(args.fault(Fault::ObjectDepth { limit: MAX_DEPTH }));
        }
        let id = match self.object_ids.get(&name) {
            Some(&id) => {
                self.opened_again(id, args);
                id
            }
            None => {
                let id = self.add_object(Object { name: name.clone(), parent, hidden: false }, Some(args.at()));
                self.object_ids.insert(name, id);
                id
            }
        };
        self.objects.push((id, args.location()));
        Ok(())
    }

    /// Adds an object to the scene.
    /// - `place`: position that opens it; `None` if opening it again needs no warning.
    pub(super) fn add_object(&mut self, object: Object, place: Option<Position>) -> ObjectId {
        let id = ObjectId(self.scene.objects.len() as u32);
        self.scene.objects.push(object);
        self.object_places.push(place);
        id
    }

    /// Warns once about an object name that two places of the scene open. Copies made by an array or by a repeated include are
    /// opened in one place.
    fn opened_again(&mut self, id: ObjectId, args: &Args<'_>) {
        let line = args.location().line;
        let Some(place) = self.object_places.get_mut(id.index()) else { return };
        if let Some(first) = place.take_if(|first| first.line != line || first.file != args.file) {
            let name = self.scene.objects[id.index()].name.clone();
            self.warn(args, Oddity::ObjectAgain { name, first });
        }
    }

    /// Returns the innermost open object.
    pub(super) fn object(&self) -> Option<ObjectId> {
        self.objects.last().map(|(id, _)| *id)
    }

    /// Closes the objects that the current file left open.
    pub(super) fn close_objects(&mut self) {
        for (_, location) in self.objects.split_off(self.open_at_start().objects) {
            let at = self.position(location);
            self.warnings.push(at, Oddity::LeftOpen { entity: "o" });
        }
    }
}
