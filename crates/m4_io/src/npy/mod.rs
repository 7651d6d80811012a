//! Reads numpy arrays: `.npy` files (NumPy enhancement proposal 1) and `.npz` archives of them.
//!
//! ```text
//! .npy   header | numbers                       Header -> Array, read from front to back
//! .npz   zip of NAME.npy, stored or deflated    Npz: one Array a member
//! ```
//!
//! Files are not trusted. A shape is compared with the bytes that the file can hold (for a deflated
//! member: 1032 times what is packed, the most that deflate can do) before anything of its size is
//! allocated, and pieces are read one by one. Booleans, integers of 8 to 64 bits and floats of 16,
//! 32 and 64 bits are read, of either byte order; arrays in Fortran order are reversed. This is
//! done here and not by a crate: `npyz` multiplies a shape without looking for an overflow.

mod array;

pub use array::Array;
pub(crate) use array::Numbers;

use crate::Fault;
use crate::files::{self, memory_for};
use half::f16;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;
use zip::result::ZipError;
use zip::{CompressionMethod, ZipArchive};

const MAGIC: &[u8; 6] = b"\x93NUMPY";
/// Longest header that is read, bytes; those of plain arrays have 118 at most.
const MAX_HEADER: usize = 4096;
/// What a header is padded to, bytes.
const ALIGN: usize = 64;

/// What the bytes after it mean.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Header {
    /// Type of a number, such as `<f4`.
    pub descr: String,
    /// True where the first index runs fastest; written are arrays whose last one does.
    pub fortran_order: bool,
    /// Slowest dimension first.
    pub shape: Vec<u64>,
}

impl Header {
    /// Reads a header; `reader` is then at the first number. Errors: what is wrong with it, in
    /// words.
    pub fn read(reader: &mut impl Read) -> Result<Self, String> {
        let mut take = |n: usize| -> Result<Vec<u8>, String> {
            let mut bytes = vec![0; n];
            let cut = |e| format!("ends in its header ({e})");
            reader.read_exact(&mut bytes).map_err(cut)?;
            Ok(bytes)
        };
        let start = take(8)?;
        if &start[..6] != MAGIC {
            return Err("is not an npy array".into());
        }
        let length = match start[6] {
            1 => take(2)?,
            2 | 3 => take(4)?,
            other => return Err(format!("has version {other} of npy; 1 to 3 are read")),
        };
        let length = length
            .iter()
            .rev()
            .fold(0usize, |sum, &b| sum << 8 | usize::from(b));
        if length > MAX_HEADER {
            return Err(format!(
                "has a header of {length} bytes; at most {MAX_HEADER} are read"
            ));
        }
        let text = String::from_utf8(take(length)?)
            .map_err(|_| "has a header that is not text".to_owned())?;
        Self::parse(&text)
            .ok_or_else(|| format!("has a header that is not understood: {}", text.trim_end()))
    }

    /// `{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }`, in any order.
    fn parse(text: &str) -> Option<Self> {
        let value = |key: &str| {
            let (_, rest) = text.split_once(&format!("'{key}'"))?;
            Some(rest.trim_start().strip_prefix(':')?.trim_start())
        };
        let descr = value("descr")?.strip_prefix('\'')?.split_once('\'')?.0;
        let order = value("fortran_order")?;
        let fortran_order = order.starts_with("True");
        if !fortran_order && !order.starts_with("False") {
            return None;
        }
        let shape = value("shape")?.strip_prefix('(')?.split_once(')')?.0;
        let sizes = shape.split(',').map(str::trim).filter(|s| !s.is_empty());
        Some(Self {
            descr: descr.to_owned(),
            fortran_order,
            shape: sizes.map(|s| s.parse().ok()).collect::<Option<_>>()?,
        })
    }

    /// That of an array in C order.
    pub fn new(descr: &str, shape: Vec<u64>) -> Self {
        Self {
            descr: descr.to_owned(),
            fortran_order: false,
            shape,
        }
    }

    /// Numbers in the array; `None` if they are more than can be counted.
    pub fn len(&self) -> Option<u64> {
        self.shape
            .iter()
            .try_fold(1u64, |n, &side| n.checked_mul(side))
    }

    /// The bytes of the header of an array in C order.
    pub fn to_bytes(&self) -> Vec<u8> {
        let sizes: Vec<String> = self.shape.iter().map(|n| format!("{n},")).collect();
        let text = format!(
            "{{'descr': '{}', 'fortran_order': False, 'shape': ({}), }}",
            self.descr,
            sizes.join(" ")
        );
        // magic, version, length, text, line feed
        let padded = (10 + text.len() + 1).next_multiple_of(ALIGN);
        let mut out = MAGIC.to_vec();
        out.extend([1, 0]);
        out.extend(((padded - 10) as u16).to_le_bytes());
        out.extend(text.as_bytes());
        out.resize(padded - 1, b' ');
        out.push(b'\n');
        out
    }
}

/// How a number is stored; `Bool` takes a byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Number {
    Bool,
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F16,
    F32,
    F64,
}

