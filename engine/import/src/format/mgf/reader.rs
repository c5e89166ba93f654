//! State of one import, and the dispatch of entities.

use super::{
    args::{Args, Result},
    camera,
    color::Color,
    include::OpenFile,
    material::MaterialState,
    medium::MediumState,
    polygon::Triangulator,
    recovery::Errors,
    stack::Frame,
    table::ContextTable,
    vertex::VertexState,
};
use crate::{
    EntityKind, FileSource, ImportError, ImportErrors, LoadedScene, Position, Warning, WarningKind,
    format::ies::{Remark, Tilt},
    image::Role,
    warning::Warnings,
};
use femc_scene::{
    Camera, Group, GroupId, ImageId, Location, MaterialId, MediumId, ObjectId, PathId, PhotometryId, ScatteringPart,
    Scene,
};
use std::{
    collections::{BTreeMap, HashMap, HashSet},
    sync::Arc,
};

/// Maximum number of primitives (triangles, quadrics, luminaires) after array expansion.
pub(super) const MAX_PRIMITIVES: u64 = 100_000_000;

/// State of one import. Hash tables are only used for lookups; their order never affects the scene.
pub(super) struct Reader<'f> {
    pub files: &'f dyn FileSource,
    pub scene: Scene,
    pub warnings: Warnings,
    pub notes: Warnings,
    pub errors: Errors,
    /// All files read.
    pub files_read: Vec<String>,
    pub texts: HashMap<String, Arc<Vec<u8>>>,
    pub file_indices: HashMap<String, u32>,
    /// Open files, outermost first.
    pub open_files: Vec<OpenFile>,
    pub includes: u64,
    pub included_bytes: u64,
    pub reported_unknown: HashSet<String>,
    /// Folder of the scene file, from the root: empty, or with a `/` at its end.
    pub folder: String,
    /// Files outside this folder that were already reported.
    pub reported_outside: HashSet<String>,

    pub colors: ContextTable<Color>,
    /// Locations of clipped colors that were used.
    pub clipped_colors: HashSet<Location>,
    pub materials: ContextTable<MaterialState>,
    /// Entries of the scene by name, newest last.
    pub material_entries: HashMap<String, Vec<MaterialId>>,
    pub vertices: ContextTable<VertexState>,
    pub cameras: ContextTable<Camera>,
    pub media: ContextTable<MediumState>,
    /// Whether a color was given since the medium was opened. Earlier colors do not tint media.
    pub medium_colored: bool,
    /// Whether a color was given since the medium was opened and since its latest `sigma_s`.
    pub absorption_colored: bool,
    pub medium_entries: HashMap<String, Vec<MediumId>>,
    pub photometries: HashMap<String, (PhotometryId, Option<Tilt>)>,
    /// Hints about photometry that no luminaire has scaled yet.
    pub normalization_hints: HashMap<PhotometryId, Remark>,
    /// Textured materials found on surfaces without texture coordinates.
    pub without_uv: HashSet<MaterialId>,
    pub images: HashMap<(String, Role), ImageId>,
    /// Images used as factors on reflectances.
    pub reflectance_maps: HashSet<ImageId>,
    pub paths: BTreeMap<String, PathId>,
    pub path: Option<PathId>,
    /// Paths whose definition failed.
    pub faulty_paths: HashSet<PathId>,

    /// Open objects and the locations that opened them, outermost first.
    pub objects: Vec<(ObjectId, Location)>,
    pub object_ids: HashMap<String, ObjectId>,
    /// Position that first opened each object; `None` once a second position that opens it has been reported.
    pub object_positions: Vec<Option<Position>>,
    pub frames: Vec<Frame>,
    pub frame_ids: u32,
    /// Group that receives new surfaces.
    pub group: GroupId,
    /// Number of primitives of each group after expansion.
    pub primitive_counts: Vec<u64>,
    /// Approximate number of instances and steps of their motions.
    pub stored_instances: u64,
    /// Mirror images of groups.
    pub mirror_images: HashMap<GroupId, GroupId>,
    pub triangulator: Triangulator,
}

/// Imports `entry` of `files`. Stops at error number `limit`.
pub(crate) fn load(
    files: &dyn FileSource,
    entry: &str,
    limit: usize,
) -> std::result::Result<LoadedScene, ImportErrors> {
    let mut reader = Reader::new(files, limit);
    let notes = match reader.read_scene(entry) {
        Ok(notes) => notes,
        Err(error) => {
            // `finish` returns this error together with the earlier ones.
            let _ = reader.errors.report(error);
            Vec::new()
        }
    };
    let Reader { scene, warnings, files_read: read, errors, .. } = reader;
    errors.finish(&scene.files)?;
    Ok(LoadedScene { scene, warnings: warnings.0, notes, files: read })
}

