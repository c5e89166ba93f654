//! The surfaces of a frame as a glTF document.
//!
//! A root node turns the scene's z up into glTF's y up and adds the origin. Below it, each object has a node at each of its places,
//! and each camera has a node. Copies of small meshes are united in one mesh; copies of large meshes share it.

use crate::cameras::cameras;
use crate::detail::{Detail, DetailLimits, DetailPlan};
use crate::glb::{Glb, TooLarge};
use crate::material::material;
use crate::mesh::PieceMesh;
use crate::objects::{ObjectSurfaces, Piece, Place, surfaces_by_object};
use crate::root::scene_root;
use femc_geometry::Aabb;
use femc_math::glam::Affine3A;
use femc_prepared::Prepared;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Meshes with at least this many triangles are shared by their copies.
const SHARED_TRIANGLES: u64 = 1024;
/// Largest number of entries in the list of boxed objects.
const MAX_LISTED: usize = 1000;

/// Options of [`scene_geometry`].
#[derive(Clone, Debug, PartialEq)]
pub struct GeometryOptions {
    /// Largest distance of triangles from a curved surface, as a share of the diagonal of its bounding box.
    pub deviation: f64,
    /// Maximum number of triangles. The triangles of a mesh count once for each copy of it.
    pub max_triangles: u64,
    /// Largest number of objects.
    pub max_objects: usize,
    /// Name of the frame's camera; `None`: the first.
    pub camera: Option<String>,
}

impl Default for GeometryOptions {
    fn default() -> Self {
        Self { deviation: 0.002, max_triangles: 2_000_000, max_objects: 100_000, camera: None }
    }
}

/// Returns the surfaces of a frame as binary glTF. The bytes depend only on the frame and the options.
pub fn scene_geometry(prepared: &Prepared, options: &GeometryOptions) -> Result<Vec<u8>, TooLarge> {
    let objects = surfaces_by_object(prepared);
    let plan = DetailPlan::new(
        &objects,
        options.deviation,
        DetailLimits { triangles: options.max_triangles, objects: options.max_objects },
    );
    let mut document = Document::new(prepared);
    let mut boxed = Vec::new();
    for (object, &(detail, full)) in objects.iter().zip(&plan.objects) {
        document.add_object(object, detail, plan.share);
        if detail != Detail::Full {
            boxed.push(json!({
                "object": prepared.object_name(object.object),
                "object_number": object.object.map(|object| object.0),
                "triangles": full,
                "left_out": detail == Detail::LeftOut,
            }));
        }
    }
    for camera in cameras(prepared, options.camera.as_deref()) {
        document.add_camera(camera.camera, camera.node);
    }
    let full = plan.objects.iter().fold(0u64, |sum, (_, triangles)| sum.saturating_add(*triangles));
    let boxed_objects = boxed.len();
    boxed.truncate(MAX_LISTED);
    let extras = json!({
        "origin": prepared.origin.to_array(),
        "axes": "positions are x, y, z of the scene in m minus its origin; the root node adds the origin and makes y the up axis",
        "deviation": document.deviation,
        "deviation_share": plan.share,
        "triangles": document.triangles,
        "full_triangles": full,
        "max_triangles": options.max_triangles,
        "boxed_objects": boxed_objects,
        "boxed": boxed,
    });
    document.finish(extras)
}

/// A document under construction.
struct Document<'a> {
    prepared: &'a Prepared,
    glb: Glb,
    meshes: Vec<Value>,
    nodes: Vec<Value>,
    cameras: Vec<Value>,
    materials: Vec<Value>,
    material_indices: BTreeMap<u32, usize>,
    triangles: u64,
    deviation: f64,
}

impl<'a> Document<'a> {
    fn new(prepared: &'a Prepared) -> Self {
        Self {
            prepared,
            glb: Glb::default(),
            meshes: Vec::new(),
            nodes: Vec::new(),
            cameras: Vec::new(),
            materials: Vec::new(),
            material_indices: BTreeMap::new(),
            triangles: 0,
            deviation: 0.0,
        }
    }

    fn add_object(&mut self, object: &ObjectSurfaces<'_>, detail: Detail, share: f64) {
        match detail {
            Detail::LeftOut => {}
            Detail::Full => {
                for piece in &object.pieces {
                    let mesh = PieceMesh::new(piece, share);
                    self.add_piece(object, &mesh, &piece.places, detail);
                }
            }
            Detail::PlacedBoxes => {
                for piece in &object.pieces {
                    let mesh = PieceMesh::of_box(&piece.bounds(), first_material(piece));
                    self.add_piece(object, &mesh, &piece.places, detail);
                }
            }
            Detail::OneBox => {
                let boxes = object.pieces.iter().flat_map(|piece| {
                    let bounds = piece.bounds();
                    piece.places.iter().map(move |place| bounds.transformed(&place.pose))
                });
                let bounds = boxes.fold(Aabb::EMPTY, Aabb::union);
                let Some(material) = object.pieces.first().map(first_material) else { return };
                let moves = object.pieces.iter().any(|piece| piece.places.iter().any(|place| place.moves));
                let place = Place { pose: Affine3A::IDENTITY, moves };
                self.add_piece(object, &PieceMesh::of_box(&bounds, material), &[place], detail);
            }
        }
    }

