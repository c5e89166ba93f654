//! A flat list of lights, stored in vectors and weighted all at once.

use super::approx::inverse_cos_power;
use crate::tree::Node;
use femc_math::glam::Vec3A;
use femc_simd::{Kernel, Lanes, Level, Simd, Vector, WIDTH};

/// Maximum number of lights that are weighted individually.
pub const MAX_LIGHTS: usize = 128;
/// Tolerance of cosines of bounds, so that rounding does not lose a light.
const COSINE_TOLERANCE: f32 = 1e-3;
/// Maximum weight, which keeps the sum of all weights finite.
const MAX_WEIGHT: f32 = 1e30;

/// Eight lights. In unused lanes, the intensity is 0.
#[derive(Clone, Debug)]
struct Block {
    center: [Lanes; 3],
    radius: Lanes,
    axis: [Lanes; 3],
    /// Tolerance for the distance of the middle from the border plane of the light's visible half-space: the radius, or 0 for a
    /// flat light.
    border: Lanes,
    /// Intensity at the peak of the profile, cd.
    intensity: Lanes,
    exponent: Lanes,
    cos_normals: Lanes,
    sin_normals: Lanes,
    /// Mask of the two-sided lights.
    two_sided: Lanes,
    omnidirectional: Lanes,
    extinction: Lanes,
    /// Whether each light is flat, or sends light everywhere.
    all_flat: bool,
    /// Whether the intensity of each light follows the cosine itself.
    all_lambertian: bool,
}

/// Converts a flag to a mask lane.
fn mask(is_set: bool) -> f32 {
    f32::from_bits(if is_set { u32::MAX } else { 0 })
}

impl Block {
    fn new(lights: &[Node]) -> Self {
        let lanes = |value: &dyn Fn(&Node) -> f32| Lanes(std::array::from_fn(|k| lights.get(k).map_or(0.0, value)));
        let vector = |value: &dyn Fn(&Node) -> Vec3A| [0, 1, 2].map(|axis| lanes(&|light| value(light)[axis]));
        Self {
            center: vector(&|light| light.center),
            radius: lanes(&|light| light.radius),
            axis: vector(&|light| light.axis),
            border: lanes(&|light| if light.cos_normals >= 1.0 { 0.0 } else { light.radius }),
            intensity: lanes(&|light| light.intensity.min(MAX_WEIGHT)),
            exponent: lanes(&|light| light.exponent),
            cos_normals: lanes(&|light| light.cos_normals),
            sin_normals: lanes(&|light| light.sin_normals),
            two_sided: lanes(&|light| mask(light.two_sided)),
            omnidirectional: lanes(&|light| mask(light.is_omnidirectional())),
            extinction: lanes(&|light| light.extinction),
            all_flat: lights.iter().all(|light| light.cos_normals >= 1.0 || light.is_omnidirectional()),
            all_lambertian: lights.iter().all(|light| light.exponent <= 1.0 || light.is_omnidirectional()),
        }
    }
}

/// The lights in blocks of eight.
#[derive(Clone, Debug)]
pub struct LightBlocks {
    blocks: Vec<Block>,
    level: Level,
}

/// Weights of the lights for one place.
#[derive(Clone, Debug)]
pub struct LaneWeights {
    lanes: [Lanes; MAX_LIGHTS / WIDTH],
    /// Sum of the lanes of each block.
    sums: [f64; MAX_LIGHTS / WIDTH],
    blocks: usize,
    total: f64,
}

impl Default for LaneWeights {
    fn default() -> Self {
        Self { lanes: [Lanes::ZERO; MAX_LIGHTS / WIDTH], sums: [0.0; MAX_LIGHTS / WIDTH], blocks: 0, total: 0.0 }
    }
}

impl LaneWeights {
    fn finish(&mut self, blocks: usize) {
        self.blocks = blocks;
        self.total = 0.0;
        for (sum, lanes) in self.sums.iter_mut().zip(&self.lanes[..blocks]) {
            let l = lanes.0.map(f64::from);
            *sum = ((l[0] + l[1]) + (l[2] + l[3])) + ((l[4] + l[5]) + (l[6] + l[7]));
            self.total += *sum;
        }
    }

