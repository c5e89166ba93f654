//! Parser of the arguments of `xf`: fixed steps, repetitions, arrays and paths become layers.
//!
//! Arguments apply from left to right. `-i n` repeats the arguments after it, up to the next `-i` or `-a`; `-a n` makes an array of
//! them (as in MGF, `-i 1` ends an array's arguments). Arguments before the first array or path are baked into the vertices. Every
//! later array or path is a layer of instances around the layer before it.

use super::args::{Args, Result, Tail};
use crate::{EntityKind, ImportFault};
use femc_math::{
    Transform, elementary,
    glam::{DMat3, DVec3},
};
use femc_scene::{Motion, MotionStep, PathId};

/// Maximum number of copies of an array and of repetitions of `-i`. More copies could not contain one primitive each.
pub(super) const MAX_COPIES: u64 = 100_000_000;
/// Maximum number of steps of the motions of one `xf` that contains paths.
const MAX_STEPS: u64 = 10_000;

/// Parsed transform of an `xf`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TransformSpec {
    /// Transform that is applied first, to vertices.
    pub baked: Transform,
    /// Placements of the contents, from the innermost outward.
    pub layers: Vec<InstanceLayer>,
}

/// One array (or a single path). Copy k is transformed by `before`, then k times by `body`, then by `after`.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct InstanceLayer {
    pub before: Vec<MotionStep>,
    pub body: Vec<MotionStep>,
    /// Number of copies, >= 1.
    pub count: u64,
    pub after: Vec<MotionStep>,
}

impl InstanceLayer {
    /// Returns the motion of copy `k`.
    pub fn motion(&self, k: u64) -> Vec<MotionStep> {
        let mut steps = Vec::new();
        for &step in &self.before {
            push_step(&mut steps, step);
        }
        repeat(&self.body, k, &mut steps);
        for &step in &self.after {
            push_step(&mut steps, step);
        }
        steps
    }

    /// Returns the body as one fixed transform.
    pub fn fixed_body(&self) -> Option<Transform> {
        Motion { steps: self.body.clone() }.as_static()
    }
}

/// Appends `step`; merges consecutive fixed steps.
pub(super) fn push_step(steps: &mut Vec<MotionStep>, step: MotionStep) {
    match (steps.last_mut(), step) {
        (_, MotionStep::Static(t)) if t == Transform::IDENTITY => {}
        (Some(MotionStep::Static(last)), MotionStep::Static(t)) => *last = t * *last,
        _ => steps.push(step),
    }
}

/// Appends `body` `n` times.
fn repeat(body: &[MotionStep], n: u64, steps: &mut Vec<MotionStep>) {
    if let Some(fixed) = (Motion { steps: body.to_vec() }).as_static() {
        push_step(steps, MotionStep::Static(power(fixed, n)));
        return;
    }
    for _ in 0..n {
        for &step in body {
            push_step(steps, step);
        }
    }
}

/// Returns `t` applied `n` times, by repeated squaring.
pub(super) fn power(t: Transform, mut n: u64) -> Transform {
    let (mut result, mut square) = (Transform::IDENTITY, t);
    while n > 0 {
        if n & 1 == 1 {
            result = square * result;
        }
        n >>= 1;
        if n > 0 {
            square = square * square;
        }
    }
    result
}

/// Returns the uniform scale (>= 0) of a similarity.
pub(super) fn scale_of(t: &Transform) -> f64 {
    elementary::double::cbrt(t.matrix3.determinant().abs())
}

/// Returns whether `t` mirrors.
pub(super) fn is_mirror(t: &Transform) -> bool {
    t.matrix3.determinant() < 0.0
}

enum Repeat {
    Once,
    Times(u64),
    Array(u64),
}

/// Parses transform arguments. `find` looks a path up by name.
pub(super) fn parse(
    tail: Tail<'_>,
    find: &dyn Fn(&str) -> std::result::Result<PathId, ImportFault>,
) -> Result<TransformSpec> {
    let args = tail.args;
    let mut builder = Builder { spec: TransformSpec { baked: Transform::IDENTITY, layers: Vec::new() }, open: None };
    let mut block = Vec::new();
    let mut mode = (Repeat::Once, tail.first);
    let mut i = tail.first;
    while i < args.len() {
        let option = args.raw(i);
        if let b"-i" | b"-a" = option {
            builder.close(&args, &mode, &block)?;
            block.clear();
            let n = require_fields(&args, i, 1).and_then(|()| match option {
                b"-a" => args.whole_number(i + 1, "number of copies", [1, MAX_COPIES], "a whole number in [1, 1e8]"),
                _ => args.whole_number(i + 1, "number of repetitions", [0, MAX_COPIES], "a whole number in [0, 1e8]"),
            })?;
            mode = (if option == b"-a" { Repeat::Array(n) } else { Repeat::Times(n) }, i);
            i += 2;
            continue;
        }
        let (step, used) = step(&args, i, find)?;
        push_step(&mut block, step);
        i += used;
    }
    builder.close(&args, &mode, &block)?;
    let spec = builder.finish();
    check_finite(&args, &spec)?;
    Ok(spec)
}

struct Builder {
    spec: TransformSpec,
    /// Layer that receives further steps.
    open: Option<InstanceLayer>,
}

