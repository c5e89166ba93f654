//! Participating media along a ray: intervals of constant coefficients, plus height-dependent fog. All have closed-form optical
//! depth, so transmittance is exact and distances are sampled by inversion.
//!
//! Overlapping media add up. Coefficients may differ by color channel. A distance is then sampled for one channel, and its density
//! is the mean over the channels. This keeps the estimator unbiased and its weights bounded.

use femc_geometry::Aabb;
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::elementary::{decay, decay_of_each, exp_m1, ln, ln_1p};
use femc_math::glam::{Affine3, Affine3A, Vec3A};
use femc_scattering::Phase;
use femc_scene::Medium;

/// Maximum distance along a ray, m. It replaces infinity in products that must stay finite.
pub const MAX_DISTANCE: f32 = 1e30;

/// Relative density of a medium over height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DensityProfile {
    /// 1 everywhere.
    Uniform,
    /// 1 below `z0`, `exp(-(z - z0) / scale)` above; prepared frame.
    Height {
        /// Height of full density, m.
        z0: f32,
        /// 1 / scale height, 1/m.
        inverse_scale: f32,
    },
}

/// A medium in the form that the kernels read.
#[derive(Clone, Debug)]
pub struct KernelMedium {
    /// Scattering coefficient at density 1, 1/m.
    pub sigma_s: Rgb,
    /// Extinction coefficient at density 1, 1/m.
    pub sigma_t: Rgb,
    /// Emitted radiance per meter at density 1, cd/m2/m.
    pub glow: Rgb,
    /// Phase function.
    pub phase: Phase,
    /// Density over height.
    pub profile: DensityProfile,
}

impl KernelMedium {
    fn scatters(&self) -> bool {
        self.sigma_s.max_element() > 0.0
    }

    fn density(&self, z: f32) -> f32 {
        match self.profile {
            DensityProfile::Uniform => 1.0,
            DensityProfile::Height { z0, inverse_scale } => decay(((z - z0) * inverse_scale).max(0.0)),
        }
    }

    /// Returns the integral of the density over [a, b] along a ray with heights `oz + dz t`, m.
    fn density_integral(&self, oz: f32, dz: f32, a: f32, b: f32) -> f32 {
        let DensityProfile::Height { z0, inverse_scale } = self.profile else { return b - a };
        // Split at the height of full density, then integrate an exponential over the part above it.
        let crossing = if dz != 0.0 { (z0 - oz) / dz } else { MAX_DISTANCE };
        let (below, above) = if dz > 0.0 {
            let c = crossing.clamp(a, b);
            (c - a, (c, b))
        } else if dz < 0.0 {
            let c = crossing.clamp(a, b);
            (b - c, (a, c))
        } else if oz < z0 {
            (b - a, (b, b))
        } else {
            (0.0, (a, b))
        };
        let length = above.1 - above.0;
        if length <= 0.0 {
            return below;
        }
        let start = decay(((oz + dz * above.0 - z0) * inverse_scale).max(0.0));
        let rate = dz * inverse_scale * length;
        let mean = if rate.abs() < 1e-3 { 1.0 - 0.5 * rate } else { -exp_m1(-rate) / rate };
        // On a descending ray far above the fog, `start` underflows while `mean` overflows, so measure from the dense end instead.
        if rate < -60.0 {
            let end = decay(((oz + dz * above.1 - z0) * inverse_scale).max(0.0));
            return below + end / (-dz * inverse_scale);
        }
        below + start * mean * length
    }
}

/// Region of a medium.
#[derive(Clone, Debug)]
enum Bounds {
    Everywhere,
    Box { to_local: Affine3A, min: Vec3A, max: Vec3A },
}

/// All media of a prepared frame.
#[derive(Clone, Debug, Default)]
pub struct Media {
    media: Vec<KernelMedium>,
    regions: Vec<(u16, Bounds)>,
    has_interior_media: bool,
    glows: bool,
}

