//! Measures the first pass.
//!
//! - `first_pass errors [--error E,E..] [--only WORD]` compares the solver's error estimates with true errors, in scenes whose
//!   light is known.
//! - `first_pass growth [--error E] [--faces N,N..] [--kind room|terrain] [--memory MB]` solves scenes with increasing numbers of
//!   faces, within a memory limit.
//! - `first_pass solve SCENE [--error E,E..] [--memory MB]` prints the cost of a solution, and a digest of its field.
//! - `first_pass steps SCENE` prints the cost of each step of a first pass that guides paths.
//! - `first_pass pictures SCENE..` compares pictures of the solution with path-traced ones, and prints the flux of the solution. Set
//!   `SPP` for the samples a pixel of path tracing.
//! - `first_pass rooms [--count N] [--from SEED] [--out FILE.tsv] [--without F,F..] [--fog]` compares such pictures of random rooms.
//!   `first_pass rooms --write SEED` prints a room.
//! - `first_pass laws [--only T1,T2..] [--error E] [--all]` compares light with closed forms, by the first pass or by path tracing.
//! - `first_pass fog SCENE [--error E,E..] [--rays N] [--samples N]` compares light in the fog of a scene with the light that paths
//!   find.
//!
//! `cargo run --release -p femc-tests --example first_pass -- errors`

mod laws;
mod rooms;

use femc_pipeline::radiosity::{Census, KindCounts, SolveOptions, solve};
use femc_pipeline::{FirstPassStatistics, Method, SceneSource, Settings, first_pass_world, prepare_frame, solver};
use femc_tests::clock::processor_seconds;
use femc_tests::closed_forms::{Case, SolvedScene, all_cases, relative_errors};
use femc_tests::fog_light::{self, FogComparison, compare_points, compare_rays};
use femc_tests::fuzz::peak_memory;
use femc_tests::generated_scenes::{Kind, generate_scene};
use femc_tests::picture_comparison::{LampPixels, PictureComparison};
use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let option =
        |name: &str| args.iter().position(|arg| arg == name).and_then(|at| args.get(at + 1)).map(String::as_str);
    match args.first().map(String::as_str) {
        Some("errors") => {
            let errors = numbers(option("--error").unwrap_or("1,0.3,0.1,0.03"))?;
            let word = option("--only").unwrap_or("");
            table(&all_cases().into_iter().filter(|case| case.name.contains(word)).collect::<Vec<_>>(), &errors);
        }
        Some("growth") => {
            let faces = numbers(option("--faces").unwrap_or("1000,3000,10000,30000,100000"))?;
            let error = option("--error").unwrap_or("1").parse()?;
            let kind = if option("--kind") == Some("terrain") { Kind::Terrain } else { Kind::Room };
            let memory = option("--memory").map(str::parse::<usize>).transpose()?.map(|megabytes| megabytes << 20);
            let memory = memory.unwrap_or(SolveOptions::default().memory);
            growth(kind, &faces, SolveOptions { error, memory, ..SolveOptions::default() });
        }
        Some("pictures") => args[1..].iter().try_for_each(|scene| pictures(Path::new(scene)))?,
        Some("rooms") => rooms::run(&option, args.iter().any(|arg| arg == "--fog"))?,
        Some("laws") => {
            let error = option("--error").unwrap_or("0.3").parse()?;
            laws::run(option("--only"), error, args.iter().any(|arg| arg == "--all"));
        }
        Some("solve") => {
            let scene = args.get(1).ok_or("which scene?")?;
            let errors = numbers(option("--error").unwrap_or("2,1,0.3"))?;
            let memory = option("--memory").map(str::parse::<usize>).transpose()?.map(|megabytes| megabytes << 20);
            let memory = memory.unwrap_or(SolveOptions::default().memory);
            cost(Path::new(scene), &errors, SolveOptions { memory, ..SolveOptions::default() })?;
        }
        Some("steps") => steps(Path::new(args.get(1).ok_or("which scene?")?))?,
        Some("fog") => {
            let scene = args.get(1).ok_or("which scene?")?;
            let errors = numbers(option("--error").unwrap_or("2,1,0.3"))?;
            let [rays, samples] = [("--rays", "300"), ("--samples", "4096")]
                .map(|(name, otherwise)| option(name).unwrap_or(otherwise).parse());
            fog(Path::new(scene), &errors, rays?, samples?)?;
        }
        _ => return Err("usage: first_pass errors [--error E,E..] [--only WORD] | pictures SCENE.. | rooms [--count N] [--from SEED] [--out FILE.tsv] [--without F,F..] [--fog] [--write SEED] | laws [--only T1,T2..] [--error E] [--all] | growth [--error E] [--faces N,N..] [--kind room|terrain] [--memory MB] | solve SCENE [--error E,E..] [--memory MB] [--guides] | steps SCENE | fog SCENE [--error E,E..] [--rays N] [--samples N]".into()),
    }
    Ok(())
}

