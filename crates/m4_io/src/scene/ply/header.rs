//! The text header of a PLY file.

/// Longest header that is read, bytes.
const MAX_HEADER: usize = 64 << 10;

/// How the numbers are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Little,
    Big,
    Text,
}

/// A type of number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes of a number.
    pub fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// A number of each row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Property {
    pub name: String,
    pub kind: Kind,
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

/// What is wrong with a header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum BadHeader {
    /// The file is of another kind.
    NotPly(String),
    /// It is a PLY file that makes no sense.
    Damaged(String),
}

/// Reads the text.
pub(super) fn parse(bytes: &[u8]) -> Result<Header, BadHeader> {
    let damaged = |reason: &str, line: &str| {
        let line: String = line.chars().take(80).collect();
        BadHeader::Damaged(format!("its header has {reason}: {line:?}"))
    };
    let mut lines = Lines { bytes, at: 0 };
    if lines.next() != Some("ply") {
        return Err(BadHeader::NotPly("it does not start with \"ply\"".to_owned()));
    }
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    loop {
        let Some(line) = lines.next() else {
            return Err(BadHeader::Damaged("its header has no end, or is not text".to_owned()));
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
                    _ => return Err(damaged("an unknown format", line)),
                });
            }
            ["element", name, rows] => elements.push(Element {
                name: name.to_owned(),
                rows: rows
                    .parse()
                    .map_err(|_| damaged("a count that is not a number", line))?,
                properties: Vec::new(),
                lists: false,
            }),
            ["property", "list", _, _, _] => match elements.last_mut() {
                Some(element) => element.lists = true,
                None => return Err(damaged("a property before the first element", line)),
            },
            ["property", kind, name] => {
                let kind = Kind::named(kind).ok_or_else(|| damaged("an unknown type", line))?;
                match elements.last_mut() {
                    Some(element) => element.properties.push(Property {
                        name: name.to_owned(),
                        kind,
                    }),
                    None => return Err(damaged("a property before the first element", line)),
                }
            }
            _ => return Err(damaged("a line that makes no sense", line)),
        }
    }
    match encoding {
        Some(encoding) => Ok(Header {
            encoding,
            elements,
            length: lines.at,
        }),
        None => Err(BadHeader::Damaged("its header states no format".to_owned())),
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

#[cfg(test)]
mod tests {
    use super::{BadHeader, Encoding, parse};

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
        assert!(matches!(parse(b"PLY\n"), Err(BadHeader::NotPly(_))));
        for text in [
            "ply\nend_header\n",
            "ply\nformat ascii 1.0\nproperty float x\nend_header\n",
            "ply\nformat ascii 1.0\nelement vertex -1\nend_header\n",
            "ply\nformat ascii 1.0\nelement vertex 99999999999999999999\nend_header\n",
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\nend_header\n",
            "ply\nformat ascii 1.0\nelement vertex 1\n",
            "ply\nformat ascii 2.0\nend_header\n",
        ] {
            assert!(matches!(parse(text.as_bytes()), Err(BadHeader::Damaged(_))), "{text}");
        }
    }
}
