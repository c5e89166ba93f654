//! Selectors: names for the scalars of a scene, used by `vary`, by sweeps and by overrides.
//!
//! | selector | scalar |
//! | --- | --- |
//! | `material.NAME.PART`, `.ed` | the amount of a [`ScatteringPart`], the emittance; `.r`, `.g`, `.b` after it: the color's channels |
//! | `material.NAME.PART_alpha` | GGX roughness of a specular part |
//! | `material.NAME.ir`, `.ir.im` | index of refraction, if the material has one |
//! | `material.NAME.lobe` | exponent of the emission lobe; 0 = Lambertian |
//! | `material.NAME.sides` | 1 or 2 |
//! | `medium.NAME.sigma_s\|sigma_a\|glow` | coefficients; `sigma_s.r`, `sigma_a.r`, `glow.r` ..: the colors' channels |
//! | `medium.NAME.phase.g`, `.phase.k` | parameter of `hg`, of `schlick`, if the medium has it |
//! | `medium.NAME.density.z0`, `.density.h` | height fog, if the medium is one |
//! | `camera.NAME.origin.x` .., `target.x` .., `up.x` .., `fov`, `film.w`, `film.h`, `lens`, `focus`, `shutter.open`, `shutter.close` | camera |
//! | `object.NAME.hidden` | 0 or 1 |
//! | `object.NAME.multiplier` | the factor (`-m`) of all IES luminaires in the object, including nested ones |
//! | `ies.PATH.multiplier` | the factor (`-m`) of all luminaires of one file |
//! | `path.NAME.K.time\|x\|y\|z` | time and translation of key K = 1, 2, .. |
//! | `time.t0\|t1\|fps` | the clip |
//!
//! Names may contain dots (`object.car.wheel.hidden`). If several entities share a name (a redefined material), a write sets all of
//! them that have the scalar, and a read returns the first.

mod field;
mod nearest;
mod slot;

use crate::description::{
    Camera, Clip, Luminaire, Material, Medium, MotionPath, Object, Photometry, ScatteringPart, Scene,
};
use slot::Slot;
use std::fmt;

/// Error of a selector.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SelectorError {
    /// No scalar of the scene has this name.
    #[error("unknown scalar `{selector}`; nearest: {}", Names(nearest))]
    Unknown {
        /// The selector, as given.
        selector: String,
        /// The three nearest names.
        nearest: Vec<String>,
    },
    /// The scalar cannot have this value.
    #[error("`{selector}` cannot be {value}: {constraint}")]
    Refused {
        /// The selector.
        selector: String,
        /// The value.
        value: f64,
        /// Constraint that the value violates.
        constraint: Constraint,
    },
    /// The scalar cannot change over time.
    #[error("`{selector}` belongs to the clip or the film and cannot vary over time")]
    Timeless {
        /// The selector.
        selector: String,
    },
}

impl SelectorError {
    /// Returns the selector that caused the error.
    pub fn selector(&self) -> &str {
        match self {
            Self::Unknown { selector, .. } | Self::Refused { selector, .. } | Self::Timeless { selector } => selector,
        }
    }
}

/// Constraint on the value of a scalar.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Constraint {
    /// Any finite number.
    #[error("it must be finite")]
    Finite,
    /// At least 0.
    #[error("it must be 0 or more")]
    NotNegative,
    /// Greater than 0.
    #[error("it must be more than 0")]
    Positive,
    /// Between two bounds, inclusive.
    #[error("it must be from {0} to {1}")]
    Within(f64, f64),
    /// Between two bounds, exclusive.
    #[error("it must be more than {0} and less than {1}")]
    Between(f64, f64),
    /// One of two values.
    #[error("it must be {0} or {1}")]
    Either(u8, u8),
    /// A whole number from 1 to a limit.
    #[error("it must be a whole number from 1 to {0}")]
    Count(u32),
    /// [`Material::reflectance_sum`] would exceed 1.
    #[error("{sum}, each times its color, would be {0}, more than 1", sum = ScatteringPart::SUM)]
    Energy(f64),
    /// The shutter would close before it opens.
    #[error("the shutter would close before it opens")]
    Shutter,
    /// The camera would have no view direction.
    #[error("the camera's target would be at its origin, or its up direction would be parallel to the view")]
    View,
    /// The keys of the path would not ascend.
    #[error("the times of the path's keys would not ascend")]
    KeyOrder,
    /// The clip would end before it starts.
    #[error("the clip would end before it starts")]
    ClipOrder,
}