/// Media of the closed objects that a path is inside: a multiset of medium indices.
#[derive(Clone, Copy, Debug, Default)]
pub struct MediumStack {
    media: [u16; Medium::MAX_NESTED],
    count: u8,
}

impl MediumStack {
    /// Enters `medium`. At most [`Medium::MAX_NESTED`] nested media are tracked. Deeper ones are ignored, which `femc check`
    /// reports.
    pub fn push(&mut self, medium: u16) {
        if let Some(slot) = self.media.get_mut(usize::from(self.count)) {
            *slot = medium;
            self.count += 1;
        }
    }

    /// Leaves `medium`. Has no effect if the path is not in it.
    pub fn remove(&mut self, medium: u16) {
        let n = usize::from(self.count);
        if let Some(i) = self.media[..n].iter().rposition(|&m| m == medium) {
            self.media.copy_within(i + 1..n, i);
            self.count -= 1;
        }
    }

    /// Checks whether the path is in no medium.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Iterates over the media, outermost first.
    pub fn iter(&self) -> impl Iterator<Item = u16> + '_ {
        self.media[..usize::from(self.count)].iter().copied()
    }
}

/// An interval of the ray with a constant set of media.
#[derive(Clone, Copy, Debug)]
struct Interval {
    start: f32,
    end: f32,
    /// Sum over the uniform media.
    sigma_t: Rgb,
    sigma_s: Rgb,
    /// Extinction of the uniform media that scatter. Distances are sampled by it.
    sampled_sigma_t: Rgb,
    glow: Rgb,
    /// First of the interval's media in `MediaRay::active`.
    first: u32,
    count: u32,
    /// Whether some medium varies with height.
    varies: bool,
}

/// Buffers of [`Media::find_intervals`], reused for all rays.
#[derive(Clone, Default)]
pub struct MediaRay {
    crossings: Vec<(f32, u32, i32)>,
    intervals: Vec<Interval>,
    active: Vec<u16>,
    present: Vec<u16>,
    oz: f32,
    dz: f32,
}

/// A scattering event on a ray.
#[derive(Clone, Copy, Debug)]
pub struct ScatterEvent {
    /// Distance, m.
    pub t: f32,
    /// Transmittance from the ray's origin times the scattering coefficient at `t`. [`Media::sample_distance`] divides it by the
    /// density of `t`; [`Media::event_at`] does not.
    pub weight: Rgb,
    /// Density of the distance, 1/m.
    pub pdf: f32,
    /// Interval of the event.
    interval: u32,
}

/// Outcome of sampling a distance.
#[derive(Clone, Copy, Debug)]
pub enum DistanceSample {
    /// A scattering event.
    Scatter(ScatterEvent),
    /// The ray passed through; the weight is transmittance / probability.
    Through {
        /// Transmittance to the end, divided by its probability.
        weight: Rgb,
    },
}

impl Media {
    /// Creates media, in order of their indices. `has_interior_media`: whether surfaces have media behind them (see
    /// [`MediumStack`]).
    pub fn new(media: Vec<KernelMedium>, has_interior_media: bool) -> Self {
        let glows = media.iter().any(|m| m.glow.max_element() > 0.0);
        Self { media, regions: Vec::new(), has_interior_media, glows }
    }

    /// Fills all space with `medium`.
    pub fn fill_everywhere(&mut self, medium: u16) {
        self.regions.push((medium, Bounds::Everywhere));
    }

    /// Fills a box with `medium`.
    pub fn fill_box(&mut self, medium: u16, to_local: Affine3A, min: Vec3A, max: Vec3A) {
        self.regions.push((medium, Bounds::Box { to_local, min, max }));
    }

    /// Returns whether no path can ever be in a medium.
    pub fn is_empty(&self) -> bool {
        self.regions.is_empty() && !self.has_interior_media
    }

    /// Returns whether some medium emits.
    pub fn glows(&self) -> bool {
        self.glows
    }

