//! Laws of light with closed forms (algorithm brief, T1 to T14), and what the first pass or the path tracer finds.

use crate::closed_forms::{
    Case, FloorReceiver, SLABS, Slab, ball_over_plate, coaxial_discs, disc_form_factor, furnace, furnace_fog,
    lamp_in_fog, reflecting_floor_of, relative_errors, sphere,
};
use crate::stress::{self, Effort};

/// Engine that answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Engine {
    /// Finite-element solution.
    FirstPass,
    /// Path tracer of the engine.
    Paths,
}

impl Engine {
    /// Returns the engine's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::FirstPass => "first pass",
            Self::Paths => "path tracer",
        }
    }
}

/// A setting of a law.
pub struct Law {
    /// Number of the law, such as `T1`.
    pub name: &'static str,
    /// Engine that answers.
    pub engine: Engine,
    /// Whether the setting takes many seconds.
    pub is_slow: bool,
    setting: Setting,
}

enum Setting {
    /// A scene of the first pass. Its pairs are split into equal parts with these names. The truth replaces the mean of the true
    /// values. The scene is not solved with a smaller error of a link than `min_error`.
    Elements { case: Case, parts: &'static [&'static str], truth: Option<f64>, min_error: f32 },
    /// A scene of the path tracer.
    Paths(stress::Case),
}

/// A value that the law states, and the value found.
#[derive(Clone, Debug)]
pub struct LawResult {
    /// Name of the scene and of its part.
    pub setting: String,
    /// True value.
    pub truth: f64,
    /// Value found.
    pub found: f64,
    /// Relative rms error over points of the solution, or relative standard error of path tracing.
    pub spread: f64,
}

impl Law {
    /// Measures the setting.
    /// - `error`: greatest error of a link of the first pass; spheres have at least 2;
    /// - `effort`: effort of path tracing.
    pub fn measure(&self, error: f32, effort: &Effort) -> Vec<LawResult> {
        match &self.setting {
            Setting::Paths(case) => {
                let line = case.measure("paths", effort);
                let setting = case.name.clone();
                vec![LawResult { setting, truth: line.truth, found: line.value, spread: line.error / line.truth }]
            }
            Setting::Elements { case, parts, truth, min_error } => {
                let (_, pairs) = case.solve(error.max(*min_error));
                let result = |(part, pairs): (&&str, &[[f64; 2]])| {
                    let errors = relative_errors(pairs);
                    let known = pairs.iter().map(|pair| pair[1]).sum::<f64>() / pairs.len() as f64;
                    let (found, truth) = (known * (1.0 + errors.mean), truth.unwrap_or(known));
                    let setting = if part.is_empty() { case.name.clone() } else { format!("{}, {part}", case.name) };
                    LawResult { setting, truth, found, spread: errors.rms }
                };
                parts.iter().zip(pairs.chunks(pairs.len().div_ceil(parts.len()))).map(result).collect()
            }
        }
    }
}

/// Returns a setting of the first pass.
fn elements(name: &'static str, case: Case) -> Law {
    let setting = Setting::Elements { case, parts: &[""], truth: None, min_error: 0.0 };
    Law { name, engine: Engine::FirstPass, is_slow: false, setting }
}

/// Returns a setting of a sphere. At an error of 0.3, each takes half a minute.
fn of_sphere(name: &'static str, case: Case) -> Law {
    let mut law = elements(name, case);
    if let Setting::Elements { min_error, .. } = &mut law.setting {
        *min_error = 2.0;
    }
    law
}

impl Law {
    fn with_truth(mut self, known: f64) -> Self {
        if let Setting::Elements { truth, .. } = &mut self.setting {
            *truth = Some(known);
        }
        self
    }

    fn with_parts(mut self, names: &'static [&'static str]) -> Self {
        if let Setting::Elements { parts, .. } = &mut self.setting {
            *parts = names;
        }
        self
    }

    fn slow(self) -> Self {
        Self { is_slow: true, ..self }
    }
}

/// Number of settings of a law by path tracing that are not slow.
const QUICK_PATHS: usize = 2;

