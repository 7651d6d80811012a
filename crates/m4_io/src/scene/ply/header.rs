//! The text header of a PLY file, and the rows of a table as columns of numbers.

use crate::Fault;
use crate::npy::Number;

/// Longest header that is read, bytes.
const MAX_HEADER: usize = 64 << 10;

/// How the numbers are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Little,
    Big,
    Text,
}

/// The type of number of that name.
fn number_of(name: &str) -> Option<Number> {
    Some(match name {
        "char" | "int8" => Number::I8,
        "uchar" | "uint8" => Number::U8,
        "short" | "int16" => Number::I16,
        "ushort" | "uint16" => Number::U16,
        "int" | "int32" => Number::I32,
        "uint" | "uint32" => Number::U32,
        "float" | "float32" => Number::F32,
        "double" | "float64" => Number::F64,
        _ => return None,
    })
}

/// A number of each row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Property {
    pub name: String,
    pub kind: Number,
}

/// A table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Element {
    pub name: String,
    pub rows: usize,
    pub properties: Vec<Property>,
    /// True where rows have lists, and so no common length.
    pub lists: bool,
}

impl Element {
    /// Bytes of a row in a binary file.
    pub fn stride(&self) -> usize {
        self.properties.iter().map(|p| p.kind.bytes()).sum()
    }
}

/// The contents of the header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Header {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
    /// Bytes up to the first table.
    pub length: usize,
}

/// Reads the text.
pub(super) fn parse(bytes: &[u8]) -> Result<Header, Fault> {
    let bad = |reason: &str, line: &str| {
        let line: String = line.chars().take(80).collect();
        Fault::damaged(format!("its header has {reason}: {line:?}"))
    };
    let mut lines = Lines { bytes, at: 0 };
    if lines.next() != Some("ply") {
        let what = "it is not a PLY file: it does not start with \"ply\"";
        return Err(Fault::bad(what, "check the name, or import it as another format"));
    }
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    loop {
        let Some(line) = lines.next() else {
            return Err(Fault::damaged("its header has no end, or is not text".to_owned()));
        };
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words[..] {
            [] | ["comment" | "obj_info", ..] => {}
            ["end_header"] => break,
            ["format", name, "1.0"] => {
                encoding = Some(match name {
                    "binary_little_endian" => Encoding::Little,
                    "binary_big_endian" => Encoding::Big,
                    "ascii" => Encoding::Text,
                    _ => return Err(bad("an unknown format", line)),
                });
            }
            ["element", name, rows] => elements.push(Element {
                name: name.to_owned(),
                rows: rows.parse().map_err(|_| bad("a count that is not a number", line))?,
                properties: Vec::new(),
                lists: false,
            }),
            ["property", "list", _, _, _] => match elements.last_mut() {
                Some(element) => element.lists = true,
                None => return Err(bad("a property before the first element", line)),
            },
            ["property", kind, name] => {
                let kind = number_of(kind).ok_or_else(|| bad("an unknown type", line))?;
                match elements.last_mut() {
                    Some(element) => element.properties.push(Property { name: name.to_owned(), kind }),
                    None => return Err(bad("a property before the first element", line)),
                }
            }
            _ => return Err(bad("a line that makes no sense", line)),
        }
    }
    match encoding {
        Some(encoding) => Ok(Header { encoding, elements, length: lines.at }),
        None => Err(Fault::damaged("its header states no format".to_owned())),
    }
}

/// Lines of text at the start of a file that goes on with something else.
struct Lines<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Lines<'a> {
    fn next(&mut self) -> Option<&'a str> {
        let end = self.bytes.len().min(MAX_HEADER);
        let rest = self.bytes.get(self.at..end)?;
        let line = &rest[..rest.iter().position(|&b| b == b'\n')?];
        self.at += line.len() + 1;
        let text = std::str::from_utf8(line).ok()?;
        Some(text.strip_suffix('\r').unwrap_or(text))
    }
}

/// Numbers of one table.
pub(super) struct Table<'a> {
    element: &'a Element,
    columns: Vec<Option<Vec<f32>>>,
}

