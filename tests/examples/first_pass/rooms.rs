//! Comparison of the first pass with path tracing in random rooms.

use femc_tests::parse_scene;
use femc_tests::picture_comparison::{LampPixels, PictureComparison};
use femc_tests::random_rooms::{FEATURES, RoomOptions, random_room};
use std::error::Error;
use std::fs::OpenOptions;
use std::io::Write as _;

/// Columns of a room's row.
const COLUMNS: &str = "seed\tfeatures\tfaces\tmean\tits error\trms\tits noise\tmedian\tdirect\tsent lm\tkept\tescaped\tkept elsewhere\tall\timbalance\trow sum\tresidual\titerations\tseconds\tseconds of 32 samples\tverdict";
/// Samples a pixel of each path-traced picture, and in white rooms, whose paths are long.
const SPP: u32 = 40;
const SPP_OF_WHITE: u32 = 16;

/// Numbers of the summary, from a row.
struct Row {
    features: String,
    /// Ratio of the means, and its standard error.
    mean: [f64; 2],
    rms: f64,
    /// Flux that is kept or escapes, relative to the sent flux; NaN if it is unknown.
    balance: f64,
    is_trusted: bool,
    seconds: [f64; 2],
}

impl Row {
    /// Parses a row. Returns `None` for other lines.
    fn parse(line: &str) -> Option<(u64, Self)> {
        let fields: Vec<&str> = line.split('\t').collect();
        let seed = fields.first()?.parse().ok()?;
        let number = |k: usize| fields.get(k).and_then(|field| field.parse().ok());
        let row = Self {
            features: fields.get(1)?.to_string(),
            mean: [number(3)?, number(4)?],
            rms: number(5)?,
            balance: number(13).unwrap_or(f64::NAN),
            is_trusted: *fields.get(20)? == "trusted",
            seconds: [number(18)?, number(19)?],
        };
        Some((seed, row))
    }

    fn has(&self, feature: &str) -> bool {
        self.features.split(',').any(|name| name == feature)
    }
}

/// Compares rooms and prints a row of each and a summary. Rooms with a row in the output file are not computed again.
pub fn run<'a>(option: &impl Fn(&str) -> Option<&'a str>, fog: bool) -> Result<(), Box<dyn Error>> {
    let without = option("--without").map_or(Vec::new(), |names| names.split(',').map(str::to_owned).collect());
    if let Some(name) = without.iter().find(|name| !FEATURES.iter().any(|(known, _)| known == name)) {
        let known = FEATURES.map(|(name, _)| name).join(", ");
        return Err(format!("unknown feature \"{name}\" (features: {known})").into());
    }
    let options = RoomOptions { without, fog };
    if let Some(seed) = option("--write") {
        print!("{}", random_room(seed.parse()?, &options).text);
        return Ok(());
    }
    let count: u64 = option("--count").unwrap_or("20").parse()?;
    let from: u64 = option("--from").unwrap_or("0").parse()?;
    let path = option("--out");
    let known = path.map_or(String::new(), |path| std::fs::read_to_string(path).unwrap_or_default());
    let mut rows: Vec<(u64, Row)> = known.lines().filter_map(Row::parse).collect();
    let mut out = path.map(|path| OpenOptions::new().create(true).append(true).open(path)).transpose()?;
    let mut write = |line: &str| -> std::io::Result<()> {
        println!("{line}");
        out.as_mut().map_or(Ok(()), |out| writeln!(out, "{line}"))
    };
    if known.is_empty() {
        write(COLUMNS)?;
    }
    for seed in from..from + count {
        if rows.iter().any(|(done, _)| *done == seed) {
            continue;
        }
        let line = row_of(seed, &options)?;
        write(&line)?;
        rows.extend(Row::parse(&line));
    }
    rows.retain(|(seed, _)| (from..from + count).contains(seed));
    summarize(&rows.into_iter().map(|(_, row)| row).collect::<Vec<_>>());
    Ok(())
}

