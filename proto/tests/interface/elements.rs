//! The elements of `femc/v1/femc.proto`, read from its descriptor.

use std::collections::BTreeMap;
use std::path::Path;

use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, FieldDescriptorProto, FileDescriptorProto, ServiceDescriptorProto,
};

/// Returns the descriptor of the file, with comments.
pub fn file() -> FileDescriptorProto {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut all = protox::compile(["femc/v1/femc.proto"], [here]).expect("it compiles");
    assert_eq!(all.file.len(), 1, "it imports nothing");
    all.file.remove(0)
}

/// Kind of an element.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Kind {
    Service,
    /// A call: types of request and reply, with `stream` for streams.
    Call {
        request: String,
        reply: String,
    },
    Message,
    /// A field: number, type, and label: `optional`, `repeated`, or its `oneof`.
    Field {
        number: i32,
        form: String,
    },
    Oneof,
    Enum,
    Value {
        number: i32,
    },
}

/// A named element.
#[derive(Debug)]
pub struct Element {
    /// Name without the package: `JobSpec.name`.
    pub name: String,
    pub kind: Kind,
    /// Comment before the element; empty if there is none.
    pub comment: String,
}

impl Element {
    /// Returns the last part of the name.
    pub fn last(&self) -> &str {
        self.name.rsplit('.').next().unwrap_or(&self.name)
    }

    /// Returns a line that changes whenever the element changes incompatibly for old clients.
    pub fn line(&self) -> String {
        let name = &self.name;
        match &self.kind {
            Kind::Service => format!("service {name}"),
            Kind::Call { request, reply } => format!("call {name} {request} -> {reply}"),
            Kind::Message => format!("message {name}"),
            Kind::Field { number, form } => format!("field {name} = {number} {form}"),
            Kind::Oneof => format!("oneof {name}"),
            Kind::Enum => format!("enum {name}"),
            Kind::Value { number } => format!("value {name} = {number}"),
        }
    }
}

/// Returns all named elements in the order of the descriptor.
pub fn elements(file: &FileDescriptorProto) -> Vec<Element> {
    let mut walk = DescriptorWalk { comments: comments(file), elements: Vec::new() };
    for (at, service) in (0..).zip(&file.service) {
        walk.service(service, &[6, at]);
    }
    for (at, message) in (0..).zip(&file.message_type) {
        walk.message(message, "", &[4, at]);
    }
    for (at, enumeration) in (0..).zip(&file.enum_type) {
        walk.enumeration(enumeration, "", &[5, at]);
    }
    walk.elements
}

/// Returns the comments by the path of their element: field numbers and indices of the descriptor.
fn comments(file: &FileDescriptorProto) -> BTreeMap<Vec<i32>, String> {
    let places = file.source_code_info.iter().flat_map(|info| &info.location);
    places.map(|place| (place.path.clone(), place.leading_comments().trim().to_owned())).collect()
}

struct DescriptorWalk {
    comments: BTreeMap<Vec<i32>, String>,
    elements: Vec<Element>,
}

impl DescriptorWalk {
    fn push(&mut self, name: String, kind: Kind, path: &[i32]) {
        let comment = self.comments.get(path).cloned().unwrap_or_default();
        self.elements.push(Element { name, kind, comment });
    }

    fn service(&mut self, service: &ServiceDescriptorProto, path: &[i32]) {
        self.push(service.name().into(), Kind::Service, path);
        for (at, call) in (0..).zip(&service.method) {
            let stream = |is_stream: bool, type_name: &str| {
                format!("{}{}", if is_stream { "stream " } else { "" }, short(type_name))
            };
            let request = stream(call.client_streaming(), call.input_type());
            let reply = stream(call.server_streaming(), call.output_type());
            let name = format!("{}.{}", service.name(), call.name());
            self.push(name, Kind::Call { request, reply }, &[path, &[2, at]].concat());
        }
    }

    fn message(&mut self, message: &DescriptorProto, within: &str, path: &[i32]) {
        let name = format!("{within}{}", message.name());
        self.push(name.clone(), Kind::Message, path);
        for (at, field) in (0..).zip(&message.field) {
            let (number, form) = (field.number(), form(message, field));
            let name = format!("{name}.{}", field.name());
            self.push(name, Kind::Field { number, form }, &[path, &[2, at]].concat());
        }
        for (at, oneof) in (0..).zip(&message.oneof_decl) {
            // The compiler adds a oneof for each `optional` field that is not in the file.
            if !oneof.name().starts_with('_') {
                self.push(format!("{name}.{}", oneof.name()), Kind::Oneof, &[path, &[8, at]].concat());
            }
        }
        for (at, inner) in (0..).zip(&message.nested_type) {
            self.message(inner, &format!("{name}."), &[path, &[3, at]].concat());
        }
        for (at, inner) in (0..).zip(&message.enum_type) {
            self.enumeration(inner, &format!("{name}."), &[path, &[4, at]].concat());
        }
    }

    fn enumeration(&mut self, enumeration: &EnumDescriptorProto, within: &str, path: &[i32]) {
        let name = format!("{within}{}", enumeration.name());
        self.push(name.clone(), Kind::Enum, path);
        for (at, value) in (0..).zip(&enumeration.value) {
            let number = value.number();
            self.push(format!("{name}.{}", value.name()), Kind::Value { number }, &[path, &[2, at]].concat());
        }
    }
}

fn form(message: &DescriptorProto, field: &FieldDescriptorProto) -> String {
    let kind = match field.r#type() {
        Type::Message | Type::Enum => short(field.type_name()).to_owned(),
        scalar => scalar.as_str_name().trim_start_matches("TYPE_").to_lowercase(),
    };
    let oneof = field.oneof_index.and_then(|at| message.oneof_decl.get(at as usize));
    match (field.label(), field.proto3_optional(), oneof) {
        (Label::Repeated, _, _) => format!("repeated {kind}"),
        (_, true, _) => format!("optional {kind}"),
        (_, false, Some(oneof)) => format!("{kind} of {}", oneof.name()),
        (_, false, None) => kind,
    }
}

/// Shortens `.femc.v1.JobSpec` to `JobSpec`.
fn short(name: &str) -> &str {
    name.trim_start_matches(".femc.v1.")
}