impl<'a> Table<'a> {
    /// Reads the `wanted` properties; `bytes` start at the table and are compared with its rows before anything is allocated.
    pub fn read(
        element: &'a Element,
        encoding: Encoding,
        bytes: &[u8],
        wanted: impl Fn(&str) -> bool,
    ) -> Result<Self, Fault> {
        let width = element.properties.len();
        // a digit and a space in text
        let stride = if encoding == Encoding::Text { 2 * width } else { element.stride() };
        // the last number of a text may end the file
        let there = bytes.len().saturating_add(usize::from(encoding == Encoding::Text));
        if stride == 0 || element.rows > there / stride {
            return Err(Fault::damaged(format!(
                "its header says {} splats of {stride} bytes or more and the file has {} bytes for them",
                element.rows,
                bytes.len()
            )));
        }
        let mut columns: Vec<Option<Vec<f32>>> =
            element.properties.iter().map(|p| wanted(&p.name).then(|| Vec::with_capacity(element.rows))).collect();
        if encoding == Encoding::Text {
            text(element, bytes, &mut columns)?;
        } else {
            let big = encoding == Encoding::Big;
            for row in bytes.chunks_exact(stride).take(element.rows) {
                let mut at = 0;
                for (property, column) in element.properties.iter().zip(&mut columns) {
                    let next = at + property.kind.bytes();
                    if let Some(column) = column {
                        column.push(property.kind.read(&row[at..next], big) as f32);
                    }
                    at = next;
                }
            }
        }
        Ok(Self { element, columns })
    }

    /// The column of the first of these names that the table has.
    pub fn column(&self, names: &[&str]) -> Option<(&str, Number, &[f32])> {
        names.iter().find_map(|name| {
            let at = self.element.properties.iter().position(|p| p.name == *name)?;
            let property = &self.element.properties[at];
            Some((property.name.as_str(), property.kind, self.columns[at].as_deref()?))
        })
    }
}

fn text(element: &Element, bytes: &[u8], columns: &mut [Option<Vec<f32>>]) -> Result<(), Fault> {
    let mut words = bytes.split(|b| b.is_ascii_whitespace()).filter(|word| !word.is_empty());
    for row in 0..element.rows {
        for (property, column) in element.properties.iter().zip(&mut *columns) {
            let number = words.next().and_then(|word| std::str::from_utf8(word).ok()?.parse::<f64>().ok());
            let Some(number) = number else {
                return Err(Fault::damaged(format!("{} of splat {row} is not a number, or missing", property.name)));
            };
            if let Some(column) = column {
                column.push(number as f32);
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{Encoding, parse};

    #[test]
    fn elements_and_properties_are_listed() {
        let text = b"ply\r\nformat binary_little_endian 1.0\ncomment x\nelement face 2\nproperty list uchar int i\n\
            element vertex 3\nproperty float x\nproperty uchar red\nend_header\nrest";
        let header = parse(text).unwrap();
        assert_eq!(header.encoding, Encoding::Little);
        assert!(header.elements[0].lists && !header.elements[1].lists);
        assert_eq!((header.elements[1].rows, header.elements[1].stride()), (3, 5));
        assert_eq!(&text[header.length..], b"rest");
    }

    #[test]
    fn malformed_ply_headers_are_rejected() {
        assert!(parse(b"PLY\n").unwrap_err().to_string().contains("not a PLY file"));
        for text in [
            "ply\nend_header\n",
            "ply\nformat ascii 1.0\nproperty float x\nend_header\n",
            "ply\nformat ascii 1.0\nelement vertex -1\nend_header\n",
            "ply\nformat ascii 1.0\nelement vertex 99999999999999999999\nend_header\n",
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\nend_header\n",
            "ply\nformat ascii 1.0\nelement vertex 1\n",
            "ply\nformat ascii 2.0\nend_header\n",
        ] {
            assert!(parse(text.as_bytes()).unwrap_err().to_string().contains("damaged"), "{text}");
        }
    }
}
