//! The JSON chunk.

use serde::Serialize;
use std::collections::BTreeMap;

/// The root.
#[derive(Debug, Clone, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Document {
    pub asset: serde_json::Value,
    pub extensions_used: Vec<String>,
    pub scene: usize,
    pub scenes: Vec<serde_json::Value>,
    pub nodes: Vec<Node>,
    pub meshes: Vec<Mesh>,
    pub accessors: Vec<Accessor>,
    pub buffer_views: Vec<BufferView>,
    pub buffers: Vec<Buffer>,
}

/// The node of a mesh.
#[derive(Debug, Clone, Serialize)]
pub struct Node {
    pub name: String,
    pub mesh: usize,
}

/// A list of primitives.
#[derive(Debug, Clone, Serialize)]
pub struct Mesh {
    pub primitives: Vec<Primitive>,
}

/// Points with attributes.
#[derive(Debug, Clone, Serialize)]
pub struct Primitive {
    pub attributes: BTreeMap<String, usize>,
    pub mode: u32,
    pub extensions: BTreeMap<String, serde_json::Value>,
}

/// An array in a view.
#[derive(Debug, Clone, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Accessor {
    pub buffer_view: usize,
    pub byte_offset: u64,
    pub component_type: u32,
    pub normalized: bool,
    pub count: u64,
    #[serde(rename = "type")]
    pub kind: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min: Option<Vec<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max: Option<Vec<f64>>,
}

/// A stretch of a buffer.
#[derive(Debug, Clone, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct BufferView {
    pub buffer: usize,
    pub byte_offset: u64,
    pub byte_length: u64,
    pub target: u32,
}

/// The binary chunk.
#[derive(Debug, Clone, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Buffer {
    pub byte_length: u64,
}
