//! Fit of lobes to the ways along which light arrives.
//!
//! The ways are split in two, and the parts again, each time where the split raises the likelihood of the ways most. The likelihood
//! assumes that each part's light is spread evenly over the directions that it fills, so narrow bright bundles separate from wide
//! dim ones. Each part becomes a lobe, centered where its ways fill the least solid angle. Then each way is assigned to the lobe
//! that samples it with the greatest density, and the lobes are fitted again.

use crate::fewer::fewer;
use crate::portals::Portal;
use femc_field::{Block, Directions, HALF, LOBES, Lobe};
use femc_math::Frame;
use femc_math::elementary::{atan2, ln, sin_cos};
use femc_math::glam::{Vec3A, Vec4};
use std::array;
use std::cell::OnceCell;

/// Distance of the nearest candidate for a lobe's center, relative to that of its ways' ends, and number of steps from there to
/// these.
const NEAREST: f32 = 0.15;
const DEPTHS: u32 = 17;
/// Number of times that ways are assigned to lobes again.
const SETTLING: usize = 3;
/// Maximum number of ways for a fit. If there are more, a selection represents all.
const MOST: usize = 256;
/// Number of bins of a bundle's length along an axis, between which it may be split.
const BINS: usize = 16;
/// Minimum gain of a split, relative to all light, that justifies another lobe.
const GAIN: f32 = 0.005;
/// Weight of prior knowledge, in numbers of ways.
const PRIOR: f32 = 1.0;
/// Minimum effective number of ways through a portal that form a lobe without it. The effective number is that of equally bright
/// ways.
const MANY: f32 = 10.0;

/// Light along a way.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    /// Ends of the way, m.
    pub origin: Vec3A,
    pub target: Vec3A,
    /// Mean squared distance from the target across the view, m2.
    pub spread: f32,
    /// Irradiance.
    pub amount: f32,
}

/// Sums over the ways of a lobe, in a plane across its axis: positions there, and slopes.
#[derive(Clone, Copy, Debug, Default)]
struct Focus {
    amount: f32,
    squared: f32,
    place: [f32; 2],
    slope: [f32; 2],
    /// Sums of amount times the products of positions, of positions and slopes, and of slopes: for the first axis, both axes, the
    /// second axis.
    places: [f32; 3],
    both: [f32; 3],
    slopes: [f32; 3],
    /// Sums of amount times the way's own width at the target, and times its length.
    width: f32,
    distance: f32,
}

/// Returns the products of the components of two vectors, symmetrized.
fn products(a: [f32; 2], b: [f32; 2]) -> [f32; 3] {
    [a[0] * b[0], 0.5 * (a[0] * b[1] + a[1] * b[0]), a[1] * b[1]]
}

impl Focus {
    fn add(&mut self, part: &Part, center: Vec3A, frame: &Frame) {
        let dir = frame.to_local((part.target - part.origin).normalize_or(Vec3A::Z));
        let ahead = dir.z.max(0.2);
        let slope = [dir.x / ahead, dir.y / ahead];
        let from = frame.to_local(part.origin - center);
        let place = [from.x - slope[0] * from.z, from.y - slope[1] * from.z];
        let (amount, distance) = (part.amount, part.target.distance(part.origin));
        self.amount += amount;
        self.squared += amount * amount;
        let sums = [(&mut self.places, place, place), (&mut self.both, place, slope), (&mut self.slopes, slope, slope)];
        for (sum, a, b) in sums {
            sum.iter_mut().zip(products(a, b)).for_each(|(sum, of)| *sum += of * amount);
        }
        for axis in 0..2 {
            self.place[axis] += place[axis] * amount;
            self.slope[axis] += slope[axis] * amount;
        }
        self.width += amount * (part.spread / (distance * distance).max(f32::MIN_POSITIVE)).min(1.0);
        self.distance += amount * distance;
    }

