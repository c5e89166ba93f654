//! Constants that trade accuracy against time and memory, with the measurement behind each.
//!
//! They change the solution: a new value needs `first_pass errors` (an example of `tests`, scenes in closed form), `first_pass fog`
//! and the references (`tests/all references`) measured again, and a new version in `first_pass_key`. "Not measured" means that no
//! record of a measurement exists. Such a constant was chosen by what it trades, and its scenes in closed form pass with it.
//! Constants of views are in `mesh`.

// Shapes of elements.

/// Cosine between an element's normals below which they no longer count as one. A smaller one has fewer elements with light by
/// direction, and larger errors of patches. Not measured.
pub const MIN_NORMAL_COSINE: f32 = 0.85;
/// Factor of the radius of a bent part, and share of it that is added to its box, for bulges between the points of its grid. They
/// suffice for spheres, cylinders, cones, rings and tori (test `bounds_contain_all_parts`).
pub const BULGE_RADIUS: f32 = 1.1;
pub const BULGE_BOX: f32 = 0.05;
/// Maximum angle between normals of a cluster's parts that count as equal. It allows for rounding alone.
pub const EQUAL_NORMALS_ANGLE: f32 = 1.4e-3;
/// Minimum ratio of the radius of the largest surface of a cluster to that of the next, for it to be separated first. Not
/// measured: it keeps a floor out of the clusters of the things on it.
pub const LARGE_SURFACE_RATIO: f32 = 2.0;
/// Number of free paths beyond the surfaces to which the fog is extended. Of the light that goes
/// beyond, a share below exp(-4) returns unscattered. Not measured.
pub const FAR_FREE_PATHS: f32 = 2.0;
/// Number of rays by which a direction counts as open. Not measured: at half of them the share of open rays has a deviation of 6 %.
pub const OPEN_RAYS: u32 = 64;
/// Number of points by axis at which the fog of a box is evaluated if it varies. Not measured.
pub const FOG_GRID: u32 = 4;
/// Number of normals at which a curved element's light is evaluated. Not measured: nine harmonics need at least nine.
pub const CURVED_NORMALS: usize = 16;

// Refinement.

/// Allowed errors of a link in successive levels, as multiples of the requested error. Light found at one level says where the next
/// must be exact. The closed forms are calibrated on these levels.
pub const ERROR_LEVELS: [f32; 3] = [8.0, 2.5, 1.0];
/// Number of surfaces of a cluster that represent all of them in the first estimate of their irradiance. Not measured: light found
/// later replaces the estimate.
pub const CLUSTER_SAMPLES: usize = 16;
/// Maximum error of a link with a light source, whatever the requested error. Direct light determines all other light, and its
/// links are few. Not measured.
pub const MAX_LAMP_ERROR: f32 = 0.1;
/// Share of the mean irradiance that is added to an element's when a link's error is judged. A smaller one refines dark places
/// more: behind an opening of 1 % of the hemisphere a room has 0.86 of its light (docs/first-pass.md).
pub const IRRADIANCE_FLOOR: f32 = 0.03;
/// Maximum irradiance that an error is relative to, in multiples of the scene's mean. Places far above it are near lamps, and what
/// they send matters elsewhere: a ceiling 2 cm above a lamp, whose bright part the room cannot see.
pub const MAX_REFERENCE: f32 = 10.0;
/// Minimum area of an element that may be split, as a share of the total, divided by the error. Not measured: it limits the number
/// of elements in places whose error no split lowers.
pub const MIN_AREA_SHARE: f32 = 1e-4;
/// Maximum factor by which the minimum area is smaller in places that are brighter than `MAX_REFERENCE`. A lamp of 0.16 m2 close to
/// the ceiling of a corridor of 1,100 m2 needs parts of a hundredth of a square meter there.
pub const MAX_FINER: f32 = 30.0;
/// Minimum volume of fog that may be split, as `MIN_AREA_SHARE`.
pub const MIN_VOLUME_SHARE: f32 = 1e-5;
/// Share of all surfaces' area, or of the fog's volume, of an element that may have exactly the requested error. It scales `error`
/// as a whole; the table of accuracy in docs/first-pass.md is for this value.
pub const UNIT_SHARE: f32 = 1e-3;
/// Bounds of the error scale, for large and for small elements. With larger elements split first, the roundabout took 12.8 s
/// instead of 118 s, with a relmse of 0.022 instead of 0.029 (together with light in fog that is conserved).
pub const ERROR_SCALE_BOUNDS: [f32; 2] = [0.5, 4.0];
/// Minimum limit for the bytes of links, even if elements and links have a smaller limit. Not measured: with fewer bytes a room has
/// no links.
pub const MIN_LINK_MEMORY: usize = 1 << 20;
/// Height above the plane of a flat element, relative to the radii, up to which another element counts as behind it. It allows for
/// rounding alone.
pub const BEHIND_HEIGHT: f32 = 1e-5;