/// Compares a room. Returns its row.
fn row_of(seed: u64, options: &RoomOptions) -> Result<String, Box<dyn Error>> {
    let room = random_room(seed, options);
    let spp = if room.features.contains(&"white") { SPP_OF_WHITE } else { SPP };
    let found = PictureComparison::new(parse_scene(&room.text), spp, LampPixels::Excluded)?;
    let PictureComparison { mean, median, blocks, flux, report, solver_seconds, path_seconds, .. } = &found;
    let share = |flux_of: Option<f64>| flux_of.map_or("-".to_owned(), |value| format!("{value:.4}"));
    Ok([
        seed.to_string(),
        room.features.join(","),
        room.faces.to_string(),
        format!("{:.4}\t{:.4}\t{:.4}\t{:.4}\t{median:.4}", mean[0], mean[1], blocks[0], blocks[1]),
        share(flux.direct_ratio()),
        format!("{:.4}\t{:.4}", flux.sent, flux.kept / flux.sent),
        share(flux.traced.map(|traced| traced.escaped / flux.sent)),
        share(flux.traced.map(|traced| traced.kept_elsewhere / flux.sent)),
        share(flux.balance()),
        format!("{:.4}\t{:.2}\t{:.1e}\t{}", report.imbalance, report.row_sum, report.residual, report.iterations),
        format!("{solver_seconds:.2}\t{path_seconds:.2}"),
        found.verdict(),
    ]
    .join("\t"))
}

/// Prints the totals of the rooms, and the effect of each feature.
fn summarize(rows: &[Row]) {
    let n = rows.len();
    if n == 0 {
        return;
    }
    let count = |holds: &dyn Fn(&Row) -> bool| rows.iter().filter(|row| holds(row)).count();
    let percent = |part: usize| 100.0 * part as f64 / n as f64;
    let refused = count(&|row| !row.is_trusted);
    let infinite = count(&|row| !row.mean[0].is_finite());
    let deviation = |row: &Row| (row.mean[0] - 1.0).abs();
    println!("\n{n} rooms, {refused} refused, {infinite} without a finite picture");
    for limit in [0.01, 0.03, 0.1] {
        let near = count(&|row| deviation(row) <= limit);
        let maybe = count(&|row| deviation(row) <= limit + 2.0 * row.mean[1]);
        println!(
            "mean within {:.0} %: {:.0} % of the rooms; within that and two standard errors: {:.0} %",
            100.0 * limit,
            percent(near),
            percent(maybe)
        );
    }
    let quartiles = |what: &str, value: &dyn Fn(&Row) -> f64| {
        let mut sorted: Vec<f64> = rows.iter().map(value).filter(|value| !value.is_nan()).collect();
        sorted.sort_by(f64::total_cmp);
        let at = |quarter: usize| sorted.get((quarter * sorted.len().saturating_sub(1) + 2) / 4).unwrap_or(&f64::NAN);
        println!("{what}: {:.4} {:.4} {:.4} {:.4} {:.4}", at(0), at(1), at(2), at(3), at(4));
    };
    println!("least, quartiles, greatest");
    quartiles("mean", &|row| row.mean[0]);
    quartiles("rms of blocks", &|row| row.rms);
    quartiles("flux kept or escaped, of sent", &|row| row.balance);
    quartiles("seconds of the solver", &|row| row.seconds[0]);
    quartiles("seconds of the solver, divided by the seconds of path tracing with 32 samples", &|row| {
        row.seconds[0] / row.seconds[1]
    });
    println!(
        "\nfeature\trooms with it\tmean-1 with it\twithout it\tdifference\tits error\trms with it\twithout it\tflux-1 with it\twithout it"
    );
    let finite: Vec<&Row> = rows.iter().filter(|row| row.mean[0].is_finite()).collect();
    for (feature, _) in FEATURES {
        let (with, without): (Vec<&Row>, Vec<&Row>) = finite.iter().copied().partition(|row| row.has(feature));
        let both = [&with, &without];
        let [[a, a_variance], [b, b_variance]] = both.map(|rows| mean_of(rows, |row| row.mean[0] - 1.0));
        let [[a_rms, _], [b_rms, _]] = both.map(|rows| mean_of(rows, |row| row.rms));
        let [[a_flux, _], [b_flux, _]] = both.map(|rows| mean_of(rows, |row| row.balance - 1.0));
        println!(
            "{feature}\t{}\t{a:+.4}\t{b:+.4}\t{:+.4}\t{:.4}\t{a_rms:.3}\t{b_rms:.3}\t{a_flux:+.3}\t{b_flux:+.3}",
            with.len(),
            a - b,
            (a_variance + b_variance).sqrt()
        );
    }
}

/// Returns the mean of a value over the rooms where it is known, and the variance of that mean.
fn mean_of(rows: &[&Row], value: impl Fn(&Row) -> f64) -> [f64; 2] {
    let values: Vec<f64> = rows.iter().map(|row| value(row)).filter(|value| !value.is_nan()).collect();
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
    [mean, squares / (count * (count - 1.0))]
}