    /// Returns the lobe centered where the ways fill the least solid angle as seen from the leaf: at a gap that all go through, or
    /// at a source.
    fn lobe(&self, center: Vec3A, frame: &Frame) -> Option<Lobe> {
        if self.amount <= 0.0 {
            return None;
        }
        let share = 1.0 / self.amount;
        let [place, slope] = [self.place, self.slope].map(|of| of.map(|sum| sum * share));
        let less = |sum: [f32; 3], mean: [f32; 3]| [0, 1, 2].map(|k| sum[k] * share - mean[k]);
        let places = less(self.places, products(place, place));
        let both = less(self.both, products(place, slope));
        let slopes = less(self.slopes, products(slope, slope));
        let (distance, width) = (self.distance * share, self.width * share);
        // Few ways do not determine their width well.
        let wider = 1.0 + 2.0 * PRIOR * self.squared / (self.amount * self.amount);
        // Covariance in the plane at a depth, from the ways' centers and their own widths.
        let at = |depth: f32| {
            let mut of = [0, 1, 2].map(|k| places[k] + 2.0 * depth * both[k] + depth * depth * slopes[k]);
            let own = 0.5 * depth * depth * width.max(1e-6);
            (of[0], of[2]) = (of[0].max(0.0) + own, of[2].max(0.0) + own);
            of.map(|sum| sum * wider)
        };
        let solid_angle = |depth: f32| {
            let [a, b, c] = at(depth);
            (a * c - b * b).max(0.0) / depth.powi(4)
        };
        let depths = (0..=DEPTHS).map(|k| distance * (NEAREST + (1.0 - NEAREST) * k as f32 / DEPTHS as f32));
        let (depth, _) = depths
            .map(|depth| (depth, solid_angle(depth)))
            .fold((distance, f32::INFINITY), |best, it| if it.1 < best.1 { it } else { best });
        let [a, b, c] = at(depth);
        // Principal axes.
        let turn = 0.5 * atan2(2.0 * b, a - c);
        let (sin, cos) = sin_cos(turn);
        let along = a * cos * cos + 2.0 * b * sin * cos + c * sin * sin;
        let across = (a + c - along).max(0.25 * depth * depth * width.max(1e-6));
        let axes = [(cos, sin, along), (-sin, cos, across)]
            .map(|(x, y, square)| frame.to_world(Vec3A::new(x, y, 0.0)) * (2.0 * square.max(f32::MIN_POSITIVE)).sqrt());
        let middle = Vec3A::new(place[0] + slope[0] * depth, place[1] + slope[1] * depth, depth);
        Some(Lobe { target: center + frame.to_world(middle), axes, share: self.amount })
    }
}

/// Fits lobes to ways that reach a leaf. `None` if there is no light.
/// - `center`: center of the leaf;
/// - `frame`: frame with its normal;
/// - `portals`: ways through a portal get a lobe there, even if they are few.
pub fn fit(parts: &[Part], center: Vec3A, frame: &Frame, portals: &[Portal]) -> Option<Vec<Lobe>> {
    let mut through = vec![[0.0f32; 2]; portals.len()];
    let mut rest = Vec::with_capacity(parts.len());
    for part in parts {
        match portals.iter().position(|portal| portal.has(part.origin, part.target)) {
            Some(at) => {
                through[at] = [through[at][0] + part.amount, through[at][1] + part.amount * part.amount];
                rest.push((Some(at), *part));
            }
            None => rest.push((None, *part)),
        }
    }
    // Enough ways describe the leaf better than the portal, which all leaves share.
    let lobe = |(portal, [amount, squares]): (&Portal, &[f32; 2])| {
        let is_known = amount * amount > MANY * squares;
        (!is_known && *amount > 0.0).then(|| portal.lobe(center, frame.normal, *amount)).flatten()
    };
    let fixed: Vec<Option<Lobe>> = portals.iter().zip(&through).map(lobe).collect();
    let is_free = |at: Option<usize>| at.is_none_or(|at| fixed[at].is_none());
    let parts: Vec<Part> = rest.into_iter().filter(|&(at, _)| is_free(at)).map(|(_, part)| part).collect();
    let fixed: Vec<Lobe> = fixed.into_iter().flatten().collect();
    let parts = fewer(&parts, MOST, |part| f64::from(part.amount));
    let parts = &parts.into_iter().map(|(part, amount)| Part { amount: amount as f32, ..part }).collect::<Vec<_>>();
    let places: Vec<Place> = parts.iter().filter_map(|part| Place::new(part, center, frame)).collect();
    let whole: f32 = places.iter().map(|place| place.part.amount).sum();
    if !(whole > 0.0 && whole.is_finite()) {
        return shares(fixed);
    }
    let most = if portals.is_empty() { HALF } else { LOBES };
    let mut bundles = vec![Bundle::new(places, 0.25)];
    while bundles.len() + fixed.len() < most {
        let gain = |k: usize| bundles[k].cut().map_or(0.0, |cut| cut.gain);
        let best = (1..bundles.len()).fold(0, |best, k| if gain(k) > gain(best) { k } else { best });
        let Some(cut) = bundles[best].cut().filter(|cut| cut.gain > GAIN * whole) else { break };
        let Bundle { places, area, .. } = bundles.swap_remove(best);
        let (places, rest) = places.into_iter().partition(|place| place.along[cut.axis] < cut.at);
        bundles.extend([places, rest].map(|places: Vec<Place>| Bundle::new(places, area)));
    }
    let mut lobes: Vec<Lobe> = bundles.iter().filter_map(|bundle| bundle.lobe(center)).collect();
    for _ in 0..SETTLING {
        let Some(settled) = shares(lobes.clone()).and_then(|lobes| settled(&lobes, parts, center)) else { break };
        lobes = settled;
    }
    lobes.extend(fixed);
    shares(lobes)
}

