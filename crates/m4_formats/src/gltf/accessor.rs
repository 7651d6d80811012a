//! Arrays of f32 out of the binary chunk.

use super::document::Document;
use super::{FLOAT, UNSIGNED_BYTE};

/// Why an array is not there.
#[derive(Debug)]
pub enum Fault {
    Damaged(String),
    Unsupported(String),
}

/// Rows of `width` numbers. The number of rows is checked against the chunk before anything is allocated.
pub fn floats(document: &Document, bin: &[u8], name: &str, index: usize, width: usize) -> Result<Vec<f32>, Fault> {
    let damaged = |what: String| Fault::Damaged(format!("{name}: {what}"));
    let unsupported = |what: String| Fault::Unsupported(format!("{what} for {name}"));
    let accessor = document
        .accessors
        .get(index)
        .ok_or_else(|| damaged(format!("accessor {index} does not exist")))?;
    let expected = match width {
        1 => "SCALAR",
        3 => "VEC3",
        _ => "VEC4",
    };
    if accessor.kind != expected {
        return Err(damaged(format!(
            "accessor {index} is a {:?} where {expected} was expected",
            accessor.kind
        )));
    }
    if accessor.component_type != FLOAT {
        let kind = accessor.component_type;
        let bytes = if kind == UNSIGNED_BYTE { " (bytes)" } else { "" };
        return Err(unsupported(format!("components of type {kind}{bytes}")));
    }
    if accessor.sparse.is_some() {
        return Err(unsupported("a sparse array".into()));
    }
    let view = accessor
        .buffer_view
        .ok_or_else(|| unsupported("an array without a view".into()))?;
    let view = document
        .buffer_views
        .get(view)
        .ok_or_else(|| damaged(format!("view {view} does not exist")))?;
    if view.buffer != 0 {
        return Err(unsupported(format!("data in buffer {}", view.buffer)));
    }
    let row = 4 * width as u64;
    let stride = view.byte_stride.unwrap_or(row);
    if stride < row {
        return Err(damaged(format!("rows of {row} bytes every {stride} bytes")));
    }
    // start + (count - 1) stride + row, within the view and the view within the chunk
    let last = accessor.count.saturating_sub(1).checked_mul(stride);
    let end = last
        .and_then(|b| b.checked_add(accessor.byte_offset))
        .and_then(|b| b.checked_add(if accessor.count == 0 { 0 } else { row }));
    let view_end = view.byte_offset.checked_add(view.byte_length);
    let fits = end.is_some_and(|e| e <= view.byte_length) && view_end.is_some_and(|e| e <= bin.len() as u64);
    if !fits {
        return Err(damaged(format!(
            "{} rows of {row} bytes lie beyond the {} bytes of the binary chunk or of its view",
            accessor.count,
            bin.len()
        )));
    }
    let start = (view.byte_offset + accessor.byte_offset) as usize;
    let mut out = Vec::with_capacity(accessor.count as usize * width);
    for i in 0..accessor.count as usize {
        let row = &bin[start + i * stride as usize..][..4 * width];
        out.extend(row.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)));
    }
    Ok(out)
}
