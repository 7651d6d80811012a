//! Parses `cameras.txt` and `images.txt`.

use super::tables::{ColmapCamera, ColmapImage, PlacedError, damaged};
use std::str::{FromStr, SplitAsciiWhitespace};

pub fn read_cameras(text: &str) -> Result<Vec<ColmapCamera>, PlacedError> {
    let mut rows = Vec::new();
    for (number, line) in lines(text).filter(|(_, l)| !l.trim().is_empty()) {
        let mut words = Words::new(number, line);
        let id = words.next("CAMERA_ID")?;
        let model: String = words.next("MODEL")?;
        let (width, height) = (words.next("WIDTH")?, words.next("HEIGHT")?);
        rows.push(ColmapCamera { id, model, width, height, parameters: words.rest("PARAMS")? });
    }
    Ok(rows)
}

pub fn read_images(text: &str) -> Result<Vec<ColmapImage>, PlacedError> {
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
        Self { line, words: text.split_ascii_whitespace() }
    }

    fn damaged(&self, reason: String) -> PlacedError {
        damaged(format!("line {}", self.line), reason)
    }

    fn next<T: FromStr>(&mut self, what: &str) -> Result<T, PlacedError> {
        let word = self.words.next();
        let word = word.ok_or_else(|| self.damaged(format!("{what} is missing")))?;
        word.parse().map_err(|_| self.damaged(format!("{what} is {word:?}")))
    }

    fn rest<T: FromStr>(&mut self, what: &str) -> Result<Vec<T>, PlacedError> {
        let mut all = Vec::new();
        while let Some(word) = self.words.next() {
            all.push(word.parse().map_err(|_| self.damaged(format!("{what} holds {word:?}")))?);
        }
        Ok(all)
    }
}