    /// Draws a light with `u` in [0, 1). Returns its number, probability > 0, and the remainder of `u` rescaled to [0, 1); `None`
    /// if no light has a weight.
    #[inline]
    pub fn choose(&self, u: f64) -> Option<(usize, f32, f32)> {
        let mut rest = u * self.total;
        let mut chosen = None;
        for (block, &sum) in self.sums[..self.blocks].iter().enumerate() {
            if sum > 0.0 {
                chosen = Some((block, rest));
                if rest < sum {
                    break;
                }
            }
            rest -= sum;
        }
        let (block, mut rest) = chosen?;
        let mut light = None;
        for (lane, &weight) in self.lanes[block].0.iter().enumerate() {
            let weight = f64::from(weight);
            if weight > 0.0 {
                light = Some((block * WIDTH + lane, weight));
                if rest < weight {
                    break;
                }
            }
            rest -= weight;
        }
        let (light, weight) = light?;
        let left = (rest / weight).clamp(0.0, 1.0 - f64::from(f32::EPSILON)) as f32;
        Some((light, (weight / self.total) as f32, left)).filter(|&(_, probability, _)| probability > 0.0)
    }

    /// Checks whether no light has a weight.
    pub fn is_zero(&self) -> bool {
        self.total <= 0.0
    }

    /// Returns the probability with which [`Self::choose`] draws a light.
    #[inline]
    pub fn probability(&self, light: usize) -> f32 {
        let weight = f64::from(self.lanes[light / WIDTH].0[light % WIDTH]);
        if weight > 0.0 { (weight / self.total) as f32 } else { 0.0 }
    }
}

impl LightBlocks {
    pub fn new(lights: &[Node]) -> Self {
        debug_assert!(lights.len() <= MAX_LIGHTS);
        Self { blocks: lights.chunks(WIDTH).map(Block::new).collect(), level: Level::detect() }
    }

    /// Returns the list for plain arrays, for tests.
    #[cfg(test)]
    pub fn portable(self) -> Self {
        Self { level: Level::PORTABLE, ..self }
    }

    /// Computes the weight of every light for a place.
    #[inline]
    pub fn weigh<W: Weigh>(&self, context: &W, out: &mut LaneWeights) {
        self.level.run(WeighKernel { blocks: &self.blocks, context, out });
    }

    /// Returns the instruction set that is used.
    pub fn level(&self) -> Level {
        self.level
    }

    /// Sums over the lights their probability in `weights`, times a function of their middle and radius.
    #[inline]
    pub fn mixture<M: MixtureComponent>(&self, weights: &LaneWeights, component: &M) -> f32 {
        self.level.run(MixtureKernel { blocks: &self.blocks, weights, component })
    }
}

/// A place that computes the weights of lights.
pub trait Weigh {
    /// Returns the weights of eight lights, >= 0; 0 only if a light can send nothing. `#[inline(always)]`.
    fn weigh<S: Simd>(&self, simd: S, lights: &LightLanes<S>) -> S::V;
}

/// A function of a light's middle and radius.
pub trait MixtureComponent {
    /// Returns the values for eight lights' middles. `#[inline(always)]`.
    fn value<S: Simd>(&self, simd: S, center: [S::V; 3], radius: S::V) -> S::V;
}

/// Eight lights, loaded into vectors.
pub struct LightLanes<S: Simd> {
    simd: S,
    pub center: [S::V; 3],
    pub radius: S::V,
    pub axis: [S::V; 3],
    border: S::V,
    pub intensity: S::V,
    exponent: S::V,
    cos_normals: S::V,
    sin_normals: S::V,
    two_sided: S::V,
    omnidirectional: S::V,
    /// Extinction of the media around each light, 1/m.
    pub extinction: S::V,
    all_flat: bool,
    all_lambertian: bool,
}

impl<S: Simd> LightLanes<S> {
    #[inline(always)]
    fn new(simd: S, block: &Block) -> Self {
        let load = |lanes: &Lanes| simd.load(lanes);
        let vector = |lanes: &[Lanes; 3]| [load(&lanes[0]), load(&lanes[1]), load(&lanes[2])];
        Self {
            simd,
            center: vector(&block.center),
            radius: load(&block.radius),
            axis: vector(&block.axis),
            border: load(&block.border),
            intensity: load(&block.intensity),
            exponent: load(&block.exponent),
            cos_normals: load(&block.cos_normals),
            sin_normals: load(&block.sin_normals),
            two_sided: load(&block.two_sided),
            omnidirectional: load(&block.omnidirectional),
            extinction: load(&block.extinction),
            all_flat: block.all_flat,
            all_lambertian: block.all_lambertian,
        }
    }

