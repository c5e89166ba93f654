use super::terminal::{Style, obeyed};
use crate::args::{ColorChoice, CommonArgs};
use crate::exit::Failure;
use std::fmt::Display;
use std::io::{self, IsTerminal, Write};

/// How much to say, and whether in color.
#[derive(Clone, Copy, Debug)]
pub struct Say {
    quiet: bool,
    colored_out: bool,
    colored_err: bool,
}

impl Say {
    /// From the flags and the terminal.
    pub fn new(common: &CommonArgs) -> Self {
        let plain = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
        let colored = |terminal: bool| match common.color {
            ColorChoice::Always => true,
            ColorChoice::Never => false,
            ColorChoice::Auto => terminal && !plain,
        };
        Self {
            quiet: common.quiet,
            colored_out: colored(io::stdout().is_terminal()),
            colored_err: colored(io::stderr().is_terminal()),
        }
    }

    /// Whether what is on stderr may have 24-bit colors.
    pub fn true_color(self) -> bool {
        let color = std::env::var("COLORTERM").unwrap_or_default();
        self.colored_err && matches!(color.as_str(), "truecolor" | "24bit")
    }

    /// Whether only errors and results are wanted.
    pub fn quiet(self) -> bool {
        self.quiet
    }

    /// A result: a line on stdout. A reader that has gone away (`| head`) is no fault.
    pub fn result(self, line: impl Display) {
        let _ = writeln!(io::stdout().lock(), "{}", obeyed(&line.to_string()));
    }

    /// A document on stdout, to the letter.
    pub fn document(self, text: &str) {
        let _ = writeln!(io::stdout().lock(), "{text}");
    }

    /// A picture of characters on stderr, with its colors; not with `--quiet`.
    pub fn picture(self, text: &str) {
        if !self.quiet {
            let _ = writeln!(io::stderr().lock(), "{text}");
        }
    }

    /// A remark on stderr, not with `--quiet`.
    pub fn note(self, line: impl Display) {
        if !self.quiet {
            let _ = writeln!(io::stderr().lock(), "{}", obeyed(&line.to_string()));
        }
    }

    /// A warning on stderr.
    pub fn warning(self, line: impl Display) {
        let label = Style::Yellow.paint("warning:", self.colored_err);
        let _ = writeln!(io::stderr().lock(), "{}", obeyed(&format!("femc: {label} {line}")));
    }

    /// The failure that ends the command.
    pub fn failure(self, failure: &Failure) {
        let label = Style::Red.paint("error:", self.colored_err);
        let _ = writeln!(io::stderr().lock(), "{}", obeyed(&format!("femc: {label} {failure}")));
    }

    /// A heading for stdout.
    pub fn heading(self, text: &str) -> String {
        Style::Bold.paint(text, self.colored_out)
    }

    /// Text on stdout that tells of a fault.
    pub fn bad(self, text: &str) -> String {
        Style::Red.paint(text, self.colored_out)
    }

    /// Text on stdout that asks for attention.
    pub fn doubtful(self, text: &str) -> String {
        Style::Yellow.paint(text, self.colored_out)
    }
}
