//! Table of laws of light.

use femc_tests::clock::processor_seconds;
use femc_tests::laws::all_laws;
use femc_tests::stress::Effort;

/// Measures laws and prints a row of each value.
/// - `only`: names of laws, separated by commas; all if it is `None`;
/// - `with_slow`: whether slow settings are measured, and path tracing has half of the noise.
pub fn run(only: Option<&str>, error: f32, with_slow: bool) {
    let effort = Effort { error_factor: if with_slow { 2.0 } else { 4.0 }, ..Effort::QUICK };
    println!("law\tengine\tsetting\ttruth\tfound\trelative error\trms or standard error\tprocessor seconds");
    let is_wanted = |name: &str| only.is_none_or(|names| names.split(',').any(|wanted| wanted == name));
    let mut greatest = [0.0f64; 2];
    for law in all_laws().iter().filter(|law| is_wanted(law.name) && (with_slow || !law.is_slow)) {
        let clock = || processor_seconds().unwrap_or(0.0);
        let start = clock();
        let results = law.measure(error, &effort);
        let seconds = (clock() - start) / results.len() as f64;
        for result in results {
            let deviation = result.found / result.truth - 1.0;
            println!(
                "{}\t{}\t{}\t{:.6e}\t{:.6e}\t{deviation:+.5}\t{:.5}\t{seconds:.2}",
                law.name,
                law.engine.name(),
                result.setting,
                result.truth,
                result.found,
                result.spread
            );
            let engine = law.engine as usize;
            greatest[engine] = greatest[engine].max(deviation.abs());
        }
    }
    println!("\ngreatest relative error: first pass {:.4}, path tracer {:.4}", greatest[0], greatest[1]);
}
