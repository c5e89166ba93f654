//! Compares rays per second with Embree 4 on the same rays:
//! `cargo run --release -p femc-geometry --features yardsticks --example embree LIBEMBREE4.so [MESH.bin]`.
//!
//! The library is loaded at run time, so femc is not built with it. Wheels of `embreex` contain one. The meshes, rays and rounds are
//! those of the example `rays`. Embree gets one ray a call (`rtcIntersect1`, `rtcOccluded1`). It builds its tree with medium quality, its
//! default.
#![allow(unsafe_code, reason = "calls of a C library")]

#[path = "rays.rs"]
mod rays;

use femc_geometry::Ray;
use libloading::Library;
use rays::{Contender, Mesh, TraceSummary, cornell, read_mesh, run, terrain};
use std::ffi::{c_char, c_void};
use std::ptr::null_mut;

type Pointer = *mut c_void;
type NewDevice = unsafe extern "C" fn(*const c_char) -> Pointer;
type NewScene = unsafe extern "C" fn(Pointer) -> Pointer;
type NewGeometry = unsafe extern "C" fn(Pointer, u32) -> Pointer;
type NewBuffer = unsafe extern "C" fn(Pointer, u32, u32, u32, usize, usize) -> Pointer;
type Commit = unsafe extern "C" fn(Pointer);
type Attach = unsafe extern "C" fn(Pointer, Pointer) -> u32;
type Trace = unsafe extern "C" fn(Pointer, *mut RayHit, Pointer);

/// Values of Embree's enumerations.
const TRIANGLES: u32 = 0;
const INDICES: u32 = 0;
const VERTICES: u32 = 1;
const UINT3: u32 = 0x5003;
const FLOAT3: u32 = 0x9003;
const NO_GEOMETRY: u32 = u32::MAX;

/// `RTCRayHit`, and room for the fields of other builds. `RTCRay` is its beginning.
#[repr(C, align(16))]
struct RayHit {
    origin: [f32; 3],
    near: f32,
    dir: [f32; 3],
    time: f32,
    far: f32,
    mask: u32,
    id: u32,
    flags: u32,
    normal: [f32; 3],
    uv: [f32; 2],
    primitive: u32,
    geometry: u32,
    instance: [u32; 2],
    room: [u32; 8],
}

impl RayHit {
    fn new(ray: &Ray) -> Self {
        Self {
            origin: ray.origin.to_array(),
            near: 0.0,
            dir: ray.dir.to_array(),
            time: 0.0,
            far: ray.t_max,
            mask: u32::MAX,
            id: 0,
            flags: 0,
            normal: [0.0; 3],
            uv: [0.0; 2],
            primitive: NO_GEOMETRY,
            geometry: NO_GEOMETRY,
            instance: [NO_GEOMETRY; 2],
            room: [0; 8],
        }
    }
}

/// A scene of Embree, with the library that it belongs to.
struct EmbreeScene {
    scene: Pointer,
    intersect: Trace,
    occluded: Trace,
}

// SAFETY: a committed scene may be traced by several threads at a time (Embree's manual, "rtcIntersect1").
unsafe impl Sync for EmbreeScene {}
// SAFETY: as above; nothing in it belongs to a thread.
unsafe impl Send for EmbreeScene {}

impl EmbreeScene {
    /// Builds the mesh. The library stays loaded.
    fn build(library: &'static Library, mesh: &Mesh) -> Result<Self, libloading::Error> {
        // SAFETY: the functions have the types of Embree's header `rtcore.h`. Embree allocates the two buffers for as many elements as
        // this code asks for, and the loop writes no others.
        unsafe {
            let new_device = library.get::<NewDevice>(b"rtcNewDevice")?;
            let new_scene = library.get::<NewScene>(b"rtcNewScene")?;
            let new_geometry = library.get::<NewGeometry>(b"rtcNewGeometry")?;
            let new_buffer = library.get::<NewBuffer>(b"rtcSetNewGeometryBuffer")?;
            let commit_geometry = library.get::<Commit>(b"rtcCommitGeometry")?;
            let attach = library.get::<Attach>(b"rtcAttachGeometry")?;
            let commit_scene = library.get::<Commit>(b"rtcCommitScene")?;
            let device = new_device(std::ptr::null());
            let (scene, geometry) = (new_scene(device), new_geometry(device, TRIANGLES));
            let count = mesh.triangles.len();
            let positions = new_buffer(geometry, VERTICES, 0, FLOAT3, 12, 3 * count).cast::<[f32; 3]>();
            let indices = new_buffer(geometry, INDICES, 0, UINT3, 12, count).cast::<[u32; 3]>();
            for (number, triangle) in mesh.triangles.iter().enumerate() {
                for (corner, vertex) in triangle.iter().enumerate() {
                    positions.add(3 * number + corner).write(vertex.to_array());
                }
                indices.add(number).write([0, 1, 2].map(|corner| 3 * number as u32 + corner));
            }
            commit_geometry(geometry);
            attach(scene, geometry);
            commit_scene(scene);
            let trace = |name: &[u8]| library.get::<Trace>(name).map(|function| *function);
            Ok(Self { scene, intersect: trace(b"rtcIntersect1")?, occluded: trace(b"rtcOccluded1")? })
        }
    }

    fn closest_hits(&self, rays: &[Ray]) -> TraceSummary {
        let mut summary = (0, 0.0);
        for ray in rays {
            let mut hit = RayHit::new(ray);
            // SAFETY: the scene is committed, and the ray lives until the call returns.
            unsafe { (self.intersect)(self.scene, &raw mut hit, null_mut()) };
            if hit.geometry != NO_GEOMETRY {
                summary = (summary.0 + 1, summary.1 + f64::from(hit.far));
            }
        }
        summary
    }

    fn occluded_rays(&self, rays: &[Ray]) -> TraceSummary {
        let mut count = 0;
        for ray in rays {
            let mut hit = RayHit::new(ray);
            // SAFETY: as above. An occluded ray gets a negative length.
            unsafe { (self.occluded)(self.scene, &raw mut hit, null_mut()) };
            count += usize::from(hit.far < 0.0);
        }
        (count, 0.0)
    }
}

fn main() -> Result<(), libloading::Error> {
    let mut arguments = std::env::args().skip(1);
    let Some(path) = arguments.next() else {
        eprintln!("usage: embree LIBEMBREE4.so [MESH.bin]");
        std::process::exit(2);
    };
    // SAFETY: the caller names a library of Embree, whose initialization has no requirements.
    let library: &'static Library = Box::leak(Box::new(unsafe { Library::new(path)? }));
    let meshes = match arguments.next() {
        Some(path) => vec![read_mesh(&path)],
        None => vec![cornell(), terrain(500)],
    };
    for mesh in &meshes {
        let scene: &'static EmbreeScene = Box::leak(Box::new(EmbreeScene::build(library, mesh)?));
        let contenders: Vec<Contender> = vec![
            ("embree".into(), Box::new(|rays: &[Ray]| scene.closest_hits(rays))),
            ("embree any hit".into(), Box::new(|rays: &[Ray]| scene.occluded_rays(rays))),
        ];
        run(mesh, contenders);
    }
    Ok(())
}
