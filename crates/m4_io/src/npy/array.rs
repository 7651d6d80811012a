//! Reads the numbers of an array from front to back.

use super::{Header, Number};
use crate::{Fault, files};
use std::io::{BufReader, Cursor, Read};
use std::path::Path;

/// Most dimensions of an array.
const MAX_RANK: usize = 8;
const HINT: &str = "save it again with numpy";

/// The type of a `descr`, and whether its bytes are most significant first.
fn parse(descr: &str) -> Option<(Number, bool)> {
    let number = match descr.get(1..)? {
        "b1" => Number::Bool,
        "u1" => Number::U8,
        "i1" => Number::I8,
        "u2" => Number::U16,
        "i2" => Number::I16,
        "u4" => Number::U32,
        "i4" => Number::I32,
        "u8" => Number::U64,
        "i8" => Number::I64,
        "f2" => Number::F16,
        "f4" => Number::F32,
        "f8" => Number::F64,
        _ => return None,
    };
    match descr.as_bytes()[0] {
        b'<' | b'|' | b'=' => Some((number, false)),
        b'>' => Some((number, true)),
        _ => None,
    }
}

/// An array whose header was read and whose numbers follow, in C order.
pub struct Array<'a> {
    /// Slowest dimension first.
    pub shape: Vec<usize>,
    /// Type of its numbers.
    pub(crate) number: Number,
    /// For messages.
    name: String,
    big_endian: bool,
    reader: Box<dyn Read + 'a>,
}

/// All numbers of an array.
pub(crate) struct Numbers {
    /// Slowest dimension first.
    pub shape: Vec<usize>,
    /// In C order.
    pub values: Vec<f64>,
    /// Whether they are stored as integers or booleans.
    pub whole: bool,
}

impl Numbers {
    /// Those of a `.npy` file; in memory they may take `limit_bytes`.
    pub(crate) fn read(path: &Path, limit_bytes: u64) -> Result<Self, Fault> {
        // in memory each number takes 8 bytes, in the file 1 at least
        Array::of_file("the array", path, limit_bytes / 8)?.numbers()
    }

    /// Height and width of one map, `[h][w]`, also with dimensions of 1 around.
    pub(crate) fn map_size(&self) -> Result<(usize, usize), Fault> {
        match self.shape[..] {
            [h, w] | [h, w, 1] | [1, h, w] | [1, h, w, 1] if h * w > 0 => Ok((h, w)),
            _ => {
                let what = format!(
                    "an array of shape {:?}; [height, width] was expected",
                    self.shape
                );
                Err(Fault::bad(what, "save one map per file"))
            }
        }
    }
}

impl Array<'static> {
    /// That of a `.npy` file, its header read; it may take `limit_bytes`.
    pub(crate) fn of_file(name: &str, path: &Path, limit_bytes: u64) -> Result<Self, Fault> {
        let file = files::open(path)?;
        let file_bytes = file.metadata()?.len();
        Self::open(name, BufReader::new(file), file_bytes, limit_bytes)
    }
}

impl<'a> Array<'a> {
    /// Reads the header; `most_bytes` is what `reader` can give at most, `limit_bytes` what the
    /// array may take.
    pub fn open(
        name: &str,
        mut reader: impl Read + 'a,
        most_bytes: u64,
        limit_bytes: u64,
    ) -> Result<Self, Fault> {
        let bad = |why: String| Fault::bad(format!("{name} {why}"), HINT);
        let header = Header::read(&mut reader).map_err(bad)?;
        let Some((number, big_endian)) = parse(&header.descr) else {
            let types = "booleans, integers and floats are read";
            return Err(bad(format!(
                "holds numbers of type {}; {types}",
                header.descr
            )));
        };
        if header.shape.len() > MAX_RANK {
            return Err(bad(format!("has {} dimensions", header.shape.len())));
        }
        let needed_bytes = header
            .len()
            .and_then(|n| n.checked_mul(number.bytes() as u64));
        let needed_bytes = needed_bytes.unwrap_or(u64::MAX);
        if needed_bytes > most_bytes {
            return Err(bad(format!(
                "has shape {:?} of {}, more than the file can hold; it is damaged or cut off",
                header.shape, header.descr
            )));
        }
        if needed_bytes > limit_bytes {
            return Err(Fault::too_large(name, needed_bytes, limit_bytes));
        }
        // with no dimension of 0 each is smaller than the product, which is no larger than the
        // limit
        let shape: Result<Vec<usize>, _> =
            header.shape.iter().map(|&n| usize::try_from(n)).collect();
        let mut array = Self {
            number,
            shape: shape.map_err(|_| bad(format!("has shape {:?}", header.shape)))?,
            name: name.to_owned(),
            big_endian,
            reader: Box::new(reader),
        };
        if header.fortran_order && array.shape.len() > 1 {
            let bytes = array.next_bytes(needed_bytes as usize)?;
            array.end()?;
            let turned = in_c_order(&bytes, &array.shape, number.bytes());
            array.reader = Box::new(Cursor::new(turned));
        }
        Ok(array)
    }

