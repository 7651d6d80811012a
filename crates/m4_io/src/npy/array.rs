//! Reads the numbers of an array from front to back.

use super::Header;
use half::f16;
use std::io::{self, Cursor, Read};

/// Most dimensions of an array.
const MAX_RANK: usize = 8;

/// Why an array cannot be read.
#[derive(Debug)]
pub enum ArrayError {
    /// What is wrong with it, in words that follow "the array".
    Bad(String),
    /// It would take more memory than is allowed.
    TooLarge {
        /// What it takes, bytes.
        needed_bytes: u64,
        /// The limit.
        limit_bytes: u64,
    },
}

/// Type of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Number {
    /// `bool`, a byte each.
    Bool,
    /// `uint8`.
    U8,
    /// `int8`.
    I8,
    /// `uint16`.
    U16,
    /// `int16`.
    I16,
    /// `uint32`.
    U32,
    /// `int32`.
    I32,
    /// `uint64`.
    U64,
    /// `int64`.
    I64,
    /// `float16`.
    F16,
    /// `float32`.
    F32,
    /// `float64`.
    F64,
}

impl Number {
    /// The type of a `descr`, and whether its bytes are most significant first.
    fn parse(descr: &str) -> Option<(Self, bool)> {
        let number = match descr.get(1..)? {
            "b1" => Self::Bool,
            "u1" => Self::U8,
            "i1" => Self::I8,
            "u2" => Self::U16,
            "i2" => Self::I16,
            "u4" => Self::U32,
            "i4" => Self::I32,
            "u8" => Self::U64,
            "i8" => Self::I64,
            "f2" => Self::F16,
            "f4" => Self::F32,
            "f8" => Self::F64,
            _ => return None,
        };
        match descr.as_bytes()[0] {
            b'<' | b'|' | b'=' => Some((number, false)),
            b'>' => Some((number, true)),
            _ => None,
        }
    }

    fn bytes(self) -> usize {
        match self {
            Self::Bool | Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 | Self::F16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }
}

/// An array whose header was read and whose numbers follow, in C order.
pub struct Array<'a> {
    /// Type of its numbers.
    pub number: Number,
    /// Slowest dimension first.
    pub shape: Vec<usize>,
    big_endian: bool,
    reader: Box<dyn Read + 'a>,
}

impl<'a> Array<'a> {
    /// Reads the header. `most_bytes` is what `reader` can give at most, and `limit_bytes` what the array may take.
    ///
    /// # Errors
    ///
    /// [`ArrayError`]: no array, numbers of another type, or more of them than there are bytes for.
    pub fn open(mut reader: impl Read + 'a, most_bytes: u64, limit_bytes: u64) -> Result<Self, ArrayError> {
        let header = Header::read(&mut reader).map_err(ArrayError::Bad)?;
        let Some((number, big_endian)) = Number::parse(&header.descr) else {
            let types = "booleans, integers and floats are read";
            return Err(ArrayError::Bad(format!(
                "holds numbers of type {}; {types}",
                header.descr
            )));
        };
        if header.shape.len() > MAX_RANK {
            return Err(ArrayError::Bad(format!("has {} dimensions", header.shape.len())));
        }
        let needed_bytes = header.len().and_then(|n| n.checked_mul(number.bytes() as u64));
        let needed_bytes = needed_bytes.unwrap_or(u64::MAX);
        if needed_bytes > most_bytes {
            return Err(ArrayError::Bad(format!(
                "has shape {:?} of {}, more than the file can hold; it is damaged or cut off",
                header.shape, header.descr
            )));
        }
        if needed_bytes > limit_bytes {
            return Err(ArrayError::TooLarge {
                needed_bytes,
                limit_bytes,
            });
        }
        // with no dimension of 0 each is smaller than the product, which is no larger than the limit
        let shape: Result<Vec<usize>, _> = header.shape.iter().map(|&n| usize::try_from(n)).collect();
        let shape = shape.map_err(|_| ArrayError::Bad(format!("has shape {:?}", header.shape)))?;
        let mut array = Self {
            number,
            shape,
            big_endian,
            reader: Box::new(reader),
        };
        if header.fortran_order && array.shape.len() > 1 {
            let bytes = array.bytes(needed_bytes as usize)?;
            array.end()?;
            let turned = in_c_order(&bytes, &array.shape, number.bytes());
            array.reader = Box::new(Cursor::new(turned));
        }
        Ok(array)
    }

    /// The next `n` bytes.
    fn bytes(&mut self, n: usize) -> Result<Vec<u8>, ArrayError> {
        let mut bytes = Vec::with_capacity(n);
        let read = (&mut self.reader).take(n as u64).read_to_end(&mut bytes);
        read.map_err(unpacked)?;
        if bytes.len() == n {
            Ok(bytes)
        } else {
            Err(ArrayError::Bad(
                "ends before all of its numbers; it is damaged or cut off".into(),
            ))
        }
    }

