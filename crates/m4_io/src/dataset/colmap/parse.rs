//! The tables as text and as binary files; in these counts u64, identifiers of cameras and images
//! u32, numbers f64, all little-endian.

use super::tables::{ColmapCamera, ColmapImage, ColmapPoint, PlacedError, damaged};
use crate::Fault;
use std::str::{FromStr, SplitAsciiWhitespace};

/// COLMAP's models in the order of their numbers, each with how many parameters it has
/// (`colmap/sensor/models.h`, 4.2).
const MODELS: [(&str, usize); 18] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
];

pub fn cameras(rows: &[ColmapCamera]) -> Vec<u8> {
    let mut out = (rows.len() as u64).to_le_bytes().to_vec();
    for row in rows {
        let model = MODELS.iter().position(|(name, _)| *name == row.model);
        out.extend(row.id.to_le_bytes());
        out.extend(model.map_or(-1, |model| model as i32).to_le_bytes());
        out.extend(row.width.to_le_bytes());
        out.extend(row.height.to_le_bytes());
        numbers(&mut out, &row.parameters);
    }
    out
}

pub fn images(rows: &[ColmapImage]) -> Vec<u8> {
    let mut out = (rows.len() as u64).to_le_bytes().to_vec();
    for row in rows {
        out.extend(row.id.to_le_bytes());
        numbers(&mut out, &row.rotation);
        numbers(&mut out, &row.translation);
        out.extend(row.camera.to_le_bytes());
        out.extend(row.name.as_bytes());
        out.push(0);
        out.extend(0u64.to_le_bytes());
    }
    out
}

pub fn points(rows: &[ColmapPoint]) -> Vec<u8> {
    let mut out = (rows.len() as u64).to_le_bytes().to_vec();
    for (i, row) in (1u64..).zip(rows) {
        out.extend(i.to_le_bytes());
        numbers(&mut out, &row.position);
        out.extend(row.colour);
        numbers(&mut out, &[-1.0]);
        out.extend(0u64.to_le_bytes());
    }
    out
}

fn numbers(out: &mut Vec<u8>, values: &[f64]) {
    values.iter().for_each(|v| out.extend(v.to_le_bytes()));
}

pub fn read_cameras(bytes: &[u8]) -> Result<Vec<ColmapCamera>, PlacedError> {
    table(bytes, |from| {
        let (id, model) = (from.u32()?, from.u32()? as i32);
        let (width, height) = (from.u64()?, from.u64()?);
        let entry = usize::try_from(model).ok().and_then(|k| MODELS.get(k));
        let &(name, len) = entry.ok_or_else(|| {
            let what = format!("its lens is of the unknown model {model}");
            (
                format!("camera {id}"),
                Fault::unsupported(what, "undistort the images (`colmap image_undistorter`)"),
            )
        })?;
        let parameters: Vec<f64> = (0..len).map(|_| from.f64()).collect::<Result<_, _>>()?;
        Ok(ColmapCamera {
            id,
            model: name.to_owned(),
            width,
            height,
            parameters,
        })
    })
}

pub fn read_images(bytes: &[u8]) -> Result<Vec<ColmapImage>, PlacedError> {
    table(bytes, |from| {
        let id = from.u32()?;
        let rotation = from.array()?;
        let translation = from.array()?;
        let camera = from.u32()?;
        let name = from.name()?;
        let n_points = from.u64()?;
        from.skip(n_points, 24)?;
        Ok(ColmapImage {
            id,
            rotation,
            translation,
            camera,
            name,
        })
    })
}

pub fn read_points(bytes: &[u8]) -> Result<Vec<ColmapPoint>, PlacedError> {
    table(bytes, |from| {
        from.u64()?;
        let position = from.array()?;
        let colour = from.fixed()?;
        from.f64()?;
        let track = from.u64()?;
        from.skip(track, 8)?;
        Ok(ColmapPoint { position, colour })
    })
}