struct Names<'a>(&'a [String]);

impl fmt::Display for Names<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() {
            return f.write_str("none, the scene has no scalars");
        }
        for (index, name) in self.0.iter().enumerate() {
            write!(f, "{}`{name}`", if index == 0 { "" } else { ", " })?;
        }
        Ok(())
    }
}

/// Parts of a scene that contain scalars, without its geometry and images: cheap to copy for every frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Scalars {
    /// As [`Scene::materials`].
    pub materials: Vec<Material>,
    /// As [`Scene::objects`].
    pub objects: Vec<Object>,
    /// As [`Scene::media`].
    pub media: Vec<Medium>,
    /// As [`Scene::cameras`]; not yet moved along their paths ([`Camera::at`]).
    pub cameras: Vec<Camera>,
    /// As [`Scene::paths`].
    pub paths: Vec<MotionPath>,
    /// [`crate::Group::luminaires`] of every group.
    pub luminaires: Vec<Vec<Luminaire>>,
}

/// Data that selectors read.
struct ScalarsView<'a> {
    materials: &'a [Material],
    objects: &'a [Object],
    media: &'a [Medium],
    cameras: &'a [Camera],
    paths: &'a [MotionPath],
    luminaires: Vec<&'a [Luminaire]>,
    photometry: &'a [Photometry],
    clip: Option<&'a Clip>,
}

/// Data that selectors write.
struct ScalarsViewMut<'a> {
    materials: &'a mut [Material],
    objects: &'a mut [Object],
    media: &'a mut [Medium],
    cameras: &'a mut [Camera],
    paths: &'a mut [MotionPath],
    luminaires: Vec<&'a mut [Luminaire]>,
    clip: Option<&'a mut Clip>,
}

impl ScalarsViewMut<'_> {
    fn view(&self) -> ScalarsView<'_> {
        ScalarsView {
            materials: self.materials,
            objects: self.objects,
            media: self.media,
            cameras: self.cameras,
            paths: self.paths,
            luminaires: self.luminaires.iter().map(|group| &**group).collect(),
            photometry: &[],
            clip: self.clip.as_deref(),
        }
    }

    /// Sets every slot to its value, then checks the constraints that join several scalars of the changed entities. Restores all
    /// values on failure.
    fn apply(&mut self, wanted: &[(Vec<Slot>, f64)]) -> Result<(), (usize, Constraint)> {
        let mut done = Vec::new();
        let outcome = self.write_all(wanted, &mut done);
        if outcome.is_err() {
            for (slot, old) in done.into_iter().rev() {
                slot.write(self, old);
            }
        }
        outcome
    }

    fn write_all(
        &mut self,
        wanted: &[(Vec<Slot>, f64)],
        done: &mut Vec<(Slot, f64)>,
    ) -> Result<(), (usize, Constraint)> {
        for (index, (slots, value)) in wanted.iter().enumerate() {
            for slot in slots {
                slot.check_value(*value).map_err(|constraint| (index, constraint))?;
                done.extend(slot.read(&self.view()).map(|old| (*slot, old)));
                slot.write(self, *value);
            }
        }
        // Backwards, so that the error names the last of the scalars that violate a constraint together.
        for (index, (slots, _)) in wanted.iter().enumerate().rev() {
            for slot in slots {
                slot.check_consistency(&self.view()).map_err(|constraint| (index, constraint))?;
            }
        }
        Ok(())
    }
}

impl Scene {
    /// Sets one scalar for all times; see [`Self::set_all`].
    pub fn set(&mut self, selector: &str, value: f64) -> Result<(), SelectorError> {
        self.set_all(&[(selector, value)])
    }

    /// Sets scalars, in order, for all times: a `vary` of the same scalar is removed. Values are checked together at the end, so
    /// two values that are only valid together may be given in either order. On failure the scene is unchanged.
    pub fn set_all<S: AsRef<str>>(&mut self, values: &[(S, f64)]) -> Result<(), SelectorError> {
        let wanted = self.resolve_all(values)?;
        self.view_mut().apply(&wanted).map_err(|(index, constraint)| constraint_error(&values[index], constraint))?;
        self.varies.retain(|vary| values.iter().all(|(selector, _)| selector.as_ref() != vary.selector));
        Ok(())
    }