impl Number {
    /// Bytes of a number.
    pub fn bytes(self) -> usize {
        match self {
            Self::Bool | Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 | Self::F16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    pub fn is_float(self) -> bool {
        matches!(self, Self::F16 | Self::F32 | Self::F64)
    }

    /// The number in `bytes`, which are as many as it takes; integers of 64 bits beyond 2^53 are
    /// rounded.
    pub fn read(self, bytes: &[u8], big_endian: bool) -> f64 {
        let mut word = [0; 8];
        let n = self.bytes();
        word[..n].copy_from_slice(&bytes[..n]);
        if big_endian {
            word[..n].reverse();
        }
        let [a, b, c, d, ..] = word;
        match self {
            Self::Bool => f64::from(u8::from(a != 0)),
            Self::U8 => f64::from(a),
            Self::I8 => f64::from(i8::from_le_bytes([a])),
            Self::U16 => f64::from(u16::from_le_bytes([a, b])),
            Self::I16 => f64::from(i16::from_le_bytes([a, b])),
            Self::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Self::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Self::U64 => u64::from_le_bytes(word) as f64,
            Self::I64 => i64::from_le_bytes(word) as f64,
            Self::F16 => f16::from_le_bytes([a, b]).to_f64(),
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::F64 => f64::from_le_bytes(word),
        }
    }
}

/// What a byte of deflate can unpack to at most.
const MAX_RATIO: u64 = 1032;

/// An archive of arrays.
pub struct Npz {
    zip: ZipArchive<BufReader<File>>,
    file_bytes: u64,
}

impl Npz {
    /// Opens the file and reads its directory. Errors: what the system says, or why it is no
    /// archive.
    pub fn open(path: &Path) -> Result<Self, Fault> {
        let file = files::open(path)?;
        let file_bytes = file.metadata()?.len();
        let zip = ZipArchive::new(BufReader::new(file)).map_err(|reason| {
            let what = format!("it is not an npz archive of arrays, or a damaged one ({reason})");
            Fault::bad(what, "give the npz file that the tool wrote, whole")
        })?;
        Ok(Self { zip, file_bytes })
    }

    /// Whether it has an array of that name.
    #[must_use]
    pub fn has(&self, name: &str) -> bool {
        self.zip.index_for_name(&format!("{name}.npy")).is_some()
    }

    /// Names of its first arrays, for messages.
    pub fn names(&self) -> String {
        let names = self.zip.file_names().flatten().take(12);
        let names: Vec<String> = names
            .map(|n| n.trim_end_matches(".npy").to_owned())
            .collect();
        if names.is_empty() {
            return "nothing".into();
        }
        names.join(", ")
    }

    /// One array, its header read; `None` if it is missing.
    pub fn array(&mut self, name: &str, limit_bytes: u64) -> Result<Option<Array<'_>>, Fault> {
        let called = format!("the array `{name}`");
        let member = match self.zip.by_name(&format!("{name}.npy")) {
            Ok(member) => member,
            Err(ZipError::FileNotFound) => return Ok(None),
            Err(e) => {
                return Err(Fault::bad(
                    format!("{called} cannot be unpacked ({e})"),
                    "save it again",
                ));
            }
        };
        let packed = member.compressed_size().min(self.file_bytes);
        let most_bytes = match member.compression() {
            CompressionMethod::Stored => packed,
            _ => packed.saturating_mul(MAX_RATIO),
        };
        let most_bytes = most_bytes.min(member.size());
        // in memory its numbers take up to four times as much
        let limit_bytes = limit_bytes.min(memory_for(self.file_bytes) / 4);
        Array::open(&called, member, most_bytes, limit_bytes).map(Some)
    }

    /// One array, which must be there.
    pub(crate) fn need(&mut self, name: &str, limit_bytes: u64) -> Result<Array<'_>, Fault> {
        if !self.has(name) {
            let what = format!("the array `{name}`");
            return Err(Fault::missing(
                what,
                format!("it has {}; save it again", self.names()),
            ));
        }
        let array = self.array(name, limit_bytes)?;
        array.ok_or_else(|| Fault::missing(name, "save it again"))
    }
}

#[cfg(test)]
mod tests {
    use super::Header;

    #[test]
    fn unsupported_headers_name_the_reason() {
        let refused = |bytes: &[u8]| Header::read(&mut &*bytes).unwrap_err();
        assert!(refused(b"PK").contains("ends in its header"));
        assert!(refused(b"\x93NUMPX\x01\x00\x02\x00{}").contains("not an npy"));
        assert!(refused(b"\x93NUMPY\x09\x00\x02\x00{}").contains("version 9"));
        assert!(refused(b"\x93NUMPY\x02\x00\xff\xff\xff\xff").contains("4294967295 bytes"));
        let written = |text: &str| {
            let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
            bytes.extend((text.len() as u16).to_le_bytes());
            bytes.extend(text.as_bytes());
            bytes
        };
        let unknown = written("{'descr': '<f4', 'fortran_order': None, 'shape': (2, 3), }");
        assert!(refused(&unknown).contains("not understood"));
        let columns = written("{'shape': (2, 3), 'fortran_order': True, 'descr': '<f4'}");
        let columns = Header::read(&mut columns.as_slice()).unwrap();
        assert!(columns.fortran_order && columns.shape == [2, 3]);
        assert_eq!(Header::new("|b1", vec![u64::MAX, 2]).len(), None);
    }
}