impl<'f> Reader<'f> {
    fn new(files: &'f dyn FileSource, limit: usize) -> Self {
        Self {
            files,
            scene: Scene { groups: vec![Group::default()], ..Scene::default() },
            warnings: Warnings::default(),
            notes: Warnings::default(),
            errors: Errors::new(limit),
            files_read: Vec::new(),
            texts: HashMap::new(),
            file_indices: HashMap::new(),
            open_files: Vec::new(),
            includes: 0,
            included_bytes: 0,
            reported_unknown: HashSet::new(),
            folder: String::new(),
            reported_outside: HashSet::new(),
            clipped_colors: HashSet::new(),
            colors: ContextTable::new(EntityKind::Color, Color::default()),
            materials: ContextTable::new(EntityKind::Material, MaterialState::default()),
            material_entries: HashMap::new(),
            vertices: ContextTable::new(EntityKind::Vertex, VertexState::default()),
            cameras: ContextTable::new(EntityKind::Camera, camera::default_camera()),
            media: ContextTable::new(EntityKind::Medium, MediumState::default()),
            medium_entries: HashMap::new(),
            photometries: HashMap::new(),
            normalization_hints: HashMap::new(),
            without_uv: HashSet::new(),
            images: HashMap::new(),
            reflectance_maps: HashSet::new(),
            paths: BTreeMap::new(),
            path: None,
            faulty_paths: HashSet::new(),
            objects: Vec::new(),
            object_ids: HashMap::new(),
            object_positions: Vec::new(),
            frames: vec![Frame::world()],
            frame_ids: 0,
            group: GroupId(0),
            primitive_counts: vec![0],
            stored_instances: 0,
            mirror_images: HashMap::new(),
            medium_colored: false,
            absorption_colored: false,
            triangulator: Triangulator::default(),
        }
    }

    /// Dispatches one entity.
    pub(super) fn dispatch(&mut self, entity: &[u8], args: &Args<'_>) -> Result<()> {
        match entity {
            b"v" => self.vertices.select(args, &mut self.errors).map(|_| ()),
            b"p" => self.p(args),
            b"n" => self.n(args),
            b"uv" => self.uv(args),
            b"f" => self.f(args),
            b"fh" => self.fh(args),
            b"c" => {
                self.note_color();
                self.colors.select(args, &mut self.errors).map(|_| ())
            }
            b"cxy" => self.cxy(args),
            b"cspec" => self.cspec(args),
            b"cct" => self.cct(args),
            b"cmix" => self.cmix(args),
            b"crgb" => self.crgb(args),
            b"m" => self.m(args),
            b"sides" => self.sides(args),
            b"ir" => self.ir(args),
            b"ed" => self.ed(args),
            b"lobe" => self.lobe(args),
            b"inside" => self.inside(args),
            b"map_rd" | b"map_ed" | b"map_n" => self.map(entity, args),
            b"o" => self.o(args),
            b"xf" => self.xf(args),
            b"i" => self.i(args),
            b"ies" => self.ies(args),
            b"sph" => self.sph(args),
            b"cyl" => self.cyl(args),
            b"cone" => self.cone(args),
            b"ring" => self.ring(args),
            b"torus" => self.torus(args),
            b"prism" => self.prism(args),
            b"camera" => self.camera(args),
            b"origin" | b"target" | b"up" | b"fov" | b"film" | b"lens" | b"shutter" | b"along" => {
                self.camera_field(entity, args)
            }
            b"medium" => self.medium(args),
            b"sigma_s" | b"sigma_a" | b"phase" | b"glow" | b"density" => self.medium_field(entity, args),
            b"mbox" => self.mbox(args),
            b"mglobal" => self.mglobal(args),
            b"time" => self.time(args),
            b"path" => self.path(args),
            b"key" => self.key(args),
            b"vary" => self.vary(args),
            _ => {
                if let Some(part) = ScatteringPart::ALL.into_iter().find(|part| part.name().as_bytes() == entity) {
                    return self.reflectance(part, args);
                }
                let name = args.entity();
                if self.reported_unknown.insert(name.clone().into_owned()) {
                    self.warn(args, WarningKind::UnknownEntity { name: name.into_owned() });
                }
                Ok(())
            }
        }
    }

    /// Reads the scene and returns notes.
    fn read_scene(&mut self, entry: &str) -> Result<Vec<Warning>> {
        let path = crate::files::resolve("", entry)
            .map_err(|fault| ImportError::new(Position { file: entry.to_owned(), line: 0, column: 0 }, fault))?;
        let (folder, file) = path.split_at(path.rfind('/').map_or(0, |slash| slash + 1));
        self.folder = folder.to_owned();
        self.scene.name = file.rsplit_once('.').map_or(file, |(stem, _)| stem).to_owned();
        self.read_file(&path, Position { file: path.clone(), line: 0, column: 0 })?;
        self.seal_material();
        self.seal_medium()?;
        self.finish_cameras()?;
        self.finish_paths()?;
        let camera = self.add_default_camera();
        Ok(camera.into_iter().chain(std::mem::take(&mut self.notes.0)).collect())
    }

    /// Adds a warning at the entity.
    pub(super) fn warn(&mut self, args: &Args<'_>, kind: WarningKind) {
        self.warnings.push(args.entity_position(), kind);
    }

    /// Converts a location of the description to a position for messages.
    pub(super) fn position(&self, location: Location) -> Position {
        let file = self.scene.files.get(location.file as usize).cloned().unwrap_or_default();
        Position { file, line: location.line, column: location.column }
    }
}
