//! Valid files with extreme numbers: in each field of texts, arrays and tables. What is read of
//! them must be in the ranges of [`m4_io::range`], and a refusal must name the file.

use std::ops::Range;

/// What the numbers of a text become.
const TEXTS: [&str; 9] = [
    "1e39",
    "-1e39",
    "1e30",
    "-1e30",
    "1e-39",
    "0",
    "-1",
    "NaN",
    "9223372036854775807",
];
/// What those of an array or a table become.
const NUMBERS: [f64; 9] = [1e39, -1e39, 1e30, -1e30, 1e-39, 0.0, -1.0, f64::NAN, 9.2e18];
/// Fields of a file that are replaced: all of small files, of large ones each key once and others
/// evenly.
const FIELDS: usize = 48;

/// What extreme numbers are called, for [`is_number`].
const NAME: &str = "number";

/// Whether the input of that name is one of [`extremes`].
pub fn is_number(input: &str) -> bool {
    input.starts_with(NAME)
}

/// The file with each of its numbers extreme, one at a time; nothing for files of images and
/// compressed data.
pub fn extremes(valid: &[u8]) -> Vec<(String, Vec<u8>)> {
    let put = |place: &Range<usize>, with: &[u8], what: &str| {
        let bytes = [&valid[..place.start], with, &valid[place.end..]].concat();
        (format!("{NAME} {what} at {}", place.start), bytes)
    };
    if let Ok(text) = std::str::from_utf8(valid) {
        let places = of_text(text);
        return places
            .iter()
            .flat_map(|place| TEXTS.map(|number| put(place, number.as_bytes(), number)))
            .collect();
    }
    let Some((start, widths)) = table(valid) else {
        return Vec::new();
    };
    let mut all = Vec::new();
    for &width in widths {
        // fields of eight bytes may begin at each fourth
        let every = width.min(4);
        let places: Vec<usize> = (start..(valid.len() + 1).saturating_sub(width))
            .step_by(every)
            .collect();
        for at in places
            .iter()
            .copied()
            .step_by(places.len().div_ceil(FIELDS).max(1))
        {
            for number in NUMBERS {
                let bytes = if width == 4 {
                    (number as f32).to_le_bytes().to_vec()
                } else {
                    number.to_le_bytes().to_vec()
                };
                all.push(put(&(at..at + width), &bytes, &format!("{number:e}")));
            }
        }
    }
    all
}

/// Where the numbers of a binary file begin, and their widths.
fn table(file: &[u8]) -> Option<(usize, &'static [usize])> {
    let after = |end: &[u8]| Some(file.windows(end.len()).position(|w| w == end)? + end.len());
    if file.starts_with(b"\x93NUMPY") {
        let header = String::from_utf8_lossy(&file[..after(b"\n")?]).into_owned();
        let width = ["<f4", "<f8"]
            .iter()
            .position(|kind| header.contains(kind))?;
        return Some((after(b"\n")?, [&[4], &[8]][width]));
    }
    if file.starts_with(b"ply\n") {
        return Some((after(b"end_header\n")?, &[4]));
    }
    let other: [&[u8]; 5] = [
        b"\x89PNG",
        &[0xff, 0xd8],
        b"PK",
        &[0x76, 0x2f, 0x31, 0x01],
        b"4DGS",
    ];
    if other.iter().any(|start| file.starts_with(start)) || file.get(4..8) == Some(b"ftyp") {
        return None;
    }
    let head = usize::try_from(u64::from_le_bytes(*file.first_chunk()?)).ok()?;
    // a scene file, or a table of COLMAP
    if file.get(8) == Some(&b'{') {
        Some((8 + head, &[4, 8]))
    } else {
        Some((8, &[8]))
    }
}

/// Places of numbers in a text, none of those within words and names.
fn of_text(text: &str) -> Vec<Range<usize>> {
    let bytes = text.as_bytes();
    let (mut all, mut keys) = (Vec::new(), Vec::new());
    let (mut quoted, mut key, mut i) = (None, Vec::new(), 0);
    while i < bytes.len() {
        let begins = i == 0 || b" \t\n[,:=".contains(&bytes[i - 1]);
        match (quoted, bytes[i]) {
            (None, b'"') => quoted = Some(i + 1),
            (Some(from), b'"') => {
                key = bytes[from..i].to_vec();
                quoted = None;
            }
            (None, b'-' | b'0'..=b'9') if begins => {
                let length = bytes[i..]
                    .iter()
                    .position(|b| !(b.is_ascii_digit() || b"+-.eE".contains(b)));
                let end = length.map_or(bytes.len(), |n| i + n);
                let new = !keys.contains(&key);
                if new {
                    keys.push(key.clone());
                }
                all.push((i..end, new));
                i = end;
                continue;
            }
            _ => {}
        }
        i += 1;
    }
    let step = all.len().div_ceil(FIELDS).max(1);
    let selection = all
        .into_iter()
        .enumerate()
        .filter(|(i, (_, new))| *new || i.is_multiple_of(step));
    selection.map(|(_, (place, _))| place).collect()
}

#[cfg(test)]
mod tests {
    use super::extremes;

    #[test]
    fn every_number_of_a_text_is_replaced() {
        let all = extremes(br#"{"a 1": [2, -3.5], "b": 4e5}"#);
        let with = |text: &str| all.iter().any(|(_, bytes)| bytes == text.as_bytes());
        assert!(
            with(r#"{"a 1": [1e39, -3.5], "b": 4e5}"#) && with(r#"{"a 1": [2, NaN], "b": 4e5}"#)
        );
        assert!(with(r#"{"a 1": [2, -3.5], "b": 0}"#));
        assert_eq!(all.len(), 27);
    }
}
