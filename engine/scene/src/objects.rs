//! Properties that objects pass on to the objects that they enclose.

use crate::description::{Object, ObjectId};

/// Checks whether an object's dotted name is `value` or lies in it.
pub fn is_name_within(name: &str, value: &str) -> bool {
    name.strip_prefix(value).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

/// Returns for every object whether it is hidden, either itself or through an enclosing object.
/// - `objects`: the scene's objects, as described or at some time ([`crate::Scalars::objects`]).
pub fn hidden_objects(objects: &[Object]) -> Vec<bool> {
    inherited_flags(objects, |object| object.hidden)
}

/// Returns for each object whether `has` holds for it or for an object that encloses it. A cycle of parents is followed only once.
pub(crate) fn inherited_flags(objects: &[Object], has: impl Fn(&Object) -> bool) -> Vec<bool> {
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
