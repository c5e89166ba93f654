use crate::{Cell, DirectionTable, DirectionTables, FogTree, Harmonics, NONE, Side, Surface};
use femc_geometry::Hit;
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::glam::{Vec2, Vec3A};

/// Data of a leaf: irradiance, lx by channel.
#[derive(Clone, Copy, Debug)]
pub enum Leaf {
    /// Values of a triangle, at the three points with barycentric weights of two thirds for one corner and a sixth for each of the
    /// others.
    Triangle([Rgb; 3]),
    /// Values of a rectangle, at the four points of Gauss' rule, the first parameter fastest.
    Rectangle([Rgb; 4]),
    /// Values by direction of the normal.
    Curved(Harmonics),
}

/// Distance of the points of Gauss' rule from the center of [0, 1].
const GAUSS_OFFSET: f32 = 0.288_675_13;

impl Leaf {
    /// Points of a triangle's values, in the leaf's coordinates.
    pub const TRIANGLE_POINTS: [Vec2; 3] =
        [Vec2::new(1.0 / 6.0, 1.0 / 6.0), Vec2::new(2.0 / 3.0, 1.0 / 6.0), Vec2::new(1.0 / 6.0, 2.0 / 3.0)];
    /// Points of a rectangle's values, in the leaf's coordinates.
    pub const RECTANGLE_POINTS: [Vec2; 4] = [
        Vec2::new(0.5 - GAUSS_OFFSET, 0.5 - GAUSS_OFFSET),
        Vec2::new(0.5 + GAUSS_OFFSET, 0.5 - GAUSS_OFFSET),
        Vec2::new(0.5 - GAUSS_OFFSET, 0.5 + GAUSS_OFFSET),
        Vec2::new(0.5 + GAUSS_OFFSET, 0.5 + GAUSS_OFFSET),
    ];

    /// Evaluates the linear function with these values at a triangle's points.
    pub fn interpolate_triangle(values: &[Rgb; 3], local: Vec2) -> Rgb {
        let [a, b, c] = [1.0 - local.x - local.y, local.x, local.y].map(|weight| 2.0 * weight - 1.0 / 3.0);
        values[0] * a + values[1] * b + values[2] * c
    }

    /// Evaluates the bilinear function with these values at a rectangle's points.
    pub fn interpolate_rectangle(values: &[Rgb; 4], local: Vec2) -> Rgb {
        let [x, y] = [local.x, local.y].map(|at| (at - (0.5 - GAUSS_OFFSET)) / (2.0 * GAUSS_OFFSET));
        (values[0] * (1.0 - x) + values[1] * x) * (1.0 - y) + (values[2] * (1.0 - x) + values[3] * x) * y
    }

    /// Returns the irradiance at a point of the leaf.
    /// - `local`: the point's coordinates in the leaf;
    /// - `normal`: unit normal of the surface's side there.
    pub fn irradiance(&self, local: Vec2, normal: Vec3A) -> Rgb {
        match self {
            Self::Triangle(values) => Self::interpolate_triangle(values, local).max(Rgb::ZERO),
            Self::Rectangle(values) => Self::interpolate_rectangle(values, local).max(Rgb::ZERO),
            Self::Curved(light) => light.cosine_integral(normal),
        }
    }

    /// Returns the leaf with all light multiplied by a factor.
    fn scaled(&self, factor: f32) -> Self {
        match self {
            Self::Triangle(values) => Self::Triangle(values.map(|value| value * factor)),
            Self::Rectangle(values) => Self::Rectangle(values.map(|value| value * factor)),
            Self::Curved(light) => Self::Curved(*light * Rgb::splat(factor)),
        }
    }

    /// Returns the luminance of the mean irradiance over the leaf, lx; at least 0.
    pub fn mean_illuminance(&self) -> f32 {
        luminance(self.mean_irradiance())
    }

    /// Returns the mean irradiance over the leaf, lx by channel; at least 0.
    pub fn mean_irradiance(&self) -> Rgb {
        let mean = |values: &[Rgb]| values.iter().copied().sum::<Rgb>() * (1.0 / values.len() as f32);
        let mean = match self {
            Self::Triangle(values) => mean(values),
            Self::Rectangle(values) => mean(values),
            Self::Curved(light) => {
                let axes = [Vec3A::X, Vec3A::Y, Vec3A::Z];
                axes.iter()
                    .map(|&axis| (light.cosine_integral(axis) + light.cosine_integral(-axis)) * (1.0 / 6.0))
                    .sum()
            }
        };
        mean.max(Rgb::ZERO)
    }
}