fn numbers(text: &str) -> Result<Vec<f32>, std::num::ParseFloatError> {
    text.split(',').map(str::parse).collect()
}

/// Error estimates of a solution, as fractions of its light.
const ESTIMATES: [&str; 6] = ["error", "corrected", "|checked-1|", "sum of both", "row sum-1", "error/4"];

fn estimates(error: f32, solved: &SolvedScene) -> [f64; 6] {
    let report = &solved.report;
    let (corrected, checked) = (f64::from(report.ray_correction), f64::from((report.ray_link_ratio - 1.0).abs()));
    let error = f64::from(error);
    [error, corrected, checked, corrected + checked, f64::from((report.row_sum - 1.0).abs()), 0.25 * error]
}

fn table(cases: &[Case], wanted_errors: &[f32]) {
    println!(
        "scene\terror\tseconds\tleaves\trefused\tof the mean\trms\tgreatest\tchecked\tcorrected\trow sum\tresidual"
    );
    let mut ratios: [Vec<f64>; 6] = Default::default();
    for case in cases {
        for &error in wanted_errors {
            let start = Instant::now();
            let (solved, pairs) = case.solve(error);
            let (found, report) = (relative_errors(&pairs), solved.report);
            println!(
                "{}\t{error}\t{:.1}\t{}\t{}\t{:+.5}\t{:.5}\t{:.5}\t{:.4}\t{:.4}\t{:.4}\t{:.1e}",
                case.name,
                start.elapsed().as_secs_f64(),
                report.leaves,
                report.inexact_links,
                found.mean,
                found.rms,
                found.max_abs,
                report.ray_link_ratio,
                report.ray_correction,
                report.row_sum,
                report.residual
            );
            for (ratios, estimate) in ratios.iter_mut().zip(estimates(error, &solved)) {
                ratios.push(estimate / found.rms);
            }
        }
    }
    println!("\nestimate over rms error\tleast\tmedian\tgreatest\tbelow 1");
    for (name, ratios) in ESTIMATES.iter().zip(&mut ratios) {
        ratios.sort_by(f64::total_cmp);
        let below = ratios.iter().filter(|&&ratio| ratio < 1.0).count();
        let n = ratios.len();
        if n > 0 {
            println!("{name}\t{:.3}\t{:.3}\t{:.3}\t{below} of {n}", ratios[0], ratios[n / 2], ratios[n - 1]);
        }
    }
}

/// Prints a picture of the solution beside two path-traced ones: the ratio of the means, of the median pixels, and the relative rms
/// difference of blocks of 8 x 8 pixels with at least a twentieth of the mean, each with the noise of the path-traced pictures.
fn pictures(path: &Path) -> Result<(), Box<dyn Error>> {
    let scene = Arc::new(femc_import::load_scene_file(path)?.scene);
    let spp = std::env::var("SPP").map_or(Ok(64), |spp| spp.parse())?;
    let found = PictureComparison::new(scene, spp, LampPixels::Included)?;
    let PictureComparison { flux, report, solver_seconds, path_seconds, .. } = &found;
    let shares = flux.traced.map(|traced| {
        format!(
            "direct {:.4} of the true {:.4}, escaped {:.4} of sent, all {:.4}",
            flux.direct / traced.direct,
            traced.direct / flux.sent,
            traced.escaped / flux.sent,
            flux.balance().unwrap_or(f64::NAN),
        )
    });
    println!(
        "{}\tmean {:.4} ({:.4})\tmedian {:.4}\tblocks {:.3} ({:.3})\t{}, absorbed {:.4} of sent\tseconds {solver_seconds:.2}, {:.1} times 32 samples\titerations {} residual {:.1e} imbalance {:.4} row sum {:.2} rays/links {:.3} corrected {:.3}\t{}",
        path.file_stem().unwrap_or_default().to_string_lossy(),
        found.mean[0],
        found.mean[1],
        found.median,
        found.blocks[0],
        found.blocks[1],
        shares.unwrap_or_default(),
        flux.kept / flux.sent,
        solver_seconds / path_seconds,
        report.iterations,
        report.residual,
        report.imbalance,
        report.row_sum,
        report.ray_link_ratio,
        report.ray_correction,
        found.verdict(),
    );
    Ok(())
}