    /// The next `n` numbers of an array of 8-bit integers; callers compare [`Array::number`] first.
    ///
    /// # Errors
    ///
    /// [`ArrayError::Bad`] if there are fewer.
    pub fn next_u8(&mut self, n: usize) -> Result<Vec<u8>, ArrayError> {
        self.bytes(n)
    }

    /// The next `n` numbers; integers of 64 bits beyond 2^53 are rounded.
    ///
    /// # Errors
    ///
    /// [`ArrayError::Bad`] if there are fewer.
    pub fn next_f64(&mut self, n: usize) -> Result<Vec<f64>, ArrayError> {
        let (number, big_endian) = (self.number, self.big_endian);
        let wide = |bytes: &[u8]| match (number, big_endian) {
            (Number::Bool, _) => f64::from(u8::from(bytes[0] != 0)),
            (Number::U8, _) => f64::from(bytes[0]),
            (Number::I8, _) => f64::from(i8::from_le_bytes(exact(bytes))),
            (Number::U16, false) => f64::from(u16::from_le_bytes(exact(bytes))),
            (Number::U16, true) => f64::from(u16::from_be_bytes(exact(bytes))),
            (Number::I16, false) => f64::from(i16::from_le_bytes(exact(bytes))),
            (Number::I16, true) => f64::from(i16::from_be_bytes(exact(bytes))),
            (Number::U32, false) => f64::from(u32::from_le_bytes(exact(bytes))),
            (Number::U32, true) => f64::from(u32::from_be_bytes(exact(bytes))),
            (Number::I32, false) => f64::from(i32::from_le_bytes(exact(bytes))),
            (Number::I32, true) => f64::from(i32::from_be_bytes(exact(bytes))),
            (Number::U64, false) => u64::from_le_bytes(exact(bytes)) as f64,
            (Number::U64, true) => u64::from_be_bytes(exact(bytes)) as f64,
            (Number::I64, false) => i64::from_le_bytes(exact(bytes)) as f64,
            (Number::I64, true) => i64::from_be_bytes(exact(bytes)) as f64,
            (Number::F16, false) => f16::from_le_bytes(exact(bytes)).to_f64(),
            (Number::F16, true) => f16::from_be_bytes(exact(bytes)).to_f64(),
            (Number::F32, false) => f64::from(f32::from_le_bytes(exact(bytes))),
            (Number::F32, true) => f64::from(f32::from_be_bytes(exact(bytes))),
            (Number::F64, false) => f64::from_le_bytes(exact(bytes)),
            (Number::F64, true) => f64::from_be_bytes(exact(bytes)),
        };
        let width = number.bytes();
        let bytes = self.bytes(n.saturating_mul(width))?;
        Ok(bytes.chunks_exact(width).map(wide).collect())
    }

    /// Makes sure that nothing follows; of an archive this also compares the checksum.
    ///
    /// # Errors
    ///
    /// [`ArrayError::Bad`].
    pub fn end(&mut self) -> Result<(), ArrayError> {
        let mut one = [0];
        match self.reader.read(&mut one) {
            Ok(0) => Ok(()),
            Ok(_) => Err(ArrayError::Bad("continues after all of its numbers".into())),
            Err(e) => Err(unpacked(e)),
        }
    }
}

fn unpacked(error: io::Error) -> ArrayError {
    ArrayError::Bad(format!("cannot be unpacked ({error}); it is damaged or cut off"))
}

/// The `N` bytes of a number: `chunks_exact` gives no other length.
fn exact<const N: usize>(bytes: &[u8]) -> [u8; N] {
    std::array::from_fn(|k| bytes[k])
}