/// The rows of a table: as many as its first number says, to the end of the file.
fn table<T>(
    bytes: &[u8],
    row: impl Fn(&mut Cursor<'_>) -> Result<T, PlacedError>,
) -> Result<Vec<T>, PlacedError> {
    let mut from = Cursor { bytes, at: 0 };
    let count = from.u64()?;
    let mut rows = Vec::new();
    for _ in 0..count {
        rows.push(row(&mut from)?);
    }
    from.end()?;
    Ok(rows)
}

/// A place in a file. Every row takes bytes, so tables grow no larger than the file.
struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    fn damaged(&self, reason: String) -> PlacedError {
        damaged(format!("byte {}", self.at), reason)
    }

    fn take(&mut self, len: usize) -> Result<&'a [u8], PlacedError> {
        let slice = self.bytes.get(self.at..).and_then(|rest| rest.get(..len));
        let Some(slice) = slice else {
            let rest = self.bytes.len() - self.at;
            return Err(self.damaged(format!("{rest} bytes are left where {len} were expected")));
        };
        self.at += len;
        Ok(slice)
    }

    fn fixed<const N: usize>(&mut self) -> Result<[u8; N], PlacedError> {
        let bytes = self.take(N)?;
        Ok(std::array::from_fn(|i| bytes[i]))
    }

    fn u32(&mut self) -> Result<u32, PlacedError> {
        self.fixed().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, PlacedError> {
        self.fixed().map(u64::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64, PlacedError> {
        self.fixed().map(f64::from_le_bytes)
    }

    fn array<const N: usize>(&mut self) -> Result<[f64; N], PlacedError> {
        let mut values = [0.0; N];
        for v in &mut values {
            *v = self.f64()?;
        }
        Ok(values)
    }

    /// `count` records of `width` bytes.
    fn skip(&mut self, count: u64, width: u64) -> Result<(), PlacedError> {
        let len = count
            .checked_mul(width)
            .and_then(|n| usize::try_from(n).ok());
        let len = len.ok_or_else(|| self.damaged(format!("a list of {count} records")))?;
        self.take(len).map(|_| ())
    }

    fn name(&mut self) -> Result<String, PlacedError> {
        let rest = &self.bytes[self.at..];
        let end = rest.iter().position(|&b| b == 0);
        let end = end.ok_or_else(|| self.damaged("a name does not end".into()))?;
        let name = std::str::from_utf8(&rest[..end]);
        let name = name.map_err(|_| self.damaged("a name is not UTF-8".into()))?;
        self.at += end + 1;
        Ok(name.to_owned())
    }

    fn end(&self) -> Result<(), PlacedError> {
        match self.bytes.len() - self.at {
            0 => Ok(()),
            n => Err(self.damaged(format!("{n} bytes follow the last record"))),
        }
    }
}

pub fn read_cameras_text(text: &str) -> Result<Vec<ColmapCamera>, PlacedError> {
    let mut rows = Vec::new();
    for (number, line) in lines(text).filter(|(_, l)| !l.trim().is_empty()) {
        let mut words = Words::new(number, line);
        let id = words.next("CAMERA_ID")?;
        let model: String = words.next("MODEL")?;
        let (width, height) = (words.next("WIDTH")?, words.next("HEIGHT")?);
        rows.push(ColmapCamera {
            id,
            model,
            width,
            height,
            parameters: words.rest("PARAMS")?,
        });
    }
    Ok(rows)
}

pub fn read_images_text(text: &str) -> Result<Vec<ColmapImage>, PlacedError> {
    let mut rows = Vec::new();
    let mut lines = lines(text);
    while let Some((number, line)) = lines.next() {
        if line.trim().is_empty() {
            continue;
        }
        let mut words = Words::new(number, line);
        let id = words.next("IMAGE_ID")?;
        let mut pose = [0.0; 7];
        for (v, name) in pose
            .iter_mut()
            .zip(["QW", "QX", "QY", "QZ", "TX", "TY", "TZ"])
        {
            *v = words.next(name)?;
        }
        let [w, x, y, z, a, b, c] = pose;
        rows.push(ColmapImage {
            id,
            rotation: [w, x, y, z],
            translation: [a, b, c],
            camera: words.next("CAMERA_ID")?,
            name: words.next("NAME")?,
        });
        // the points that it sees, perhaps none
        lines.next();
    }
    Ok(rows)
}

/// Lines that are no comments, with their numbers from 1.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let numbered = text.lines().enumerate().map(|(i, line)| (i + 1, line));
    numbered.filter(|(_, line)| !line.trim_start().starts_with('#'))
}

/// The words of a line.
struct Words<'a> {
    line: usize,
    words: SplitAsciiWhitespace<'a>,
}

impl<'a> Words<'a> {
    fn new(line: usize, text: &'a str) -> Self {
        Self {
            line,
            words: text.split_ascii_whitespace(),
        }
    }

    fn damaged(&self, reason: String) -> PlacedError {
        damaged(format!("line {}", self.line), reason)
    }

    fn next<T: FromStr>(&mut self, what: &str) -> Result<T, PlacedError> {
        let word = self.words.next();
        let word = word.ok_or_else(|| self.damaged(format!("{what} is missing")))?;
        word.parse()
            .map_err(|_| self.damaged(format!("{what} is {word:?}")))
    }

    fn rest<T: FromStr>(&mut self, what: &str) -> Result<Vec<T>, PlacedError> {
        let mut all = Vec::new();
        while let Some(word) = self.words.next() {
            all.push(
                word.parse()
                    .map_err(|_| self.damaged(format!("{what} holds {word:?}")))?,
            );
        }
        Ok(all)
    }
}
