//! Image textures of materials: `map_rd FILE`, `map_ed FILE`, `map_n FILE`.

use super::{
    args::{Args, Result},
    include::unreadable,
    reader::Reader,
};
use crate::{
    ImportFault, WarningKind,
    image::{self, Role},
};
use femc_scene::ImageId;

/// Maximum size of an image file, bytes.
const MAX_FILE: u64 = 1 << 31;

impl Reader<'_> {
    pub(super) fn map(&mut self, entity: &[u8], args: &Args<'_>) -> Result<()> {
        args.check_count(1.., "the path of a PNG, JPEG or EXR file")?;
        let role = if entity == b"map_n" { Role::Normals } else { Role::Color };
        let path = self.resolve(args)?;
        args.check_count(1..=1, "the path of a PNG, JPEG or EXR file")?;
        let id = self.image(args, &path, role)?;
        if entity == b"map_rd" {
            self.check_factors(args, id);
        }
        let image = Some(id);
        let material = self.current_material_mut();
        match entity {
            b"map_rd" => material.map_rd = image,
            b"map_ed" => material.map_ed = image,
            _ => material.map_n = image,
        }
        Ok(())
    }

    /// Returns the image of a file in a role. Each image is decoded once.
    fn image(&mut self, args: &Args<'_>, path: &str, role: Role) -> Result<ImageId> {
        let key = (path.to_owned(), role);
        if let Some(&id) = self.images.get(&key) {
            return Ok(id);
        }
        let files = self.files;
        let unreadable = |e: std::io::Error| args.fault_at(0, unreadable(files, path, &e));
        let size = files.size(path).map_err(unreadable)?;
        if size > MAX_FILE {
            let reason = format!("the file has {size} bytes; the limit for images is {MAX_FILE} bytes");
            let advice = "make it smaller";
            return Err(args.fault_at(0, ImportFault::BadFile { path: path.into(), reason, advice }));
        }
        let bytes = files.read(path).map_err(unreadable)?;
        self.note_read(path);
        let used: u64 = self.scene.images.iter().map(|image| image::memory_size(image.width, image.height)).sum();
        let decoded = image::decode(path, &bytes, role, used).map_err(|fault| args.fault_at(0, fault))?;
        for what in decoded.remarks {
            self.texture_remark(args, path, what);
        }
        let id = ImageId(self.scene.images.len() as u32);
        self.scene.images.push(decoded.image);
        self.images.insert(key, id);
        Ok(id)
    }

    /// Warns once about an image file.
    fn texture_remark(&mut self, args: &Args<'_>, path: &str, remark: String) {
        let kind = WarningKind::Texture { path: path.to_owned(), what: remark };
        if !self.warnings.0.iter().any(|known| known.kind == kind) {
            self.warn(args, kind);
        }
    }

    /// Warns if factors on a reflectance are above 1.
    fn check_factors(&mut self, args: &Args<'_>, id: ImageId) {
        if !self.reflectance_maps.insert(id) {
            return;
        }
        let image = &self.scene.images[id.index()];
        let most = image.pixels.iter().flatten().copied().fold(0.0, f32::max);
        if most > 1.0 {
            let path = image.path.clone();
            let what =
                format!("texture has values above 1 (up to {most}): reflectance factors above 1 are clamped to 1");
            self.texture_remark(args, &path, what);
        }
    }
}
