//! Reads a PLY file of splats as a scene.

use super::header::{Table, parse as parse_header};
use crate::error::AtPath;
use crate::files::bytes;
use crate::scene::splats::{Life, Row, collect, unit};
use crate::scene::{C0, Imported, Loss};
use crate::{Fault, ReadError};
use m4_core::Scene;
use std::path::Path;

/// Near plane of a file, which says nothing of it, world units.
const NEAR: f32 = 0.01;
/// What an infinite logit or logarithm is read as; converters that take the logarithm of a byte write infinities.
const BEYOND: f32 = 20.0;

/// Reads a file of any writer. Fails if the file is missing, damaged, or holds no splats.
pub fn read(path: &Path) -> Result<Imported, ReadError> {
    parse(path, &bytes(path, u64::MAX).at(path)?)
}

/// True for a property that a splat is made of.
fn known(name: &str) -> bool {
    let numbered = name.rsplit_once('_').is_some_and(|(stem, number)| {
        let stems = ["f_dc", "f_rest", "scale", "scaling", "rot", "rotation", "opacity"];
        number.parse::<usize>().is_ok() && stems.contains(&stem)
    });
    numbered || matches!(name, "x" | "y" | "z" | "opacity" | "red" | "green" | "blue")
}

/// The scene in the bytes of a file; `path` is for messages alone. It has one frame and no cameras.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Imported, ReadError> {
    scene_of(bytes).at(path)
}

fn unsupported(reason: impl Into<String>) -> Fault {
    Fault::unsupported(reason, "give a PLY file of splats as 3DGS writes it")
}

fn scene_of(bytes: &[u8]) -> Result<Imported, Fault> {
    let header = parse_header(bytes)?;
    let [element, ..] = &header.elements[..] else {
        return Err(unsupported("it has no tables"));
    };
    if header.elements.iter().flat_map(|e| &e.properties).any(|p| p.name == "packed_position") {
        return Err(unsupported("it is a compressed PLY; splat-transform turns it into a plain one"));
    }
    if element.name != "vertex" || element.lists {
        return Err(unsupported(format!(
            "its first table is {:?}{} and not a plain one of vertices",
            element.name,
            if element.lists { " with lists" } else { "" }
        )));
    }
    let table = Table::read(element, header.encoding, &bytes[header.length..], known)?;
    let (columns, sh_degree) = Columns::of(&table).map_err(unsupported)?;
    let rows = (0..element.rows)
        .map(|i| columns.row(i))
        .collect::<Result<Vec<_>, _>>()
        .and_then(|rows| columns.check_colours(element.rows).map(|()| rows))
        .map_err(|(splat, property, value)| Fault::damaged(format!("{property} of splat {splat} is {value}")))?;
    let splats = collect(sh_degree, &rows, |i, out| columns.colour(i, out));
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
        losses: unknown(element.properties.iter().map(|p| p.name.as_str())),
    })
}

/// What the file has besides: such as the motion of formats that keep splats with time in PLY files.
fn unknown<'a>(names: impl Iterator<Item = &'a str>) -> Vec<Loss> {
    let plain = |name: &&str| !known(name) && !matches!(*name, "nx" | "ny" | "nz" | "alpha");
    let mut names: Vec<&str> = names.filter(plain).collect();
    if names.is_empty() {
        return Vec::new();
    }
    let more = names.len().saturating_sub(8);
    names.truncate(8);
    let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
    vec![Loss::Dropped(format!("properties that are not known here: {}{rest}", names.join(", ")))]
}