fn fog(path: &Path, errors: &[f32], rays: u32, samples: u32) -> Result<(), Box<dyn Error>> {
    let scene = Arc::new(femc_import::load_scene_file(path)?.scene);
    let mut prepared = prepare_frame(&SceneSource::new(scene), &Settings::default(), 1, None)?;
    let start = Instant::now();
    let along = fog_light::trace_rays(&prepared, rays, samples);
    let around = fog_light::trace_points(&mut prepared, &along, samples);
    println!("{rays} rays and {} points, {samples} paths each: {:.0} s", around.len(), start.elapsed().as_secs_f64());
    println!("error\tseconds\tboxes\twhat\tmean ratio\tits error\trms\trelative rms");
    for &error in errors {
        let start = Instant::now();
        let options = SolveOptions { error, ..SolveOptions::default() };
        let solution = solve(&prepared, &options, &AtomicBool::new(false)).map_err(|_| "cancelled")?;
        let (fog, seconds) = (&solution.field.fog, start.elapsed().as_secs_f64());
        let found = [("along rays", compare_rays(fog, &along)), ("around points", compare_points(fog, &around))];
        for (what, FogComparison { ratio, rms, relative, error: of_paths }) in found {
            let boxes = fog.leaves().count();
            println!("{error}\t{seconds:.1}\t{boxes}\t{what}\t{ratio:.4}\t{of_paths:.4}\t{rms:.4}\t{relative:.4}");
        }
    }
    Ok(())
}

/// Prints the cost of solutions. The greatest memory of the process is that of all solutions so far.
fn cost(path: &Path, errors: &[f32], options: SolveOptions) -> Result<(), Box<dyn Error>> {
    let scene = Arc::new(femc_import::load_scene_file(path)?.scene);
    let prepared = prepare_frame(&SceneSource::new(scene), &Settings::default(), 1, None)?;
    println!(
        "error\tprocessor seconds\telements\tleaves\tboxes\tlinks\tlamp links\trefused\trays\tMB\tprocess MB\tchecked\tcorrected\tdigest"
    );
    for &error in errors {
        let before = processor_seconds().unwrap_or(0.0);
        let solution = solve(&prepared, &SolveOptions { error, ..options }, &AtomicBool::new(false));
        let solution = solution.map_err(|_| "cancelled")?;
        let seconds = processor_seconds().unwrap_or(0.0) - before;
        let report = solution.report;
        println!(
            "{error}\t{seconds:.2}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{:.1}\t{}\t{:.4}\t{:.4}\t{}",
            report.elements,
            report.leaves,
            solution.field.fog.leaves().count(),
            report.links,
            report.lamp_links,
            report.inexact_links,
            report.rays,
            report.bytes as f64 / f64::from(1 << 20),
            peak_memory().unwrap_or(0) >> 20,
            report.ray_link_ratio,
            report.ray_correction,
            &blake3::hash(&solution.field.encode(&FirstPassStatistics::default())).to_hex()[..12],
        );
        let Census { elements, receivers, sources } = report.census;
        for (what, counts) in [("elements", elements), ("links by receiver", receivers), ("links by source", sources)] {
            let KindCounts { clusters, patches, curved, fog } = counts;
            println!("  {what}: {clusters} of clusters, {patches} of patches, {curved} curved, {fog} of fog");
        }
    }
    Ok(())
}

