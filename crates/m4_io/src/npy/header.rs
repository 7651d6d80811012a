//! Headers of `.npy` files (NumPy enhancement proposal 1).

use std::io::Read;

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
    /// Reads a header; `reader` is then at the first number.
    ///
    /// # Errors
    ///
    /// What is wrong with it, in words.
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
        let length = length.iter().rev().fold(0usize, |sum, &b| sum << 8 | usize::from(b));
        if length > MAX_HEADER {
            return Err(format!("has a header of {length} bytes; at most {MAX_HEADER} are read"));
        }
        let text = String::from_utf8(take(length)?).map_err(|_| "has a header that is not text".to_owned())?;
        Self::parse(&text).ok_or_else(|| format!("has a header that is not understood: {}", text.trim_end()))
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
        Self { descr: descr.to_owned(), fortran_order: false, shape }
    }

    /// Numbers in the array; `None` if they are more than can be counted.
    pub fn len(&self) -> Option<u64> {
        self.shape.iter().try_fold(1u64, |n, &side| n.checked_mul(side))
    }

    /// The bytes of the header of an array in C order.
    pub fn to_bytes(&self) -> Vec<u8> {
        let sizes: Vec<String> = self.shape.iter().map(|n| format!("{n},")).collect();
        let text = format!("{{'descr': '{}', 'fortran_order': False, 'shape': ({}), }}", self.descr, sizes.join(" "));
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

#[cfg(test)]
mod tests {
    use super::Header;

    #[test]
    fn headers_round_trip() {
        for shape in [vec![], vec![7], vec![96, 20_000, 3]] {
            let header = Header::new("<f4", shape);
            let bytes = header.to_bytes();
            assert_eq!(bytes.len() % 64, 0);
            let mut rest = bytes.as_slice();
            assert_eq!(Header::read(&mut rest).unwrap(), header);
            assert!(rest.is_empty());
        }
    }

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
