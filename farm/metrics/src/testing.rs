//! A strict reader of pages: deviations that Prometheus would accept are errors here.

use std::collections::{BTreeMap, BTreeSet};

/// Label names with their values, in the order of the names.
pub type Labels = BTreeMap<String, String>;

/// The samples of a page.
#[derive(Debug, Default)]
pub struct Samples {
    values: BTreeMap<(String, Labels), f64>,
    /// Kinds of the metrics, by the metric's name.
    pub kinds: BTreeMap<String, String>,
}

impl Samples {
    /// Reads a page and checks these rules: Each metric begins with its help and its kind. Its values follow immediately. No metric
    /// and no series occurs twice. A counter's name ends with `_total`, and its value is not negative. The buckets of a histogram
    /// do not shrink, and the last one equals its count.
    pub fn parse(page: &str) -> Result<Self, String> {
        let (mut samples, mut helped, mut current) = (Self::default(), BTreeSet::new(), String::new());
        for line in page.strip_suffix('\n').ok_or("the last line has no line break")?.lines() {
            let wrong = |what: &str| format!("{what}: {line}");
            if let Some(rest) = line.strip_prefix("# HELP ") {
                let (name, help) = rest.split_once(' ').ok_or_else(|| wrong("the help text is missing"))?;
                if help.trim().is_empty() || !helped.insert(name.to_owned()) {
                    return Err(wrong("the help text is empty or repeated"));
                }
            } else if let Some(rest) = line.strip_prefix("# TYPE ") {
                let (name, kind) = rest.split_once(' ').ok_or_else(|| wrong("the kind is missing"))?;
                let is_known = matches!(kind, "gauge" | "counter" | "histogram");
                if !is_known || (kind == "counter") != name.ends_with("_total") || !helped.contains(name) {
                    return Err(wrong("the kind is unknown, does not match the name, or has no help text"));
                }
                current = name.to_owned();
                if samples.kinds.insert(current.clone(), kind.to_owned()).is_some() {
                    return Err(wrong("the kind is repeated"));
                }
            } else {
                samples.parse_sample(line, &current).map_err(|what| wrong(&what))?;
            }
        }
        samples.check_histograms()?;
        Ok(samples)
    }

    fn parse_sample(&mut self, line: &str, family: &str) -> Result<(), String> {
        let (series, value) = line.rsplit_once(' ').ok_or("the value is missing")?;
        let (name, labels) = match series.split_once('{') {
            None => (series, Labels::new()),
            Some((name, labels)) => {
                (name, parse_labels(labels.strip_suffix('}').ok_or("the labels have no closing brace")?)?)
            }
        };
        let kind = self.kinds.get(family).ok_or("no kind precedes it")?;
        let of_histogram = ["_bucket", "_sum", "_count"].iter().any(|end| name.strip_suffix(end) == Some(family));
        if (kind == "histogram" && !of_histogram) || (kind != "histogram" && name != family) {
            return Err(format!("the name does not belong to {family}"));
        }
        let value: f64 = match value {
            "+Inf" => f64::INFINITY,
            "inf" | "-inf" | "infinity" => return Err("the value is not a number".into()),
            other => other.parse().map_err(|_| "the value is not a number".to_owned())?,
        };
        if kind == "counter" && !(value >= 0.0 && value.is_finite()) {
            return Err("the counter is negative or not finite".into());
        }
        match self.values.insert((name.to_owned(), labels), value) {
            None => Ok(()),
            Some(_) => Err("the series is repeated".into()),
        }
    }