    /// Iterates over the media at a point, without those inside closed objects.
    fn media_at(&self, point: Vec3A) -> impl Iterator<Item = &KernelMedium> {
        let holds = move |bounds: &Bounds| match bounds {
            Bounds::Everywhere => true,
            Bounds::Box { to_local, min, max } => {
                let local = to_local.transform_point3a(point);
                local.cmpge(*min).all() && local.cmple(*max).all()
            }
        };
        self.regions.iter().filter(move |(_, bounds)| holds(bounds)).map(|&(m, _)| self.medium(m))
    }

    /// Returns the extinction at a point, 1/m, by luminance. Media inside closed objects do not count.
    pub fn extinction_at(&self, point: Vec3A) -> f32 {
        self.media_at(point).map(|medium| luminance(medium.sigma_t) * medium.density(point.z)).sum()
    }

    /// Returns the extinction at a point by channel, 1/m. Media inside closed objects do not count.
    pub fn extinction_color_at(&self, point: Vec3A) -> Rgb {
        self.media_at(point).map(|medium| medium.sigma_t * medium.density(point.z)).sum()
    }

    /// Returns bounds of the extinction in a box by channel, 1/m. Media inside closed objects do not count.
    pub fn extinction_bounds(&self, around: &Aabb) -> [Rgb; 2] {
        let mut bounds = [Rgb::ZERO; 2];
        for (medium, region) in &self.regions {
            let medium = self.medium(*medium);
            let (is_touched, is_inside) = match region {
                Bounds::Everywhere => (true, true),
                Bounds::Box { to_local, min, max } => {
                    let local = around.transformed(to_local);
                    (
                        local.max.cmpge(*min).all() && local.min.cmple(*max).all(),
                        local.min.cmpge(*min).all() && local.max.cmple(*max).all(),
                    )
                }
            };
            // Density decreases with height.
            bounds[0] += medium.sigma_t * if is_inside { medium.density(around.max.z) } else { 0.0 };
            bounds[1] += medium.sigma_t * if is_touched { medium.density(around.min.z) } else { 0.0 };
        }
        bounds
    }

    /// Returns the extinction if all media together are gray and uniform everywhere, 1/m. Media inside closed objects do not count.
    pub fn uniform_extinction(&self) -> Option<f32> {
        let even = |(medium, bounds): &(u16, Bounds)| {
            let medium = self.medium(*medium);
            let gray = medium.sigma_t.min_element() == medium.sigma_t.max_element();
            (matches!(bounds, Bounds::Everywhere) && medium.profile == DensityProfile::Uniform && gray)
                .then_some(medium.sigma_t.x)
        };
        self.regions.iter().map(even).sum()
    }

    /// Returns the scattering coefficient at a point, 1/m. Media inside closed objects do not count.
    pub fn scattering_at(&self, point: Vec3A) -> Rgb {
        self.media_at(point).map(|medium| medium.sigma_s * medium.density(point.z)).sum()
    }

    /// Returns the mean cosine between the propagation directions before and after scattering at a point, by luminance; 0 without
    /// fog. Media inside closed objects do not count.
    pub fn mean_cosine_at(&self, point: Vec3A) -> f32 {
        let (mut sum, mut all) = (0.0, 0.0);
        for medium in self.media_at(point) {
            let scattering = luminance(medium.sigma_s) * medium.density(point.z);
            (sum, all) = (sum + scattering * medium.phase.mean_cosine(), all + scattering);
        }
        if all > 0.0 { sum / all } else { 0.0 }
    }

