//! The finite-element solution of a frame as a glTF document, for viewers: a mesh of the elements' leaves by material and side.
//!
//! Positions have the coordinates of [`scene_geometry`](crate::scene_geometry), so that a viewer can show both.

use crate::glb::{Glb, TooLarge};
use crate::root::scene_root;
use femc_field::Field;
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_prepared::Prepared;
use femc_radiosity::{Mesh, MeshContent, SolutionView, solution_meshes};
use serde_json::{Value, json};

/// Options of [`solution_model`].
#[derive(Clone, Debug, PartialEq)]
pub struct SolutionOptions {
    /// Maximum number of triangles. A solution with more is left out, and the document says so.
    pub max_triangles: usize,
}

impl Default for SolutionOptions {
    fn default() -> Self {
        Self { max_triangles: 2_000_000 }
    }
}

/// Returns a finite-element solution as binary glTF. The bytes depend only on the frame, the solution and the options.
///
/// Vertices have the attributes `_RADIANCE` (luminance along the normal, cd/m2 by channel of linear Rec.709: reflected, transmitted
/// and emitted), `_ILLUMINANCE` (lx) and `_DIRECT` (the part of it that comes directly from lamps, lx).
/// - `field`: the solution of `prepared`, with direct light.
/// - errors: the file would be larger than 4 GiB.
pub fn solution_model(prepared: &Prepared, field: &Field, options: &SolutionOptions) -> Result<Vec<u8>, TooLarge> {
    let mut all = solution_meshes(&SolutionView::new(prepared, field));
    let full: usize = all.iter().map(|mesh| mesh.triangles.len()).sum();
    if full > options.max_triangles {
        all.clear();
    }
    let mut glb = Glb::default();
    let (mut meshes, mut nodes) = (Vec::new(), Vec::new());
    for mesh in &all {
        let name = prepared.material_name(mesh.material);
        let primitive = primitive(&mut glb, mesh);
        nodes.push(json!({
            "name": name,
            "mesh": meshes.len(),
            "extras": { "lamp": mesh.content == MeshContent::Lamps },
        }));
        meshes.push(json!({ "name": name, "primitives": [primitive] }));
    }
    let triangles: usize = all.iter().map(|mesh| mesh.triangles.len()).sum();
    let root = scene_root(prepared.origin, nodes.len());
    nodes.push(root);
    let mut document = json!({
        "asset": { "version": "2.0", "generator": format!("femc {}", env!("CARGO_PKG_VERSION")) },
        "scene": 0,
        "scenes": [{ "nodes": [nodes.len() - 1], "extras": {
            "origin": prepared.origin.to_array(),
            "axes": "positions are x, y, z of the scene in m minus its origin; the root node adds the origin and makes y the up axis",
            "_RADIANCE": "luminance along the normal, cd/m2 per channel of linear Rec.709",
            "_ILLUMINANCE": "lx",
            "_DIRECT": "the part of it that comes directly from lamps, lx",
            "leaves": field.leaves.len(),
            "triangles": triangles,
            "full_triangles": full,
            "max_triangles": options.max_triangles,
        } }],
        "nodes": nodes,
    });
    if !meshes.is_empty() {
        document["meshes"] = meshes.into();
    }
    glb.finish(document)
}

fn primitive(glb: &mut Glb, mesh: &Mesh) -> Value {
    let illuminance = |values: &[[f32; 3]]| -> Vec<f32> {
        values.iter().map(|&irradiance| luminance(Rgb::from_array(irradiance))).collect()
    };
    json!({
        "attributes": {
            "POSITION": glb.vectors(&mesh.positions),
            "_RADIANCE": glb.vectors(&mesh.radiance),
            "_ILLUMINANCE": glb.scalars(illuminance(&mesh.irradiance).into_iter()),
            "_DIRECT": glb.scalars(illuminance(&mesh.direct).into_iter()),
        },
        "indices": glb.indices(&mesh.triangles),
        "mode": 4,
    })
}
