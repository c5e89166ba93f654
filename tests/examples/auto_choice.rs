//! Measures how much `--method auto` loses against the better of path tracing and two passes, in counted work.
//!
//! `cargo run --release -p femc-tests --example auto_choice -- SCENE.mgf.. [--spp N] [--size N] [--seeds N]`
//!
//! The cost of a method is the variance of its samples times their rays, with the first pass: as many rays as path tracing traces in
//! the processor seconds of the first pass. The pilot only estimates that number. The cost of `auto` is that of the method
//! that its pilot chooses with a seed, with the work of the pilot. One line for each scene: the pilots' mean relative variance and
//! their mean maximum gain, the estimated and the measured work of the first pass and the cost of two passes relative to path
//! tracing's, the gain
//! without the first pass, how often two passes were chosen, the gains that the pilots measured and (in parentheses) estimated, and
//! the ratio of `auto` to the better method, with the upper end of its 95 % interval over seeds.

use femc_montecarlo::Guidance;
use femc_pipeline::method_choice::{Pilot, choose_method, work};
use femc_pipeline::radiosity::{self, SolveOptions};
use femc_pipeline::{Method, SceneSource, Settings, StopCondition, plan_job, prepare_frame};
use femc_tests::clock::processor_seconds;
use femc_tests::relative_variance::measure;
use std::error::Error;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Half width of the 95 % interval of Student's distribution, standard errors, by degrees of freedom from 1 on.
const STUDENT_95: [f64; 9] = [12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26];

fn main() -> Result<(), Box<dyn Error>> {
    let (mut scenes, mut spp, mut size, mut seeds) = (Vec::new(), 1024u32, 96u32, 10u64);
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().ok_or(format!("{arg} needs a value"));
        match arg.as_str() {
            "--spp" => spp = value()?.parse()?,
            "--size" => size = value()?.parse()?,
            "--seeds" => seeds = value()?.parse()?,
            scene => scenes.push(scene.to_owned()),
        }
    }
    if scenes.is_empty() || seeds < 2 {
        return Err("usage: auto_choice SCENE.mgf.. [--spp N] [--size N] [--seeds N]; at least 2 seeds".into());
    }
    println!(
        "scene\tvariance\tmost gain\tfirst pass estimated\tfirst pass\tfemc\tgain\tchosen\tgains by pilot\tauto over better\tupper"
    );
    for path in scenes {
        let source = SceneSource::new(Arc::new(femc_import::load_scene_file(path.as_ref())?.scene));
        let settings = Settings { size: Some([size; 2]), stop: StopCondition::Spp(spp), ..Settings::default() };
        let prepared = prepare_frame(&source, &Settings { method: Method::Pt, ..settings.clone() }, 1, None)?;
        let options = SolveOptions { error: 1.0, ..SolveOptions::default() };
        let start = processor_seconds().unwrap_or(0.0);
        let solution = radiosity::solve(&prepared, &options, &AtomicBool::new(false)).map_err(|_| "cancelled")?;
        let learned = femc_guiding::learn(&prepared, &solution.field, &AtomicBool::new(false)).ok_or("cancelled")?;
        let guide = learned.guide(&solution.field);
        let first_pass_seconds = processor_seconds().unwrap_or(0.0) - start;
        let guidance = Guidance::new(&prepared, &solution.field).with_targets(&prepared, &guide);
        let methods = [None, Some(guidance)];
        let measured_spp = spp.min(256);
        let measured = measure(&methods, &prepared, size, measured_spp, 2);
        let work_of_sample = [(Method::Pt, &measured[0]), (Method::Femc, &measured[1])]
            .map(|(method, measured)| work(&prepared, method, measured.rays, measured.guided));
        let work_per_second =
            work_of_sample[0] * f64::from(measured_spp) * f64::from(size * size) / measured[0].seconds.max(1e-9);
        let first_pass = first_pass_seconds * work_per_second;
        let samples = f64::from(spp) * f64::from(size * size);
        let work = work_of_sample.map(|work| samples * work);
        let plan = plan_job(source.scene(), &settings, Some(&[1]))?;
        let (mut ratios, mut chosen, mut estimated, mut gains) = (Vec::new(), 0, 0.0, Vec::new());
        let (mut variances, mut most_gains) = (0.0, 0.0);
        let costs = [measured[0].variance * work[0], measured[1].variance * (work[1] + first_pass)];
        for seed in 1..=seeds {
            let (choice, _) = choose_method(&source, &Settings { seed, ..settings.clone() }, &plan)?;
            let Some(Pilot {
                samples: drawn,
                rays_a_sample,
                work_of_ray,
                first_pass_rays,
                learning_rays,
                gain,
                variance,
                most_gain,
                ..
            }) = choice.pilot
            else {
                return Err(format!("{path}: the job is too small for a pilot").into());
            };
            estimated = first_pass_rays + learning_rays;
            let is_guided = choice.method == Method::Femc;
            chosen += u64::from(is_guided);
            gains.extend(gain.map(|gain| format!("{:.2} ({:.2})", gain.measured, gain.estimated)));
            (variances, most_gains) = (variances + variance, most_gains + most_gain);
            // A first pass that was solved for the choice counts once.
            let spare = if gain.is_some() && !is_guided { first_pass } else { 0.0 };
            // A pilot traces its paths one after the other.
            let pilot = drawn as f64 * rays_a_sample / work_of_ray + spare;
            let own = costs[usize::from(is_guided)] + measured[usize::from(is_guided)].variance * pilot;
            ratios.push(own / costs[0].min(costs[1]));
        }
        let n = ratios.len() as f64;
        let mean = ratios.iter().sum::<f64>() / n;
        let error = (ratios.iter().map(|ratio| (ratio - mean).powi(2)).sum::<f64>() / (n - 1.0) / n).sqrt();
        let name = std::path::Path::new(&path).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let student = STUDENT_95[(seeds as usize - 2).min(STUDENT_95.len() - 1)];
        println!(
            "{name}\t{:.2}\t{:.1}\t{:.3}\t{:.3}\t{:.2}\t{:.2}\t{chosen} of {seeds}\t{}\t{mean:.3}\t{:.3}",
            variances / n,
            most_gains / n,
            estimated / work[0],
            first_pass / work[0],
            costs[1] / costs[0],
            costs[0] / (measured[1].variance * work[1]),
            gains.join(" "),
            mean + student * error
        );
    }
    Ok(())
}
