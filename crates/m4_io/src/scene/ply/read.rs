//! Reads a PLY file of splats as a scene.

use crate::error::AtPath;
use crate::files;
use crate::range::{self, Range};
use crate::scene::splats::{Row, collect, unit};
use crate::scene::{Imported, Loss};
use crate::{Fault, ReadError};
use m4_core::{Column, Scene};
use std::path::Path;

/// Near plane of a file, which says nothing of it, world units.
const NEAR: f32 = 0.01;
/// What an infinite logit or logarithm is read as; converters that take the logarithm of a byte
/// write infinities.
const BEYOND: f32 = 20.0;
/// Longest header that is read, bytes.
const MAX_HEADER: usize = 64 << 10;

/// Reads a file of any writer. Fails if the file is missing, damaged, or holds no splats.
pub fn read(path: &Path) -> Result<Imported, ReadError> {
    parse(path, &files::read(path, u64::MAX).at(path)?)
}

/// The scene in the bytes of a file; `path` is for messages alone. It has one frame and no cameras.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Imported, ReadError> {
    scene_of(bytes).at(path)
}

fn unsupported(reason: impl Into<String>) -> Fault {
    Fault::unsupported(
        reason,
        "give a PLY file of splats as 3DGS writes it, binary and little-endian",
    )
}

fn scene_of(bytes: &[u8]) -> Result<Imported, Fault> {
    let table = Table::parse(bytes)?;
    let numbered = |stem: &str, n: usize| -> Result<Vec<usize>, Fault> {
        (0..n).map(|k| table.need(&format!("{stem}_{k}"))).collect()
    };
    let mean = [table.need("x")?, table.need("y")?, table.need("z")?];
    let opacity = table.need("opacity")?;
    let (scale, quat) = (numbered("scale", 3)?, numbered("rot", 4)?);
    let mut colour = numbered("f_dc", 3)?;
    colour.extend((0..=45).map_while(|k| table.place(&format!("f_rest_{k}"))));
    let sh_degree = match colour.len() - 3 {
        0 => 0,
        9 => 1,
        24 => 2,
        45 => 3,
        n => {
            let what =
                format!("it has {n} properties f_rest_, and harmonics come 9, 24 or 45 at a time");
            return Err(unsupported(what));
        }
    };
    let mut rows = Vec::with_capacity(table.rows);
    for i in 0..table.rows {
        let number = |column: Column, at: usize| {
            let value = table.number(i, at);
            let range = range::of_column(column);
            if range.contains(&f64::from(value)) {
                Ok(value)
            } else {
                Err(table.bad(i, at, value, &range))
            }
        };
        let bounded = |column: Column, at: usize| match table.number(i, at) {
            value if value.is_infinite() => Ok(BEYOND.copysign(value)),
            _ => number(column, at),
        };
        for &at in &colour {
            number(Column::Colour, at)?;
        }
        let [x, y, z] = mean.map(|at| number(Column::Mean, at));
        let mut row = Row {
            mean: [x?, y?, z?],
            log_scale: [0.0; 3],
            quat: [0.0; 4],
            opacity: bounded(Column::Opacity, opacity)?,
        };
        for (to, &at) in row.log_scale.iter_mut().zip(&scale) {
            *to = bounded(Column::LogScale, at)?;
        }
        for (to, &at) in row.quat.iter_mut().zip(&quat) {
            *to = number(Column::Quat, at)?;
        }
        row.quat = unit(row.quat);
        rows.push((row, None));
    }
    let terms = colour.len() / 3;
    let splats = collect(sh_degree, &rows, |i, out| {
        for (k, &at) in colour.iter().enumerate() {
            // the constants of three channels, then the other harmonics channel by channel
            let to = if k < 3 {
                k
            } else {
                3 * ((k - 3) % (terms - 1) + 1) + (k - 3) / (terms - 1)
            };
            out[to] = table.number(i, at);
        }
    });
    let used: Vec<usize> = [&mean[..], &[opacity], &scale, &quat, &colour].concat();
    let others = table
        .properties
        .iter()
        .filter(|p| !used.contains(&p.offset) && !["nx", "ny", "nz"].contains(&p.name));
    Ok(Imported {
        scene: Scene {
            splats,
            background: [0.0; 3],
            time_frames: 1,
            duration_s: None,
            mip: false,
            near: NEAR,
            source: Vec::new(),
        },
        up: None,
        losses: unknown(others.map(|p| p.name).collect()),
    })
}

/// What the file has besides: such as the motion of formats that keep splats with time in PLY
/// files.
fn unknown(mut names: Vec<&str>) -> Vec<Loss> {
    if names.is_empty() {
        return Vec::new();
    }
    let more = names.len().saturating_sub(8);
    names.truncate(8);
    let rest = if more > 0 {
        format!(" and {more} more")
    } else {
        String::new()
    };
    vec![Loss::Dropped(format!(
        "properties that are not known here: {}{rest}",
        names.join(", ")
    ))]
}