impl Builder {
    fn close(&mut self, args: &Args<'_>, mode: &(Repeat, usize), block: &[MotionStep]) -> Result<()> {
        let (repetition, at) = mode;
        let moving = block.iter().any(|step| matches!(step, MotionStep::Along(_)));
        let too_many =
            || args.fault_at(*at, ImportFault::TooMany { what: "repeated paths in one `xf`", limit: MAX_STEPS });
        let length = block.len() as u64;
        match *repetition {
            Repeat::Array(n) if n > 1 => {
                // The steps of all copies together: 0 + 1 + .. + (n - 1) times the body.
                if moving && n.saturating_mul(n - 1).saturating_mul(length) / 2 > MAX_STEPS {
                    return Err(too_many());
                }
                let mut layer = match self.open.take() {
                    Some(layer) if layer.count == 1 => layer,
                    open => {
                        self.spec.layers.extend(open);
                        InstanceLayer::default()
                    }
                };
                layer.before.append(&mut layer.after);
                (layer.count, layer.body) = (n, block.to_vec());
                self.open = Some(layer);
            }
            Repeat::Array(_) => {}
            Repeat::Once => self.apply(block),
            Repeat::Times(n) => {
                if moving && n.saturating_mul(length) > MAX_STEPS {
                    return Err(too_many());
                }
                let mut steps = Vec::new();
                repeat(block, n, &mut steps);
                self.apply(&steps);
            }
        }
        Ok(())
    }

    fn apply(&mut self, steps: &[MotionStep]) {
        for &step in steps {
            match (&mut self.open, step) {
                (None, MotionStep::Static(t)) => self.spec.baked = t * self.spec.baked,
                (None, MotionStep::Along(_)) => {
                    self.open = Some(InstanceLayer { count: 1, after: vec![step], ..InstanceLayer::default() });
                }
                (Some(layer), step) => push_step(&mut layer.after, step),
            }
        }
    }

    fn finish(mut self) -> TransformSpec {
        self.spec.layers.extend(self.open);
        self.spec
    }
}

/// Parses one option at `i`. Returns the step and the number of fields used.
fn step(
    args: &Args<'_>,
    i: usize,
    find: &dyn Fn(&str) -> std::result::Result<PathId, ImportFault>,
) -> Result<(MotionStep, usize)> {
    let fixed = |matrix: DMat3, used: usize| {
        Ok((MotionStep::Static(Transform::from_mat3_translation(matrix, DVec3::ZERO)), used))
    };
    let angle = || require_fields(args, i, 1).and_then(|()| args.number(i + 1, "angle (degrees)")).map(sin_cos_degrees);
    let mirror = |x, y, z| fixed(DMat3::from_diagonal(DVec3::new(x, y, z)), 1);
    match args.raw(i) {
        b"-t" => {
            require_fields(args, i, 3)?;
            Ok((MotionStep::Static(Transform::from_translation(args.vector(i + 1, "translation (m)")?)), 4))
        }
        b"-rx" => angle().and_then(|(s, c)| fixed(rows([1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]), 2)),
        b"-ry" => angle().and_then(|(s, c)| fixed(rows([c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]), 2)),
        b"-rz" => angle().and_then(|(s, c)| fixed(rows([c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]), 2)),
        b"-s" => {
            require_fields(args, i, 1)?;
            let scale = args.number_in(i + 1, "scale factor", "not 0", |s| s != 0.0)?;
            fixed(DMat3::from_diagonal(DVec3::splat(scale)), 2)
        }
        b"-mx" => mirror(-1.0, 1.0, 1.0),
        b"-my" => mirror(1.0, -1.0, 1.0),
        b"-mz" => mirror(1.0, 1.0, -1.0),
        b"-path" => {
            require_fields(args, i, 1)?;
            let path = find(&args.text(i + 1)).map_err(|fault| args.fault_at(i + 1, fault))?;
            Ok((MotionStep::Along(path), 2))
        }
        _ => {
            let expected = "-t x y z, -rx a, -ry a, -rz a, -s f, -mx, -my, -mz, -i n, -a n or -path NAME";
            Err(args.fault_at(i, ImportFault::Unexpected { found: args.text(i).into_owned(), expected }))
        }
    }
}

/// Checks that `n` more fields follow the option at `i`.
fn require_fields(args: &Args<'_>, i: usize, n: usize) -> Result<()> {
    let found = args.len() - i - 1;
    if found >= n {
        return Ok(());
    }
    let expected = if n == 3 { "three numbers" } else { "one argument" };
    Err(args.fault_at(i, ImportFault::ArgumentCount { entity: args.text(i).into_owned(), expected, found }))
}

fn rows(x: [f64; 3], y: [f64; 3], z: [f64; 3]) -> DMat3 {
    DMat3::from_cols_array_2d(&[x, y, z]).transpose()
}

/// Returns sine and cosine of an angle in degrees. They are exact at multiples of a right angle, so that rotated boxes stay boxes.
fn sin_cos_degrees(degrees: f64) -> (f64, f64) {
    let turn = elementary::double::fmod(degrees, 360.0);
    match if turn < 0.0 { turn + 360.0 } else { turn } {
        0.0 | 360.0 => (0.0, 1.0),
        90.0 => (1.0, 0.0),
        180.0 => (0.0, -1.0),
        270.0 => (-1.0, 0.0),
        rest => elementary::double::sin_cos(rest.to_radians()),
    }
}

fn check_finite(args: &Args<'_>, spec: &TransformSpec) -> Result<()> {
    let fixed = |steps: &[MotionStep]| {
        steps.iter().all(|step| match step {
            MotionStep::Static(t) => t.is_finite(),
            MotionStep::Along(_) => true,
        })
    };
    let finite = spec.baked.is_finite()
        && spec.layers.iter().all(|layer| [&layer.before, &layer.body, &layer.after].into_iter().all(|s| fixed(s)));
    if finite { Ok(()) } else { Err(args.fault(ImportFault::NotFinite { what: "the transform" })) }
}

/// Returns the fault of an undefined path.
pub(super) fn undefined_path(name: &str, nearest: Vec<String>) -> ImportFault {
    ImportFault::Undefined { kind: EntityKind::Path, name: name.to_owned(), nearest }
}

#[cfg(test)]
mod tests;
