//! Advice of errors: the parts of their messages that depend on the case.

use super::EntityKind;

/// Returns example lines that define a name.
fn definition(kind: EntityKind, name: &str) -> String {
    match kind {
        EntityKind::Vertex => format!("`v {name} =` and `p x y z`"),
        EntityKind::Color => format!("`c {name} =` and `crgb r g b`"),
        EntityKind::Material => format!("`m {name} =` and `rd r`"),
        EntityKind::Camera => format!("`camera {name} =`, `origin x y z` and `target x y z`"),
        EntityKind::Medium => format!("`medium {name} =` and `sigma_s s`"),
        EntityKind::Path => format!("`path {name} = linear` and `key t`"),
    }
}

/// Returns advice on an undefined name.
pub(super) fn undefined_advice(kind: EntityKind, name: &str, nearest: &[String]) -> String {
    let definition = definition(kind, name);
    match nearest {
        [] => format!("define it before this line: {definition}"),
        names => {
            let quoted: Vec<_> = names.iter().map(|name| format!("`{name}`")).collect();
            format!("define it before this line ({definition}), or use a similar name: {}", quoted.join(", "))
        }
    }
}

/// Returns advice on a file that cannot be read.
/// - `near`: name of a similar file in its folder.
pub(super) fn path_advice(near: Option<&str>) -> String {
    match near {
        Some(name) if name.contains(char::is_whitespace) => format!("did you mean `\"{name}\"` in the same folder?"),
        Some(name) => format!("did you mean `{name}` in the same folder?"),
        None => "check the path; it is relative to the file that names it".to_owned(),
    }
}

/// Returns fault and advice for an unquoted file name with blanks.
pub(super) fn blank_name(entity: &str, name: &str, exists: bool) -> String {
    if exists {
        return format!("the file name `{name}` contains spaces; write it in double quotes: `{entity} \"{name}\"`");
    }
    let (first, rest) = name.split_once(char::is_whitespace).unwrap_or((name, ""));
    let rest = rest.trim_start();
    format!(
        "found `{rest}` after the file name `{first}`; if it is part of the name, write the name in double quotes: \
         `{entity} \"{name}\"`"
    )
}

/// Returns subject and verb of a sentence about extra text.
pub(super) fn left_over(found: &str, numbers: u64) -> String {
    match numbers {
        0 => format!("`{found}` follows"),
        1 => "1 number follows".to_owned(),
        n => format!("{n} numbers follow"),
    }
}
