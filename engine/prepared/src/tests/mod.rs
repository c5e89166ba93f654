//! Tests of prepared frames against closed forms and quadrature in double precision.
#![expect(clippy::disallowed_methods, reason = "references may differ in their last bits between platforms")]

mod camera;
mod lights;
mod material;
mod media;

/// Returns the midpoints of `count` equal parts of [0, 1].
fn midpoints(count: u32) -> impl Iterator<Item = f64> + Clone {
    (0..count).map(move |k| (f64::from(k) + 0.5) / f64::from(count))
}
