//! Portals: regions of space through which much light comes along few ways, such as a gap or a spot that a lamp lights.
//!
//! Few rays of one leaf find such light, but the rays of all leaves together find it often. So the bright ways of all leaves are
//! treated as one set of lines, each of which passes through some portal or none. A portal is a normal distribution in space. The
//! lines determine its extent only across their directions (expectation maximization with missing data, \[dempster1977\]). Each
//! leaf then knows the direction of the portal.

use crate::bytes::{Reader, StepDecodeError, Writer};
use crate::fewer::fewer;
use femc_field::Lobe;
use femc_math::Frame;
use femc_math::elementary::{atan2, ln, sin_cos};
use femc_math::glam::{DMat3, DVec3, Vec3A};
use std::f64::consts::PI;

/// Maximum number of portals of a scene.
const MOST: usize = 6;
/// Number of cells of space along the longest side of the ways' bounds.
const CELLS: usize = 24;
/// Number of cells at which the search for portals starts, and number of iterations for each.
const SEEDS: usize = 6;
const TURNS: usize = 40;
/// Maximum number of ways for the search. If there are more, a selection represents all.
const WAYS: usize = 4096;
/// Minimum share of a portal in all light, and minimum number of its ways.
const LEAST: f64 = 0.01;
const FEW: usize = 12;
/// Number of ways through a portal from which on the leaves' own rays measure its light well enough.
const RARE: usize = 2048;
/// Maximum solid angle of a portal as seen from its ways' origins, as a share of the hemisphere.
const WIDE: f64 = 0.025;
/// Minimum mean information of a line about whether it passes through a portal, relative to lines in all directions, nats. In any
/// set of lines, some meet somewhere by chance.
const TOLD: f64 = 0.2;
/// Ratio of the width of a lobe to that of its portal. A gap has sharp edges, and light just inside them must not be missed.
const LOOSE: f32 = 2.0;
/// Squared distance from a portal's center, in standard deviations, up to which a line passes through it.
const NEAR: f64 = 6.0;

/// A bright way of light.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// Point where the light arrives, m.
    pub origin: DVec3,
    /// Unit direction toward the origin of the light.
    pub dir: DVec3,
    /// Length of the way, m.
    pub length: f64,
    /// Weight of the way.
    pub weight: f64,
}

/// A region of space through which light comes.
#[derive(Clone, Copy, Debug)]
pub struct Portal {
    /// Center, m.
    middle: DVec3,
    /// Covariance, m2, its inverse and its determinant.
    covariance: DMat3,
    inverse: DMat3,
    determinant: f64,
    /// Share of all lines that pass through it.
    share: f64,
    /// Number of bright ways through it, and their mean direction, from which the light comes.
    ways: usize,
    toward: DVec3,
}

/// Point of a line that is nearest to a portal.
struct Passage {
    /// Position, m, and its variance along the line, m2.
    place: DVec3,
    along: f64,
    /// Squared distance from the portal's center, in standard deviations.
    far: f64,
    /// Probability density over the area across the line, 1/m2, through the portal's center; and the density here relative to that.
    peak: f64,
    tail: f64,
}

impl Passage {
    /// Returns the probability density of the direction of a line through the portal's center, relative to a constant density over
    /// the hemisphere.
    fn over(&self, line: &Line) -> f64 {
        2.0 * PI * self.peak * self.place.distance_squared(line.origin)
    }
}

/// Returns a b^T.
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

impl Portal {
    fn new(middle: DVec3, covariance: DMat3, share: f64) -> Option<Self> {
        let determinant = covariance.determinant();
        let is_sound = middle.is_finite() && covariance.is_finite() && determinant > 0.0 && determinant.is_finite();
        let inverse = if is_sound { covariance.inverse() } else { DMat3::ZERO };
        (is_sound && inverse.is_finite()).then_some(Self {
            middle,
            covariance,
            inverse,
            determinant,
            share,
            ways: 0,
            toward: DVec3::ZERO,
        })
    }