// Errors of links. The weights are calibrated together: in scenes in closed form without fog, 0.64 times (`error` + `corrected`)
// was never below the true error (docs/first-pass.md). Single weights were not measured unless stated.

/// Distance of a pair with light by direction, in sums of the radii, below which it is split if its light is more than
/// `CLOSE_LIGHT` of the allowed error: the center represents the element only from far away.
pub const CLOSE_RADII: f32 = 1.5;
pub const CLOSE_LIGHT: f32 = 0.5;
/// Error of an element with light by direction, as a share of the light: nine harmonics represent the cosine to 7 % of its greatest
/// value, and the second term, times (radius over distance) squared, stands for the positions of its parts.
pub const DIRECTIONAL_ERROR: [f32; 2] = [0.1, 2.0];
/// Mean irradiance of a cluster without parts, relative to that of a surface that faces the source. It is exact for convex bodies.
pub const CLUSTER_SHARE: f32 = 0.25;
/// Second term of [`DIRECTIONAL_ERROR`] for light sources, which are closer to points.
pub const DIRECTIONAL_LAMP_ERROR: f32 = 4.0;
/// Weight of the difference between the center and the mean of the nodes. The nodes are exact for linear functions, so it is the
/// curvature that they miss.
pub const CENTER_WEIGHT: f32 = 2.0;
/// Weight of the difference between the nodes, which a linear function represents up to its curvature: without it, a link whose
/// center is exact by chance would be kept.
pub const NODES_WEIGHT: f32 = 0.03;
/// [`NODES_WEIGHT`] for light sources, whose light has sharp edges.
pub const LAMP_NODES_WEIGHT: f32 = 0.1;
/// Weight of (radius over distance) squared, for what no node shows. Also that of a source that is no polygon: with it, discs are
/// exact to 1 % at an error of 0.1.
pub const SHAPE_WEIGHT: f32 = 0.5;
/// Weight of the thickness of the fog over the source, times radius over distance.
pub const THICKNESS_WEIGHT: f32 = 0.3;
/// Minimum share of a source in the receiver's view, by radius over distance, in the estimate of the number of similar sources.
/// Errors of many small sources add up; without a minimum, far sources would be linked by their smallest parts.
pub const MIN_SOURCE_SHARE: f32 = 0.03;
/// Minimum sum of the radii of a box of fog and its neighbor, as a share of their distance, for the light that the nodes miss to
/// be computed in reverse. Four points of a box of fog miss most of what a source inside of it sends.
pub const MIN_NEIGHBOR_RADII: f32 = 0.5;
/// Weight of the light at a box's edge that the nodes miss. With a small weight, large adjacent boxes would be linked. Their light
/// travels from edge to edge, where no node is, and is lost: in a slab of one free path, half of the light that is scattered more
/// than once.
pub const EDGE_WEIGHT: f32 = 2.0;
/// Weight for a surface as the source, which is adjacent to a larger part of the box. Slabs are exact to 5 % at an error of 1 with
/// it (docs/first-pass.md).
pub const SURFACE_EDGE_WEIGHT: f32 = 4.0;
/// Position of the test point at the edge of a box of fog, in half edges from its center.
pub const AT_EDGE: f32 = 0.9;
/// Optical thickness of half of a box of fog above which its light to itself is not treated as one value.
pub const THICK_DEPTH: f32 = 0.5;

// Factors.

