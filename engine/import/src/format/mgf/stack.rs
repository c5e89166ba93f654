//! Transform stack: baked transforms, groups for arrays and paths, and their placement.
//!
//! A plain `xf` is baked into the vertices. An array or a path opens a group. Closing it places instances in the enclosing group,
//! so copies share their geometry. Primitives are counted as prototypes times instances before anything is placed. Instances never
//! mirror: a mirrored copy is an instance of a mirrored twin of the group, which is created once. So an instance never reverses the
//! winding of a triangle in the renderer.

use super::{
    args::{Args, Result},
    reader::{MAX_PRIMITIVES, Reader},
    transform::{self, InstanceLayer, TransformSpec, is_mirror, power, push_step, scale_of},
};
use crate::{ImportError, ImportFault, Position, WarningKind};
use femc_math::{
    Transform,
    glam::{DMat3, DVec3},
};
use femc_scene::{Group, GroupId, Instance, Motion, MotionStep, Shape};

/// Number of copies above which an array is split into two levels, so that memory grows with the square root of its length.
const FLAT_ARRAY: u64 = 4096;
/// Maximum number of stored instances and steps of their motions.
const MAX_STORED: u64 = 10_000_000;
/// Maximum nesting of arrays and paths around a surface.
const MAX_NESTING: u64 = 128;

/// A transform on the stack.
pub(super) struct Frame {
    /// Transform to the frame of the innermost group.
    pub to_group: Transform,
    /// Uniform scale of `to_group`.
    pub scale: f64,
    /// Whether `to_group` mirrors.
    pub mirrored: bool,
    /// Id, unique among the frames of a scene.
    pub id: u32,
    /// Group that this frame opened.
    opened: Option<OpenedGroup>,
    at: Position,
    /// Number of copies of the contents, over all enclosing frames, saturated.
    copies: u64,
    /// Number of groups around the contents.
    nesting: u64,
}

struct OpenedGroup {
    layers: Vec<InstanceLayer>,
    content: GroupId,
    outer: GroupId,
}

impl Frame {
    /// Returns a frame with the transform of `outer`, opened at `entity_position`.
    pub fn with_transform_of(outer: &Self, at: Position) -> Self {
        Self { opened: None, at, ..*outer }
    }

    /// Returns the frame of the world.
    pub fn world() -> Self {
        Self {
            to_group: Transform::IDENTITY,
            scale: 1.0,
            mirrored: false,
            id: 0,
            opened: None,
            at: Position::default(),
            copies: 1,
            nesting: 0,
        }
    }
}

