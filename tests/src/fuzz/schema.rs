//! Generates messages that their descriptors allow, with extreme values.

use std::collections::BTreeMap;

use prost::Message as _;
use prost::encoding::{WireType, encode_key, encode_varint};
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorSet};

use crate::rng::Rng;

/// All messages of a package, by full name.
pub(super) struct Schema {
    messages: BTreeMap<String, DescriptorProto>,
}

impl Schema {
    /// Parses a descriptor set.
    /// - panics: if it is invalid; this is for tests only.
    pub(super) fn from_descriptors(descriptors: &[u8]) -> Self {
        let set = FileDescriptorSet::decode(descriptors).expect("a descriptor set");
        let mut messages = BTreeMap::new();
        for file in set.file {
            for message in &file.message_type {
                insert(&mut messages, &format!(".{}", file.package()), message);
            }
        }
        Self { messages }
    }

    /// Generates the bytes of a message of this name.
    pub(super) fn bytes(&self, rng: &mut Rng, name: &str, depth: usize) -> Vec<u8> {
        let mut out = Vec::new();
        let Some(message) = self.messages.get(name) else { return out };
        let chosen = rng.below(message.field.len());
        for (at, field) in message.field.iter().enumerate() {
            // Usually one field of a oneof is set. Rarely several are set, and the last one counts.
            let is_there = match field.oneof_index {
                Some(_) if field.proto3_optional() => !rng.once_in(2),
                Some(_) => at == chosen || rng.once_in(4 * message.field.len()),
                None => !rng.once_in(8),
            };
            let times = match field.label() {
                Label::Repeated => rng.below(4),
                Label::Optional | Label::Required => 1,
            };
            for _ in 0..if is_there { times } else { 0 } {
                self.field(rng, field, depth, &mut out);
            }
        }
        out
    }

    fn field(&self, rng: &mut Rng, field: &FieldDescriptorProto, depth: usize, out: &mut Vec<u8>) {
        let number = field.number() as u32;
        let mut delimited = |bytes: &[u8]| {
            encode_key(number, WireType::LengthDelimited, out);
            encode_varint(bytes.len() as u64, out);
            out.extend_from_slice(bytes);
        };
        match field.r#type() {
            Type::Message if depth > 0 => delimited(&self.bytes(rng, field.type_name(), depth - 1)),
            Type::Message | Type::Group => {}
            Type::String => {
                delimited(rng.pick(&["", "fog", "a/b.mgf", "../..", "\u{0}", "ä\u{202e}b", "{}"]).as_bytes());
            }
            Type::Bytes => {
                let length = *rng.pick(&[32, 32, 32, 32, 32, 32, 0, 31, 33]);
                let byte = rng.bits() as u8;
                delimited(&vec![byte; length]);
            }
            Type::Double => {
                let value = match rng.below(4) {
                    0 => *rng.pick(&[f64::NAN, f64::INFINITY, -1.0, f64::MAX, -0.0, f64::MIN_POSITIVE]),
                    _ => rng.below(1000) as f64 / 8.0,
                };
                encode_key(number, WireType::SixtyFourBit, out);
                out.extend(value.to_le_bytes());
            }
            Type::Fixed64 | Type::Sfixed64 => {
                encode_key(number, WireType::SixtyFourBit, out);
                out.extend(rng.number().to_le_bytes());
            }
            Type::Float | Type::Fixed32 | Type::Sfixed32 => {
                encode_key(number, WireType::ThirtyTwoBit, out);
                out.extend((rng.number() as u32).to_le_bytes());
            }
            Type::Enum => {
                encode_key(number, WireType::Varint, out);
                encode_varint(rng.below(8) as u64, out);
            }
            Type::Bool | Type::Uint32 | Type::Uint64 | Type::Int32 | Type::Int64 | Type::Sint32 | Type::Sint64 => {
                encode_key(number, WireType::Varint, out);
                let value = if rng.once_in(2) { 1 + rng.below(3) as u64 } else { rng.number() };
                encode_varint(value, out);
            }
        }
    }
}

fn insert(messages: &mut BTreeMap<String, DescriptorProto>, within: &str, message: &DescriptorProto) {
    let name = format!("{within}.{}", message.name());
    for nested in &message.nested_type {
        insert(messages, &name, nested);
    }
    messages.insert(name, message.clone());
}