/// Where the parameters of splats are.
struct Columns<'a> {
    mean: [&'a [f32]; 3],
    opacity: &'a [f32],
    scale: [&'a [f32]; 3],
    quat: Option<[&'a [f32]; 4]>,
    colour: [&'a [f32]; 3],
    /// True where the colour is a value and no coefficient, and what it is divided by.
    value: Option<f32>,
    /// Channel major.
    rest: Vec<&'a [f32]>,
}

/// Splat, property and value.
type Bad = (usize, String, f32);

impl<'a> Columns<'a> {
    fn of(table: &'a Table<'a>) -> Result<(Self, usize), String> {
        let find = |names: &[&str]| table.column(names);
        let need = |names: &[&str]| {
            find(names).map(|(_, _, column)| column).ok_or_else(|| format!("it has no property {}", names[0]))
        };
        let numbered = |stems: [&str; 2], k: usize| {
            let names = stems.map(|stem| format!("{stem}_{k}"));
            find(&[&names[0], &names[1]]).map(|(_, _, column)| column)
        };
        let scale = |k| numbered(["scale", "scaling"], k);
        let first = scale(0).ok_or("it has no property scale_0")?;
        let scale = match (scale(1), scale(2)) {
            (Some(second), Some(third)) => [first, second, third],
            (None, None) => [first; 3],
            _ => return Err("it has two scales per splat: flat splats are not supported".to_owned()),
        };
        let turn: Option<Vec<&[f32]>> = (0..4).map(|k| numbered(["rot", "rotation"], k)).collect();
        let quat = turn.and_then(|columns| <[&[f32]; 4]>::try_from(columns).ok());
        if quat.is_none() && !scale.iter().all(|s| std::ptr::eq(*s, first)) {
            return Err("it has no property rot_0".to_owned());
        }
        let dc: Option<Vec<&[f32]>> = (0..3).map(|k| numbered(["f_dc", "f_dc"], k)).collect();
        let (colour, value) = match dc.and_then(|columns| <[&[f32]; 3]>::try_from(columns).ok()) {
            Some(columns) => (columns, None),
            None => {
                let (_, kind, red) = find(&["red"]).ok_or("it has no property f_dc_0 and no red")?;
                let divisor = if kind.is_float() { 1.0 } else { 255.0 };
                ([red, need(&["green"])?, need(&["blue"])?], Some(divisor))
            }
        };
        let rest: Vec<&[f32]> = (0..=45).map_while(|k| numbered(["f_rest", "f_rest"], k)).collect();
        let sh_degree = match rest.len() {
            0 => 0,
            9 => 1,
            24 => 2,
            45 => 3,
            n => {
                return Err(format!("it has {n} properties f_rest_, and harmonics come 9, 24 or 45 at a time"));
            }
        };
        let columns = Self {
            mean: [need(&["x"])?, need(&["y"])?, need(&["z"])?],
            opacity: need(&["opacity", "opacity_0"])?,
            scale,
            quat,
            colour,
            value,
            rest,
        };
        Ok((columns, sh_degree))
    }

    fn row(&self, i: usize) -> Result<(Row, Option<Life>), Bad> {
        let finite = |name: &str, value: f32| {
            if value.is_finite() { Ok(value) } else { Err((i, name.to_owned(), value)) }
        };
        let bounded = |name: &str, value: f32| {
            if value.is_nan() {
                Err((i, name.to_owned(), value))
            } else if value.is_infinite() {
                Ok(BEYOND.copysign(value))
            } else {
                Ok(value)
            }
        };
        let [x, y, z] = self.mean.map(|column| column[i]);
        let [a, b, c] = self.scale.map(|column| column[i]);
        let quat = match self.quat {
            None => [1.0, 0.0, 0.0, 0.0],
            Some(columns) => {
                let [w, x, y, z] = columns.map(|column| column[i]);
                unit([finite("rot_0", w)?, finite("rot_1", x)?, finite("rot_2", y)?, finite("rot_3", z)?])
            }
        };
        let row = Row {
            mean: [finite("x", x)?, finite("y", y)?, finite("z", z)?],
            log_scale: [bounded("scale_0", a)?, bounded("scale_1", b)?, bounded("scale_2", c)?],
            quat,
            opacity: bounded("opacity", self.opacity[i])?,
        };
        Ok((row, None))
    }

    fn check_colours(&self, rows: usize) -> Result<(), Bad> {
        let names = |k: usize| {
            if k < 3 { format!("f_dc_{k}") } else { format!("f_rest_{}", k - 3) }
        };
        for (k, column) in self.colour.iter().chain(&self.rest).enumerate() {
            if let Some(at) = column.iter().take(rows).position(|v| !v.is_finite()) {
                return Err((at, names(k), column[at]));
            }
        }
        Ok(())
    }

    fn colour(&self, i: usize, out: &mut [f32]) {
        for c in 0..3 {
            let value = self.colour[c][i];
            out[c] = match self.value {
                Some(divisor) => ((f64::from(value / divisor) - 0.5) / C0) as f32,
                None => value,
            };
        }
        let terms = self.rest.len() / 3;
        for (k, column) in self.rest.iter().enumerate() {
            out[3 * (k % terms + 1) + k / terms] = column[i];
        }
    }
}