impl Reader<'_> {
    /// Reads `xf [args]`.
    pub(super) fn xf(&mut self, args: &Args<'_>) -> Result<()> {
        if args.len() > 0 {
            return self.push_frame(args, 0);
        }
        if self.frames.len() <= self.current_file().frames {
            return Err(args.fault(ImportFault::NothingToClose { entity: "xf" }));
        }
        self.pop_frame()
    }

    /// Returns the current transform.
    pub(super) fn frame(&self) -> &Frame {
        self.frames.last().expect("the world's frame is never popped")
    }

    /// Pushes the transform of the arguments from `first` on.
    pub(super) fn push_frame(&mut self, args: &Args<'_>, first: usize) -> Result<()> {
        let spec = {
            let find = |name: &str| self.find_path(name);
            transform::parse(args.tail(first), &find)?
        };
        let TransformSpec { baked, layers } = spec;
        let outer = self.frame();
        let copies = layers.iter().fold(outer.copies, |n, layer| n.saturating_mul(layer.count));
        if copies > MAX_PRIMITIVES {
            return Err(args.fault(ImportFault::TooManyPrimitives { count: copies, limit: MAX_PRIMITIVES }));
        }
        let nesting = outer.nesting + layers.len() as u64;
        if nesting > MAX_NESTING {
            return Err(args.fault(ImportFault::TooMany { what: "nested arrays and paths", limit: MAX_NESTING }));
        }
        let to_group = if layers.is_empty() { outer.to_group * baked } else { baked };
        let scale = scale_of(&to_group);
        if !to_group.is_finite() || !scale.is_normal() {
            return Err(
                args.fault(ImportFault::NotFinite { what: "the transform combined with the enclosing transforms" })
            );
        }
        let mirrored = is_mirror(&to_group);
        let opened = (!layers.is_empty()).then(|| {
            let content = self.new_group();
            OpenedGroup { layers, content, outer: std::mem::replace(&mut self.group, content) }
        });
        self.frame_ids += 1;
        self.frames.push(Frame {
            to_group,
            scale,
            mirrored,
            id: self.frame_ids,
            opened,
            at: args.entity_position(),
            copies,
            nesting,
        });
        Ok(())
    }

    /// Pops the innermost transform and places the contents of its group.
    pub(super) fn pop_frame(&mut self) -> Result<()> {
        let Some(Frame { opened: Some(opened), at, .. }) = self.frames.pop() else { return Ok(()) };
        self.group = opened.outer;
        let mut child = opened.content;
        if self.primitive_counts[child.index()] == 0 {
            self.drop_if_last(child);
            return Ok(());
        }
        let outer = MotionStep::Static(self.frame().to_group);
        let last = opened.layers.len() - 1;
        for (i, mut layer) in opened.layers.into_iter().enumerate() {
            let parent = if i == last { self.group } else { self.new_group() };
            if i == last {
                push_step(&mut layer.after, outer);
            }
            let total = self.primitive_counts[child.index()].saturating_mul(layer.count);
            self.count_primitives(parent, total).map_err(|fault| ImportError::new(at.clone(), fault))?;
            let stored = if layer.count > FLAT_ARRAY { 4 * layer.count.isqrt() } else { layer.count };
            let steps = (layer.before.len() + layer.after.len() + 1) as u64 + layer.body.len() as u64 * stored / 2;
            self.stored_instances = self.stored_instances.saturating_add(stored.saturating_mul(steps));
            if self.stored_instances > MAX_STORED {
                self.errors.end_at_next_error();
                let fault = ImportFault::TooMany { what: "instances (nest arrays in arrays)", limit: MAX_STORED };
                return Err(ImportError::new(at, fault));
            }
            self.place_copies(child, &layer, parent);
            child = parent;
        }
        Ok(())
    }

    /// Closes the transforms that the current file left open.
    pub(super) fn close_frames(&mut self) -> Result<()> {
        while self.frames.len() > self.current_file().frames {
            let at = self.frame().at.clone();
            self.warnings.push(at, WarningKind::LeftOpen { entity: "xf" });
            self.pop_frame()?;
        }
        Ok(())
    }

    fn new_group(&mut self) -> GroupId {
        let id = GroupId(self.scene.groups.len() as u32);
        self.scene.groups.push(Group::default());
        self.primitive_counts.push(0);
        id
    }

    fn drop_if_last(&mut self, group: GroupId) {
        if group.index() + 1 == self.scene.groups.len() {
            self.scene.groups.pop();
            self.primitive_counts.pop();
        }
    }

    /// Counts `n` more primitives in `group`, after expansion.
    pub(super) fn count_primitives(&mut self, group: GroupId, n: u64) -> std::result::Result<(), ImportFault> {
        let count = &mut self.primitive_counts[group.index()];
        *count = count.saturating_add(n);
        if *count > MAX_PRIMITIVES {
            self.errors.end_at_next_error();
            return Err(ImportFault::TooManyPrimitives { count: *count, limit: MAX_PRIMITIVES });
        }
        Ok(())
    }

    fn place_copies(&mut self, child: GroupId, layer: &InstanceLayer, parent: GroupId) {
        let block = layer.fixed_body().filter(|_| layer.count > FLAT_ARRAY).map(|body| {
            let side = layer.count.isqrt();
            (body, side, power(body, side))
        });
        let Some((body, side, stride)) = block else {
            for k in 0..layer.count {
                self.add_instance(child, layer.motion(k), parent);
            }
            return;
        };
        // Rows of `side` copies, then the rest of the last row.
        let row = self.new_group();
        self.primitive_counts[row.index()] = self.primitive_counts[child.index()].saturating_mul(side);
        let within = InstanceLayer {
            before: layer.before.clone(),
            body: vec![MotionStep::Static(body)],
            count: side,
            after: vec![],
        };
        for k in 0..side {
            self.add_instance(child, within.motion(k), row);
        }
        let rows = InstanceLayer {
            body: vec![MotionStep::Static(stride)],
            after: layer.after.clone(),
            ..InstanceLayer::default()
        };
        for k in 0..layer.count / side {
            self.add_instance(row, rows.motion(k), parent);
        }
        for k in layer.count - layer.count % side..layer.count {
            self.add_instance(child, layer.motion(k), parent);
        }
    }

    fn add_instance(&mut self, child: GroupId, steps: Vec<MotionStep>, parent: GroupId) {
        let mirrors = steps.iter().filter(|step| matches!(step, MotionStep::Static(t) if is_mirror(t))).count();
        let (group, steps) = match mirrors % 2 {
            0 => (child, steps),
            _ => (self.mirror_image(child), around_mirror(&steps, Some(mirror_x()), None)),
        };
        self.scene.groups[parent.index()].instances.push(Instance { group, motion: Motion { steps } });
    }

    /// Returns the mirror image of `group` about its x = 0 plane.
    fn mirror_image(&mut self, group: GroupId) -> GroupId {
        if let Some(&known) = self.mirror_images.get(&group) {
            return known;
        }
        let mut image = self.scene.groups[group.index()].clone();
        mirror_surfaces(&mut image);
        for instance in &mut image.instances {
            instance.group = self.mirror_image(instance.group);
            instance.motion.steps = around_mirror(&instance.motion.steps, Some(mirror_x()), Some(mirror_x()));
        }
        let mirrored = self.new_group();
        self.primitive_counts[mirrored.index()] = self.primitive_counts[group.index()];
        self.scene.groups[mirrored.index()] = image;
        self.mirror_images.insert(group, mirrored);
        self.mirror_images.insert(mirrored, group);
        mirrored
    }

    /// Returns the world transforms of anything created now, one for each copy.
    pub(super) fn world_transforms(&self, limit: u64) -> std::result::Result<Vec<Transform>, NoWorldTransforms> {
        if self.frame().copies > limit {
            return Err(NoWorldTransforms::TooMany);
        }
        let mut transforms = vec![self.frame().to_group];
        for (i, frame) in self.frames.iter().enumerate().rev() {
            let Some(opened) = &frame.opened else { continue };
            let outer = self.frames[i - 1].to_group;
            for layer in &opened.layers {
                let mut placed = Vec::with_capacity(transforms.len() * layer.count as usize);
                for k in 0..layer.count {
                    let motion = Motion { steps: layer.motion(k) }.as_static().ok_or(NoWorldTransforms::Moving)?;
                    placed.extend(transforms.iter().map(|t| motion * *t));
                }
                transforms = placed;
            }
            for t in &mut transforms {
                *t = outer * *t;
            }
        }
        Ok(transforms)
    }

    /// Returns whether the current transform is not the identity.
    pub(super) fn is_transformed(&self) -> bool {
        self.frames.iter().any(|frame| frame.opened.is_some() || frame.to_group != Transform::IDENTITY)
    }
}