    /// Adds a mesh at its places.
    fn add_piece(&mut self, object: &ObjectSurfaces<'_>, mesh: &PieceMesh, places: &[Place], detail: Detail) {
        let moves = places.iter().any(|place| place.moves);
        if places.len() > 1 && mesh.triangles() < SHARED_TRIANGLES {
            let united = Place { pose: Affine3A::IDENTITY, moves };
            let mesh = mesh.placed(places);
            let index = self.mesh(object, &mesh);
            self.node(object, &mesh, index, (&united, places.len()), detail);
            return;
        }
        let index = self.mesh(object, mesh);
        for place in places {
            self.node(object, mesh, index, (place, 1), detail);
        }
    }

    /// Adds a mesh. Returns its index.
    fn mesh(&mut self, object: &ObjectSurfaces<'_>, mesh: &PieceMesh) -> usize {
        let mut primitives = Vec::new();
        for ((material, _), part) in &mesh.parts {
            let mut attributes = json!({ "POSITION": self.glb.vectors(&part.positions) });
            if !part.normals.is_empty() {
                attributes["NORMAL"] = self.glb.vectors(&part.normals).into();
            }
            primitives.push(json!({
                "attributes": attributes,
                "indices": self.glb.indices(&part.triangles),
                "material": self.material(*material),
                "mode": 4,
            }));
        }
        self.meshes.push(json!({ "name": self.prepared.object_name(object.object), "primitives": primitives }));
        self.meshes.len() - 1
    }

    fn material(&mut self, number: u32) -> usize {
        *self.material_indices.entry(number).or_insert_with(|| {
            self.materials.push(material(self.prepared, number));
            self.materials.len() - 1
        })
    }

    /// Adds a node of an object.
    /// - `place`: pose of the mesh, and number of places that it shows.
    fn node(
        &mut self,
        object: &ObjectSurfaces<'_>,
        mesh: &PieceMesh,
        index: usize,
        (place, places): (&Place, usize),
        detail: Detail,
    ) {
        let deviation = mesh.deviation * place.scale();
        let name = self.prepared.object_name(object.object);
        let mut node = json!({
            "name": name,
            "mesh": index,
            "extras": {
                "object": name,
                "object_number": object.object.map(|object| object.0),
                "triangles": mesh.triangles(),
                "places": places,
                "deviation": deviation,
                "boxed": detail != Detail::Full,
                "moves": place.moves,
            },
        });
        if place.pose != Affine3A::IDENTITY {
            let m = place.pose.matrix3;
            let columns = [m.x_axis, m.y_axis, m.z_axis, place.pose.translation];
            let matrix = columns.iter().zip([0.0, 0.0, 0.0, 1.0]).map(|(c, w)| [c.x, c.y, c.z, w]);
            node["matrix"] = matrix.flatten().map(f64::from).collect();
        }
        self.nodes.push(node);
        self.triangles += mesh.triangles();
        self.deviation = self.deviation.max(deviation);
    }

    fn add_camera(&mut self, camera: Value, mut node: Value) {
        node["camera"] = self.cameras.len().into();
        self.cameras.push(camera);
        self.nodes.push(node);
    }

    fn finish(mut self, extras: Value) -> Result<Vec<u8>, TooLarge> {
        let root = scene_root(self.prepared.origin, self.nodes.len());
        self.nodes.push(root);
        let mut document = json!({
            "asset": { "version": "2.0", "generator": format!("femc {}", env!("CARGO_PKG_VERSION")) },
            "scene": 0,
            "scenes": [{ "nodes": [self.nodes.len() - 1] }],
            "nodes": self.nodes,
        });
        document["scenes"][0]["extras"] = extras;
        for (key, values) in [("meshes", self.meshes), ("materials", self.materials), ("cameras", self.cameras)] {
            if !values.is_empty() {
                document[key] = values.into();
            }
        }
        self.glb.finish(document)
    }
}

/// Returns the material of the first surface of a piece.
fn first_material(piece: &Piece<'_>) -> u32 {
    let first = piece.numbers().find(|primitive| piece.surface(*primitive).is_some());
    first.map_or(0, |primitive| piece.group.primitives[primitive as usize].material)
}
