//! State of a path between two rays.

use crate::dimensions as dim;
use crate::fog::Collision;
use crate::record::{PathEnd, Termination};
use femc_emission::PointContext;
use femc_geometry::Ray;
use femc_math::glam::Vec3A;
use femc_math::{Rgb, SampleStream};
use femc_prepared::media::MediumStack;

/// A path from the camera, up to its next ray. The light found so far is not part of it ([`PathSample`](crate::PathSample)).
///
/// A copy with another random stream is another path with the same past. The tracer keeps the weights of the lights only for the
/// latest vertex, so light that a copy hits with its next ray must be weighted before the other copy reaches a vertex.
#[derive(Clone, Copy)]
pub(crate) struct PathState {
    /// Ray to trace next. After [`Self::begin_ray`], the current ray.
    pub ray: Ray,
    /// Random numbers of the sample.
    pub stream: SampleStream,
    /// First random dimension of the current ray.
    pub base: u32,
    /// Throughput up to the ray's origin.
    pub throughput: Rgb,
    /// Factors of the throughput that Russian roulette must ignore: squares of index ratios, and ratios of densities from the
    /// mixtures that replaced the BSDF or the phase function. If only the latest ratio counts, the reference roundabout has 8 %
    /// more variance.
    pub roulette_scale: f32,
    /// Light that the field expected at the path's first vertex with data, and a share of the frame's mean, cd/m2 by channel;
    /// 0 before.
    pub expected_light: Rgb,
    /// Closed objects that contain the ray's origin.
    pub medium_stack: MediumStack,
    /// Vertex at which the segment began.
    pub previous: PreviousVertex,
    /// Whether the path has not yet reached a surface that the camera sees, nor a collision.
    pub awaits_first_surface: bool,
    /// Index of the current segment, 0: the camera's. A segment that goes through clear surfaces has several rays.
    pub bounce: u32,
    /// Number of rays.
    pub rays: u32,
    /// Number of vertices.
    pub vertices: u32,
}

/// The vertex before the current segment, for multiple importance sampling of light that the path hits.
#[derive(Clone, Copy)]
pub(crate) struct PreviousVertex {
    /// Position, m.
    pub position: Vec3A,
    /// Sampler of the segment's direction.
    pub origin: SegmentOrigin,
}

/// Origin of a segment.
#[derive(Clone, Copy)]
pub(crate) enum SegmentOrigin {
    /// Delta origin: a mirror, or the camera if it sees no small emitters.
    Delta,
    /// Camera. Its visible small emitters are sampled, too.
    Camera {
        /// Index of the pixel.
        pixel: u32,
        /// Position on the film, pixels.
        film_position: [f32; 2],
        /// Density of the position on the film, 1/pixel2.
        film_pdf: f32,
        /// Solid angle of a pixel there, sr.
        solid_angle: f32,
    },
    /// Surface.
    Surface {
        /// Context for which the lights were weighed.
        light_context: PointContext,
        /// Density of the direction, 1/sr.
        pdf: f32,
    },
    /// Medium.
    Medium {
        /// Event that scattered the path.
        collision: Collision,
        /// Density of the direction by the phase function alone, 1/sr.
        phase_pdf: f32,
    },
}

impl PathState {
    /// Creates the path of a camera ray.
    #[inline(always)]
    pub fn new(ray: Ray, origin: SegmentOrigin, medium_stack: MediumStack, stream: SampleStream) -> Self {
        Self {
            ray,
            stream,
            base: 0,
            throughput: Rgb::ONE,
            roulette_scale: 1.0,
            expected_light: Rgb::ZERO,
            medium_stack,
            previous: PreviousVertex { position: ray.origin, origin },
            awaits_first_surface: true,
            bounce: 0,
            rays: 0,
            vertices: 0,
        }
    }

    /// Counts the ray to trace next, and assigns its random dimensions.
    #[inline(always)]
    pub fn begin_ray(&mut self) {
        self.base = dim::ray_base(self.rays);
        self.rays += 1;
    }

    /// Returns the end of the path with its current throughput.
    #[inline(always)]
    pub fn end(&self, end: PathEnd) -> Termination {
        Termination { end, vertices: self.vertices, throughput: self.throughput }
    }
}
