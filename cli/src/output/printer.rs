use super::terminal::{Style, apply_styles};
use crate::args::{ColorChoice, CommonArgs};
use crate::exit::Failure;
use std::fmt::Display;
use std::io::{self, IsTerminal, Write};

/// Verbosity and colors of the output.
#[derive(Clone, Copy, Debug)]
pub struct Printer {
    quiet: bool,
    colored_out: bool,
    colored_err: bool,
}

impl Printer {
    /// Creates the output settings from the flags and the terminal.
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

    /// Returns whether stderr may have 24-bit colors.
    pub fn true_color(self) -> bool {
        let color = std::env::var("COLORTERM").unwrap_or_default();
        self.colored_err && matches!(color.as_str(), "truecolor" | "24bit")
    }

    /// Returns whether only errors and results are wanted.
    pub fn quiet(self) -> bool {
        self.quiet
    }

    /// Prints a result as a line on stdout. A closed reader (`| head`) is not an error.
    pub fn result(self, line: impl Display) {
        let _ = writeln!(io::stdout().lock(), "{}", apply_styles(&line.to_string()));
    }

    /// Prints a document verbatim on stdout.
    pub fn document(self, text: &str) {
        let _ = writeln!(io::stdout().lock(), "{text}");
    }

    /// Prints a picture made of characters with its colors on stderr, except with `--quiet`.
    pub fn picture(self, text: &str) {
        if !self.quiet {
            let _ = writeln!(io::stderr().lock(), "{text}");
        }
    }

    /// Prints a note on stderr, except with `--quiet`.
    pub fn note(self, line: impl Display) {
        if !self.quiet {
            let _ = writeln!(io::stderr().lock(), "{}", apply_styles(&line.to_string()));
        }
    }

    /// Prints a warning on stderr.
    pub fn warning(self, line: impl Display) {
        let label = Style::Yellow.paint("warning:", self.colored_err);
        let _ = writeln!(io::stderr().lock(), "{}", apply_styles(&format!("femc: {label} {line}")));
    }

    /// Prints the failure that ends the command.
    pub fn failure(self, failure: &Failure) {
        let label = Style::Red.paint("error:", self.colored_err);
        let _ = writeln!(io::stderr().lock(), "{}", apply_styles(&format!("femc: {label} {failure}")));
    }

    /// Styles a heading for stdout.
    pub fn style_heading(self, text: &str) -> String {
        Style::Bold.paint(text, self.colored_out)
    }

    /// Styles text on stdout that reports a fault.
    pub fn style_error(self, text: &str) -> String {
        Style::Red.paint(text, self.colored_out)
    }

    /// Styles text on stdout that needs attention.
    pub fn style_warning(self, text: &str) -> String {
        Style::Yellow.paint(text, self.colored_out)
    }
}
