//! The solution as a glTF document. Each material and side has one node. All nodes are below a root node that turns the scene's z
//! up into glTF's y up.

use femc_pipeline::gltf::{Glb, TooLarge, scene_root};
use femc_pipeline::radiosity::{Mesh, MeshContent};
use femc_pipeline::{Prepared, Side};
use serde_json::{Value, json};

/// Whether the elements' edges are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wireframe {
    /// The edges are drawn as lines.
    Shown,
    /// The edges are not drawn.
    Hidden,
}

/// Distance of the lines from the surface, relative to the scene's extent.
const EDGE_OFFSET: f32 = 1e-4;
/// Gray value of the lines.
const EDGE_GRAY: f32 = 0.02;

/// Metadata of the file.
pub struct GltfMetadata<'a> {
    /// The frame.
    pub prepared: &'a Prepared,
    /// Color of a luminance of 1 cd/m2: colors are luminances times this.
    pub scale: f32,
    /// `scale` as an exposure value.
    pub ev: f64,
    /// The scene file.
    pub scene: String,
}

/// Returns the bytes of the file.
pub fn glb(meshes: &[Mesh], wireframe: Wireframe, metadata: &GltfMetadata<'_>) -> Result<Vec<u8>, TooLarge> {
    let mut glb = Glb::default();
    let (mut materials, mut shown, mut nodes) = (Vec::new(), Vec::new(), Vec::new());
    let lift = EDGE_OFFSET * metadata.prepared.world.bounds().size().length();
    for mesh in meshes {
        let name = name(mesh, metadata.prepared);
        materials.push(material(&name, 1.0));
        let mut primitives = vec![surface(&mut glb, mesh, metadata.scale, materials.len() - 1)];
        if wireframe == Wireframe::Shown && mesh.content == MeshContent::Elements {
            materials.push(material(&format!("edges of {name}"), EDGE_GRAY));
            primitives.push(edges(&mut glb, mesh, lift, materials.len() - 1));
        }
        shown.push(json!({ "name": name, "primitives": primitives }));
        nodes.push(json!({ "name": name, "mesh": shown.len() - 1 }));
    }
    let root = scene_root(metadata.prepared.origin, nodes.len());
    nodes.push(root);
    let mut document = json!({
        "asset": { "version": "2.0", "generator": format!("femc {}", env!("CARGO_PKG_VERSION")) },
        "scene": 0,
        "scenes": [{ "name": metadata.scene, "nodes": [nodes.len() - 1], "extras": extras(metadata) }],
        "nodes": nodes,
    });
    if !shown.is_empty() {
        document["meshes"] = shown.into();
        document["materials"] = materials.into();
        document["extensionsUsed"] = json!(["KHR_materials_unlit"]);
    }
    glb.finish(document)
}

fn extras(metadata: &GltfMetadata<'_>) -> Value {
    json!({
        "frame": metadata.prepared.frame,
        "scale": metadata.scale,
        "exposure_ev": metadata.ev,
        "color": "COLOR_0 = min(1, scale * luminance), luminance in cd/m2 per channel of linear Rec.709, along the normal",
        "_RADIANCE": "this luminance without scale and limit, cd/m2",
        "_IRRADIANCE": "lx per channel, including direct light of lamps",
        "_DIRECT": "only the direct light of lamps, lx",
        "_ELEMENT": "number of the element, -1 for lamps",
        "_SURFACE": "number of the surface, -1 for lamps",
        "origin": metadata.prepared.to_world([0.0; 3].into()),
        "axes": "positions are x, y, z of the scene in m minus its origin; the root node adds the origin and makes y the up axis",
    })
}

fn name(mesh: &Mesh, prepared: &Prepared) -> String {
    let material = match prepared.material_name(mesh.material) {
        "" => "unnamed",
        name => name,
    };
    let part = if mesh.content == MeshContent::Lamps { ", lamp" } else { "" };
    let side = if mesh.side == Side::Back { ", back" } else { "" };
    format!("{material}{part}{side}")
}

/// Returns an unlit, one-sided material.
fn material(name: &str, gray: f32) -> Value {
    json!({
        "name": name,
        "doubleSided": false,
        "pbrMetallicRoughness": { "baseColorFactor": [gray, gray, gray, 1.0], "metallicFactor": 0.0 },
        "extensions": { "KHR_materials_unlit": {} },
    })
}

fn surface(glb: &mut Glb, mesh: &Mesh, scale: f32, material: usize) -> Value {
    let colors: Vec<[f32; 3]> = mesh.radiance.iter().map(|color| color.map(|c| (c * scale).min(1.0))).collect();
    // Exact up to 2^24, which is more than fits into a file.
    let number = |&index: &u32| if index == u32::MAX { -1.0 } else { index as f32 };
    json!({
        "attributes": {
            "POSITION": glb.vectors(&mesh.positions),
            "COLOR_0": glb.vectors(&colors),
            "_RADIANCE": glb.vectors(&mesh.radiance),
            "_IRRADIANCE": glb.vectors(&mesh.irradiance),
            "_DIRECT": glb.vectors(&mesh.direct),
            "_ELEMENT": glb.scalars(mesh.leaves.iter().map(number)),
            "_SURFACE": glb.scalars(mesh.surfaces.iter().map(number)),
        },
        "indices": glb.indices(&mesh.triangles),
        "material": material,
        "mode": 4,
    })
}

/// Returns lines a little in front of the surface.
fn edges(glb: &mut Glb, mesh: &Mesh, lift: f32, material: usize) -> Value {
    let lifted = |(p, n): (&[f32; 3], &[f32; 3])| std::array::from_fn(|axis| p[axis] + lift * n[axis]);
    let positions: Vec<[f32; 3]> = mesh.positions.iter().zip(&mesh.normals).map(lifted).collect();
    json!({
        "attributes": { "POSITION": glb.vectors(&positions) },
        "indices": glb.indices(&mesh.edges),
        "material": material,
        "mode": 1,
    })
}