    /// Returns the value of a scalar, ignoring its `vary`. If several entities share the name, it is the value of the first.
    pub fn get(&self, selector: &str) -> Result<f64, SelectorError> {
        let view = self.view();
        let first = slot::resolve(&view, selector).first().and_then(|slot| slot.read(&view));
        first.ok_or_else(|| self.unknown_selector_error(selector))
    }

    /// Returns all names that [`Self::set`] accepts, in the order of the scene, each once.
    pub fn selectors(&self) -> Vec<String> {
        slot::names(&self.view())
    }

    /// Returns the scalars at `time` (s). A varied scalar has its value at that time; the others are as in the description. A
    /// varied scalar with only two values (`hidden`, `sides`) takes the nearer one, so it switches half way between keys.
    pub fn scalars_at(&self, time: f64) -> Result<Scalars, SelectorError> {
        let mut scalars = Scalars {
            materials: self.materials.clone(),
            objects: self.objects.clone(),
            media: self.media.clone(),
            cameras: self.cameras.clone(),
            paths: self.paths.clone(),
            luminaires: self.groups.iter().map(|group| group.luminaires.clone()).collect(),
        };
        let values: Vec<(&str, f64)> = self.varies.iter().map(|vary| (vary.selector.as_str(), vary.at(time))).collect();
        let mut wanted = self.resolve_all(&values)?;
        for (slots, value) in &mut wanted {
            if slots.iter().any(Slot::is_switch) {
                *value = value.round();
            }
        }
        if let Some(index) = wanted.iter().position(|(slots, _)| slots.iter().any(Slot::is_timeless)) {
            return Err(SelectorError::Timeless { selector: values[index].0.into() });
        }
        scalars
            .view_mut()
            .apply(&wanted)
            .map_err(|(index, constraint)| constraint_error(&values[index], constraint))?;
        Ok(scalars)
    }

    fn resolve_all<S: AsRef<str>>(&self, values: &[(S, f64)]) -> Result<Vec<(Vec<Slot>, f64)>, SelectorError> {
        let view = self.view();
        let resolve = |(selector, value): &(S, f64)| match slot::resolve(&view, selector.as_ref()) {
            slots if slots.is_empty() => Err(self.unknown_selector_error(selector.as_ref())),
            slots => Ok((slots, *value)),
        };
        values.iter().map(resolve).collect()
    }

    fn unknown_selector_error(&self, selector: &str) -> SelectorError {
        SelectorError::Unknown { selector: selector.into(), nearest: nearest::nearest(selector, &self.selectors()) }
    }

    fn view(&self) -> ScalarsView<'_> {
        ScalarsView {
            materials: &self.materials,
            objects: &self.objects,
            media: &self.media,
            cameras: &self.cameras,
            paths: &self.paths,
            luminaires: self.groups.iter().map(|group| group.luminaires.as_slice()).collect(),
            photometry: &self.photometry,
            clip: self.clip.as_ref(),
        }
    }

    fn view_mut(&mut self) -> ScalarsViewMut<'_> {
        ScalarsViewMut {
            materials: &mut self.materials,
            objects: &mut self.objects,
            media: &mut self.media,
            cameras: &mut self.cameras,
            paths: &mut self.paths,
            luminaires: self.groups.iter_mut().map(|group| group.luminaires.as_mut_slice()).collect(),
            clip: self.clip.as_mut(),
        }
    }
}

impl Scalars {
    fn view_mut(&mut self) -> ScalarsViewMut<'_> {
        ScalarsViewMut {
            materials: &mut self.materials,
            objects: &mut self.objects,
            media: &mut self.media,
            cameras: &mut self.cameras,
            paths: &mut self.paths,
            luminaires: self.luminaires.iter_mut().map(Vec::as_mut_slice).collect(),
            clip: None,
        }
    }
}

fn constraint_error<S: AsRef<str>>((selector, value): &(S, f64), constraint: Constraint) -> SelectorError {
    SelectorError::Refused { selector: selector.as_ref().into(), value: *value, constraint }
}
