//! HTML around the figures.

use super::figure::WIDTH;
use crate::attempts::{FailureLog, GroupBy, JobRecord, Row, columns, visible_cells};
use base64::Engine as _;
use plotters::style::RGBColor;
use std::fmt::Write;

/// Greatest displayed width of pictures, pixels.
const PICTURE_WIDTH: u32 = WIDTH / 2;
/// Most lines of a table. `femc stats` prints the whole table.
const MAX_TABLE_ROWS: usize = 200;

const STYLE: &str = "
    body { font: 15px/1.5 sans-serif; color: #222; max-width: 1160px; margin: 2em auto; padding: 0 1em }
    h1 { font-size: 1.5em } h2 { font-size: 1.15em; margin: 2em 0 .3em } p { margin: .3em 0 }
    svg { width: 100%; height: auto } .wide { overflow-x: auto }
    table { border-collapse: collapse; font-size: 13px; margin: .5em 0 }
    th, td { text-align: left; padding: .2em .8em .2em 0; border-bottom: 1px solid #ddd; white-space: nowrap }
    th { white-space: normal; vertical-align: bottom }
    dl { display: grid; grid-template-columns: max-content auto; gap: .1em 1.2em } dt { color: #666 } dd { margin: 0 }
    pre { background: #f5f5f5; padding: .8em; overflow-x: auto; font-size: 12px }
    .map { display: inline-block; width: 49%; margin: .5em 0; font-size: 13px } .map img { width: 98%; height: auto; image-rendering: pixelated }
    .key { display: inline-block; width: .9em; height: .9em; margin: 0 .4em 0 1em; vertical-align: -.1em }";

/// A page under construction.
pub struct Page(String);

impl Page {
    /// Begins a page with this title.
    pub fn new(title: &str) -> Self {
        let title = escape_html(title);
        Self(format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title>\
             <style>{STYLE}</style></head><body>\n<h1>{title}</h1>\n"
        ))
    }

    /// Adds a list of names and values.
    pub fn facts(&mut self, facts: &[(&str, String)]) {
        self.0.push_str("<dl>");
        for (name, fact) in facts {
            self.put(format_args!("<dt>{name}</dt><dd>{}</dd>", escape_html(fact)));
        }
        self.0.push_str("</dl>\n");
    }

    /// Begins a section.
    pub fn section(&mut self, title: &str, about: &str) {
        self.put(format_args!("<h2>{}</h2>\n<p>{}</p>\n", escape_html(title), escape_html(about)));
    }

    /// Adds a paragraph.
    pub fn text(&mut self, text: &str) {
        self.put(format_args!("<p>{}</p>\n", escape_html(text)));
    }

    /// Adds an SVG.
    pub fn figure(&mut self, svg: &str) {
        // Scale the figure to the width of the page with its own proportions.
        let (width, height) = (attribute(svg, "width"), attribute(svg, "height"));
        let scaled = svg.replacen(
            "<svg ",
            &format!("<svg viewBox=\"0 0 {width} {height}\" "),
            usize::from(!svg.contains("viewBox")),
        );
        self.put(format_args!("<figure style=\"margin: 0\">{scaled}</figure>\n"));
    }

    /// Adds SVGs, or the text `without` if there are none.
    pub fn figures(&mut self, svgs: &[String], without: &str) {
        if svgs.is_empty() {
            self.text(without);
        }
        svgs.iter().for_each(|svg| self.figure(svg));
    }

    /// Adds a PNG with a caption.
    pub fn picture(&mut self, title: &str, png: &[u8]) {
        let (title, address, width) = (escape_html(title), data_url(png), PICTURE_WIDTH);
        self.put(format_args!(
            "<figure class=\"map\"><img src=\"{address}\" width=\"{width}\" alt=\"{title}\"><figcaption>{title}</figcaption>\
             </figure>\n"
        ));
    }

    /// Adds a legend of colors.
    pub fn legend(&mut self, entries: &[(&str, RGBColor)]) {
        self.0.push_str("<p>");
        for (name, RGBColor(r, g, b)) in entries {
            self.put(format_args!("<span class=\"key\" style=\"background: rgb({r} {g} {b})\"></span>{name}"));
        }
        self.0.push_str("</p>\n");
    }

    /// Adds a table of rows, as `femc stats` shows them.
    pub fn table(&mut self, by: GroupBy, rows: &[Row]) {
        let (titles, cells) = visible_cells(&columns(by), &rows[..rows.len().min(MAX_TABLE_ROWS)]);
        self.cells(&titles, &cells);
        if rows.len() > MAX_TABLE_ROWS {
            self.text(&format!(
                "{} more rows are not shown; `femc stats` shows all rows.",
                rows.len() - MAX_TABLE_ROWS
            ));
        }
    }

    /// Adds a table of titles and rows of text.
    pub fn cells<T: AsRef<str>>(&mut self, titles: &[T], rows: &[Vec<String>]) {
        self.0.push_str("<div class=\"wide\"><table><tr>");
        titles.iter().for_each(|title| self.put(format_args!("<th>{}</th>", escape_html(title.as_ref()))));
        for row in rows {
            self.0.push_str("</tr>\n<tr>");
            row.iter().for_each(|cell| self.put(format_args!("<td>{}</td>", escape_html(cell))));
        }
        self.0.push_str("</tr></table></div>\n");
    }

    /// Adds failures and their logs.
    pub fn failures(&mut self, records: &[JobRecord]) {
        if records.iter().all(|record| record.failures.is_empty()) {
            self.text("None.");
        }
        for record in records {
            let (job, variant) = (record.job, escape_html(record.variant.as_deref().unwrap_or_default()));
            for FailureLog { task, worker, text } in &record.failures {
                let (worker, text) = (escape_html(worker), escape_html(text));
                self.put(format_args!(
                    "<details><summary>{job} {variant} {task} on {worker}</summary><pre>{text}</pre></details>\n"
                ));
            }
        }
    }

    /// Returns the finished page.
    pub fn finish(mut self) -> String {
        self.0.push_str("</body></html>\n");
        self.0
    }

    fn put(&mut self, text: std::fmt::Arguments<'_>) {
        // Writing into a string cannot fail.
        let _ = self.0.write_fmt(text);
    }
}

/// Encodes a PNG as a data URL.
fn data_url(png: &[u8]) -> String {
    format!("data:image/png;base64,{}", base64::engine::general_purpose::STANDARD.encode(png))
}

/// Returns the value of the first attribute of this name, or an empty string.
fn attribute<'a>(svg: &'a str, name: &str) -> &'a str {
    let rest = svg.split_once(&format!("{name}=\"")).map_or("", |(_, rest)| rest);
    rest.split('"').next().unwrap_or("")
}

/// Escapes text for HTML.
pub fn escape_html(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            c => safe.push(c),
        }
    }
    safe
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_others_wrote_is_text_and_nothing_else() {
        assert_eq!(escape_html("<b a=\"1\">&"), "&lt;b a=&quot;1&quot;&gt;&amp;");
        let page = Page::new("<script>alert(1)</script>").finish();
        assert!(!page.contains("<script"), "{page}");
        assert_eq!(data_url(b"abc"), "data:image/png;base64,YWJj");
    }
}