/// Reason why an element has no list of world transforms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NoWorldTransforms {
    /// A path moves the element.
    Moving,
    /// The element has more copies than the limit.
    TooMany,
}

fn mirror_x() -> Transform {
    Transform::from_mat3_translation(DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)), DVec3::ZERO)
}

/// Returns `steps` with fixed transforms before and after them.
fn around_mirror(steps: &[MotionStep], before: Option<Transform>, after: Option<Transform>) -> Vec<MotionStep> {
    let mut all = Vec::new();
    let fixed = |t: Option<Transform>| t.map(MotionStep::Static);
    for step in fixed(before).into_iter().chain(steps.iter().copied()).chain(fixed(after)) {
        push_step(&mut all, step);
    }
    all
}

/// Mirrors the surfaces of a group about x = 0. Front sides stay front sides.
fn mirror_surfaces(group: &mut Group) {
    let flip = |v: &mut DVec3| v.x = -v.x;
    for vertex in &mut group.vertices {
        flip(&mut vertex.position);
        vertex.normal.as_mut().map(flip);
    }
    for triangle in &mut group.triangles {
        triangle.swap(1, 2);
    }
    for quadric in &mut group.quadrics {
        match &mut quadric.shape {
            Shape::Sphere { center, .. } => flip(center),
            Shape::Cone { start, end, .. } => [start, end].into_iter().for_each(flip),
            Shape::Ring { center, normal, .. } => [center, normal].into_iter().for_each(flip),
            Shape::Torus { center, axis, .. } => [center, axis].into_iter().for_each(flip),
        }
    }
    for luminaire in &mut group.luminaires {
        luminaire.to_group = mirror_x() * luminaire.to_group;
    }
}
