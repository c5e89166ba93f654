//! Container of columns of numbers, `application/vnd.femc.columns`: `docs/http.md` specifies it.

use serde_json::{Map, Value, json};

const MAGIC: &[u8; 4] = b"FLCV";
const VERSION: u32 = 1;
/// Alignment of each column, bytes.
const ALIGNMENT: usize = 8;

/// Number that stands for "none" in columns of record numbers.
pub const NO_RECORD: u32 = u32::MAX;

/// Writer of a container.
pub struct Columns {
    header: Map<String, Value>,
    columns: Vec<Value>,
    bytes: Vec<u8>,
}

impl Columns {
    /// Creates a container without fields and columns.
    pub fn new() -> Self {
        Self { header: Map::new(), columns: Vec::new(), bytes: Vec::new() }
    }

    /// Sets a field of the header.
    pub fn set(&mut self, field: &str, value: Value) {
        self.header.insert(field.to_owned(), value);
    }

    /// Adds a column of bytes.
    pub fn add_u8(&mut self, name: &str, numbers: &[u8]) {
        self.add(name, "u8", numbers.iter().map(|number| [*number]));
    }

    /// Adds a column of whole numbers.
    pub fn add_u32(&mut self, name: &str, numbers: impl IntoIterator<Item = u32>) {
        self.add(name, "u32", numbers.into_iter().map(u32::to_le_bytes));
    }

    /// Adds a column of single precision.
    pub fn add_f32(&mut self, name: &str, numbers: impl IntoIterator<Item = f32>) {
        self.add(name, "f32", numbers.into_iter().map(f32::to_le_bytes));
    }

    /// Adds a column of double precision.
    pub fn add_f64(&mut self, name: &str, numbers: &[f64]) {
        self.add(name, "f64", numbers.iter().map(|number| number.to_le_bytes()));
    }

    fn add<const N: usize>(&mut self, name: &str, kind: &str, numbers: impl Iterator<Item = [u8; N]>) {
        self.bytes.resize(self.bytes.len().next_multiple_of(ALIGNMENT), 0);
        let offset = self.bytes.len();
        numbers.for_each(|number| self.bytes.extend(number));
        let length = (self.bytes.len() - offset) / N;
        self.columns.push(json!({ "name": name, "type": kind, "length": length, "offset": offset }));
    }

    /// Returns the bytes of the container.
    pub fn finish(mut self) -> Vec<u8> {
        self.header.insert("columns".to_owned(), Value::Array(self.columns));
        let mut header = Value::Object(self.header).to_string().into_bytes();
        let prefix = MAGIC.len() + 4 + 4;
        header.resize((prefix + header.len()).next_multiple_of(ALIGNMENT) - prefix, b' ');
        let mut all = Vec::with_capacity(prefix + header.len() + self.bytes.len());
        all.extend(MAGIC);
        all.extend(VERSION.to_le_bytes());
        all.extend((header.len() as u32).to_le_bytes());
        all.extend(header);
        all.extend(self.bytes);
        all
    }
}
