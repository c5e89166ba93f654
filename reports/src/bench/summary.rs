//! Summary of measurements: means over seeds, efficiencies, ratios between methods.

use super::method::Method;
use super::record::{Record, Run};
use super::reference::Noise;
use super::statistics::{Estimate, Factor, Interval, median};
use serde::Serialize;

/// Summary of all measurements.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Seeds behind each mean.
    pub seeds: Vec<u64>,
    /// Summary of each scene.
    pub scenes: Vec<SceneSummary>,
    /// Summary of each method over all scenes.
    pub methods: Vec<MethodSummary>,
}

/// Summary of one scene.
#[derive(Clone, Debug, Serialize)]
pub struct SceneSummary {
    /// Name of the scene.
    pub scene: String,
    /// Noise that is subtracted from mse and relmse; `None`: nothing is subtracted, because the noise of the reference is unknown.
    pub reference_noise: Option<Noise>,
    /// Results by method and budget.
    pub points: Vec<Point>,
    /// Results by method.
    pub methods: Vec<SceneMethodSummary>,
}

/// A method with a budget in a scene: means over seeds.
#[derive(Clone, Debug, Serialize)]
pub struct Point {
    /// Name of the method.
    pub method: &'static str,
    /// Budget of the method: samples per pixel or relative error.
    pub budget: f64,
    /// Samples drawn per pixel.
    pub spp: f64,
    /// Number of rays.
    pub rays: f64,
    /// Wall time, s.
    pub seconds: Estimate,
    /// Median wall time, s.
    pub seconds_median: f64,
    /// Processor time, s.
    pub cpu_seconds: Estimate,
    /// Mean squared error minus the reference's noise, (cd/m2)^2.
    pub mse: Estimate,
    /// Relative mean squared error minus the reference's noise.
    pub relmse: Estimate,
    /// Fraction of the measured relmse that is noise of the reference.
    pub noise_share: Option<f64>,
    /// Mean HDR-FLIP, including the reference's noise.
    pub flip: Estimate,
    /// Relative error of the worst block, including the reference's noise.
    pub worst: Estimate,
    /// 1 / (relmse x s); `None`: no error is left after subtracting the reference's noise.
    pub efficiency: Option<Interval>,
    /// Wall time over the first method's time for the same relmse; `None`: for the first method, and outside of its measured range.
    pub time_ratio: Option<Interval>,
    /// Wall time over the first method's time for the same worst block.
    pub worst_time_ratio: Option<Interval>,
    #[serde(skip)]
    factors: [Option<Factor>; 2],
}

/// A method in a scene: geometric means over its budgets. Ratios use only budgets in the first method's measured range.
#[derive(Clone, Debug, Serialize)]
pub struct SceneMethodSummary {
    /// Name of the method.
    pub method: &'static str,
    /// 1 / (relmse x s).
    pub efficiency: Option<Interval>,
    /// Efficiency over the first method's at the same relmse.
    pub efficiency_ratio: Option<Interval>,
    /// Time over the first method's for the same relmse, the reciprocal of `efficiency_ratio`.
    pub time_ratio: Option<Interval>,
    /// Time over the first method's for the same worst block.
    pub worst_time_ratio: Option<Interval>,
    #[serde(skip)]
    ratios: [Option<Factor>; 2],
}

/// A method: geometric means over scenes.
#[derive(Clone, Debug, Serialize)]
pub struct MethodSummary {
    /// Name of the method.
    pub method: &'static str,
    /// Number of scenes in which the ratio is known.
    pub scenes: usize,
    /// Efficiency over the first method's at the same relmse.
    pub efficiency_ratio: Option<Interval>,
    /// Time over the first method's for the same relmse, the reciprocal of `efficiency_ratio`.
    pub time_ratio: Option<Interval>,
    /// Time over the first method's for the same worst block.
    pub worst_time_ratio: Option<Interval>,
}