/// Prints the cost of each step, in one process.
fn steps(path: &Path) -> Result<(), Box<dyn Error>> {
    let (settings, cancel) = (Settings { method: Method::Femc, ..Settings::default() }, AtomicBool::new(false));
    let world =
        first_pass_world(&SceneSource::new(Arc::new(femc_import::load_scene_file(path)?.scene)), &settings, 1, None)?;
    let mut rows: Vec<(&str, f64)> = Vec::new();
    let mut clock = processor_seconds().unwrap_or(0.0);
    let mut took = |what| {
        let now = processor_seconds().unwrap_or(0.0);
        match rows.iter_mut().find(|row| row.0 == what) {
            Some(row) => row.1 += now - clock,
            None => rows.push((what, now - clock)),
        }
        clock = now;
    };
    let solver = solver(Method::Femc);
    let begun = solver.begin(&world, &cancel)?;
    let start = begun.encode_start();
    let mut casting = begun.before_rays(&world);
    took("elements and links");
    let rounds = solver.rounds();
    for round in 1..=rounds {
        let rays = casting.cast(&world, 0, 1);
        took("rays");
        let hits = vec![solver.decode_rays(&rays)?];
        let corrected = casting.apply(&world, hits, &cancel)?.ok_or("rays of other elements")?;
        took("correction by rays");
        if round == rounds {
            break;
        }
        casting = solver.decode(&world, &start, Some(&corrected.encode_elements()))?.before_rays(&world);
        took("bytes between steps");
    }
    let whole: f64 = rows.iter().map(|row| row.1).sum();
    println!("step\tprocessor seconds\tshare");
    rows.iter().for_each(|(what, seconds)| println!("{what}\t{seconds:.2}\t{:.0} %", 100.0 * seconds / whole));
    Ok(())
}

fn growth(kind: Kind, faces: &[f32], options: SolveOptions) {
    println!(
        "faces\tseconds\tprocessor seconds\telements\tleaves\tlinks\tlamp links\trefused\trays\tMB\trow sum\timbalance"
    );
    let mut rows: Vec<[f64; 4]> = Vec::new();
    for &wanted in faces {
        let (text, faces) = generate_scene(kind, wanted as usize);
        let source = SceneSource::new(femc_tests::parse_scene(&text));
        let prepared = prepare_frame(&source, &Settings::default(), 1, None);
        let prepared = prepared.unwrap_or_else(|e| panic!("{e}"));
        let (start, before) = (Instant::now(), processor_seconds());
        let cancel = AtomicBool::new(false);
        let solution = solve(&prepared, &options, &cancel);
        let report = solution.unwrap_or_else(|e| panic!("{e:?}")).report;
        let seconds = start.elapsed().as_secs_f64();
        let spent = processor_seconds().zip(before).map_or(seconds, |(now, before)| now - before);
        println!(
            "{faces}\t{seconds:.2}\t{spent:.2}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{:.2}\t{}",
            report.elements,
            report.leaves,
            report.links,
            report.lamp_links,
            report.inexact_links,
            report.rays,
            report.bytes >> 20,
            report.row_sum,
            report.imbalance
        );
        rows.push([report.elements as f64, seconds, spent, report.links as f64]);
    }
    for (k, what) in ["seconds", "processor seconds", "links"].into_iter().enumerate() {
        println!("exponent of {what} by elements: {:.3}", exponent(rows.iter().map(|row| [row[0], row[k + 1]])));
    }
}

/// Computes the slope of a least-squares line through the logarithms.
fn exponent(pairs: impl Iterator<Item = [f64; 2]>) -> f64 {
    let logs: Vec<[f64; 2]> = pairs.map(|pair| pair.map(|x| x.max(1e-9).ln())).collect();
    let n = logs.len() as f64;
    let [x, y] = [0, 1].map(|k| logs.iter().map(|pair| pair[k]).sum::<f64>() / n);
    let (xy, xx) = logs.iter().fold((0.0, 0.0), |(xy, xx), [a, b]| (xy + (a - x) * (b - y), xx + (a - x) * (a - x)));
    xy / xx
}