/// Distance in radii up to which a polygon's form factor is computed exactly. Beyond, its nodes represent it. Not measured.
pub const POLYGON_RADII: f32 = 5.0;
/// Distance in radii beyond which a surface is one point. Its error is below 0.1 %.
pub const FAR_RADII: f32 = 30.0;
/// Height of a polygon above the horizon of a point, as a share of its distance, below which it counts as in the plane of the
/// point: it sends nothing there. Lambert's formula has no value for it: a two-sided lamp would light itself (test
/// `coplanar_polygon_sends_nothing_to_a_point_facing_either_way`).
pub const IN_PLANE: f32 = 1e-5;
/// Optical thickness of a surface's radius, times radius over distance, up to which its nodes suffice for the attenuation by fog.
/// With 64 points beyond, factors are exact to 2 % (test `surfaces_in_fog_are_attenuated_like_the_quadrature`).
pub const THIN_DEPTH: f32 = 0.1;
/// Distance in radii beyond which a box of fog is one point.
pub const FAR_BOX_RADII: f32 = 3.0;
/// Distance in radii up to which a box's faces have [`FACE_POINTS`] points by axis; beyond, they have [`FAR_FACE_POINTS`].
pub const NEAR_BOX_RADII: f32 = 1.5;
/// Number of points by axis on a face of a box of fog. Dense near the point, they are exact to 2 % (test
/// `a_point_receives_of_a_box_what_all_directions_bring`); evenly spaced ones were 5 to 9 % too small.
pub const FACE_POINTS: u32 = 5;
pub const FAR_FACE_POINTS: u32 = 3;
/// Minimum distance between a point and a face of a box of fog, as a share of the box's radius, for the choice of points on the
/// face. It avoids a division by zero alone.
pub const MIN_FACE_DISTANCE: f32 = 1e-4;

// Occlusion.

/// Number of visibility rays of a first test, and of a second one if the first found the source partly occluded. Not measured;
/// rays from leaves correct what they miss.
pub const VISIBILITY_RAYS: [u32; 2] = [4, 12];
/// Maximum light of a link, as a share of the allowed error, for which one ray is enough. Not measured.
pub const ONE_RAY_LIGHT: f32 = 0.2;
/// Number of attempts to choose points that face each other. Not measured.
pub const FACING_ATTEMPTS: u32 = 4;
/// Limit for the light of a source that no ray has reached, in multiples of the minimum irradiance that an error is relative to.
/// Below, the source counts as dark. Otherwise dark areas would be split finely only to prove their darkness. Not measured.
pub const UNPROVED_LIGHT: f32 = 10.0;
/// Difference between the shares of two parts by light and by size up to which a point of a patch is not sampled by light: strata
/// are worth more than a choice between nearly equal parts. Not measured.
pub const EVEN_PARTS: f32 = 0.2;
/// Maximum number of clear surfaces that a ray passes through. It bounds the time of rays that never end.
pub const MAX_CLEAR_SURFACES: u32 = 64;

// Light sources.

/// Number of rays that test whether any light of a source arrives. Not measured.
pub const LAMP_VISIBILITY_RAYS: u32 = 16;
/// Number of shadow rays from an element with light by direction to a point of a source, at most four. They begin on different parts
/// that face the source. Not measured.
pub const DIRECTIONAL_SHADOW_RAYS: u32 = 4;
/// Number of points by axis on a source that is large as seen from the element. Not measured: occlusion has as many levels.
pub const LAMP_STRATA: u32 = 2;
/// Minimum radius of a large source, as a share of the distance. A point instead of a disc of this radius has an error of 1 %.
pub const LARGE_SOURCE: f32 = 0.1;
/// Minimum radius of an element near a source, as a share of the distance. Not measured.
pub const NEAR_ELEMENT: f32 = 0.3;
/// Maximum number of surfaces of a cluster that is not split. Not measured: its light is found by some dozens of rays.
pub const MAX_MEMBERS: usize = 64;
/// Minimum distance of a source from the surfaces of a cluster, as a share of the cluster's radius, in the estimate of the light that
/// its center does not show. Not measured.
pub const CLUSTER_REACH: f32 = 0.25;
/// Maximum share of a source's light that a box around the source absorbs, times the error. Not measured.
pub const MAX_LAMP_ABSORBED: f32 = 0.3;