/// A method and its budgets.
pub type Ladder = (&'static Method, Vec<f64>);

impl Summary {
    /// Summarizes the measurements of these scenes, ladders and seeds.
    /// - `scenes`: names, and the noise of their references where it is known.
    pub fn new(record: &Record, scenes: &[(&str, Option<Noise>)], ladders: &[Ladder], seeds: &[u64]) -> Self {
        let scenes: Vec<SceneSummary> = scenes
            .iter()
            .map(|&(scene, noise)| {
                SceneSummary::new(scene, noise, ladders, |method, budget| {
                    seeds.iter().filter_map(|&seed| record.run(scene, method, budget, seed)).collect()
                })
            })
            .collect();
        let methods = ladders.iter().map(|(method, _)| MethodSummary::new(method.name, &scenes)).collect();
        Self { seeds: seeds.to_vec(), scenes, methods }
    }
}

impl SceneSummary {
    fn new<'a>(
        scene: &str,
        noise: Option<Noise>,
        ladders: &[Ladder],
        runs: impl Fn(&'static Method, f64) -> Vec<&'a Run>,
    ) -> Self {
        let (mut points, mut methods): (Vec<Point>, Vec<SceneMethodSummary>) = (Vec::new(), Vec::new());
        let mut first: Option<[Vec<(f64, Factor)>; 2]> = None;
        for (method, budgets) in ladders {
            let measured = budgets.iter().map(|&budget| (budget, runs(method, budget))).filter(|it| !it.1.is_empty());
            let mut method_points: Vec<Point> =
                measured.map(|(budget, runs)| Point::from_runs(method.name, budget, noise, &runs)).collect();
            let factors: Vec<Factor> = method_points.iter().filter_map(|point| point.factors[0]).collect();
            let mut all: [Vec<Factor>; 2] = Default::default();
            if let Some(first) = &first {
                for point in &mut method_points {
                    let ratios = std::array::from_fn(|place| {
                        let there = Factor::interpolate(&first[place], point.comparison_errors()[place]);
                        point.factors[place].zip(there).map(|(here, there)| here.divided_by(there))
                    });
                    [point.time_ratio, point.worst_time_ratio] = ratios.map(to_time_ratio);
                    all.iter_mut().zip(ratios).for_each(|(all, ratio)| all.extend(ratio));
                }
            } else {
                let known = |place: usize| {
                    method_points.iter().filter_map(move |it| Some((it.comparison_errors()[place], it.factors[place]?)))
                };
                first = Some([known(0).collect(), known(1).collect()]);
            }
            let ratios = all.map(|ratios| Factor::mean_of_dependent(&ratios));
            let [time_ratio, worst_time_ratio] = ratios.map(to_time_ratio);
            methods.push(SceneMethodSummary {
                method: method.name,
                efficiency: Factor::geometric_mean(&factors).map(Factor::interval),
                efficiency_ratio: ratios[0].map(Factor::interval),
                time_ratio,
                worst_time_ratio,
                ratios,
            });
            points.extend(method_points);
        }
        Self { scene: scene.to_owned(), reference_noise: noise, points, methods }
    }
}

/// Converts a ratio of efficiencies to a ratio of times.
fn to_time_ratio(ratio: Option<Factor>) -> Option<Interval> {
    ratio.map(|ratio| ratio.inverse().interval())
}

impl Point {
    /// Returns the errors at which methods are compared. Both are inversely proportional to the time.
    fn comparison_errors(&self) -> [f64; 2] {
        [self.relmse.mean, self.worst.mean * self.worst.mean]
    }

    fn from_runs(method: &'static str, budget: f64, noise: Option<Noise>, runs: &[&Run]) -> Self {
        let all = |of: fn(&Run) -> f64| runs.iter().map(|run| of(run)).collect::<Vec<f64>>();
        let mean = |of: fn(&Run) -> f64| Estimate::from_values(&all(of));
        let (mse_noise, relmse_noise) = noise.map_or((0.0, 0.0), |noise| (noise.mse, noise.relmse));
        let (seconds, measured) = (all(|run| run.seconds), all(|run| run.relmse));
        let errors: Vec<f64> = measured.iter().map(|relmse| relmse - relmse_noise).collect();
        let squares = all(|run| run.worst * run.worst);
        let factors = [Factor::efficiency(&errors, &seconds), Factor::efficiency(&squares, &seconds)];
        Self {
            method,
            budget,
            spp: mean(|run| run.spp).mean,
            rays: mean(|run| run.rays as f64).mean,
            seconds: Estimate::from_values(&seconds),
            seconds_median: median(&seconds),
            cpu_seconds: mean(|run| run.cpu_seconds),
            mse: mean(|run| run.mse).minus(mse_noise),
            relmse: Estimate::from_values(&errors),
            noise_share: noise.map(|noise| noise.relmse / Estimate::from_values(&measured).mean),
            flip: mean(|run| run.flip),
            worst: mean(|run| run.worst),
            efficiency: factors[0].map(Factor::interval),
            time_ratio: None,
            worst_time_ratio: None,
            factors,
        }
    }
}

impl MethodSummary {
    fn new(method: &'static str, scenes: &[SceneSummary]) -> Self {
        let of_method = |scene: &SceneSummary| scene.methods.iter().find(|it| it.method == method).map(|it| it.ratios);
        let found: Vec<[Option<Factor>; 2]> = scenes.iter().filter_map(of_method).collect();
        let of = |place: usize| found.iter().filter_map(|ratios| ratios[place]).collect::<Vec<Factor>>();
        let ratios = [of(0), of(1)];
        let [ratio, worst] = [0, 1].map(|place| Factor::geometric_mean(&ratios[place]));
        Self {
            method,
            scenes: ratios[0].len().max(ratios[1].len()),
            efficiency_ratio: ratio.map(Factor::interval),
            time_ratio: to_time_ratio(ratio),
            worst_time_ratio: to_time_ratio(worst),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::method::METHODS;
    use super::*;

    /// Returns a run whose relmse without noise is `relmse`.
    fn run(method: &Method, budget: f64, seconds: f64, relmse: f64) -> Run {
        Run {
            scene: "box".to_owned(),
            method: method.name.to_owned(),
            budget,
            seed: 1,
            seconds,
            first_pass_seconds: 0.0,
            cpu_seconds: 2.0 * seconds,
            samples: 64,
            spp: 4.0,
            rays: 100,
            mse: 3.0 * (relmse + NOISE),
            relmse: relmse + NOISE,
            flip: 0.1,
            worst: relmse.sqrt(),
            left_out: 0,
        }
    }

    const NOISE: f64 = 0.25;

    #[test]
    fn halved_time_doubles_efficiency_without_references_noise() {
        let [pt, other] = [&METHODS[0], &METHODS[1]];
        // relmse x s is 2 for the first method and 1 for the other, which exceeds the range of the first.
        let runs: Vec<Run> =
            [(pt, 1.0, 1.0, 2.0), (pt, 4.0, 4.0, 0.5), (other, 0.5, 1.0, 1.0), (other, 0.2, 4.0, 0.25)]
                .into_iter()
                .flat_map(|(method, budget, seconds, relmse)| {
                    [0.9, 1.1].map(|off| run(method, budget, seconds, relmse * off))
                })
                .collect();
        let noise = Some(Noise { mse: 3.0 * NOISE, relmse: NOISE });
        let ladders: Vec<Ladder> = vec![(pt, vec![1.0, 4.0]), (other, vec![0.5, 0.2])];
        let scene = SceneSummary::new("box", noise, &ladders, |method, budget| {
            runs.iter().filter(|run| run.matches("box", method, budget)).collect()
        });
        let is_near = |a: f64, b: f64| (a / b - 1.0).abs() < 1e-9;
        let point = &scene.points[0];
        assert!(is_near(point.relmse.mean, 2.0) && is_near(point.mse.mean, 6.0), "{point:?}");
        assert!(is_near(point.efficiency.expect("one").value, 0.5) && is_near(point.cpu_seconds.mean, 2.0));
        assert!(is_near(point.noise_share.expect("a share"), 0.25 / 2.25));
        let times: Vec<Option<Interval>> = scene.points.iter().map(|point| point.time_ratio).collect();
        assert!(is_near(times[2].expect("within").value, 0.5) && times[3].is_none(), "{times:?}");
        let worst: Vec<Option<Interval>> = scene.points.iter().map(|point| point.worst_time_ratio).collect();
        assert!((worst[2].expect("within").value / 0.5 - 1.0).abs() < 0.01 && worst[3].is_none(), "{worst:?}");
        let Interval { value, interval } = scene.methods[1].efficiency_ratio.expect("a ratio");
        let [low, high] = interval.expect("an interval");
        assert!(is_near(value, 2.0) && low < 1.9 && high > 2.1, "{value} {low} {high}");
        let method = MethodSummary::new(other.name, &[scene.clone(), scene.clone()]);
        assert!(method.scenes == 2 && is_near(method.efficiency_ratio.expect("a ratio").value, 2.0));
        assert!(is_near(method.time_ratio.expect("a ratio").value, 0.5));
        let first = MethodSummary::new(pt.name, &[scene]);
        assert!(first.efficiency_ratio.is_none() && first.time_ratio.is_none(), "the first is not compared to itself");
    }

    #[test]
    fn an_error_of_which_nothing_is_left_has_no_efficiency() {
        let pt = &METHODS[0];
        let runs = [run(pt, 1.0, 1.0, -0.01), run(pt, 1.0, 1.0, 0.005)];
        let noise = Some(Noise { mse: 0.0, relmse: NOISE });
        let scene = SceneSummary::new("box", noise, &[(pt, vec![1.0])], |_, _| runs.iter().collect());
        assert!(scene.points[0].efficiency.is_none() && scene.methods[0].efficiency.is_none());
        let unknown = SceneSummary::new("box", None, &[(pt, vec![1.0])], |_, _| runs.iter().collect());
        assert!(unknown.points[0].relmse.mean > 0.2 && unknown.points[0].noise_share.is_none());
    }
}
