//! Vertex contexts and their use by surfaces.

use super::{
    args::{Args, Result},
    reader::Reader,
};
use crate::ImportFault;
use femc_math::glam::{DVec2, DVec3};
use femc_scene::{GroupId, Vertex};

/// Current state of a vertex.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct VertexState {
    pub vertex: Vertex,
    /// Last placement: the frame's id, the group, the index in the group. Neighboring faces share it.
    placed: Option<(u32, GroupId, u32)>,
}

impl Reader<'_> {
    pub(super) fn p(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(3..=3, "x y z")?;
        let position = args.vector(0, "coordinate (m)")?;
        self.current_vertex_mut().position = position;
        Ok(())
    }

    pub(super) fn n(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(3..=3, "x y z")?;
        let normal = args.vector(0, "normal component")?;
        let fault = ImportFault::Shape {
            what: "this normal has no direction in double precision",
            advice: "scale it to length 1",
        };
        self.current_vertex_mut().normal = match normal {
            DVec3::ZERO => None,
            n => Some(n.try_normalize().ok_or_else(|| args.fault(fault))?),
        };
        Ok(())
    }

    pub(super) fn uv(&mut self, args: &Args<'_>) -> Result<()> {
        args.check_count(2..=2, "u v")?;
        let uv = DVec2::new(args.number(0, "texture coordinate")?, args.number(1, "texture coordinate")?);
        self.current_vertex_mut().uv = Some(uv);
        Ok(())
    }

    fn current_vertex_mut(&mut self) -> &mut Vertex {
        let state = self.vertices.current_mut();
        state.placed = None;
        &mut state.vertex
    }

    /// Returns the vertex that argument `i` names, in its own coordinates.
    pub(super) fn vertex(&mut self, args: &Args<'_>, i: usize) -> Result<Vertex> {
        let slot = self.vertices.index(args, i, &mut self.errors)?;
        Ok(self.vertices.get(slot).vertex)
    }

    /// Returns `vertex` in the group's frame.
    pub(super) fn transform_vertex(&self, args: &Args<'_>, vertex: Vertex) -> Result<Vertex> {
        let frame = self.frame();
        let position = frame.to_group.transform_point3(vertex.position);
        if !position.is_finite() {
            return Err(args.fault(ImportFault::NotFinite { what: "a transformed coordinate" }));
        }
        let normal = vertex.normal.map(|n| frame.to_group.transform_vector3(n).normalize());
        if normal.is_some_and(|n| !n.is_finite()) {
            return Err(args.fault(ImportFault::NotFinite { what: "a transformed normal" }));
        }
        Ok(Vertex { position, normal, uv: vertex.uv })
    }

    /// Adds a vertex, given in the group's frame, to the group.
    pub(super) fn add_vertex(&mut self, args: &Args<'_>, vertex: Vertex) -> Result<u32> {
        let vertices = &mut self.scene.groups[self.group.index()].vertices;
        let limit = u64::from(u32::MAX - 1);
        let Some(index) = u32::try_from(vertices.len()).ok().filter(|&n| u64::from(n) < limit) else {
            self.errors.end_at_next_error();
            return Err(args.fault(ImportFault::TooMany { what: "vertices in one group", limit }));
        };
        vertices.push(vertex);
        Ok(index)
    }

    /// Returns the index in the group of the vertex that argument `i` names, with the current transform.
    pub(super) fn placed_vertex(&mut self, args: &Args<'_>, i: usize) -> Result<u32> {
        let slot = self.vertices.index(args, i, &mut self.errors)?;
        let state = *self.vertices.get(slot);
        let frame = self.frame().id;
        if let Some((id, group, index)) = state.placed
            && (id, group) == (frame, self.group)
        {
            return Ok(index);
        }
        let vertex = self.transform_vertex(args, state.vertex)?;
        let index = self.add_vertex(args, vertex)?;
        self.vertices.get_mut(slot).placed = Some((frame, self.group, index));
        Ok(index)
    }
}