    /// Returns bounds of the scattering media outside closed objects, if there are any.
    /// - `around`: bounds assumed for a medium that is everywhere, prepared frame, m.
    pub fn scattering_bounds(&self, around: Aabb) -> Option<Aabb> {
        let part = |(medium, bounds): &(u16, Bounds)| {
            let medium = self.medium(*medium);
            medium.scatters().then(|| match bounds {
                Bounds::Everywhere => around,
                Bounds::Box { to_local, min, max } => {
                    Aabb { min: *min, max: *max }.transformed(&Affine3A::from(Affine3::from(*to_local).inverse()))
                }
            })
        };
        self.regions.iter().filter_map(part).reduce(Aabb::union)
    }

    /// Returns the medium of an index.
    pub fn medium(&self, index: u16) -> &KernelMedium {
        &self.media[usize::from(index)]
    }

    /// Cuts the ray's [0, `t_max`] into intervals of constant media. Returns whether there is any medium on it.
    pub fn find_intervals(
        &self,
        origin: Vec3A,
        dir: Vec3A,
        t_max: f32,
        medium_stack: &MediumStack,
        out: &mut MediaRay,
    ) -> bool {
        let t_max = t_max.min(MAX_DISTANCE);
        out.intervals.clear();
        out.active.clear();
        out.present.clear();
        (out.oz, out.dz) = (origin.z, dir.z);
        if let [(medium, Bounds::Box { to_local, min, max })] = &self.regions[..]
            && medium_stack.is_empty()
        {
            // A single box and nothing else is by far the most common case.
            let Some((a, b)) = slab(to_local, origin, dir, *min, *max, t_max) else { return false };
            out.present.push(*medium);
            self.push_interval(a, b, out);
            return true;
        }
        out.crossings.clear();
        out.present.extend(medium_stack.iter());
        for (region, (medium, bounds)) in self.regions.iter().enumerate() {
            match bounds {
                Bounds::Everywhere => out.present.push(*medium),
                Bounds::Box { to_local, min, max } => {
                    if let Some((a, b)) = slab(to_local, origin, dir, *min, *max, t_max) {
                        out.crossings.push((a, region as u32, 1));
                        out.crossings.push((b, region as u32, -1));
                    }
                }
            }
        }
        if out.crossings.is_empty() {
            if !out.present.is_empty() {
                self.push_interval(0.0, t_max, out);
            }
            return !out.intervals.is_empty();
        }
        out.crossings.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)).then(x.2.cmp(&y.2)));
        let mut start = 0.0;
        for i in 0..out.crossings.len() {
            let (t, region, change) = out.crossings[i];
            if t > start && !out.present.is_empty() {
                self.push_interval(start, t, out);
            }
            start = start.max(t);
            let medium = self.regions[region as usize].0;
            if change > 0 {
                out.present.push(medium);
            } else if let Some(k) = out.present.iter().rposition(|&m| m == medium) {
                out.present.remove(k);
            }
        }
        if t_max > start && !out.present.is_empty() {
            self.push_interval(start, t_max, out);
        }
        !out.intervals.is_empty()
    }

    fn push_interval(&self, start: f32, end: f32, out: &mut MediaRay) {
        let mut interval = Interval {
            start,
            end,
            sigma_t: Rgb::ZERO,
            sigma_s: Rgb::ZERO,
            sampled_sigma_t: Rgb::ZERO,
            glow: Rgb::ZERO,
            first: out.active.len() as u32,
            count: out.present.len() as u32,
            varies: false,
        };
        for &m in &out.present {
            let medium = self.medium(m);
            match medium.profile {
                DensityProfile::Uniform => {
                    interval.sigma_t += medium.sigma_t;
                    interval.sigma_s += medium.sigma_s;
                    interval.glow += medium.glow;
                    if medium.scatters() {
                        interval.sampled_sigma_t += medium.sigma_t;
                    }
                }
                DensityProfile::Height { .. } => interval.varies = true,
            }
        }
        out.active.extend_from_slice(&out.present);
        out.intervals.push(interval);
    }

    /// Returns the optical depth of [a, b] within `interval`: (all extinction, extinction by which distances are sampled).
    fn depth(&self, ray: &MediaRay, interval: &Interval, a: f32, b: f32) -> (Rgb, Rgb) {
        let mut all = interval.sigma_t * (b - a);
        let mut drawn = interval.sampled_sigma_t * (b - a);
        if interval.varies {
            for &m in ray.active_of(interval) {
                let medium = self.medium(m);
                if medium.profile != DensityProfile::Uniform {
                    let depth = medium.sigma_t * medium.density_integral(ray.oz, ray.dz, a, b);
                    all += depth;
                    if medium.scatters() {
                        drawn += depth;
                    }
                }
            }
        }
        (all, drawn)
    }

    /// Returns (scattering coefficient, extinction by which distances are sampled) at `t`.
    fn coefficients(&self, ray: &MediaRay, interval: &Interval, t: f32) -> (Rgb, Rgb) {
        let (mut scatter, mut drawn) = (interval.sigma_s, interval.sampled_sigma_t);
        if interval.varies {
            for &m in ray.active_of(interval) {
                let medium = self.medium(m);
                if medium.profile != DensityProfile::Uniform && medium.scatters() {
                    let density = medium.density(ray.oz + ray.dz * t);
                    scatter += medium.sigma_s * density;
                    drawn += medium.sigma_t * density;
                }
            }
        }
        (scatter, drawn)
    }

    /// Returns the transmittance of all intervals.
    pub fn transmittance(&self, ray: &MediaRay) -> Rgb {
        let mut depth = Rgb::ZERO;
        for interval in &ray.intervals {
            depth += self.depth(ray, interval, interval.start, interval.end).0;
        }
        decay_of_each(depth)
    }

    /// Returns the range of the ray in which something scatters: (first, last) distance, m.
    pub fn scattering_range(&self, ray: &MediaRay) -> Option<(f32, f32)> {
        let mut range: Option<(f32, f32)> = None;
        for interval in &ray.intervals {
            if interval.varies || interval.sampled_sigma_t.max_element() > 0.0 {
                range = Some((range.map_or(interval.start, |r| r.0), interval.end));
            }
        }
        range
    }

    /// Returns the properties of the fog on a ray that the choice of a light uses: mean extinction of the segment `range`, 1/m, and
    /// Schlick's parameter for the phase function of the medium that scatters most. Both are approximate.
    pub fn mean_properties(&self, ray: &MediaRay, range: (f32, f32)) -> (f32, f32) {
        let Some(interval) = ray.intervals.iter().find(|it| it.varies || it.sampled_sigma_t.max_element() > 0.0) else {
            return (0.0, 0.0);
        };
        let at = 0.5 * (interval.start + interval.end.min(interval.start + 100.0));
        let active = ray.active_of(interval);
        let z = ray.oz + ray.dz * at;
        let densest =
            active.iter().copied().max_by(|a, b| self.scattering_share(*a, z).total_cmp(&self.scattering_share(*b, z)));
        let phase = densest.map_or(0.0, |medium| self.medium(medium).phase.schlick_parameter());
        if !interval.varies {
            return (luminance(interval.sigma_t), phase);
        }
        let end = range.1.min(interval.end).min(interval.start + 1e4);
        let length = (end - interval.start).max(1e-6);
        (luminance(self.depth(ray, interval, interval.start, end).0) / length, phase)
    }

    /// Returns extinction and Schlick's parameter like [`Self::mean_properties`], at an event.
    pub fn event_properties(&self, ray: &MediaRay, event: &ScatterEvent) -> (f32, f32) {
        let interval = &ray.intervals[event.interval as usize];
        let z = ray.oz + ray.dz * event.t;
        let extinction =
            ray.active_of(interval).iter().map(|&m| luminance(self.medium(m).sigma_t) * self.medium(m).density(z));
        (extinction.sum(), self.medium(self.dominant_medium(ray, event)).phase.schlick_parameter())
    }

    /// Returns the optical depth from the ray's start and the scattering coefficient (1/m), by luminance, at distances in ascending
    /// order.
    pub fn depth_and_scattering(&self, ray: &MediaRay, distances: &[f32; 8]) -> ([f32; 8], [f32; 8]) {
        if let [interval] = &ray.intervals[..]
            && !interval.varies
        {
            let extinction = luminance(interval.sigma_t);
            return (distances.map(|t| extinction * (t - interval.start).max(0.0)), [luminance(interval.sigma_s); 8]);
        }
        let (mut depths, mut scattering) = ([0.0; 8], [0.0; 8]);
        for (k, &t) in distances.iter().enumerate() {
            let mut depth = Rgb::ZERO;
            for interval in &ray.intervals {
                if t <= interval.start {
                    break;
                }
                depth += self.depth(ray, interval, interval.start, t.min(interval.end)).0;
                if t <= interval.end {
                    scattering[k] = luminance(self.coefficients(ray, interval, t).0);
                }
            }
            depths[k] = luminance(depth);
        }
        (depths, scattering)
    }

    /// Returns the event at a distance that was sampled by other means. `pdf` is the density (1/m) with which
    /// [`Media::sample_distance`] samples it. `weight` is transmittance times scattering coefficient, NOT divided by a density.
    /// Returns `None` where nothing scatters.
    pub fn event_at(&self, ray: &MediaRay, t: f32) -> Option<ScatterEvent> {
        let (mut all, mut drawn) = (Rgb::ZERO, Rgb::ZERO);
        for (index, interval) in ray.intervals.iter().enumerate() {
            if t >= interval.end {
                let depth = self.depth(ray, interval, interval.start, interval.end);
                all += depth.0;
                drawn += depth.1;
                continue;
            }
            if t < interval.start {
                return None;
            }
            let depth = self.depth(ray, interval, interval.start, t);
            let (scatter, rate) = self.coefficients(ray, interval, t);
            let pdf = channel_mean(rate * decay_of_each(drawn + depth.1));
            let weight = scatter * decay_of_each(all + depth.0);
            return (pdf > 0.0 && weight.max_element() > 0.0).then_some(ScatterEvent {
                t,
                weight,
                pdf,
                interval: index as u32,
            });
        }
        None
    }

    /// Samples a distance in proportion to extinction times transmittance. `u` is in [0, 1). `channel` in [0, 1) selects the color
    /// channel for colored media.
    pub fn sample_distance(&self, ray: &MediaRay, u: f64, channel: f32) -> DistanceSample {
        let axis = ((channel * 3.0) as usize).min(2);
        // Each half uses the function that is accurate there in single precision.
        let target = if u < 0.5 { -ln_1p(-u as f32) } else { -ln((1.0 - u) as f32) };
        let (mut all, mut drawn) = (Rgb::ZERO, Rgb::ZERO);
        for (index, interval) in ray.intervals.iter().enumerate() {
            let depth = self.depth(ray, interval, interval.start, interval.end);
            let reached = drawn + depth.1;
            if target < reached[axis] {
                let rest = target - drawn[axis];
                let t = if interval.varies {
                    self.invert(ray, interval, axis, rest)
                } else {
                    (interval.start + rest / interval.sampled_sigma_t[axis]).min(interval.end)
                };
                let part = self.depth(ray, interval, interval.start, t);
                let (scatter, rate) = self.coefficients(ray, interval, t);
                let pdf = channel_mean(rate * decay_of_each(drawn + part.1));
                if pdf <= 0.0 {
                    return DistanceSample::Through { weight: Rgb::ZERO };
                }
                let weight = scatter * decay_of_each(all + part.0) / pdf;
                return DistanceSample::Scatter(ScatterEvent { t, weight, pdf, interval: index as u32 });
            }
            all += depth.0;
            drawn = reached;
        }
        let probability = channel_mean(decay_of_each(drawn));
        if probability <= 0.0 {
            return DistanceSample::Through { weight: Rgb::ZERO };
        }
        DistanceSample::Through { weight: decay_of_each(all) / probability }
    }

    /// Returns the distance in `interval` at which the sampled optical depth of one channel reaches `target`. It must be reached.
    fn invert(&self, ray: &MediaRay, interval: &Interval, axis: usize, target: f32) -> f32 {
        let (mut low, mut high) = (interval.start, interval.end);
        // First find a finite bracket, because the interval may be endless; then use safeguarded Newton steps.
        let mut step = 1.0f32;
        while high - low > step && self.depth(ray, interval, interval.start, low + step).1[axis] < target {
            step *= 4.0;
        }
        high = high.min(low + step);
        let mut t = 0.5 * (low + high);
        for _ in 0..48 {
            let error = self.depth(ray, interval, interval.start, t).1[axis] - target;
            if error > 0.0 {
                high = t;
            } else {
                low = t;
            }
            let slope = self.coefficients(ray, interval, t).1[axis];
            let next = t - error / slope;
            let next = if next > low && next < high { next } else { 0.5 * (low + high) };
            if (next - t).abs() <= 1e-6 * t.abs() {
                return next;
            }
            t = next;
        }
        t
    }

    /// Returns the radiance that glowing media send to the ray's origin. It is exact for uniform media. On each interval whose glow
    /// varies with height, it uses one point, sampled with `u`.
    pub fn emitted_radiance(&self, ray: &MediaRay, u: f32) -> Rgb {
        let mut radiance = Rgb::ZERO;
        let mut passed = Rgb::ZERO;
        for interval in &ray.intervals {
            let before = decay_of_each(passed);
            if !interval.varies {
                if interval.glow.max_element() > 0.0 {
                    let length = interval.end - interval.start;
                    let depth = interval.sigma_t * length;
                    let share = |d: f32| if d < 1e-4 { 1.0 - 0.5 * d } else { -exp_m1(-d) / d };
                    let mean = Rgb::new(share(depth.x), share(depth.y), share(depth.z));
                    radiance += before * interval.glow * mean * length;
                }
            } else {
                radiance += before * self.varying_glow(ray, interval, u);
            }
            passed += self.depth(ray, interval, interval.start, interval.end).0;
        }
        radiance
    }

    fn varying_glow(&self, ray: &MediaRay, interval: &Interval, u: f32) -> Rgb {
        if !ray.active_of(interval).iter().any(|&m| self.medium(m).glow.max_element() > 0.0) {
            return Rgb::ZERO;
        }
        // A point with density proportional to 1 / (1 + s)^2 over the interval, s in meters: finite on endless rays.
        let length = interval.end - interval.start;
        let top = length / (1.0 + length);
        let x = u * top;
        let s = (x / (1.0 - x)).min(length);
        let t = interval.start + s;
        let pdf = 1.0 / (top * (1.0 + s) * (1.0 + s));
        let mut glow = interval.glow;
        for &m in ray.active_of(interval) {
            let medium = self.medium(m);
            if medium.profile != DensityProfile::Uniform {
                glow += medium.glow * medium.density(ray.oz + ray.dz * t);
            }
        }
        glow * decay_of_each(self.depth(ray, interval, interval.start, t).0) / pdf
    }

    /// Returns the phase function at an event: that of one of the media present, sampled with `u` in proportion to its scattering.
    /// Evaluate the mixture with [`Media::phase`].
    pub fn sample_phase(&self, ray: &MediaRay, event: &ScatterEvent, u: f32) -> &Phase {
        let interval = &ray.intervals[event.interval as usize];
        let active = ray.active_of(interval);
        if active.len() == 1 {
            return &self.medium(active[0]).phase;
        }
        let z = ray.oz + ray.dz * event.t;
        let total: f32 = active.iter().map(|&m| self.scattering_share(m, z)).sum();
        let mut rest = u * total;
        let mut chosen = active[0];
        for &m in active {
            let share = self.scattering_share(m, z);
            if share > 0.0 {
                chosen = m;
                if rest < share {
                    break;
                }
                rest -= share;
            }
        }
        &self.medium(chosen).phase
    }

    /// Returns the medium that scatters most at an event.
    pub fn dominant_medium(&self, ray: &MediaRay, event: &ScatterEvent) -> u16 {
        let active = ray.active_of(&ray.intervals[event.interval as usize]);
        let z = ray.oz + ray.dz * event.t;
        let most = |a: &u16, b: &u16| self.scattering_share(*a, z).total_cmp(&self.scattering_share(*b, z));
        active.iter().copied().max_by(most).unwrap_or(0)
    }

    /// Returns the first medium on a ray that glows.
    pub fn emitting_medium(&self, ray: &MediaRay) -> u16 {
        let glows = |medium: &&u16| self.medium(**medium).glow.max_element() > 0.0;
        ray.active.iter().find(glows).copied().unwrap_or(0)
    }

    fn scattering_share(&self, medium: u16, z: f32) -> f32 {
        let medium = self.medium(medium);
        medium.sigma_s.element_sum() * medium.density(z)
    }

    /// Returns the phase function of the mixture at an event, 1/sr: its value by color channel (colored media may differ in their
    /// phase functions), and the density of [`Media::sample_phase`] followed by sampling of the returned phase function.
    pub fn phase(&self, ray: &MediaRay, event: &ScatterEvent, wo: Vec3A, wi: Vec3A) -> (Rgb, f32) {
        let interval = &ray.intervals[event.interval as usize];
        let active = ray.active_of(interval);
        if active.len() == 1 {
            let p = self.medium(active[0]).phase.eval(wo, wi);
            return (Rgb::splat(p), p);
        }
        let z = ray.oz + ray.dz * event.t;
        let (mut value, mut scatter, mut pdf, mut total) = (Rgb::ZERO, Rgb::ZERO, 0.0, 0.0);
        for &m in active {
            let share = self.scattering_share(m, z);
            if share > 0.0 {
                let medium = self.medium(m);
                let p = medium.phase.eval(wo, wi);
                let sigma_s = medium.sigma_s * medium.density(z);
                value += sigma_s * p;
                scatter += sigma_s;
                pdf += share * p;
                total += share;
            }
        }
        let divide = |a: f32, b: f32| if b > 0.0 { a / b } else { 0.0 };
        (
            Rgb::new(divide(value.x, scatter.x), divide(value.y, scatter.y), divide(value.z, scatter.z)),
            divide(pdf, total),
        )
    }
}