/// A way in the space of directions, by positions on the disk of the unit hemisphere seen along the normal. The density of the
/// cosine distribution is constant there.
#[derive(Clone, Copy, Debug)]
struct Place {
    part: Part,
    /// Coordinates along the axes on which bundles are split: x, y, x + y and x - y of the way's direction, and of the direction from
    /// the leaf's center to its target.
    along: [f32; AXES],
    moments: Moments,
}

impl Place {
    fn new(part: &Part, center: Vec3A, frame: &Frame) -> Option<Self> {
        let dirs = [part.target - part.origin, part.target - center].map(|way| frame.to_local(way.normalize_or_zero()));
        let amount = part.amount;
        if !(dirs[1].z > 0.0 && amount > 0.0) {
            return None;
        }
        let distance2 = part.target.distance_squared(part.origin).max(f32::MIN_POSITIVE);
        // Variance on the disk caused by the width of the way itself.
        let own = (0.5 * part.spread / distance2).clamp(1e-7, 0.25) * dirs[0].z.clamp(0.05, 1.0);
        let [x, y, u, v] = [dirs[0].x, dirs[0].y, dirs[1].x, dirs[1].y];
        let moments = [1.0, amount, own, x, y, x * x, x * y, y * y, u, v, u * u, u * v, v * v, 0.0, 0.0, 0.0];
        Some(Self {
            part: *part,
            along: [x, y, x + y, x - y, u, v, u + v, u - v],
            moments: array::from_fn(|k| Vec4::from_slice(&moments[4 * k..]) * amount),
        })
    }
}

/// Number of axes along which bundles are split: four on each disk.
const AXES: usize = 8;

/// Number of sums over positions, padded to whole vectors. Each is weighted by the amount: 1, the amount, the variance of the way
/// itself, and, by disk, x, y, xx, xy, yy.
const MOMENTS: usize = 16;
/// Sums of moments, in vectors.
type Moments = [Vec4; MOMENTS / 4];

/// Adds moments to sums of moments.
#[inline(always)]
fn add(sums: &mut Moments, moments: &Moments) {
    sums.iter_mut().zip(moments).for_each(|(sum, moment)| *sum += *moment);
}

/// Returns the part of the disk that positions with these moments fill. Few positions do not determine it well, so the area of the
/// bundle before the split counts as prior knowledge, with the weight of [`PRIOR`] positions.
#[inline(always)]
fn filled_area(moment: impl Fn(usize) -> f32, before: f32) -> f32 {
    let (amount, squared) = (moment(0), moment(1));
    let share = 1.0 / amount;
    let own = (moment(2) * share).max(1e-8);
    let square = |first: usize| {
        let [x, y, xx, xy, yy] = [0, 1, 2, 3, 4].map(|k| moment(first + k) * share);
        let [a, b, c] = [(xx - x * x).max(0.0) + own, xy - x * y, (yy - y * y).max(0.0) + own];
        (a * c - b * b).max(own * own)
    };
    let number = amount * amount / squared.max(f32::MIN_POSITIVE);
    (number * square(3).min(square(8)).sqrt() + PRIOR * before) / (number + PRIOR)
}

/// Returns the logarithm of the likelihood: of the amount over the part of the disk.
fn likelihood(amount: f32, area: f32) -> f32 {
    if amount <= f32::MIN_POSITIVE { 0.0 } else { amount * ln(amount / area) }
}

/// Best split of a bundle.
#[derive(Clone, Copy, Debug)]
struct Cut {
    axis: usize,
    /// Coordinate along the axis.
    at: f32,
    gain: f32,
}

struct Bundle {
    places: Vec<Place>,
    /// Sums of the places' moments.
    whole: [f32; MOMENTS],
    /// Part of the disk that they fill.
    area: f32,
    /// Best split, once it is known.
    cut: OnceCell<Option<Cut>>,
}

impl Bundle {
    /// Creates a bundle.
    /// - `area`: area of the bundle from which it was split.
    fn new(places: Vec<Place>, area: f32) -> Self {
        let mut sums = Moments::default();
        places.iter().for_each(|place| add(&mut sums, &place.moments));
        let whole: [f32; MOMENTS] = array::from_fn(|k| sums[k / 4][k % 4]);
        let area = if whole[0] > 0.0 { filled_area(|k| whole[k], area) } else { area };
        Self { places, whole, area, cut: OnceCell::new() }
    }

    /// Returns the best split. `None` if the bundle cannot be split.
    fn cut(&self) -> Option<Cut> {
        *self.cut.get_or_init(|| self.find_best_cut())
    }