/// Light of a scene as found by the first pass.
#[derive(Clone, Debug, Default)]
pub struct Field {
    /// All surfaces.
    pub surfaces: Vec<Surface>,
    /// First cell by surface, or [`NONE`].
    pub roots: Vec<u32>,
    /// Parts of surfaces.
    pub cells: Vec<Cell>,
    /// Light of the leaves, without direct light from light sources.
    pub leaves: Vec<Leaf>,
    /// Direct light from light sources by leaf, of the same kinds as `leaves`. Viewers show it; rendering computes direct light with
    /// shadow rays. Empty if it is not known.
    pub direct: Vec<Leaf>,
    /// Estimated root mean square error of the irradiance by leaf, lx by luminance. Empty if it was not estimated.
    pub errors: Vec<f32>,
    /// Tables of directions by leaf, for the method of 1998. Empty if they were not computed.
    pub tables: DirectionTables,
    /// Surfaces of the front and of the back by instance and primitive, or [`NONE`].
    pub sides: Vec<Vec<[u32; 2]>>,
    /// Light in fog.
    pub fog: FogTree,
}

impl Field {
    /// Multiplies all light by a factor, as for a scene with lamps that are brighter by the factor.
    pub fn scaled(mut self, factor: f32) -> Self {
        self.leaves.iter_mut().chain(&mut self.direct).for_each(|leaf| *leaf = leaf.scaled(factor));
        self.errors.iter_mut().for_each(|error| *error *= factor);
        self.fog.scale(factor);
        self
    }

    /// Returns the irradiance at a hit, lx by channel, without direct light from light sources.
    /// - `position`, `normal`: position of the hit, and its unit normal on the requested side.
    /// - returns 0 if the first pass has no surface there.
    pub fn irradiance(&self, hit: &Hit, side: Side, position: Vec3A, normal: Vec3A) -> Rgb {
        let found = self.leaf_at(hit, side, position);
        found.map_or(Rgb::ZERO, |(leaf, local)| self.leaves[leaf as usize].irradiance(local, normal))
    }

    /// Returns the estimated root mean square error of the irradiance at a hit, lx by luminance.
    /// - `position`: position of the hit.
    /// - returns 0 if the first pass has no surface there, or no estimate.
    pub fn irradiance_error(&self, hit: &Hit, side: Side, position: Vec3A) -> f32 {
        let found = self.leaf_at(hit, side, position);
        found.and_then(|(leaf, _)| self.errors.get(leaf as usize)).copied().unwrap_or(0.0)
    }

    /// Returns the index of the surface of a hit, and the function that returns the parameters of a position on it. The function must
    /// not be called if the first pass has no surface there.
    #[inline]
    pub(crate) fn surface_at(&self, hit: &Hit, side: Side) -> (u32, impl FnOnce(Vec3A) -> Vec2) {
        let surface = self.sides[hit.instance as usize][hit.primitive as usize][usize::from(side == Side::Back)];
        let [u, v] = [hit.u, hit.v];
        (surface, move |position| self.surfaces[surface as usize].parameters(position, [u, v]))
    }

    /// Returns the table of directions at a hit. `None` if there is none.
    /// - `position`: position of the hit.
    pub fn table_at(&self, hit: &Hit, side: Side, position: Vec3A) -> Option<&DirectionTable> {
        self.tables.of_leaf(self.leaf_at(hit, side, position)?.0)
    }

    /// Returns the table of directions at a point in fog. `None` if there is none.
    pub fn fog_table_at(&self, point: Vec3A) -> Option<&DirectionTable> {
        self.tables.of_fog_leaf(self.fog.leaf_at(point)?)
    }

    /// Returns the leaf of a hit, and the hit's coordinates in it.
    pub fn leaf_at(&self, hit: &Hit, side: Side, position: Vec3A) -> Option<(u32, Vec2)> {
        let (surface, root) = self.surface_and_root(hit, side)?;
        Cell::find(&self.cells, root, surface.parameters(position, [hit.u, hit.v]))
    }

    /// Returns the surface of a hit, and its first cell.
    #[inline]
    fn surface_and_root(&self, hit: &Hit, side: Side) -> Option<(&Surface, u32)> {
        let sides = self.sides[hit.instance as usize][hit.primitive as usize];
        let surface = sides[usize::from(side == Side::Back)] as usize;
        let root = *self.roots.get(surface)?;
        (root != NONE).then(|| (&self.surfaces[surface], root))
    }

    /// Returns the number of bytes of the field.
    pub fn memory(&self) -> usize {
        size_of_val(&*self.surfaces)
            + size_of_val(&*self.cells)
            + size_of_val(&*self.leaves)
            + size_of_val(&*self.direct)
            + size_of_val(&*self.errors)
            + self.tables.memory()
            + self.sides.iter().map(|sides| size_of_val(&**sides)).sum::<usize>()
            + self.fog.memory()
    }
}
