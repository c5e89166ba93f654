//! Fixed dimensions of the random numbers of a path, so that one decision does not shift the numbers of another.

use femc_math::sampler::SampleStream;

/// Position in the pixel (2).
pub const FILM: u32 = 0;
/// Position on the lens (2).
pub const LENS: u32 = 2;
/// Time in the shutter (1).
pub const TIME: u32 = 4;

/// Choice of a small camera-visible emitter (1).
pub const CAMERA_EMITTER: u32 = 5;
/// Point on that emitter (2).
pub const CAMERA_EMITTER_POINT: u32 = 6;

/// Returns the first dimension of ray `ray` of a path (0: the camera's). A segment that goes through clear surfaces has
/// several rays. Each has its own numbers: if a ray has passed a stretch of fog, that carries information about the number drawn
/// for it.
pub const fn ray_base(ray: u32) -> u32 {
    8 + ray * 24
}

/// Point on the light (2), after the ray's base.
pub const LIGHT_POINT: u32 = 0;
/// Choice of the lobe, or of the phase function (1).
pub const LOBE: u32 = 3;
/// Scattered direction (2).
pub const DIRECTION: u32 = 4;
/// Free distance in a medium, and the color channel for which it is sampled (2).
pub const DISTANCE: u32 = 6;
/// Airlight: distance (1).
pub const AIRLIGHT: u32 = 8;
/// Airlight: point on the light (2).
pub const AIRLIGHT_POINT: u32 = 10;
/// Russian roulette (1).
pub const ROULETTE: u32 = 12;
/// Point of a glowing medium (1).
pub const GLOW: u32 = 13;
/// Choice of the light (2: the second number holds the finer bits of the first).
pub const LIGHT: u32 = 14;
/// Airlight: choice of the light (2).
pub const AIRLIGHT_LIGHT: u32 = 16;
/// Finer bits of the free distance (1): in thin air all events are in the first steps of 24 bits.
pub const DISTANCE_FINE: u32 = 18;

/// Airlight: color channel for which a distance is sampled (1).
pub const AIRLIGHT_CHANNEL: u32 = 19;
/// Choice of a light toward which a path in fog is guided (2).
pub const LIGHT_DIRECTION: u32 = 20;

/// Weight window (1).
pub const WINDOW: u32 = 22;

/// Draws a number in [0, 1) of 48 bits, for choices among very many items. Takes two dimensions.
pub fn draw_48(stream: &mut SampleStream, dimension: u32) -> f64 {
    stream.seek(dimension);
    uniform_48(stream.next_2d())
}

/// Combines two numbers of 24 bits to one in [0, 1) of 48 bits.
pub fn uniform_48([coarse, finer]: [f32; 2]) -> f64 {
    f64::from(coarse) + f64::from(finer) / f64::from(1u32 << 24)
}
