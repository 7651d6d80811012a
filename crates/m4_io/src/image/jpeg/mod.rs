//! Checks that a JPEG file is whole (ITU-T T.81). JPEG has no checksums, and decoders fill what is
//! missing with grey. So the Huffman codes of every scan are followed without making pixels of
//! them: a scan must end with its last block, restart markers must come in their places, and an end
//! of image must follow. What comes behind that (previews, motion photos) does not matter.
//!
//! A byte that changes without moving the others cannot be noticed. Baseline, extended and
//! progressive files are followed; others are left to the decoder, which refuses them.

mod bits;
mod scan;

use bits::Codes;
use scan::{Frame, Scan};

/// Scans of a file at most, as many as the decoder takes: each goes through all blocks.
const MAX_SCANS: usize = 100;

/// What the segments of a file have said so far.
#[derive(Default)]
struct State {
    frame: Option<Frame>,
    /// Huffman tables, of DC and AC, by their numbers.
    codes: [[Option<Codes>; 4]; 2],
    /// MCUs between two restart markers; 0 for none.
    restart: usize,
}

/// Fails with the reason unless the file is whole.
pub(super) fn check(file: &[u8]) -> Result<(), String> {
    let mut state = State::default();
    let (mut at, mut scans) = (2, 0);
    loop {
        let marker = marker(file, &mut at)?;
        match marker {
            // end of image
            0xd9 => break,
            // without a segment
            0x01 | 0xd0..=0xd7 => continue,
            _ => {}
        }
        let segment = segment(file, &mut at)?;
        match marker {
            0xc0..=0xc2 => state.frame = Some(Frame::read(segment, marker == 0xc2)?),
            // lossless, hierarchical and arithmetic
            0xc3 | 0xc5..=0xc7 | 0xc9..=0xcb | 0xcd..=0xcf => return Ok(()),
            0xc4 => tables(segment, &mut state.codes)?,
            0xdd => {
                state.restart = segment
                    .first_chunk()
                    .map_or(0, |n| usize::from(u16::from_be_bytes(*n)))
            }
            0xda => {
                scans += 1;
                if scans > MAX_SCANS {
                    return Err(format!("it has more than {MAX_SCANS} scans"));
                }
                let frame = state
                    .frame
                    .as_mut()
                    .ok_or("a scan comes before the size of the image")?;
                let scan = Scan::read(segment, frame, &state.codes, state.restart)?;
                at += scan.follow(frame, &file[at..])?;
            }
            _ => {}
        }
    }
    match state.frame {
        Some(frame) if frame.has_all() => Ok(()),
        _ => Err("it ends before its image".to_owned()),
    }
}

/// Whether the decoder holds all coefficients of an image: of one that is progressive, or whose
/// components come in scans of their own.
pub(super) fn keeps_coefficients(file: &[u8]) -> bool {
    let (mut at, mut components) = (2, 0);
    while let Ok(marker) = marker(file, &mut at) {
        if matches!(marker, 0x01 | 0xd0..=0xd7) {
            continue;
        }
        let Ok(segment) = segment(file, &mut at) else {
            break;
        };
        match marker {
            0xc2 => return true,
            0xc0 | 0xc1 => components = segment.get(5).copied().unwrap_or(0),
            0xda => return segment.first() != Some(&components),
            _ => {}
        }
    }
    true
}

/// The next marker; any number of bytes of ones may stand before it.
fn marker(file: &[u8], at: &mut usize) -> Result<u8, String> {
    let start = *at;
    while file.get(*at) == Some(&0xff) {
        *at += 1;
    }
    let code = *file.get(*at).ok_or("it ends before its end of image")?;
    if *at == start || code == 0 {
        return Err(format!("there is no marker at byte {at}"));
    }
    *at += 1;
    Ok(code)
}

/// The contents of the segment of a marker.
fn segment<'a>(file: &'a [u8], at: &mut usize) -> Result<&'a [u8], String> {
    let rest = file.get(*at..).unwrap_or_default();
    let length = rest
        .first_chunk()
        .map_or(0, |n| usize::from(u16::from_be_bytes(*n)));
    let segment = rest
        .get(2..length)
        .ok_or_else(|| format!("it ends within its segment at byte {at}"))?;
    *at += length;
    Ok(segment)
}

/// Reads Huffman tables (B.2.4.2).
fn tables(mut segment: &[u8], codes: &mut [[Option<Codes>; 4]; 2]) -> Result<(), String> {
    while let Some((&[class, ref counts @ ..], rest)) = segment.split_first_chunk::<17>() {
        let n: usize = counts.iter().map(|&n| usize::from(n)).sum();
        let table = codes
            .get_mut(usize::from(class >> 4))
            .and_then(|of| of.get_mut(usize::from(class & 15)));
        let (Some(table), Some((symbols, next))) = (table, rest.split_at_checked(n)) else {
            return Err("a Huffman table is damaged".to_owned());
        };
        *table = Some(Codes::new(counts, symbols)?);
        segment = next;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::check;
    use m4_testkit::repository;

    fn file(name: &str) -> Vec<u8> {
        std::fs::read(repository().join("fixtures").join(name)).unwrap()
    }

    /// Baseline, baseline with restart markers, progressive, progressive with restart markers.
    const FILES: [&str; 4] = [
        "floor/test/b_00000.jpg",
        "jpeg/restarts.jpg",
        "jpeg/progressive.jpg",
        "jpeg/progressive_restarts.jpg",
    ];

    #[test]
    fn whole_files_pass_with_anything_behind_their_end() {
        for name in FILES.into_iter().chain(["jpeg/grey.jpg"]) {
            let mut file = file(name);
            assert_eq!(check(&file), Ok(()), "{name}");
            file.extend(b"a preview or a video");
            assert_eq!(check(&file), Ok(()), "{name}");
        }
    }

    #[test]
    fn every_truncation_is_detected_with_and_without_an_end_of_image() {
        for name in FILES {
            let file = file(name);
            for cut in (2..file.len() - 2)
                .step_by(37)
                .chain(file.len() - 9..file.len() - 2)
            {
                let mut short = file[..cut].to_vec();
                assert!(check(&short).is_err(), "{name}: {cut}");
                short.extend([0xff, 0xd9]);
                // a progressive image may end with any of its scans
                assert!(
                    check(&short).is_err() || name.contains("progressive"),
                    "{name}: {cut} and an end"
                );
            }
            assert!(check(&file[..file.len() - 1]).is_err());
        }
    }

    /// A hole is noticed unless as many blocks can be made of it as were there: by chance, of small
    /// ones.
    #[test]
    fn holes_are_detected() {
        for name in FILES {
            let file = file(name);
            // behind the segment of its first scan
            let start = file.windows(2).position(|w| w == [0xff, 0xda]).unwrap() + 14;
            for (size, chance) in [(512, 16), (1024, usize::MAX), (2048, usize::MAX)] {
                let (mut all, mut missed) = (0, Vec::new());
                for at in (start..file.len() - 2 - size).step_by(size / 2) {
                    let holes = [0, 0xff, 0x55].map(|fill| {
                        let mut broken = file.clone();
                        broken[at..at + size].fill(fill);
                        broken
                    });
                    for broken in holes
                        .into_iter()
                        .chain([[&file[..at], &file[at + size..]].concat()])
                    {
                        all += 1;
                        missed.extend(check(&broken).is_ok().then_some(at));
                    }
                }
                assert!(
                    missed.len() <= all / chance,
                    "{name}: {size} bytes at {missed:?} of {all}"
                );
            }
        }
    }
}