/// Returns the settings of all laws, in the order of the laws.
pub fn all_laws() -> Vec<Law> {
    use FloorReceiver::{Ceiling, Side};
    let mut laws = Vec::new();
    for (r1, r2, h) in [(1.0, 1.0, 1.0), (1.0, 2.0, 1.0), (0.5, 1.0, 2.0)] {
        laws.push(elements("T1", coaxial_discs(r1, r2, h)).with_truth(disc_form_factor(r1, r2, h)));
    }
    for (size, known) in [([1.0, 1.0, 1.0], 0.199_824_9), ([1.0, 2.0, 1.0], 0.285_875_4)] {
        laws.push(elements("T2", reflecting_floor_of(size, &[Ceiling])).with_truth(known));
    }
    // The side emits: its height is the width W of the formula, the depth of the floor is H.
    for (size, known) in
        [([1.0, 1.0, 1.0], 0.200_043_8), ([1.0, 2.0, 1.0], 0.232_852_6), ([1.0, 1.0, 2.0], 0.116_426_3)]
    {
        laws.push(elements("T3", reflecting_floor_of(size, &[Side])).with_truth(known));
    }
    laws.push(elements("T4", coaxial_discs(0.05, 1.0, 1.0)));
    laws.push(elements("T4", ball_over_plate()));
    laws.extend([0.9, 0.985, 0.999].map(|reflectance| elements("T5", furnace(reflectance, 0.0))));
    for scattering in [0.3, 1.0, 3.0] {
        laws.extend([furnace(0.5, scattering), furnace_fog(0.5, scattering)].map(|case| elements("T5", case)));
        let white = [furnace(0.9, scattering), furnace_fog(0.9, scattering)];
        laws.extend(white.map(|case| elements("T5", case).slow()));
    }
    laws.extend([(0.5, 0.0), (0.9, 0.0), (0.9, 0.1)].map(|(albedo, port)| of_sphere("T6", sphere(albedo, port, 0.0))));
    laws.extend([0.5, 0.9].map(|albedo| of_sphere("T7", sphere(albedo, 0.0, 1.0))));
    for (albedo, reach) in [(0.5, 6.0), (0.9, 10.0)] {
        laws.push(elements("T8", lamp_in_fog(albedo, reach, true)).with_parts(&["at 1 m", "at 2 m", "at 3 m"]).slow());
    }
    for (number, (thickness, albedo, reflected, transmitted)) in SLABS.into_iter().enumerate() {
        let case = Slab { thickness, albedo, half_width: 6.0, lamps: 3 }.case(reflected, transmitted);
        let law = elements("T12", case).with_parts(&["reflected", "transmitted after scattering"]);
        // The albedo 1 and thicknesses 0.5 and 1. A thickness of 5 takes minutes.
        laws.push(if [1, 2].contains(&number) { law } else { law.slow() });
    }
    for thickness in [0.5, 1.0, 5.0] {
        laws.push(elements("T14", Slab { thickness, albedo: 0.0, half_width: 6.0, lamps: 12 }.unscattered_case()));
    }
    for (name, cases) in stress::media_laws() {
        for (number, case) in cases.into_iter().enumerate() {
            let is_slow = case.is_long || number >= QUICK_PATHS;
            laws.push(Law { name, engine: Engine::Paths, is_slow, setting: Setting::Paths(case) });
        }
    }
    let number = |law: &Law| law.name[1..].parse::<u32>().unwrap_or(0);
    laws.sort_by_key(number);
    laws
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_law_has_a_quick_setting() {
        let laws = all_laws();
        for number in 1..=14 {
            let of_number = |law: &&Law| law.name == format!("T{number}");
            assert!(laws.iter().filter(of_number).any(|law| !law.is_slow), "T{number}");
        }
        assert!(laws.is_sorted_by_key(|law| law.name[1..].parse::<u32>().unwrap_or(0)));
    }

    #[test]
    fn rectangles_and_unscattered_light_have_the_known_values() {
        let laws = all_laws();
        let of = |name: &'static str, engine: Engine| {
            laws.iter().filter(move |law| law.name == name && law.engine == engine)
        };
        let quick =
            of("T2", Engine::FirstPass).chain(of("T3", Engine::FirstPass)).chain(of("T14", Engine::Paths).take(1));
        let results: Vec<LawResult> = quick.flat_map(|law| law.measure(0.3, &Effort::QUICK)).collect();
        assert_eq!(results.len(), 6);
        for result in results {
            assert!((result.found / result.truth - 1.0).abs() < 0.05, "{result:?}");
        }
    }
}
