//! The rows of a table as columns of numbers.

use super::header::{Element, Encoding, Kind};

/// Numbers of one table.
pub(super) struct Table<'a> {
    element: &'a Element,
    columns: Vec<Option<Vec<f32>>>,
}

impl<'a> Table<'a> {
    /// Reads the properties that are `wanted` from `bytes`, which start at the table. The rows are compared
    /// with the bytes that are there before anything is allocated.
    pub fn read(
        element: &'a Element,
        encoding: Encoding,
        bytes: &[u8],
        wanted: impl Fn(&str) -> bool,
    ) -> Result<Self, String> {
        let width = element.properties.len();
        // a digit and a space in text
        let stride = if encoding == Encoding::Text {
            2 * width
        } else {
            element.stride()
        };
        // the last number of a text may end the file
        let there = bytes.len().saturating_add(usize::from(encoding == Encoding::Text));
        if stride == 0 || element.rows > there / stride {
            return Err(format!(
                "its header says {} splats of {stride} bytes or more and the file has {} bytes for them",
                element.rows,
                bytes.len()
            ));
        }
        let mut columns: Vec<Option<Vec<f32>>> = element
            .properties
            .iter()
            .map(|p| wanted(&p.name).then(|| Vec::with_capacity(element.rows)))
            .collect();
        if encoding == Encoding::Text {
            text(element, bytes, &mut columns)?;
        } else {
            for row in bytes.chunks_exact(stride).take(element.rows) {
                let mut at = 0;
                for (property, column) in element.properties.iter().zip(&mut columns) {
                    let next = at + property.kind.bytes();
                    if let Some(column) = column {
                        column.push(number(property.kind, encoding, &row[at..next]));
                    }
                    at = next;
                }
            }
        }
        Ok(Self { element, columns })
    }

    /// The column of the first of these names that the table has.
    pub fn column(&self, names: &[&str]) -> Option<(&str, Kind, &[f32])> {
        names.iter().find_map(|name| {
            let at = self.element.properties.iter().position(|p| p.name == *name)?;
            let property = &self.element.properties[at];
            Some((property.name.as_str(), property.kind, self.columns[at].as_deref()?))
        })
    }
}

fn text(element: &Element, bytes: &[u8], columns: &mut [Option<Vec<f32>>]) -> Result<(), String> {
    let mut words = bytes.split(|b| b.is_ascii_whitespace()).filter(|word| !word.is_empty());
    for row in 0..element.rows {
        for (property, column) in element.properties.iter().zip(&mut *columns) {
            let number = words
                .next()
                .and_then(|word| std::str::from_utf8(word).ok()?.parse::<f64>().ok());
            let Some(number) = number else {
                return Err(format!("{} of splat {row} is not a number, or missing", property.name));
            };
            if let Some(column) = column {
                column.push(number as f32);
            }
        }
    }
    Ok(())
}

/// A number of a binary file; `bytes` has the length of its kind.
fn number(kind: Kind, encoding: Encoding, bytes: &[u8]) -> f32 {
    let mut word = [0u8; 8];
    let n = bytes.len().min(8);
    word[..n].copy_from_slice(&bytes[..n]);
    if encoding == Encoding::Big {
        word[..n].reverse();
    }
    let [a, b, c, d, ..] = word;
    match kind {
        Kind::I8 => f32::from(i8::from_le_bytes([a])),
        Kind::U8 => f32::from(a),
        Kind::I16 => f32::from(i16::from_le_bytes([a, b])),
        Kind::U16 => f32::from(u16::from_le_bytes([a, b])),
        Kind::I32 => i32::from_le_bytes([a, b, c, d]) as f32,
        Kind::U32 => u32::from_le_bytes([a, b, c, d]) as f32,
        Kind::F32 => f32::from_le_bytes([a, b, c, d]),
        Kind::F64 => f64::from_le_bytes(word) as f32,
    }
}
