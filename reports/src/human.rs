//! Numbers and tables for people.

pub use femc_service::view::counted_noun;
use std::fmt::Write;

/// Formats a number with about four digits.
pub fn number(x: f64) -> String {
    let size = x.abs();
    if x == 0.0 {
        "0".to_owned()
    } else if (1e-3..1e6).contains(&size) {
        let digits = if size < 1.0 {
            4
        } else if size < 100.0 {
            3
        } else {
            1
        };
        format!("{x:.digits$}")
    } else {
        format!("{x:.3e}")
    }
}

/// Formats a duration: `0.42 s`, `12.3 s`, `3 min 20 s`, `2 h 5 min`.
pub fn seconds(s: f64) -> String {
    if !s.is_finite() || s < 0.0 {
        return "?".to_owned();
    }
    if s < 10.0 {
        // An empty floating-point sum is -0.
        return format!("{:.2} s", s.abs());
    }
    if s < 100.0 {
        return format!("{s:.1} s");
    }
    let whole = s.round() as u64;
    if whole < 3600 {
        format!("{} min {} s", whole / 60, whole % 60)
    } else {
        format!("{} h {} min", whole / 3600, whole % 3600 / 60)
    }
}

/// Formats a quantity with three significant digits: `999`, `12.3 k`, `4.56 M`, `7.89 G`.
pub fn quantity(n: f64) -> String {
    let (scaled, unit) = match n.abs() {
        a if a >= 1e9 => (n / 1e9, " G"),
        a if a >= 1e6 => (n / 1e6, " M"),
        a if a >= 1e4 => (n / 1e3, " k"),
        _ => return format!("{n:.0}"),
    };
    let decimals = if scaled.abs() < 10.0 {
        2
    } else if scaled.abs() < 100.0 {
        1
    } else {
        0
    };
    format!("{scaled:.decimals$}{unit}")
}

/// Formats a size with three significant digits: `999 B`, `12.3 KiB`, `4.56 MiB`, `7.89 GiB`.
pub fn bytes(n: u64) -> String {
    let n = n as f64;
    let units = [(1u64 << 30, "GiB"), (1 << 20, "MiB"), (1 << 10, "KiB")];
    let Some((scaled, unit)) =
        units.iter().find_map(|&(size, unit)| (n >= size as f64).then_some((n / size as f64, unit)))
    else {
        return format!("{n:.0} B");
    };
    let decimals = if scaled.abs() < 10.0 {
        2
    } else if scaled.abs() < 100.0 {
        1
    } else {
        0
    };
    format!("{scaled:.decimals$} {unit}")
}

/// Formats a fraction as a percentage: `4.2 %`.
pub fn percent(fraction: f64) -> String {
    let p = fraction * 100.0;
    if p < 10.0 { format!("{p:.2} %") } else { format!("{p:.0} %") }
}

/// Checks whether a terminal interprets a character instead of showing it: control characters, and those that change the writing
/// direction.
pub fn is_terminal_control(c: char) -> bool {
    let turns = matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    c.is_control() || turns || matches!(c, '\u{2028}' | '\u{2029}')
}

/// Makes untrusted text safe for a terminal: escapes all characters that a terminal interprets, except line feeds and tabs.
pub fn escape_controls(text: &str) -> String {
    escape_where(text, |c| is_terminal_control(c) && !matches!(c, '\n' | '\t'))
}

/// Like [`escape_controls`], but also escapes tabs.
pub fn escape_controls_and_tabs(text: &str) -> String {
    escape_where(text, |c| is_terminal_control(c) && c != '\n')
}

fn escape_where(text: &str, is_escaped: impl Fn(char) -> bool) -> String {
    text.chars().fold(String::with_capacity(text.len()), |mut shown, c| {
        if is_escaped(c) {
            shown.extend(c.escape_default());
        } else {
            shown.push(c);
        }
        shown
    })
}

/// Formats a table with aligned columns, two blanks apart, the header first. Lines have no trailing blanks.
pub fn table(header: &[&str], rows: &[Vec<String>]) -> String {
    let header: Vec<String> = header.iter().map(|&cell| cell.to_owned()).collect();
    let mut widths = vec![0; header.len()];
    for row in std::iter::once(&header).chain(rows) {
        for (width, cell) in widths.iter_mut().zip(row) {
            *width = (*width).max(cell.chars().count());
        }
    }
    let mut text = String::new();
    for row in std::iter::once(&header).chain(rows) {
        let mut line = String::new();
        for (cell, width) in row.iter().zip(&widths) {
            let _ = write!(line, "{cell:width$}  ");
        }
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text.pop();
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_grow_coarser_as_they_grow_longer() {
        assert_eq!(seconds(-0.0), "0.00 s");
        let shown: Vec<_> = [0.421, 12.34, 200.0, 7500.0, f64::NAN].into_iter().map(seconds).collect();
        assert_eq!(shown, ["0.42 s", "12.3 s", "3 min 20 s", "2 h 5 min", "?"]);
    }

    #[test]
    fn what_others_wrote_does_not_steer_a_terminal() {
        assert_eq!(escape_controls("a\tb\nc\u{1b}[2J\u{9b}1m\r\u{7}ü"), "a\tb\nc\\u{1b}[2J\\u{9b}1m\\r\\u{7}ü");
        assert_eq!(escape_controls_and_tabs("a\tb\u{202e}\u{2066}c\u{7f}\n"), "a\\tb\\u{202e}\\u{2066}c\\u{7f}\n");
    }

    #[test]
    fn quantities_keep_three_digits() {
        let shown: Vec<_> = [999.0, 12_340.0, 4.56e6, 45.6e6, 7.891e9].into_iter().map(quantity).collect();
        assert_eq!(shown, ["999", "12.3 k", "4.56 M", "45.6 M", "7.89 G"]);
        assert_eq!([999, 12_600, 5 << 30].map(bytes), ["999 B", "12.3 KiB", "5.00 GiB"]);
    }

    #[test]
    fn a_table_lines_its_columns_up() {
        let rows = [vec!["7".to_owned(), "running".to_owned()], vec!["12".to_owned(), "done".to_owned()]];
        assert_eq!(table(&["job", "state"], &rows), "job  state\n7    running\n12   done");
    }
}