    fn check_histograms(&self) -> Result<(), String> {
        let mut last: BTreeMap<(String, Labels), (f64, f64)> = BTreeMap::new();
        let mut buckets = Vec::new();
        for ((name, labels), &count) in &self.values {
            let Some(family) = name.strip_suffix("_bucket") else { continue };
            let mut labels = labels.clone();
            let bound = labels.remove("le").ok_or_else(|| format!("a bucket of {family} has no bound"))?;
            let bound =
                if bound == "+Inf" { f64::INFINITY } else { bound.parse().map_err(|_| "the bound is not a number")? };
            buckets.push((family.to_owned(), labels, bound, count));
        }
        buckets.sort_by(|a, b| (&a.0, &a.1).cmp(&(&b.0, &b.1)).then(a.2.total_cmp(&b.2)));
        for (family, labels, bound, count) in buckets {
            let key = (family, labels);
            if last.get(&key).is_some_and(|(_, before)| *before > count) {
                return Err(format!("the buckets of {} decrease", key.0));
            }
            last.insert(key, (bound, count));
        }
        for ((family, labels), (bound, count)) in last {
            let total = self.values.get(&(format!("{family}_count"), labels.clone()));
            if bound != f64::INFINITY || total != Some(&count) {
                return Err(format!("the last bucket of {family}{labels:?} does not equal its count"));
            }
        }
        Ok(())
    }

    /// Returns the value with exactly these labels.
    pub fn value(&self, name: &str, labels: &[(&str, &str)]) -> Option<f64> {
        let labels = labels.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
        self.values.get(&(name.to_owned(), labels)).copied()
    }

    /// Returns the sum of all values of this name that have at least these labels.
    pub fn sum(&self, name: &str, labels: &[(&str, &str)]) -> f64 {
        let has = |of: &Labels| labels.iter().all(|(name, value)| of.get(*name).is_some_and(|own| own == value));
        self.values.iter().filter(|((own, of), _)| own == name && has(of)).map(|(_, value)| value).sum()
    }

    /// Returns the names of all series.
    pub fn names(&self) -> BTreeSet<&str> {
        self.values.keys().map(|(name, _)| &**name).collect()
    }
}

fn parse_labels(text: &str) -> Result<Labels, String> {
    let (mut labels, mut rest) = (Labels::new(), text);
    while !rest.is_empty() {
        let (name, after) = rest.split_once("=\"").ok_or("a label has no value")?;
        let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
        if name.is_empty() || !name.chars().all(is_name) || name.starts_with(|c: char| c.is_ascii_digit()) {
            return Err(format!("invalid label name `{name}`"));
        }
        let (mut value, mut chars) = (String::new(), after.char_indices());
        let end = loop {
            match chars.next().ok_or("a value has no closing quotation mark")? {
                (at, '"') => break at + 1,
                (_, '\\') => value.push(match chars.next().map(|(_, c)| c) {
                    Some('n') => '\n',
                    Some(c @ ('\\' | '"')) => c,
                    _ => return Err("unknown escape sequence in a value".into()),
                }),
                (_, c) => value.push(c),
            }
        };
        if labels.insert(name.to_owned(), value).is_some() {
            return Err(format!("the label {name} occurs twice"));
        }
        rest = &after[end..];
        rest = match rest.strip_prefix(',') {
            Some("") => return Err("a comma follows the last label".into()),
            Some(more) => more,
            None if rest.is_empty() => rest,
            None => return Err("a comma between labels is missing".into()),
        };
    }
    Ok(labels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_page_is_refused() {
        let head = "# HELP a b\n# TYPE a gauge\n";
        assert!(Samples::parse(&format!("{head}a 1\n")).is_ok());
        for wrong in [
            "a 1\n".to_owned(),
            format!("{head}a 1"),
            format!("{head}a one\n"),
            format!("{head}a 1\na 2\n"),
            format!("{head}b 1\n"),
            format!("{head}a{{x=\"1\",}} 1\n"),
            format!("{head}a{{1x=\"1\"}} 1\n"),
            format!("{head}{head}a 1\n"),
            "# HELP a b\n# TYPE a counter\na 1\n".to_owned(),
            "# HELP a b\n# TYPE a histogram\na_bucket{le=\"1\"} 1\na_sum 1\na_count 1\n".to_owned(),
            "# HELP a b\n# TYPE a histogram\na_bucket{le=\"1\"} 2\na_bucket{le=\"+Inf\"} 1\na_count 1\n".to_owned(),
        ] {
            assert!(Samples::parse(&wrong).is_err(), "{wrong}");
        }
    }
}
