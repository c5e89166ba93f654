//! A reader of binary glTF, independent of the writer.

use femc_math::glam::{DMat4, DVec3};
use serde_json::Value;

/// A parsed file.
pub(crate) struct Parsed {
    pub(crate) json: Value,
    pub(crate) binary: Vec<u8>,
}

/// A triangle in the frame of the root node's children.
pub(crate) struct Triangle {
    pub(crate) node: usize,
    pub(crate) material: usize,
    pub(crate) corners: [DVec3; 3],
}

fn number(bytes: &[u8], at: usize) -> usize {
    u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize
}

fn index(value: &Value) -> usize {
    value.as_u64().unwrap_or_else(|| panic!("{value} is not an index")) as usize
}

impl Parsed {
    pub(crate) fn new(bytes: &[u8]) -> Self {
        assert_eq!(&bytes[..4], b"glTF");
        assert_eq!((number(bytes, 4), number(bytes, 8)), (2, bytes.len()));
        let text = number(bytes, 12);
        assert_eq!((&bytes[16..20], text % 4), (&b"JSON"[..], 0));
        let json: Value = serde_json::from_slice(&bytes[20..20 + text]).unwrap();
        let binary = match &bytes[20 + text..] {
            [] => Vec::new(),
            rest => {
                assert_eq!((&rest[4..8], number(rest, 0), rest.len() % 4), (&b"BIN\0"[..], rest.len() - 8, 0));
                rest[8..].to_vec()
            }
        };
        Self { json, binary }
    }

    pub(crate) fn list(&self, key: &str) -> &[Value] {
        self.json[key].as_array().map_or(&[], Vec::as_slice)
    }

    pub(crate) fn extras(&self) -> &Value {
        &self.json["scenes"][0]["extras"]
    }

    /// Returns the numbers of an accessor, whose ranges are checked.
    pub(crate) fn numbers(&self, accessor: &Value) -> Vec<[f64; 3]> {
        let accessor = &self.list("accessors")[index(accessor)];
        let view = &self.list("bufferViews")[index(&accessor["bufferView"])];
        let (start, length) = (index(&view["byteOffset"]), index(&view["byteLength"]));
        let width = match accessor["type"].as_str().unwrap() {
            "SCALAR" => 1,
            "VEC3" => 3,
            other => panic!("{other}"),
        };
        let count = index(&accessor["count"]);
        assert_eq!((start % 4, length), (0, 4 * width * count));
        let bytes = &self.binary[start..start + length];
        let is_float = index(&accessor["componentType"]) == 5126;
        assert!(is_float || index(&accessor["componentType"]) == 5125);
        let component = |k: usize| -> f64 {
            let four = bytes[4 * k..4 * k + 4].try_into().unwrap();
            if is_float { f32::from_le_bytes(four).into() } else { u32::from_le_bytes(four).into() }
        };
        let mut all = Vec::new();
        for row in 0..count {
            all.push(std::array::from_fn(|k| if k < width { component(width * row + k) } else { 0.0 }));
        }
        for k in 0..width {
            let least = all.iter().map(|row: &[f64; 3]| row[k]).fold(f64::INFINITY, f64::min);
            let most = all.iter().map(|row| row[k]).fold(f64::NEG_INFINITY, f64::max);
            for (stated, found) in [(&accessor["min"][k], least), (&accessor["max"][k], most)] {
                assert_eq!(stated.as_f64().map(|stated| stated as f32), Some(found as f32));
            }
        }
        all
    }

    /// Returns all triangles, at each place of their meshes.
    pub(crate) fn triangles(&self) -> Vec<Triangle> {
        let mut all = Vec::new();
        for (node, value) in self.list("nodes").iter().enumerate().filter(|(_, node)| node.get("mesh").is_some()) {
            let matrix = self.matrix(value);
            let mesh = &self.list("meshes")[index(&value["mesh"])];
            for primitive in mesh["primitives"].as_array().unwrap() {
                assert_eq!(index(&primitive["mode"]), 4);
                let positions = self.numbers(&primitive["attributes"]["POSITION"]);
                if let Some(normals) = primitive["attributes"].get("NORMAL") {
                    let normals = self.numbers(normals);
                    assert_eq!(normals.len(), positions.len());
                    assert!(normals.iter().all(|n| (DVec3::from(*n).length() - 1.0).abs() < 1e-4));
                }
                let positions: Vec<DVec3> = positions.iter().map(|p| matrix.transform_point3((*p).into())).collect();
                let material = index(&primitive["material"]);
                assert!(material < self.list("materials").len());
                for triangle in self.numbers(&primitive["indices"]).chunks(3) {
                    let corners = std::array::from_fn(|k| positions[triangle[k][0] as usize]);
                    all.push(Triangle { node, material, corners });
                }
            }
        }
        all
    }

    /// Returns the pose of a node below the root.
    pub(crate) fn matrix(&self, node: &Value) -> DMat4 {
        let numbers = node.get("matrix").map(|matrix| {
            let numbers: Vec<f64> = matrix.as_array().unwrap().iter().map(|it| it.as_f64().unwrap()).collect();
            DMat4::from_cols_slice(&numbers)
        });
        numbers.unwrap_or(DMat4::IDENTITY)
    }

    /// Returns the object name and number of a node.
    pub(crate) fn object(&self, node: usize) -> (&str, Option<u64>) {
        let extras = &self.list("nodes")[node]["extras"];
        (extras["object"].as_str().unwrap(), extras["object_number"].as_u64())
    }
}