// Iteration.

/// Share of the light that leaves all elements. Iteration stops when the change is no more than this. A greater
/// [`SolveReport::residual`](crate::SolveReport::residual) means that the light has not converged. It is far below the errors of
/// links.
pub const TARGET_RESIDUAL: f32 = 1e-4;
/// [`TARGET_RESIDUAL`] before the last level of refinement. Not measured: links are refined again afterwards.
pub const COARSE_RESIDUAL: f32 = 1e-2;
/// Maximum number of iterations at one level of refinement. With the acceleration, a room that reflects 99.9 % of the light takes
/// about 20.
pub const MAX_ITERATIONS: usize = 200;
/// Number of earlier iterations that the acceleration combines. Each needs memory for the light of all leaves twice.
pub const ACCELERATION_DEPTH: usize = 4;
/// Maximum row sum of the links at a point that no rays have measured. It is 1 with exact links. The balance of the flux keeps light
/// from growing; this bound only keeps single points from being far too bright. A bound of 1 removes the excess of some points
/// without what others lack: fog of three free paths in a box that emits evenly was 4 % too dark.
pub const MAX_ROW_SUM: f32 = 1.15;
/// Maximum factor by which light between elements is increased for the balance of flux. It is near 1 after the correction by rays.
/// A solution that needs more is not trusted.
pub const MAX_BALANCE: f64 = 2.0;

// Rays from leaves.

/// Number of times that rays are cast. Between two casts, leaves are split where the rays find shadows. Not measured.
pub const RAY_ROUNDS: u32 = 3;
/// Maximum number of times that the links' light is compared with the same rays. The correction changes the light that the rays
/// measure.
pub const RAY_CHECKS: usize = 8;
/// [`RAY_CHECKS`] before the last rays, which only show where leaves must be split. Not measured.
pub const COARSE_RAY_CHECKS: usize = 2;
/// Change of the light between two such comparisons, as a share of the light, up to which they end. Not measured: it is below the
/// noise of the rays.
pub const RAY_CHECK_CHANGE: f32 = 1e-3;
/// Maximum ratio of that change to the one before, beyond which they end as well: noise decides where light is corrected, and some
/// decisions may alternate without end. Soda (docs/first-pass.md) took 8 comparisons instead of 3.
pub const MAX_RAY_CHECK_RATIO: f32 = 0.9;
/// Minimum and maximum number of rays from each part of a leaf, and the total number of rays if the number per part is between
/// these. Rays take 24 % of the time of the roundabout (docs/first-pass.md).
pub const RAYS_PER_PART: [usize; 2] = [8, 1024];
pub const TOTAL_RAYS: usize = 1 << 16;
/// Minimum number of rays from each part of a box of fog. With 8 and as many other rays, the fog of the roundabout has 2 % less light
/// at an error of 2 (docs/first-pass.md).
pub const MIN_FOG_RAYS: usize = 16;
/// Minimum number of rays from each part of a small leaf, and the area of such a leaf as a share of the area of all surfaces. Such leaves
/// are not split.
pub const MIN_SMALL_RAYS: usize = 2;
pub const SMALL_AREA_SHARE: f32 = 3e-5;
/// Number of additional rays, distributed among the leaves by the light that they send, relative to the other rays if each
/// surface were an element and no leaf were small. Not measured.
pub const EXTRA_RAYS_RATIO: f32 = 1.0;
/// Maximum number of additional rays, if they are more than the others. Without it, the rays of a million faces took 1 GB.
pub const MAX_EXTRA_RAYS: f32 = (1 << 20) as f32;
/// Bounds of the minimum ratio of the density of rays from the other end to that of a leaf's own rays, for the former to be preferred.
/// The greater one is for evenly lit surroundings: with 8 there, a point in an evenly lit sphere was 6 % too dark. With 32
/// everywhere, a plate below a bright ball had an rms of 9 % instead of 3 %, because some leaves had missed the ball. With a lesser
/// bound of 2, the floor of a cube had an rms of 6 % at an error of 0.03 instead of less than 2 %.
pub const DENSITY_RATIOS: [f32; 2] = [8.0, 32.0];
/// Squared difference, in units of its variance, that counts as chance if links may have the error [`ROUGH_ERROR`] or more. For
/// more exact links it is larger, because a difference is then less likely their fault. A
/// larger one keeps more noise of few rays out of the solution, and more errors of links in it. In random rooms 0 to 29, the
/// quartiles of the mean are 0.987, 0.993 and 1.001 with 1, and 0.981, 0.991 and 1.004 with 4 (both with a [`RAYS_OF_WHOLE`] of 4). With 1, single points of an evenly
/// lit box without splits, where links are exact, are 0.7 % wrong.
pub const CHANCE_VARIANCES: f32 = 2.0;
/// [`CHANCE_VARIANCES`] for shadow rays, and in scenes with fog: few of these rays find most of the light. With 1, fog of one free path
/// in an evenly lit box had an rms of 5.1 %, and the direct light below a slab was 17 % too much; with 2, 8 % too much.
pub const CHANCE_VARIANCES_OF_RARE_HITS: f32 = 4.0;
pub const ROUGH_ERROR: f32 = 0.3;
/// Weight of the estimate of the whole in the variance of a part's light, in rays. With a larger one, light that leaked into closed
/// furniture stays there: with the variance of the whole alone, a white room was 5 % too dark.
pub const RAYS_OF_WHOLE: f32 = 8.0;
/// Squared difference, in units of its variance, that counts as chance in the balance of the flux. Not measured.
pub const BALANCE_VARIANCES: f32 = 4.0;
/// Minimum variance of the light of a shadow ray, relative to the squared light of the links. Eight rays in the shadow do not prove
/// that a part is all in the shadow.
pub const MIN_RELATIVE_VARIANCE: f32 = 0.25;
/// Maximum factor for the links' light. Light that rays find beyond that is added. Not measured: links whose light is a fourth of
/// the true one say little about where it arrives.
pub const MAX_RAY_SCALE: f32 = 4.0;