    fn passage(&self, line: &Line) -> Passage {
        let ahead = self.inverse * line.dir;
        let along = 1.0 / line.dir.dot(ahead).max(f64::MIN_POSITIVE);
        let at = (ahead.dot(self.middle - line.origin) * along).clamp(0.0, line.length);
        let place = line.origin + line.dir * at;
        let off = place - self.middle;
        let far = off.dot(self.inverse * off).max(0.0);
        // (1 + q)^-3 with q = 1 at root two standard deviations, as in the lobes.
        let tail = 1.0 / (1.0 + 0.5 * far);
        let across = (self.determinant / along).max(f64::MIN_POSITIVE).sqrt();
        Passage { place, along, far, peak: 1.0 / (PI * across), tail: tail * tail * tail }
    }

    /// Checks whether rays have seldom found it.
    pub fn is_rare(&self) -> bool {
        self.ways < RARE
    }

    /// Checks whether a way passes through it.
    pub fn has(&self, origin: Vec3A, target: Vec3A) -> bool {
        let way = (target - origin).as_dvec3();
        let length = way.length();
        let line = Line { origin: origin.as_dvec3(), dir: way / length, length, weight: 0.0 };
        length > 0.0 && self.passage(&line).far < NEAR
    }

    /// Returns the lobe of the portal as seen from a point, if the portal is in front of a plane there and light comes from behind
    /// it.
    pub fn lobe(&self, point: Vec3A, normal: Vec3A, share: f32) -> Option<Lobe> {
        let target = self.middle.as_vec3a();
        let way = target - point;
        let distance = way.length();
        if way.dot(normal) <= 0.0 || way.as_dvec3().dot(self.toward) <= 0.0 || distance <= 0.0 {
            return None;
        }
        let frame = Frame::from_normal(way / distance);
        let [x, y] = [Vec3A::X, Vec3A::Y].map(|axis| frame.to_world(axis));
        let of = |a: Vec3A, b: Vec3A| a.as_dvec3().dot(self.covariance * b.as_dvec3()) as f32;
        let (a, b, c) = (of(x, x), of(x, y), of(y, y));
        let turn = 0.5 * atan2(2.0 * b, a - c);
        let (sin, cos) = sin_cos(turn);
        let long = a * cos * cos + 2.0 * b * sin * cos + c * sin * sin;
        let axes = [(x * cos + y * sin, long), (y * cos - x * sin, a + c - long)]
            .map(|(axis, square)| axis * LOOSE * (2.0 * square.max(1e-6 * distance * distance)).sqrt());
        Some(Lobe { target, axes, share })
    }

    /// Fits the portal to the lines that pass through it. Also returns the gain in the likelihood of the lines.
    fn again(&self, lines: &[Line], least: f64) -> Option<(Self, f64)> {
        let (mut sum, mut whole, mut gain) = (0.0, 0.0, 0.0);
        let (mut weights, mut places, mut squares) = (0.0, DVec3::ZERO, DMat3::ZERO);
        for line in lines {
            let passage = self.passage(line);
            let through = self.share * passage.over(line) * passage.tail;
            let likelihood = through + 1.0 - self.share;
            let amount = line.weight * through / likelihood;
            gain += line.weight * f64::from(ln(likelihood as f32));
            (sum, whole) = (sum + amount, whole + line.weight);
            // Distant lines count less.
            let weight = amount / (1.0 + 0.5 * passage.far);
            let off = passage.place - self.middle;
            weights += weight;
            places += off * weight;
            squares += (outer(off, off) + outer(line.dir, line.dir) * passage.along) * weight;
        }
        if !(weights > 0.0 && whole > 0.0) {
            return None;
        }
        let mean = places / weights;
        let covariance = squares * (1.0 / weights) - outer(mean, mean) + DMat3::from_diagonal(DVec3::splat(least));
        let share = (sum / whole).clamp(1e-6, 0.999);
        Some((Self::new(self.middle + mean, covariance, share)?, gain))
    }