/// Numbers whose first index runs fastest as numbers whose last one does.
fn in_c_order(bytes: &[u8], shape: &[usize], width: usize) -> Vec<u8> {
    let strides: Vec<usize> = shape
        .iter()
        .scan(1, |stride, &n| Some(std::mem::replace(stride, *stride * n)))
        .collect();
    let mut at = vec![0; shape.len()];
    let mut out = Vec::with_capacity(bytes.len());
    for _ in 0..bytes.len() / width {
        let from: usize = at.iter().zip(&strides).map(|(i, stride)| i * stride).sum();
        out.extend(&bytes[from * width..(from + 1) * width]);
        for k in (0..shape.len()).rev() {
            at[k] += 1;
            if at[k] < shape[k] {
                break;
            }
            at[k] = 0;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::{Array, ArrayError, Number};
    use crate::npy::Header;

    fn npy(descr: &str, fortran: bool, shape: &str, numbers: &[u8]) -> Vec<u8> {
        let order = if fortran { "True" } else { "False" };
        let text = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}\n");
        let mut out = b"\x93NUMPY\x01\x00".to_vec();
        out.extend((text.len() as u16).to_le_bytes());
        out.extend(text.as_bytes());
        out.extend(numbers);
        out
    }

    fn values(bytes: &[u8]) -> Result<Vec<f64>, ArrayError> {
        let mut array = Array::open(bytes, bytes.len() as u64, 1 << 20)?;
        let n = array.shape.iter().product();
        let values = array.next_f64(n)?;
        array.end()?;
        Ok(values)
    }

    #[test]
    fn array_types_and_byte_orders_are_equivalent() {
        let flat = |f: &dyn Fn(f32) -> Vec<u8>| (0..6).flat_map(|k| f(k as f32 * 0.5)).collect::<Vec<u8>>();
        let half = |v: f32| half::f16::from_f32(v);
        let cases = [
            ("<f2", flat(&|v| half(v).to_le_bytes().to_vec())),
            (">f2", flat(&|v| half(v).to_be_bytes().to_vec())),
            ("<f4", flat(&|v| v.to_le_bytes().to_vec())),
            (">f4", flat(&|v| v.to_be_bytes().to_vec())),
            ("<f8", flat(&|v| f64::from(v).to_le_bytes().to_vec())),
            (">f8", flat(&|v| f64::from(v).to_be_bytes().to_vec())),
        ];
        let steps = |f: &dyn Fn(i8) -> Vec<u8>| (-2..4).flat_map(f).collect::<Vec<u8>>();
        let whole = [
            ("|i1", steps(&|v| v.to_le_bytes().to_vec())),
            ("<i2", steps(&|v| i16::from(v).to_le_bytes().to_vec())),
            (">i2", steps(&|v| i16::from(v).to_be_bytes().to_vec())),
            ("<i4", steps(&|v| i32::from(v).to_le_bytes().to_vec())),
            (">i4", steps(&|v| i32::from(v).to_be_bytes().to_vec())),
            ("<i8", steps(&|v| i64::from(v).to_le_bytes().to_vec())),
            (">i8", steps(&|v| i64::from(v).to_be_bytes().to_vec())),
        ];
        for (descr, bytes) in &whole {
            let got = values(&npy(descr, false, "(6,)", bytes)).unwrap();
            assert_eq!(got, [-2.0, -1.0, 0.0, 1.0, 2.0, 3.0], "{descr}");
        }
        let large = 60_000u16;
        assert_eq!(
            values(&npy("<u2", false, "(1,)", &large.to_le_bytes())).unwrap(),
            [60_000.0]
        );
        assert_eq!(
            values(&npy(">u4", false, "(1,)", &3_000_000_000u32.to_be_bytes())).unwrap(),
            [3e9]
        );
        assert_eq!(values(&npy("|b1", false, "(3,)", &[0, 1, 1])).unwrap(), [0.0, 1.0, 1.0]);
        for (descr, bytes) in &cases {
            let got = values(&npy(descr, false, "(2, 3)", bytes)).unwrap();
            assert_eq!(got, [0.0, 0.5, 1.0, 1.5, 2.0, 2.5], "{descr}");
            let got = values(&npy(descr, true, "(2, 3)", bytes)).unwrap();
            assert_eq!(got, [0.0, 1.0, 2.0, 0.5, 1.5, 2.5], "{descr}");
        }
        // rank 3: [i][j][k] lies at i + 2 j + 4 k
        let cube: Vec<u8> = (0..8).collect();
        let got = values(&npy("|u1", true, "(2, 2, 2)", &cube)).unwrap();
        assert_eq!(got, [0.0, 4.0, 2.0, 6.0, 1.0, 5.0, 3.0, 7.0]);
    }

    #[test]
    fn mismatched_image_sizes_are_refused() {
        let refused = |bytes: &[u8], limit| match Array::open(bytes, bytes.len() as u64, limit) {
            Ok(_) => panic!("it was taken"),
            Err(cause) => cause,
        };
        for shape in [
            "(2, 400)",
            "(18446744073709551615, 2)",
            "(4000000000, 4000000000)",
            "(0, 9999999999999999999999)",
        ] {
            let cause = refused(&npy("<f8", false, shape, &[0; 24]), u64::MAX);
            assert!(matches!(cause, ArrayError::Bad(_)), "{shape}");
        }
        let large = npy("|u1", false, "(2, 8)", &[0; 16]);
        assert!(matches!(
            refused(&large, 15),
            ArrayError::TooLarge { needed_bytes: 16, .. }
        ));
        let ArrayError::Bad(what) = refused(&npy("|O", false, "(1,)", &[0; 8]), 99) else {
            panic!("objects are not read");
        };
        assert!(what.contains("|O"), "{what}");
        assert!(values(&npy("<f4", false, "(2,)", &[0; 9])).is_err());
        let deep = npy("|u1", false, "(1,1,1,1,1,1,1,1,1)", &[0]);
        assert!(matches!(refused(&deep, 99), ArrayError::Bad(_)));
    }

    #[test]
    fn a_written_header_is_read() {
        let mut bytes = Header::new("|u1", vec![2, 2]).to_bytes();
        bytes.extend([1, 2, 3, 4]);
        let mut array = Array::open(bytes.as_slice(), bytes.len() as u64, 99).unwrap();
        assert_eq!((array.number, array.shape.as_slice()), (Number::U8, &[2, 2][..]));
        assert_eq!(array.next_u8(3).unwrap(), [1, 2, 3]);
        assert!(array.end().is_err());
        assert!(array.next_u8(1).is_err(), "the last was taken by the look for an end");
    }
}
