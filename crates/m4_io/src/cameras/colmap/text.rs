//! The three tables as text.

use super::binary::Fault;
use super::model::{ColmapCamera, ColmapPoint, ColmapPose};
use std::io::{self, Write};
use std::str::{FromStr, SplitAsciiWhitespace};

pub fn write_cameras(out: &mut impl Write, rows: &[ColmapCamera]) -> io::Result<()> {
    writeln!(out, "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]")?;
    for row in rows {
        write!(out, "{} {} {} {}", row.id, row.model, row.width, row.height)?;
        row.parameters.iter().try_for_each(|v| write!(out, " {v}"))?;
        writeln!(out)?;
    }
    Ok(())
}

pub fn write_images(out: &mut impl Write, rows: &[ColmapPose]) -> io::Result<()> {
    writeln!(out, "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME")?;
    writeln!(out, "# POINTS2D[] as (X, Y, POINT3D_ID)")?;
    for row in rows {
        write!(out, "{}", row.id)?;
        for v in row.rotation.iter().chain(&row.translation) {
            write!(out, " {v}")?;
        }
        writeln!(out, " {} {}\n", row.camera, row.name)?;
    }
    Ok(())
}

pub fn write_points(out: &mut impl Write, rows: &[ColmapPoint]) -> io::Result<()> {
    writeln!(
        out,
        "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"
    )?;
    for (i, row) in rows.iter().enumerate() {
        let ([x, y, z], [r, g, b]) = (row.position, row.colour);
        writeln!(out, "{} {x} {y} {z} {r} {g} {b} -1", i + 1)?;
    }
    Ok(())
}

pub fn read_cameras(text: &str) -> Result<Vec<ColmapCamera>, Fault> {
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

pub fn read_images(text: &str) -> Result<Vec<ColmapPose>, Fault> {
    let mut rows = Vec::new();
    let mut lines = lines(text);
    while let Some((number, line)) = lines.next() {
        if line.trim().is_empty() {
            continue;
        }
        let mut words = Words::new(number, line);
        let id = words.next("IMAGE_ID")?;
        let mut pose = [0.0; 7];
        for (v, name) in pose.iter_mut().zip(["QW", "QX", "QY", "QZ", "TX", "TY", "TZ"]) {
            *v = words.next(name)?;
        }
        let [w, x, y, z, a, b, c] = pose;
        rows.push(ColmapPose {
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

pub fn read_points(text: &str) -> Result<Vec<ColmapPoint>, Fault> {
    let mut rows = Vec::new();
    for (number, line) in lines(text).filter(|(_, l)| !l.trim().is_empty()) {
        let mut words = Words::new(number, line);
        words.next::<u64>("POINT3D_ID")?;
        let position = [words.next("X")?, words.next("Y")?, words.next("Z")?];
        let colour = [words.next("R")?, words.next("G")?, words.next("B")?];
        words.next::<f64>("ERROR")?;
        rows.push(ColmapPoint { position, colour });
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

    fn damaged(&self, reason: String) -> Fault {
        Fault::Damaged {
            place: format!("line {}", self.line),
            reason,
        }
    }

    fn next<T: FromStr>(&mut self, what: &str) -> Result<T, Fault> {
        let word = self.words.next();
        let word = word.ok_or_else(|| self.damaged(format!("{what} is missing")))?;
        word.parse().map_err(|_| self.damaged(format!("{what} is {word:?}")))
    }

    fn rest<T: FromStr>(&mut self, what: &str) -> Result<Vec<T>, Fault> {
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