    /// Checks whether it has enough of the lines, and of their light, for its width.
    fn is_narrow(&self, lines: &[Line], least: f64) -> bool {
        let (mut number, mut light, mut pool, mut wide) = (0, 0.0, 0.0, 0.0);
        for line in lines {
            pool += line.weight;
            let passage = self.passage(line);
            if passage.far < NEAR {
                let own = (1.0 / passage.over(line)).min(1.0);
                (number, light, wide) = (number + 1, light + line.weight, wide + line.weight * own);
            }
        }
        // Mean share of the hemisphere over the lines: of the density's center, and of the region that counts as near.
        let wide = wide / light;
        let (share, even) = (light / pool, (NEAR * wide).min(0.5));
        let told = f64::from(ln((share / even) as f32)) * share
            + f64::from(ln(((1.0 - share).max(1e-6) / (1.0 - even)) as f32)) * (1.0 - share);
        number >= FEW && light >= least && wide < WIDE && share > even && told > TOLD
    }
}

/// Finds the portals of a scene, the one with the most information about the bright ways first.
/// - `whole`: weight of all ways, including dim ones.
pub fn find(all: &[Line], whole: f64) -> Vec<Portal> {
    let mut lines = standing_for(all);
    let mut out = Vec::new();
    while out.len() < MOST {
        let Some(grid) = Grid::new(&lines) else { break };
        let found = grid.seeds(&lines).into_iter().filter_map(|middle| {
            let start = DMat3::from_diagonal(DVec3::splat(grid.cell * grid.cell));
            let mut portal = Portal::new(middle, start, 0.1)?;
            let mut gain = 0.0;
            for _ in 0..TURNS {
                (portal, gain) = portal.again(&lines, 1e-4 * grid.cell * grid.cell)?;
            }
            Some((portal, gain))
        });
        let narrow = found.filter(|(portal, _)| portal.is_narrow(&lines, LEAST * whole));
        let best = narrow.fold(None::<(Portal, f64)>, |best, it| match best {
            Some(best) if best.1 >= it.1 => Some(best),
            _ => Some(it),
        });
        let Some((portal, _)) = best else { break };
        lines.retain(|line| portal.passage(line).far >= NEAR);
        let through: Vec<&Line> = all.iter().filter(|line| portal.passage(line).far < NEAR).collect();
        let toward = through.iter().map(|line| line.dir).sum();
        out.push(Portal { ways: through.len(), toward, ..portal });
    }
    out
}

/// Writes portals, exact to the bit.
pub fn write(portals: &[Portal], writer: &mut Writer) {
    writer.number(portals.len() as u64);
    for Portal { middle, covariance, share, ways, toward, .. } in portals {
        writer.number(*ways as u64);
        let numbers = [*share].into_iter().chain(middle.to_array()).chain(toward.to_array());
        numbers.chain(covariance.to_cols_array()).for_each(|number| writer.number(number.to_bits()));
    }
}

/// Reads the output of [`write`].
/// - errors: it is damaged.
pub fn read(reader: &mut Reader) -> Result<Vec<Portal>, StepDecodeError> {
    let count = reader.number()?;
    if count > MOST as u64 {
        return Err(StepDecodeError::Damaged("it has too many portals"));
    }
    let read = |_| {
        let ways = usize::try_from(reader.number()?).map_err(|_| WRONG)?;
        let mut numbers = [0.0; 16];
        for number in &mut numbers {
            *number = f64::from_bits(reader.number()?);
        }
        let [share, x, y, z, a, b, c, ref covariance @ ..] = numbers;
        let portal = Portal::new(DVec3::new(x, y, z), DMat3::from_cols_array(covariance), share).ok_or(WRONG)?;
        let toward = DVec3::new(a, b, c);
        let is_sound = toward.is_finite() && (0.0..=1.0).contains(&share);
        is_sound.then_some(Portal { ways, toward, ..portal }).ok_or(WRONG)
    };
    (0..count).map(read).collect()
}

