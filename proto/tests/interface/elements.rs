//! The elements of `femc/v1/femc.proto`, as its descriptor has them.

use std::collections::BTreeMap;
use std::path::Path;

use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, FieldDescriptorProto, FileDescriptorProto, ServiceDescriptorProto,
};

/// The file, with its comments.
pub fn file() -> FileDescriptorProto {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut all = protox::compile(["femc/v1/femc.proto"], [here]).expect("it compiles");
    assert_eq!(all.file.len(), 1, "it imports nothing");
    all.file.remove(0)
}

/// What an element is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Kind {
    Service,
    /// Types of request and reply, `stream` where there are several.
    Call {
        request: String,
        reply: String,
    },
    Message,
    /// Number, type, and how it is there: `optional`, `repeated`, of which `oneof`.
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

/// Something that has a name.
#[derive(Debug)]
pub struct Element {
    /// Without the package: `JobSpec.name`.
    pub name: String,
    pub kind: Kind,
    /// Before it in the file; empty: there is none.
    pub comment: String,
}

impl Element {
    /// Its own name.
    pub fn last(&self) -> &str {
        self.name.rsplit('.').next().unwrap_or(&self.name)
    }

    /// A line that changes when old clients would be misled.
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

/// Everything that has a name, in the order of the descriptor.
pub fn elements(file: &FileDescriptorProto) -> Vec<Element> {
    let mut walk = Walk { comments: comments(file), found: Vec::new() };
    for (at, service) in (0..).zip(&file.service) {
        walk.service(service, &[6, at]);
    }
    for (at, message) in (0..).zip(&file.message_type) {
        walk.message(message, "", &[4, at]);
    }
    for (at, of) in (0..).zip(&file.enum_type) {
        walk.enumeration(of, "", &[5, at]);
    }
    walk.found
}

/// Comments by the path of what they stand before: field numbers and indices of the descriptor.
fn comments(file: &FileDescriptorProto) -> BTreeMap<Vec<i32>, String> {
    let places = file.source_code_info.iter().flat_map(|info| &info.location);
    places.map(|place| (place.path.clone(), place.leading_comments().trim().to_owned())).collect()
}

struct Walk {
    comments: BTreeMap<Vec<i32>, String>,
    found: Vec<Element>,
}

impl Walk {
    fn found(&mut self, name: String, kind: Kind, path: &[i32]) {
        let comment = self.comments.get(path).cloned().unwrap_or_default();
        self.found.push(Element { name, kind, comment });
    }

    fn service(&mut self, service: &ServiceDescriptorProto, path: &[i32]) {
        self.found(service.name().into(), Kind::Service, path);
        for (at, call) in (0..).zip(&service.method) {
            let stream = |is: bool, of: &str| format!("{}{}", if is { "stream " } else { "" }, short(of));
            let request = stream(call.client_streaming(), call.input_type());
            let reply = stream(call.server_streaming(), call.output_type());
            let name = format!("{}.{}", service.name(), call.name());
            self.found(name, Kind::Call { request, reply }, &[path, &[2, at]].concat());
        }
    }

    fn message(&mut self, message: &DescriptorProto, within: &str, path: &[i32]) {
        let name = format!("{within}{}", message.name());
        self.found(name.clone(), Kind::Message, path);
        for (at, field) in (0..).zip(&message.field) {
            let (number, form) = (field.number(), form(message, field));
            let name = format!("{name}.{}", field.name());
            self.found(name, Kind::Field { number, form }, &[path, &[2, at]].concat());
        }
        for (at, oneof) in (0..).zip(&message.oneof_decl) {
            // Of an `optional` field the compiler makes one that is not in the file.
            if !oneof.name().starts_with('_') {
                self.found(format!("{name}.{}", oneof.name()), Kind::Oneof, &[path, &[8, at]].concat());
            }
        }
        for (at, inner) in (0..).zip(&message.nested_type) {
            self.message(inner, &format!("{name}."), &[path, &[3, at]].concat());
        }
        for (at, inner) in (0..).zip(&message.enum_type) {
            self.enumeration(inner, &format!("{name}."), &[path, &[4, at]].concat());
        }
    }

    fn enumeration(&mut self, of: &EnumDescriptorProto, within: &str, path: &[i32]) {
        let name = format!("{within}{}", of.name());
        self.found(name.clone(), Kind::Enum, path);
        for (at, value) in (0..).zip(&of.value) {
            let number = value.number();
            self.found(format!("{name}.{}", value.name()), Kind::Value { number }, &[path, &[2, at]].concat());
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

/// `JobSpec` of `.femc.v1.JobSpec`.
fn short(name: &str) -> &str {
    name.trim_start_matches(".femc.v1.")
}