    fn bad(&self, why: impl std::fmt::Display) -> Fault {
        Fault::bad(format!("{} {why}", self.name), HINT)
    }

    fn unpacked(&self, error: &std::io::Error) -> Fault {
        self.bad(format_args!(
            "cannot be unpacked ({error}); it is damaged or cut off"
        ))
    }

    /// The next `n` bytes: of an array of 8-bit integers its numbers. Fails if there are fewer.
    pub fn next_bytes(&mut self, n: usize) -> Result<Vec<u8>, Fault> {
        let mut bytes = Vec::with_capacity(n);
        let read = (&mut self.reader).take(n as u64).read_to_end(&mut bytes);
        read.map_err(|e| self.unpacked(&e))?;
        if bytes.len() == n {
            return Ok(bytes);
        }
        Err(self.bad("ends before all of its numbers; it is damaged or cut off"))
    }

    /// The next `n` numbers; integers of 64 bits beyond 2^53 are rounded. Fails if there are fewer.
    pub fn next_f64(&mut self, n: usize) -> Result<Vec<f64>, Fault> {
        let (number, big_endian) = (self.number, self.big_endian);
        let bytes = self.next_bytes(n.saturating_mul(number.bytes()))?;
        let numbers = bytes.chunks_exact(number.bytes());
        Ok(numbers
            .map(|bytes| number.read(bytes, big_endian))
            .collect())
    }

    /// Makes sure that nothing follows; of an archive this also compares the checksum.
    pub fn end(&mut self) -> Result<(), Fault> {
        match self.reader.read(&mut [0]) {
            Ok(0) => Ok(()),
            Ok(_) => Err(self.bad("continues after all of its numbers")),
            Err(e) => Err(self.unpacked(&e)),
        }
    }

    /// Reads the array to its end.
    pub(crate) fn numbers(mut self) -> Result<Numbers, Fault> {
        let values = self.next_f64(self.shape.iter().product())?;
        self.end()?;
        Ok(Numbers {
            whole: !self.number.is_float(),
            shape: self.shape,
            values,
        })
    }
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
    use super::Array;
    use crate::{ErrorKind, Fault};

    fn npy(descr: &str, fortran: bool, shape: &str, numbers: &[u8]) -> Vec<u8> {
        let order = if fortran { "True" } else { "False" };
        let text =
            format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}\n");
        let mut out = b"\x93NUMPY\x01\x00".to_vec();
        out.extend((text.len() as u16).to_le_bytes());
        out.extend(text.as_bytes());
        out.extend(numbers);
        out
    }

    fn values(bytes: &[u8]) -> Result<Vec<f64>, Fault> {
        Ok(
            Array::open("the array", bytes, bytes.len() as u64, 1 << 20)?
                .numbers()?
                .values,
        )
    }

    #[test]
    fn array_types_and_byte_orders_are_equivalent() {
        let flat = |f: &dyn Fn(f32) -> Vec<u8>| {
            (0..6).flat_map(|k| f(k as f32 * 0.5)).collect::<Vec<u8>>()
        };
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
        assert_eq!(
            values(&npy("|b1", false, "(3,)", &[0, 1, 1])).unwrap(),
            [0.0, 1.0, 1.0]
        );
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
    fn shapes_beyond_the_file_or_the_limit_are_refused() {
        let refused = |bytes: &[u8], limit| match Array::open(
            "the array",
            bytes,
            bytes.len() as u64,
            limit,
        ) {
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
            assert_eq!(cause.kind(), ErrorKind::BadData, "{shape}");
        }
        let large = npy("|u1", false, "(2, 8)", &[0; 16]);
        assert_eq!(refused(&large, 15).kind(), ErrorKind::Unsupported);
        let what = refused(&npy("|O", false, "(1,)", &[0; 8]), 99).to_string();
        assert!(what.contains("|O"), "{what}");
        assert!(values(&npy("<f4", false, "(2,)", &[0; 9])).is_err());
        let deep = npy("|u1", false, "(1,1,1,1,1,1,1,1,1)", &[0]);
        assert_eq!(refused(&deep, 99).kind(), ErrorKind::BadData);
    }
}