const WRONG: StepDecodeError = StepDecodeError::Damaged("a portal has invalid numbers");

/// Selects at most [`WAYS`] lines that represent all. None weighs more than a hundredth of the total.
fn standing_for(lines: &[Line]) -> Vec<Line> {
    let most = 0.01 * lines.iter().map(|line| line.weight).sum::<f64>();
    let few = fewer(lines, WAYS, |line| line.weight.min(most));
    few.into_iter().map(|(line, weight)| Line { weight, ..line }).collect()
}

/// Space divided into cells.
struct Grid {
    low: DVec3,
    /// Edge of a cell, m.
    cell: f64,
    counts: [usize; 3],
}

impl Grid {
    fn new(lines: &[Line]) -> Option<Self> {
        let ends = lines.iter().flat_map(|line| [line.origin, line.origin + line.dir * line.length]);
        let (low, high) =
            ends.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), at| (low.min(at), high.max(at)));
        let cell = (high - low).max_element() / CELLS as f64;
        let is_sound = lines.len() >= FEW && low.is_finite() && high.is_finite() && cell > 0.0;
        let counts = ((high - low) / cell).to_array().map(|count| (count as usize + 1).min(CELLS + 1));
        is_sound.then_some(Self { low, cell, counts })
    }

    /// Returns the centers of cells that many lines pass through, far from where these arrive. No two cells are adjacent.
    fn seeds(&self, lines: &[Line]) -> Vec<DVec3> {
        let mut cells = vec![0.0f64; self.counts.iter().product()];
        let place = |index: usize| {
            let (x, y, z) = (
                index % self.counts[0],
                index / self.counts[0] % self.counts[1],
                index / self.counts[0] / self.counts[1],
            );
            [x, y, z].map(|at| at as i64)
        };
        for line in lines {
            let steps = ((2.0 * line.length / self.cell) as usize).clamp(1, 8 * CELLS);
            let mut last = usize::MAX;
            for step in 1..=steps {
                let part = step as f64 / steps as f64;
                let at = ((line.origin + line.dir * (line.length * part) - self.low) / self.cell).to_array();
                let at = [0, 1, 2].map(|axis| (at[axis].max(0.0) as usize).min(self.counts[axis] - 1));
                let index = at[0] + self.counts[0] * (at[1] + self.counts[1] * at[2]);
                if index != last {
                    cells[index] += line.weight * part * part;
                }
                last = index;
            }
        }
        let mut order: Vec<usize> = (0..cells.len()).filter(|&index| cells[index] > 0.0).collect();
        order.sort_by(|&a, &b| cells[b].total_cmp(&cells[a]).then(a.cmp(&b)));
        let mut seeds: Vec<[i64; 3]> = Vec::new();
        for index in order {
            let at = place(index);
            let is_near = |other: &[i64; 3]| (0..3).all(|axis| (other[axis] - at[axis]).abs() <= 2);
            if !seeds.iter().any(is_near) {
                seeds.push(at);
            }
            if seeds.len() == SEEDS {
                break;
            }
        }
        seeds.iter().map(|at| self.low + DVec3::from_array(at.map(|at| at as f64 + 0.5)) * self.cell).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a generator of numbers in [0, 1).
    fn numbers() -> impl FnMut() -> f64 {
        let mut state = 1u64;
        move || {
            state = femc_math::hash::mix64(state.wrapping_add(0x9e37_79b9_7f4a_7c15));
            f64::from(femc_math::hash::unit_f32((state >> 32) as u32))
        }
    }

    fn line(origin: DVec3, target: DVec3) -> Line {
        let way = target - origin;
        Line { origin, dir: way.normalize(), length: way.length(), weight: 1.0 }
    }

    /// Ways from a floor of 4 m through a slot of 6 cm by 2 m to a wall behind it, and the same number of random ways.
    #[test]
    fn a_slot_is_found_among_other_ways() {
        let mut number = numbers();
        let mut lines = Vec::new();
        for _ in 0..300 {
            let origin = DVec3::new(-4.0 * number(), 4.0 * number() - 2.0, 0.0);
            let slot = DVec3::new(0.0, 0.3 + 0.06 * number(), 2.0 * number());
            lines.push(line(origin, origin + (slot - origin) * (1.5 + number())));
            let other = DVec3::new(4.0 * number() - 4.0, 4.0 * number() - 2.0, 2.5);
            lines.push(line(DVec3::new(-4.0 * number(), 4.0 * number() - 2.0, 0.0), other));
        }
        let portals = find(&lines, 1000.0);
        let portal = portals[0];
        assert!((portal.middle - DVec3::new(0.0, 0.33, 1.0)).abs().max_element() < 0.15, "{portal:?}");
        let deviation = [0, 1, 2].map(|axis| portal.covariance.col(axis)[axis].sqrt());
        assert!(deviation[0] < 0.05 && deviation[1] < 0.05, "{deviation:?}");
        assert!((0.4..0.8).contains(&deviation[2]), "{deviation:?}");
        assert!((280..=330).contains(&portal.ways) && portal.is_rare(), "{}", portal.ways);
        let mut writer = Writer::new(b"portals1");
        write(&portals, &mut writer);
        let bytes = writer.finish();
        let again = read(&mut Reader::new(&bytes, b"portals1").unwrap()).unwrap();
        assert_eq!(format!("{again:?}"), format!("{portals:?}"));
        // From the side it is as wide as from the front: the lobe is perpendicular to the view.
        for point in [Vec3A::new(-3.0, -1.5, 0.0), Vec3A::new(-0.5, 0.3, 0.0)] {
            let lobe = portal.lobe(point, Vec3A::Z, 1.0).expect("in front");
            assert!(lobe.axes.iter().all(|axis| axis.dot(lobe.target - point).abs() < 1e-3), "{lobe:?}");
        }
        assert!(portal.lobe(Vec3A::new(-1.0, 0.0, 2.5), Vec3A::Z, 1.0).is_none(), "behind a ceiling's back");
    }

    /// Returns a way from a floor of 4 m, in a cosine-distributed direction, to the wall or ceiling of the room above it.
    fn any(number: &mut impl FnMut() -> f64) -> Line {
        let origin = DVec3::new(4.0 * number(), 4.0 * number(), 0.0);
        let radius = number().sqrt();
        let (sin, cos) = sin_cos((2.0 * PI * number()) as f32);
        let rise = (1.0 - radius * radius).max(1e-9).sqrt();
        let dir = DVec3::new(radius * f64::from(cos), radius * f64::from(sin), rise);
        let room = DVec3::new(4.0, 4.0, 3.0);
        let out =
            (0..3).map(|axis| (if dir[axis] > 0.0 { room[axis] - origin[axis] } else { -origin[axis] }) / dir[axis]);
        line(origin, origin + dir * out.fold(f64::INFINITY, f64::min))
    }

    #[test]
    fn ways_that_meet_nowhere_have_no_portal() {
        let mut number = numbers();
        let lines: Vec<Line> = (0..1000).map(|_| any(&mut number)).collect();
        assert!(find(&lines, 1000.0).is_empty());
        assert!(find(&[], 1.0).is_empty());
        let same = vec![line(DVec3::ZERO, DVec3::X); 100];
        assert!(find(&same, 100.0).len() <= 1, "lines that are all the same are no fault");
    }

    /// A way that is far brighter than the rest weighs no more than a hundredth, so no portal is made of one way.
    #[test]
    fn one_way_makes_no_portal() {
        let mut number = numbers();
        let mut lines: Vec<Line> = (0..500).map(|_| any(&mut number)).collect();
        lines[7].weight = 1e6;
        assert!(find(&lines, 1e6).is_empty());
    }
}
