//! Binary glTF 2.0 (\[gltf2\]): a document and one buffer. Views and accessors are kept consistent with the buffer.

use serde_json::{Value, json};

/// Component type of an accessor.
const UNSIGNED_INT: u32 = 5125;
const FLOAT: u32 = 5126;
/// Target of a buffer view.
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// The file is larger than its format allows.
#[derive(Debug, thiserror::Error)]
#[error("the file would be larger than 4 GiB, the limit of binary glTF")]
pub struct TooLarge;

/// A file under construction.
#[derive(Default)]
pub struct Glb {
    views: Vec<Value>,
    accessors: Vec<Value>,
    buffer: Vec<u8>,
}

impl Glb {
    /// Adds a vector attribute of at least one vertex. Returns the index of its accessor.
    pub fn vectors(&mut self, values: &[[f32; 3]]) -> usize {
        self.attribute(values.iter().copied(), values.len(), "VEC3")
    }

    /// Adds a scalar attribute of at least one vertex. Returns the index of its accessor.
    pub fn scalars(&mut self, values: impl ExactSizeIterator<Item = f32>) -> usize {
        let count = values.len();
        self.attribute(values.map(|value| [value]), count, "SCALAR")
    }

    /// Adds vertex indices, `N` per triangle or line. Returns the index of their accessor.
    pub fn indices<const N: usize>(&mut self, values: &[[u32; N]]) -> usize {
        let start = self.buffer.len();
        let all = values.iter().flatten();
        let (least, most) = all.clone().fold((u32::MAX, 0), |(least, most), &it| (least.min(it), most.max(it)));
        self.buffer.extend(all.flat_map(|index| index.to_le_bytes()));
        self.accessor(start, ELEMENT_ARRAY_BUFFER, |view| {
            json!({
                "bufferView": view, "componentType": UNSIGNED_INT, "count": N * values.len(), "type": "SCALAR",
                "min": [least], "max": [most],
            })
        })
    }

    fn attribute<const N: usize>(&mut self, values: impl Iterator<Item = [f32; N]>, count: usize, kind: &str) -> usize {
        let start = self.buffer.len();
        let (mut least, mut most) = ([f32::INFINITY; N], [f32::NEG_INFINITY; N]);
        for value in values {
            least = std::array::from_fn(|k| least[k].min(value[k]));
            most = std::array::from_fn(|k| most[k].max(value[k]));
            self.buffer.extend(value.iter().flat_map(|component| component.to_le_bytes()));
        }
        self.accessor(start, ARRAY_BUFFER, |view| {
            json!({
                "bufferView": view, "componentType": FLOAT, "count": count, "type": kind,
                "min": least.as_slice(), "max": most.as_slice(),
            })
        })
    }

    /// Adds an accessor for the buffer from `start` to its end. The length is always a multiple of four bytes, so that all views
    /// are aligned.
    fn accessor(&mut self, start: usize, target: u32, describe: impl FnOnce(usize) -> Value) -> usize {
        let length = self.buffer.len() - start;
        self.views.push(json!({ "buffer": 0, "byteOffset": start, "byteLength": length, "target": target }));
        self.accessors.push(describe(self.views.len() - 1));
        self.accessors.len() - 1
    }

    /// Returns the bytes of the file.
    /// - `document`: the document without buffers, views and accessors; an object.
    pub fn finish(self, mut document: Value) -> Result<Vec<u8>, TooLarge> {
        // glTF does not allow empty lists.
        if !self.buffer.is_empty() {
            document["buffers"] = json!([{ "byteLength": self.buffer.len() }]);
            document["bufferViews"] = self.views.into();
            document["accessors"] = self.accessors.into();
        }
        let mut text = document.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut chunks = vec![(*b"JSON", text)];
        if !self.buffer.is_empty() {
            chunks.push((*b"BIN\0", self.buffer));
        }
        let total = 12 + chunks.iter().map(|(_, data)| 8 + data.len()).sum::<usize>();
        let mut file = Vec::with_capacity(total);
        file.extend(b"glTF");
        file.extend(2u32.to_le_bytes());
        file.extend(u32::try_from(total).map_err(|_| TooLarge)?.to_le_bytes());
        for (kind, data) in chunks {
            file.extend((data.len() as u32).to_le_bytes());
            file.extend(kind);
            file.extend(data);
        }
        Ok(file)
    }
}