    fn find_best_cut(&self) -> Option<Cut> {
        let (mut low, mut high) = ([f32::INFINITY; AXES], [f32::NEG_INFINITY; AXES]);
        for place in &self.places {
            for axis in 0..AXES {
                low[axis] = low[axis].min(place.along[axis]);
                high[axis] = high[axis].max(place.along[axis]);
            }
        }
        let widths: [f32; AXES] = array::from_fn(|axis| (high[axis] - low[axis]) / BINS as f32);
        let scales = widths.map(f32::recip);
        let mut bins = [[Moments::default(); BINS]; AXES];
        for place in &self.places {
            for axis in 0..AXES {
                // If all places have the same coordinate, the product is NaN, which becomes bin 0.
                let bin = ((place.along[axis] - low[axis]) * scales[axis]) as usize;
                add(&mut bins[axis][bin.min(BINS - 1)], &place.moments);
            }
        }
        let before = likelihood(self.whole[0], filled_area(|k| self.whole[k], self.area));
        let mut best: Option<Cut> = None;
        for axis in (0..AXES).filter(|&axis| widths[axis] > 0.0) {
            // Moments of the first bins and of the rest, by the number of first bins.
            let (mut first, mut rest) = ([[0.0f32; BINS]; MOMENTS], [[0.0f32; BINS]; MOMENTS]);
            for (moment, &whole) in self.whole.iter().enumerate() {
                let mut sum = 0.0;
                for (bin, moments) in bins[axis].iter().enumerate() {
                    sum += moments[moment / 4][moment % 4];
                    (first[moment][bin], rest[moment][bin]) = (sum, whole - sum);
                }
            }
            let (mut areas, mut rest_areas) = ([0.0; BINS], [0.0; BINS]);
            for bin in 0..BINS {
                areas[bin] = filled_area(|k| first[k][bin], self.area);
                rest_areas[bin] = filled_area(|k| rest[k][bin], self.area);
            }
            for bin in (0..BINS - 1).filter(|&bin| bins[axis][bin][0].x > 0.0) {
                let likelihoods = [(first[0][bin], areas[bin]), (rest[0][bin], rest_areas[bin])];
                let gain = likelihoods.into_iter().map(|(amount, area)| likelihood(amount, area)).sum::<f32>() - before;
                if best.is_none_or(|best| gain > best.gain) {
                    best = Some(Cut { axis, at: low[axis] + widths[axis] * (bin + 1) as f32, gain });
                }
            }
        }
        best.filter(|cut| cut.gain.is_finite())
    }

    fn lobe(&self, center: Vec3A) -> Option<Lobe> {
        let dir = |place: &Place| (place.part.target - place.part.origin).normalize_or_zero() * place.part.amount;
        let frame = Frame::from_normal(self.places.iter().map(dir).sum::<Vec3A>().normalize_or(Vec3A::Z));
        let mut focus = Focus::default();
        self.places.iter().for_each(|place| focus.add(&place.part, center, &frame));
        focus.lobe(center, &frame)
    }
}

/// Fits the lobes again, after assigning each way to the lobe that samples it with the greatest density.
fn settled(lobes: &[Lobe], parts: &[Part], center: Vec3A) -> Option<Vec<Lobe>> {
    let block = Block::new(lobes);
    let mut sums = [Focus::default(); LOBES];
    let frames: Vec<Frame> =
        lobes.iter().map(|lobe| Frame::from_normal((lobe.target - center).normalize_or(Vec3A::Z))).collect();
    for part in parts {
        let dir = (part.target - part.origin).normalize_or(Vec3A::Z);
        let Some(each) = Directions::new(&block, part.origin).non_empty().map(|directions| directions.each(dir)) else {
            continue;
        };
        let best = (0..lobes.len()).fold(0, |best, k| if each[k] > each[best] { k } else { best });
        sums[best].add(part, center, &frames[best]);
    }
    let lobes: Vec<Lobe> = sums.iter().zip(&frames).filter_map(|(sum, frame)| sum.lobe(center, frame)).collect();
    (!lobes.is_empty()).then_some(lobes)
}

/// Normalizes the shares of lobes. `None` if there is no light.
fn shares(lobes: Vec<Lobe>) -> Option<Vec<Lobe>> {
    let sum: f32 = lobes.iter().map(|lobe| lobe.share).sum();
    let is_axis = |axis: &Vec3A| axis.is_finite() && axis.length_squared() > 0.0;
    let is_sound = |lobe: &Lobe| lobe.target.is_finite() && lobe.axes.iter().all(is_axis);
    (sum > 0.0 && sum.is_finite() && lobes.iter().all(is_sound))
        .then(|| lobes.into_iter().map(|lobe| Lobe { share: lobe.share / sum, ..lobe }).collect())
}