impl MediaRay {
    fn active_of(&self, interval: &Interval) -> &[u16] {
        &self.active[interval.first as usize..(interval.first + interval.count) as usize]
    }
}

fn channel_mean(c: Rgb) -> f32 {
    (c.x + c.y + c.z) * (1.0 / 3.0)
}

/// Returns the range of the ray in the box, clipped to [0, t_max].
#[inline]
fn slab(to_local: &Affine3A, origin: Vec3A, dir: Vec3A, min: Vec3A, max: Vec3A, t_max: f32) -> Option<(f32, f32)> {
    let o = to_local.transform_point3a(origin);
    let d = to_local.transform_vector3a(dir);
    let inverse = d.recip();
    let (t0, t1) = ((min - o) * inverse, (max - o) * inverse);
    let (mut near, mut far) = (t0.min(t1), t0.max(t1));
    let parallel = d.cmpeq(Vec3A::ZERO);
    if parallel.any() {
        if (parallel & (o.cmplt(min) | o.cmpgt(max))).any() {
            return None;
        }
        near = Vec3A::select(parallel, Vec3A::NEG_INFINITY, near);
        far = Vec3A::select(parallel, Vec3A::INFINITY, far);
    }
    let (a, b) = (near.max_element().max(0.0), far.min_element().min(t_max));
    (a < b).then_some((a, b))
}