    /// Returns an upper estimate of the fraction of the intensity that is sent in directions from the light whose cosine with its
    /// axis is `cos`; 0 only if nothing is sent there. `inverse` is one over the distance, 1/m. The result is a numerator and a
    /// denominator, because a division costs more than all the rest.
    #[inline(always)]
    pub fn profile(&self, cos: S::V, inverse: S::V) -> [S::V; 2] {
        let c = |x| self.simd.splat(x);
        let (zero, one) = (c(0.0), c(1.0));
        let cos = self.two_sided.select(cos.max(zero - cos), cos).min(one);
        let subtended = (self.radius * inverse).min(one);
        let (off, border) = if self.all_flat {
            (cos, zero)
        } else {
            let sin = (one - cos * cos).max(zero).sqrt();
            let off = self.cos_normals.le(cos).select(one, cos * self.cos_normals + sin * self.sin_normals);
            (off, (self.border * inverse).min(one))
        };
        let is_seen = c(-COSINE_TOLERANCE).lt(off + border);
        // A near light has parts that are seen under a better angle than its middle.
        let cos = (off.max(zero) + c(0.5) * subtended).min(one).max(c(COSINE_TOLERANCE));
        let whole = self.omnidirectional;
        let numerator = whole.select(one, is_seen.select(cos, zero));
        if self.all_lambertian {
            return [numerator, one];
        }
        [numerator, whole.select(one, inverse_cos_power(self.simd, cos, self.exponent - one))]
    }

    /// Returns the mask of the lights that send light to `a`, to `b`, or to a point between them; both are relative to the lights'
    /// middles.
    #[inline(always)]
    pub fn faces(&self, a: [S::V; 3], b: [S::V; 3]) -> S::V {
        let c = |x| self.simd.splat(x);
        let (front, behind) = (dot(self.axis, a), dot(self.axis, b));
        let reach = dot(a, a).max(dot(b, b)).sqrt() * c(COSINE_TOLERANCE) + self.border;
        let most = front.max(behind);
        let most = self.two_sided.select(most.max(c(0.0) - front.min(behind)), most);
        let wide = self.cos_normals.lt(c(1.0));
        (c(0.0) - reach).lt(most) | wide
    }
}

#[inline(always)]
pub fn dot<V: Vector>(a: [V; 3], b: [V; 3]) -> V {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub fn subtract<V: Vector>(a: [V; 3], b: [V; 3]) -> [V; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Computes `a + b scale`.
#[inline(always)]
pub fn add_scaled<V: Vector>(a: [V; 3], b: [V; 3], scale: V) -> [V; 3] {
    [a[0] + b[0] * scale, a[1] + b[1] * scale, a[2] + b[2] * scale]
}

/// Copies a vector to all lanes.
#[inline(always)]
pub fn splat<S: Simd>(simd: S, v: Vec3A) -> [S::V; 3] {
    [simd.splat(v.x), simd.splat(v.y), simd.splat(v.z)]
}

struct WeighKernel<'a, W> {
    blocks: &'a [Block],
    context: &'a W,
    out: &'a mut LaneWeights,
}

impl<W: Weigh> Kernel for WeighKernel<'_, W> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        for (block, out) in self.blocks.iter().zip(&mut self.out.lanes) {
            let weights = self.context.weigh(simd, &LightLanes::new(simd, block));
            *out = weights.max(simd.splat(0.0)).min(simd.splat(MAX_WEIGHT)).lanes();
        }
        self.out.finish(self.blocks.len());
    }
}

struct MixtureKernel<'a, M> {
    blocks: &'a [Block],
    weights: &'a LaneWeights,
    component: &'a M,
}

impl<M: MixtureComponent> Kernel for MixtureKernel<'_, M> {
    type Output = f32;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> f32 {
        let mut sum = simd.splat(0.0);
        for (block, weights) in self.blocks.iter().zip(&self.weights.lanes) {
            let center = [simd.load(&block.center[0]), simd.load(&block.center[1]), simd.load(&block.center[2])];
            let weights = simd.load(weights);
            let value = simd
                .splat(0.0)
                .lt(weights)
                .select(weights * self.component.value(simd, center, simd.load(&block.radius)), simd.splat(0.0));
            sum = sum + value;
        }
        let l = sum.lanes().0;
        let sum = ((l[0] + l[1]) + (l[2] + l[3])) + ((l[4] + l[5]) + (l[6] + l[7]));
        if self.weights.total > 0.0 { (f64::from(sum) / self.weights.total) as f32 } else { 0.0 }
    }
}