/// A number of each row.
struct Property<'a> {
    name: &'a str,
    /// Where it lies in a row, bytes.
    offset: usize,
    /// 32 bits.
    is_float: bool,
}

/// The first table of a file, which is of vertices.
struct Table<'a> {
    rows: usize,
    /// Bytes of a row.
    stride: usize,
    properties: Vec<Property<'a>>,
    numbers: &'a [u8],
}

impl<'a> Table<'a> {
    /// Reads the header and compares the rows that it promises with the bytes that are there.
    fn parse(bytes: &'a [u8]) -> Result<Self, Fault> {
        let bad = |reason: &str, line: &str| {
            let line: String = line.chars().take(80).collect();
            Fault::damaged(format!("its header has {reason}: {line:?}"))
        };
        let mut rest = bytes;
        let mut next = || -> Option<&'a str> {
            let end = rest.iter().take(MAX_HEADER).position(|&b| b == b'\n')?;
            let (line, after) = rest.split_at(end);
            rest = &after[1..];
            let text = std::str::from_utf8(line).ok()?;
            Some(text.strip_suffix('\r').unwrap_or(text))
        };
        if next() != Some("ply") {
            let what = "it is not a PLY file: it does not start with \"ply\"";
            return Err(Fault::bad(
                what,
                "check the name, or import it as another format",
            ));
        }
        let (mut has_format, mut tables, mut rows, mut stride) = (false, 0, 0, 0usize);
        let mut properties: Vec<Property<'a>> = Vec::new();
        loop {
            let Some(line) = next() else {
                return Err(Fault::damaged("its header has no end, or is not text"));
            };
            match line.split_ascii_whitespace().collect::<Vec<_>>()[..] {
                [] | ["comment" | "obj_info", ..] => {}
                ["end_header"] => break,
                ["format", "binary_little_endian", "1.0"] => has_format = true,
                ["format", name @ ("binary_big_endian" | "ascii"), "1.0"] => {
                    return Err(unsupported(format!("its numbers are stored as {name}")));
                }
                ["element", name, count] => {
                    tables += 1;
                    if tables == 1 && name != "vertex" {
                        let compressed = bytes
                            .windows(15)
                            .take(MAX_HEADER)
                            .any(|w| w == b"packed_position");
                        return Err(unsupported(if compressed {
                            "it is a compressed PLY; splat-transform turns it into a plain one"
                                .to_owned()
                        } else {
                            format!("its first table is {name:?} and not one of vertices")
                        }));
                    }
                    let count = count
                        .parse()
                        .map_err(|_| bad("a count that is not a number", line))?;
                    rows = if tables == 1 { count } else { rows };
                }
                ["property", ..] if tables == 0 => {
                    return Err(bad("a property before the first element", line));
                }
                ["property", ..] if tables > 1 => {}
                ["property", "list", ..] => return Err(unsupported("its vertices have lists")),
                ["property", kind, name] => {
                    let bytes = match kind {
                        "char" | "int8" | "uchar" | "uint8" => 1,
                        "short" | "int16" | "ushort" | "uint16" => 2,
                        "int" | "int32" | "uint" | "uint32" | "float" | "float32" => 4,
                        "double" | "float64" => 8,
                        _ => return Err(bad("an unknown type", line)),
                    };
                    properties.push(Property {
                        name,
                        offset: stride,
                        is_float: kind.starts_with("float") && bytes == 4,
                    });
                    stride += bytes;
                }
                _ => return Err(bad("a line that makes no sense", line)),
            }
        }
        if !has_format {
            return Err(Fault::damaged("its header states no format"));
        }
        if stride == 0 {
            return Err(unsupported("it has no table of vertices"));
        }
        if rows > rest.len() / stride {
            return Err(Fault::damaged(format!(
                "its header says {rows} splats of {stride} bytes and the file has {} bytes for them",
                rest.len()
            )));
        }
        Ok(Self {
            rows,
            stride,
            properties,
            numbers: rest,
        })
    }

    /// Where the numbers of a property lie in a row; `None` where there is none of 32 bits.
    fn place(&self, name: &str) -> Option<usize> {
        self.properties
            .iter()
            .find(|p| p.name == name && p.is_float)
            .map(|p| p.offset)
    }

    fn need(&self, name: &str) -> Result<usize, Fault> {
        self.place(name)
            .ok_or_else(|| unsupported(format!("it has no property {name} of type float")))
    }

    /// The number at `place` of a row.
    fn number(&self, row: usize, place: usize) -> f32 {
        let at = row * self.stride + place;
        f32::from_le_bytes(std::array::from_fn(|k| self.numbers[at + k]))
    }

    fn bad(&self, row: usize, place: usize, value: f32, range: &Range) -> Fault {
        let name = self
            .properties
            .iter()
            .find(|p| p.offset == place)
            .map_or("a property", |p| p.name);
        let expected = range::words(range, "");
        Fault::damaged(format!(
            "{name} of splat {row} is {value:e}; {expected} was expected"
        ))
    }
}
