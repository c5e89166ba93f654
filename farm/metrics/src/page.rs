//! Pages in Prometheus' text format, version 0.0.4.

use std::fmt::Write as _;

use crate::count::Histogram;

/// A page under construction. Names follow Prometheus' conventions: `femc_`, then the quantity, then its unit; the names of
/// counters end with `_total`.
#[derive(Debug, Default)]
pub struct Page(String);

impl Page {
    /// Begins a metric whose value rises and falls.
    pub fn gauge(&mut self, name: &'static str, help: &str) -> Family<'_> {
        self.family(name, "gauge", help)
    }

    /// Begins a metric whose value only grows after the process's start.
    pub fn counter(&mut self, name: &'static str, help: &str) -> Family<'_> {
        debug_assert!(name.ends_with("_total"), "{name}");
        self.family(name, "counter", help)
    }

    /// Begins a metric that is a histogram of durations.
    pub fn histogram(&mut self, name: &'static str, help: &str) -> Histograms<'_> {
        Histograms(self.family(name, "histogram", help))
    }

    fn family(&mut self, name: &'static str, kind: &str, help: &str) -> Family<'_> {
        let help = help.replace('\\', "\\\\").replace('\n', "\\n");
        self.line(format_args!("# HELP {name} {help}\n# TYPE {name} {kind}\n"));
        Family { page: self, name }
    }

    fn line(&mut self, line: std::fmt::Arguments<'_>) {
        // Writing to a string does not fail.
        let _ = self.0.write_fmt(line);
    }

    /// Returns the text of the page.
    pub fn finish(self) -> String {
        self.0
    }
}

/// Writer of one metric's values.
#[derive(Debug)]
pub struct Family<'a> {
    page: &'a mut Page,
    name: &'static str,
}

impl Family<'_> {
    /// Writes the metric's only value.
    pub fn value(self, value: impl Into<f64>) {
        self.labeled(&[], value.into());
    }

    /// Writes the metric's only value, a count: exact up to 2^53.
    pub fn count(self, value: u64) {
        self.value(value as f64);
    }

    /// Writes a value with these labels.
    pub fn labeled(self, labels: &[(&str, &str)], value: f64) -> Self {
        self.page.line(format_args!("{}{} {}\n", self.name, Labels(labels), Number(value)));
        self
    }

    /// Writes one value for each value of the label `label`.
    pub fn each_label<L: AsRef<str>>(self, label: &str, values: impl IntoIterator<Item = (L, u64)>) {
        let put = |family: Self, (value, count): (L, u64)| family.labeled(&[(label, value.as_ref())], count as f64);
        values.into_iter().fold(self, put);
    }
}

/// Writer of one metric's histograms.
#[derive(Debug)]
pub struct Histograms<'a>(Family<'a>);

impl Histograms<'_> {
    /// Writes a histogram with these labels.
    pub fn labeled(self, labels: &[(&str, &str)], histogram: &Histogram) -> Self {
        let Family { page, name } = self.0;
        let mut count = 0;
        for (bound, below) in histogram.cumulative_counts() {
            let bound = Number(bound).to_string();
            let labels: Vec<(&str, &str)> = labels.iter().copied().chain([("le", &*bound)]).collect();
            page.line(format_args!("{name}_bucket{} {below}\n", Labels(&labels)));
            count = below;
        }
        let labels = Labels(labels);
        page.line(format_args!("{name}_sum{labels} {}\n{name}_count{labels} {count}\n", Number(histogram.sum())));
        Self(Family { page, name })
    }
}

struct Labels<'a>(&'a [(&'a str, &'a str)]);

impl std::fmt::Display for Labels<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (place, (name, value)) in self.0.iter().enumerate() {
            let value = value.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n");
            write!(f, "{}{name}=\"{value}\"", if place == 0 { "{" } else { "," })?;
        }
        if self.0.is_empty() { Ok(()) } else { f.write_str("}") }
    }
}

struct Number(f64);

impl std::fmt::Display for Number {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.0 {
            f64::INFINITY => f.write_str("+Inf"),
            f64::NEG_INFINITY => f.write_str("-Inf"),
            number => number.fmt(f),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::testing::Samples;

    #[test]
    fn a_page_is_read_back_as_it_was_written() {
        let mut page = Page::default();
        page.gauge("femc_up", "Whether \\ it\nis there.").value(1);
        page.counter("femc_errors_total", "Errors.").labeled(&[("what", "a \"b\"\\\n"), ("code", "7")], 0.5);
        let histogram = Histogram::new(&[0.25]);
        histogram.observe(Duration::from_millis(125));
        page.histogram("femc_call_seconds", "Calls.").labeled(&[("call", "x")], &histogram);
        page.gauge("femc_odd", "No numbers.").labeled(&[("v", "i")], f64::INFINITY).labeled(&[("v", "n")], f64::NAN);
        let samples = Samples::parse(&page.finish()).expect("a page");
        assert_eq!(samples.value("femc_up", &[]), Some(1.0));
        assert_eq!(samples.value("femc_errors_total", &[("code", "7"), ("what", "a \"b\"\\\n")]), Some(0.5));
        assert_eq!(samples.value("femc_call_seconds_bucket", &[("call", "x"), ("le", "0.25")]), Some(1.0));
        assert_eq!(samples.value("femc_call_seconds_bucket", &[("call", "x"), ("le", "+Inf")]), Some(1.0));
        assert_eq!(samples.value("femc_call_seconds_sum", &[("call", "x")]), Some(0.125));
        assert_eq!(samples.value("femc_odd", &[("v", "i")]), Some(f64::INFINITY));
    }
}
