//! What objects pass on to the objects that they enclose.

use crate::description::{Object, ObjectId};

/// For every object: whether it is hidden, by itself or with an object that encloses it.
/// - `objects`: the scene's, or the same at some time ([`crate::Scalars::objects`]).
pub fn hidden_objects(objects: &[Object]) -> Vec<bool> {
    inherited(objects, |object| object.hidden)
}

/// Whether `has` holds for each object or one that encloses it. A chain of parents that comes back to itself ends.
pub(crate) fn inherited(objects: &[Object], has: impl Fn(&Object) -> bool) -> Vec<bool> {
    let mut answers: Vec<Option<bool>> = vec![None; objects.len()];
    for start in 0..objects.len() {
        let (mut chain, mut at) = (Vec::new(), Some(ObjectId(start as u32)));
        let answer = loop {
            let Some(index) = at.map(ObjectId::index).filter(|&i| i < objects.len()) else { break false };
            match answers[index] {
                Some(known) => break known,
                None if chain.len() > objects.len() => break false,
                None => chain.push(index),
            }
            if has(&objects[index]) {
                break true;
            }
            at = objects[index].parent;
        };
        for index in chain {
            answers[index] = Some(answer);
        }
    }
    answers.into_iter().map(|answer| answer.unwrap_or(false)).collect()
}
