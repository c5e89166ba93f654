//! Targets for the messages of `femc.v1`.

use std::rc::Rc;

use femc_proto::testing::{DECODERS, DESCRIPTORS};

use super::schema::Schema;
use super::{Target, mutate};

/// Nesting limit of messages, deeper than any message has.
const DEPTH: usize = 6;

pub(super) fn targets() -> Vec<Target> {
    let schema = Rc::new(Schema::from_descriptors(DESCRIPTORS));
    let target = |decoder: &femc_proto::testing::Decoder| {
        let (schema, name) = (schema.clone(), format!(".femc.v1.{}", decoder.message));
        Target {
            name: decoder.message.into(),
            make: Box::new(move |rng| {
                let bytes = schema.bytes(rng, &name, DEPTH);
                if rng.once_in(2) {
                    return bytes;
                }
                let other = schema.bytes(rng, &name, DEPTH);
                mutate::mutate(rng, bytes, &other)
            }),
            decode: Box::new(decoder.decode),
        }
    };
    DECODERS.iter().map(target).collect()
}
