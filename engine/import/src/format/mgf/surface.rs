//! Surface entities: `f`, `fh`, `prism`, `sph`, `cyl`, `cone`, `ring`, `torus`.
//!
//! MGF's transforms are similarities, so every shape maps to a shape of the same kind. Under a mirror, curved surfaces keep their
//! facing and faces are reversed, so the mirror image of a solid is a solid with its front sides out.

use super::{
    args::{Args, Result},
    polygon,
    reader::Reader,
};
use crate::{ImportFault, WarningKind};
use femc_math::glam::DVec3;
use femc_scene::{Face, Facing, MaterialId, Quadric, Shape, Vertex};

/// Deviation from the plane, relative to a face's size, above which a warning is given.
const PLANAR: f64 = 5e-3;

impl Reader<'_> {
    pub(super) fn f(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(3.., "at least three vertices")?;
        let indices = (0..args.len()).map(|i| self.placed_vertex(args, i)).collect::<Result<Vec<_>>>()?;
        self.add_face(args, indices, &[])
    }

    /// Reads `fh v1 .. - v5 ..`.
    pub(super) fn fh(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(3.., "at least three vertices")?;
        let (mut indices, mut holes) = (Vec::new(), Vec::new());
        let mut first = 0;
        for i in 0..=args.len() {
            let end = i == args.len();
            if end || args.raw(i) == b"-" {
                if indices.len() - first < 3 {
                    let what = ImportFault::Shape {
                        what: "a contour has fewer than three vertices",
                        advice: "add vertices to the contour",
                    };
                    return Err(args.fault_at(i, what));
                }
                first = indices.len();
                if !end {
                    holes.push(first as u32);
                }
            } else {
                indices.push(self.placed_vertex(args, i)?);
            }
        }
        self.add_face(args, indices, &holes)
    }

    /// Adds a face of placed vertices, in the winding of the file.
    fn add_face(&mut self, args: &Args<'_>, mut indices: Vec<u32>, holes: &[u32]) -> Result<()> {
        if self.frame().mirrored {
            let mut rest = &mut indices[..];
            for length in contour_lengths(rest.len(), holes) {
                let (contour, others) = rest.split_at_mut(length);
                contour.reverse();
                rest = others;
            }
        }
        let material = self.current_material();
        let object = self.current_object();
        let group = &mut self.scene.groups[self.group.index()];
        let bare = indices.iter().any(|&i| group.vertices[i as usize].uv.is_none());
        let points: Vec<DVec3> = indices.iter().map(|&i| group.vertices[i as usize].position).collect();
        let outcome = self.triangulator.triangulate(&points, holes);
        let triangles = &self.triangulator.triangles;
        let triangle_count = triangles.len() as u32;
        let first_triangle = group.triangles.len() as u32;
        group.triangles.extend(triangles.iter().map(|t| t.map(|i| indices[i as usize])));
        group.faces.push(Face { first_triangle, triangle_count, material, object, location: args.location() });
        self.count_primitives(self.group, u64::from(triangle_count.max(1))).map_err(|fault| args.fault(fault))?;
        if bare {
            self.warn_without_uv(args, material);
        }
        if triangle_count == 0 {
            self.warn(args, WarningKind::NoArea);
            return Ok(());
        }
        if outcome.deviation > PLANAR {
            self.warn(args, WarningKind::NotPlanar { deviation: outcome.deviation });
        }
        if !outcome.covered {
            self.warn(args, WarningKind::CrossesItself);
        }
        if outcome.hole_wound_like_outer {
            self.warn(args, WarningKind::HoleOrientation);
        }
        Ok(())
    }

    fn warn_without_uv(&mut self, args: &Args<'_>, id: MaterialId) {
        let material = &self.scene.materials[id.index()];
        let textured = [material.map_rd, material.map_ed, material.map_n].iter().any(Option::is_some);
        if textured && !self.without_uv.contains(&id) {
            let material = material.name.clone();
            self.without_uv.insert(id);
            self.warn(args, WarningKind::NoTextureCoordinates { material });
        }
    }

    /// Reads `prism v1 .. vn len`. The far end is reversed, and sides run from each edge to its copy.
    pub(super) fn prism(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(4.., "at least three vertices and a length")?;
        let n = args.len() - 1;
        let length = args.number_in(n, "length (m)", "not 0", |x| x != 0.0)?;
        let near = (0..n).map(|i| self.vertex(args, i)).collect::<Result<Vec<Vertex>>>()?;
        let positions: Vec<DVec3> = near.iter().map(|v| v.position).collect();
        let fault =
            ImportFault::Shape { what: "the base of the prism has no area", advice: "list its corners in order" };
        let normal = polygon::vector_area(&positions).try_normalize().ok_or_else(|| args.fault(fault))?;
        let far: Vec<Vertex> = near.iter().map(|v| Vertex { position: v.position - normal * length, ..*v }).collect();
        let bare = |v: &Vertex| Vertex { normal: None, ..*v };
        let base = near.iter().map(|v| self.add_transformed(args, bare(v))).collect::<Result<Vec<_>>>()?;
        let mut end = far.iter().map(|v| self.add_transformed(args, bare(v))).collect::<Result<Vec<_>>>()?;
        // Sides share the vertices of the ends unless they have normals of their own.
        let smooth = near.iter().any(|v| v.normal.is_some());
        let (near_side, far_side) = match smooth {
            true => (
                near.iter().map(|v| self.add_transformed(args, *v)).collect::<Result<Vec<_>>>()?,
                far.iter().map(|v| self.add_transformed(args, *v)).collect::<Result<Vec<_>>>()?,
            ),
            false => (base.clone(), end.clone()),
        };
        self.add_face(args, base, &[])?;
        for i in 0..n {
            let j = (i + 1) % n;
            self.add_face(args, vec![near_side[i], far_side[i], far_side[j], near_side[j]], &[])?;
        }
        end.reverse();
        self.add_face(args, end, &[])
    }

    fn add_transformed(&mut self, args: &Args<'_>, vertex: Vertex) -> Result<u32> {
        let vertex = self.transform_vertex(args, vertex)?;
        self.add_vertex(args, vertex)
    }

    pub(super) fn sph(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(2..=2, "a vertex and a radius")?;
        let (radius, facing) = self.radius(args, 1)?;
        let center = self.transformed_vertex(args, 0)?.position;
        self.add_quadric(args, Shape::Sphere { center, radius, facing })
    }

    pub(super) fn cyl(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(3..=3, "v1 radius v2")?;
        let (radius, facing) = self.radius(args, 1)?;
        let (start, end) = (self.transformed_vertex(args, 0)?.position, self.transformed_vertex(args, 2)?.position);
        self.add_cone(args, Shape::Cone { start, end, start_radius: radius, end_radius: radius, facing })
    }

    pub(super) fn cone(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(4..=4, "v1 radius1 v2 radius2")?;
        let (r1, r2) = (args.number(1, "radius (m)")?, args.number(3, "radius (m)")?);
        if r1 == 0.0 && r2 == 0.0 {
            return Err(args.out_of_range(1, "radius of both ends (m)", 0.0, "nonzero at one or both ends"));
        }
        if r1 * r2 < 0.0 || (r1 < 0.0) != (r2 < 0.0) && r1 != 0.0 && r2 != 0.0 {
            return Err(args.out_of_range(3, "radius of the second end (m)", r2, "of the same sign as the first"));
        }
        let facing = if r1 < 0.0 || r2 < 0.0 { Facing::Inward } else { Facing::Outward };
        let scale = self.frame().scale;
        let (start, end) = (self.transformed_vertex(args, 0)?.position, self.transformed_vertex(args, 2)?.position);
        let (start_radius, end_radius) = (r1.abs() * scale, r2.abs() * scale);
        self.add_cone(args, Shape::Cone { start, end, start_radius, end_radius, facing })
    }

    fn add_cone(&mut self, args: &Args<'_>, shape: Shape) -> Result<()> {
        if let Shape::Cone { start, end, .. } = shape
            && (end - start).try_normalize().is_none()
        {
            let fault = ImportFault::Shape {
                what: "both ends are at one point",
                advice: "move one; use `ring` for a flat annulus",
            };
            return Err(args.fault(fault));
        }
        self.add_quadric(args, shape)
    }

    pub(super) fn ring(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(3..=3, "a vertex, rmin and rmax")?;
        let inner = args.number_in(1, "inner radius (m)", ">= 0", |r| r >= 0.0)?;
        let outer = args.number_in(2, "outer radius (m)", "> the inner radius", |r| r > inner)?;
        let scale = self.frame().scale;
        let (center, normal) = self.oriented_vertex(args)?;
        self.add_quadric(args, Shape::Ring { center, normal, inner: inner * scale, outer: outer * scale })
    }

    pub(super) fn torus(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(3..=3, "a vertex, rmin and rmax")?;
        let (r1, r2) = (args.number(1, "inner radius (m)")?, args.number(2, "outer radius (m)")?);
        let facing = if r1 < 0.0 || (r1 == 0.0 && r2 < 0.0) { Facing::Inward } else { Facing::Outward };
        let (inner, outer) = match facing {
            Facing::Inward => (-r1, -r2),
            Facing::Outward => (r1, r2),
        };
        if outer <= inner {
            let allowed = "farther from 0 than the inner radius, and of the same sign";
            return Err(args.out_of_range(2, "outer radius (m)", r2, allowed));
        }
        let scale = self.frame().scale;
        let (center, axis) = self.oriented_vertex(args)?;
        let (major, minor) = (0.5 * (inner + outer) * scale, 0.5 * (outer - inner) * scale);
        self.add_quadric(args, Shape::Torus { center, axis, major, minor, facing })
    }

    fn radius(&self, args: &Args<'_>, i: usize) -> Result<(f64, Facing)> {
        let radius = args.number_in(i, "radius (m)", "not 0", |r| r != 0.0)?;
        let facing = if radius < 0.0 { Facing::Inward } else { Facing::Outward };
        Ok((radius.abs() * self.frame().scale, facing))
    }

    fn transformed_vertex(&mut self, args: &Args<'_>, i: usize) -> Result<Vertex> {
        let vertex = self.vertex(args, i)?;
        self.transform_vertex(args, vertex)
    }

    /// Returns position and normal of the vertex that the first argument names.
    fn oriented_vertex(&mut self, args: &Args<'_>) -> Result<(DVec3, DVec3)> {
        let vertex = self.transformed_vertex(args, 0)?;
        let fault = ImportFault::Shape {
            what: "this vertex has no normal to orient the shape",
            advice: "add one with `n x y z`",
        };
        Ok((vertex.position, vertex.normal.ok_or_else(|| args.fault_at(0, fault))?))
    }

    fn add_quadric(&mut self, args: &Args<'_>, shape: Shape) -> Result<()> {
        let finite = |radii: &[f64]| radii.iter().all(|r| r.is_finite()) && radii.iter().any(|&r| r > 0.0);
        let sound = match shape {
            Shape::Sphere { radius, .. } => finite(&[radius]),
            Shape::Cone { start_radius, end_radius, .. } => finite(&[start_radius, end_radius]),
            Shape::Ring { inner, outer, .. } => finite(&[outer]) && inner < outer,
            Shape::Torus { major, minor, .. } => finite(&[major, minor]) && minor > 0.0,
        };
        if !sound {
            return Err(args.fault(ImportFault::NotFinite { what: "a transformed radius (or it is 0)" }));
        }
        let material = self.current_material();
        self.warn_without_uv(args, material);
        let quadric = Quadric { shape, material, object: self.current_object(), location: args.location() };
        self.scene.groups[self.group.index()].quadrics.push(quadric);
        self.count_primitives(self.group, 1).map_err(|fault| args.fault(fault))
    }
}

/// Returns the lengths of the contours of `n` vertices whose holes start at `holes`.
fn contour_lengths(n: usize, holes: &[u32]) -> Vec<usize> {
    let ends = holes.iter().map(|&first| first as usize).chain([n]);
    let starts = [0].into_iter().chain(holes.iter().map(|&first| first as usize));
    starts.zip(ends).map(|(start, end)| end - start).collect()
}