// Estimate of the error.

/// Weight of the errors that the oracle has estimated for the links. It tends to estimate too much, so that links are refined enough. With
/// 1, the closed forms have 0.1 to 0.8 of the estimated error.
pub const LINK_ERROR_WEIGHT: f32 = 0.4;

/// Weight of the relative error of the element above in that of an element, in parts of leaves.
pub const ERROR_PARTS: f32 = 16.0;
/// Minimum squared relative error of an element, relative to that of the element above. Not measured: the estimate of few parts may be
/// negative.
pub const MIN_ERROR_RATIO: f32 = 0.05;
/// Minimum relative error of an element. Links are approximate even where all rays find the same.
pub const MIN_RELATIVE_ERROR: f32 = 1e-3;

// Particles from lamps.

/// Minimum and maximum number of particles. Between these, the number is proportional to the root of the share of the lamps' light that
/// they bring. Proportional to the share, points beside a mirror had an rms error of 16 % instead of 10 %.
pub const CAUSTIC_PARTICLES: [usize; 2] = [1 << 12, 1 << 18];
/// Number of the first particles, which show from where light gets to mirrors and clear solids. Not measured.
pub const CAUSTIC_PILOTS: usize = 1 << 14;
/// Maximum number of cells of a lamp's directions by height; there are twice as many by azimuth. Not measured.
pub const CAUSTIC_CELLS: usize = 16;
/// Share of particles, relative to the others, that are distributed over all light of the lamps, because the first particles may have
/// missed some. Not measured.
pub const UNSEEN_CAUSTICS: f32 = 0.2;
/// Squared difference between a part's light and the expected one, in units of its variance, that counts as chance. Not measured.
pub const CAUSTIC_CHANCE: f32 = 2.0;

// Verification.

/// Maximum ratio of the absorbed flux to the flux that is sent. Links are approximate: valid solutions of closed rooms, especially
/// in fog and for guides, absorb up to a tenth more than is sent (1.11 in a foggy test room); wrong ones absorb 1.5 times and more.
pub const MAX_ABSORBED_RATIO: f64 = 1.25;
/// Maximum light that further iterations may add, as a share of all light. If surfaces absorb very little, iterations end with some
/// light not yet absorbed. Not measured.
pub const MAX_RESIDUAL: f32 = 0.05;
