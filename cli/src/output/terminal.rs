//! Text for a terminal. Names in scenes, jobs and logs come from other people, so control characters in them are shown and not
//! executed.

use femc_reports::human;
use std::hash::{BuildHasher as _, RandomState};
use std::sync::LazyLock;

/// Styles of text.
#[derive(Clone, Copy, Debug)]
pub enum Style {
    Red,
    Yellow,
    Bold,
}

/// Marker that starts a style in a text; the letter after it names the style. It is random, so that no text of a scene can contain
/// it.
static MARK: LazyLock<String> = LazyLock::new(|| format!("\u{1b}<{:016x}>", RandomState::new().hash_one("style")));

/// Letter that ends a style.
const PLAIN: char = '-';

impl Style {
    /// Letters of the styles, and their terminal sequences.
    const ALL: [(char, &'static str); 4] =
        [('r', "\x1b[1;31m"), ('y', "\x1b[1;33m"), ('b', "\x1b[1m"), (PLAIN, "\x1b[0m")];

    /// Returns the text in this style, for [`apply_styles`]; unchanged without colors.
    pub fn paint(self, text: &str, colored: bool) -> String {
        let letter = match self {
            Self::Red => 'r',
            Self::Yellow => 'y',
            Self::Bold => 'b',
        };
        if colored { format!("{mark}{letter}{text}{mark}{PLAIN}", mark = *MARK) } else { text.to_owned() }
    }
}

/// Converts a text for the terminal: styles become sequences, and every other control character is made visible.
pub fn apply_styles(text: &str) -> String {
    let mut parts = text.split(MARK.as_str());
    let mut all = human::escape_controls_and_tabs(parts.next().unwrap_or_default());
    for part in parts {
        let style = Style::ALL.iter().find(|(letter, _)| part.starts_with(*letter));
        match style {
            Some((letter, sequence)) => {
                all += sequence;
                all += &human::escape_controls_and_tabs(&part[letter.len_utf8()..]);
            }
            None => all += &human::escape_controls_and_tabs(part),
        }
    }
    all
}

/// Replaces every terminal control character in JSON by `\uXXXX`. The document stays the same, because such characters only occur
/// in strings.
pub fn escape_json(text: &str) -> String {
    text.chars().fold(String::with_capacity(text.len()), |mut all, c| {
        if human::is_terminal_control(c) && c != '\n' {
            let mut units = [0; 2];
            c.encode_utf16(&mut units).iter().for_each(|unit| all += &format!("\\u{unit:04x}"));
        } else {
            all.push(c);
        }
        all
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn styles_are_obeyed_and_what_stands_in_a_text_is_not() {
        let text = format!("{}: a\u{1b}[31m\u{7}", Style::Red.paint("err\u{9b}or", true));
        assert_eq!(apply_styles(&text), "\x1b[1;31merr\\u{9b}or\x1b[0m: a\\u{1b}[31m\\u{7}");
        assert_eq!(Style::Red.paint("error", false), "error");
        assert_eq!(apply_styles("two\nlines"), "two\nlines");
    }

    #[test]
    fn json_keeps_its_meaning() {
        let value = serde_json::json!({ "name": "a\u{7f}\u{9b}\u{202e}\u{1b}b\"ü" });
        let text = escape_json(&serde_json::to_string_pretty(&value).expect("JSON"));
        assert!(text.chars().all(|c| !human::is_terminal_control(c) || c == '\n'), "{text:?}");
        assert_eq!(serde_json::from_str::<serde_json::Value>(&text).expect("JSON"), value);
    }
}
