//! Which random numbers a path uses for what: fixed dimensions, so that one decision does not shift another.

/// Position in the pixel (2).
pub const FILM: u32 = 0;
/// Position on the lens (2).
pub const LENS: u32 = 2;
/// Time in the shutter (1).
pub const TIME: u32 = 4;

/// First dimension of segment `segment` of a path (0: the camera ray).
pub const fn segment(segment: u32) -> u32 {
    8 + segment * 24
}

/// Point on the light (2), after the segment's base.
pub const LIGHT_POINT: u32 = 0;
/// Choice of the lobe, or of the phase function (1).
pub const LOBE: u32 = 3;
/// Scattered direction (2).
pub const DIRECTION: u32 = 4;
/// Free distance in a medium, and the colour channel that it is drawn for (2).
pub const DISTANCE: u32 = 6;
/// Equiangular: distance (1).
pub const EQUIANGULAR: u32 = 8;
/// Equiangular: point on the light (2).
pub const EQUIANGULAR_POINT: u32 = 10;
/// Russian roulette (1).
pub const ROULETTE: u32 = 12;
/// Point of a glowing medium (1).
pub const GLOW: u32 = 13;
/// Choice of the light (2: the second number is the finer part of the first).
pub const LIGHT: u32 = 14;
/// Equiangular: choice of the light (2).
pub const EQUIANGULAR_LIGHT: u32 = 16;

/// A number in [0, 1) of 48 bits, for choices among very many, from two of 24.
pub fn fine([coarse, finer]: [f32; 2]) -> f64 {
    f64::from(coarse) + f64::from(finer) / f64::from(1u32 << 24)
}
