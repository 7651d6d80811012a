//! Ways of doing harm to a file.

use m4_core::CounterRng;
use m4_testkit::harm;
use std::io::{Cursor, Read as _, Write};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

/// Copy `i` of a file, harmed once, or now and then twice; what was done. Of archives of arrays most often an array is harmed, and the
/// archive is sound.
pub fn damaged(whole: &[u8], is_npz: bool, i: u64) -> (Vec<u8>, String) {
    let mut rng = CounterRng::new(11, 0x5e_75, i);
    let mut bytes = whole.to_vec();
    if is_npz && rng.below(3) > 0 {
        let what = within(&mut bytes, &mut rng);
        return (bytes, what);
    }
    let mut what = harm(&mut bytes, &mut rng).to_owned();
    if rng.below(4) == 0 && !bytes.is_empty() {
        what = format!("{what} and {}", harm(&mut bytes, &mut rng));
    }
    (bytes, what)
}

/// Harm to an array of an archive, which is then sound itself.
fn within(bytes: &mut Vec<u8>, rng: &mut CounterRng) -> String {
    let mut archive = ZipArchive::new(Cursor::new(bytes.as_slice())).unwrap();
    let mut arrays: Vec<(String, Vec<u8>)> = Vec::new();
    for i in 0..archive.len() {
        let mut member = archive.by_index(i).unwrap();
        let name = member.name().unwrap().into_owned();
        // of arrays that are not read damage is not seen
        if !["query_points.npy", "conf.npy"].contains(&name.as_str()) {
            let mut array = Vec::new();
            member.read_to_end(&mut array).unwrap();
            arrays.push((name, array));
        }
    }
    let which = rng.below(arrays.len());
    let what = format!("{} within {}", harm(&mut arrays[which].1, rng), arrays[which].0);
    let mut to = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default()
        .compression_method([CompressionMethod::Stored, CompressionMethod::Deflated][rng.below(2)]);
    for (name, array) in arrays {
        to.start_file(name, options).unwrap();
        to.write_all(&array).unwrap();
    }
    *bytes = to.finish().unwrap().into_inner();
    what
}

/// What was made to do harm instead of a file of that name: nothing, lists without end, counts that no file can hold.
pub fn made(whole: &[u8], name: &str) -> Vec<(Vec<u8>, &'static str)> {
    let mut all = vec![
        (vec![], "nothing"),
        (vec![0; 64], "zeros"),
        (b"PK\x03\x04".to_vec(), "the start of an archive"),
        (vec![0xff; 4096], "ones"),
    ];
    if name.ends_with(".json") || name == "metadata" {
        all.push((vec![b'['; 1 << 20], "lists"));
        let deep = [b"{\"frames\":".repeat(100_000), b"}".repeat(100_000)].concat();
        all.push((deep, "objects"));
        let deep = [&b"{\"frames\": [{\"transform_matrix\": "[..], &b"[".repeat(50_000)].concat();
        all.push((deep, "lists in a frame"));
        all.push((b"{\"frames\": [{}]}".to_vec(), "an empty frame"));
        all.push((b"{\"frames\": []}".to_vec(), "no frames"));
    }
    if name.ends_with(".png") {
        // a header of 32,768 x 32,768 pixels with its checksum
        let mut huge = whole.to_vec();
        huge[16..24].copy_from_slice(&[0, 0, 0x80, 0, 0, 0, 0x80, 0]);
        let sum = crc(&huge[12..29]);
        huge[29..33].copy_from_slice(&sum.to_be_bytes());
        all.push((huge, "a huge header"));
    }
    if name.ends_with(".exr") {
        // a window of 30,001 x 30,001 pixels
        let at = whole.windows(10).position(|w| w == b"dataWindow").unwrap() + 11 + 6 + 4;
        let mut huge = whole.to_vec();
        huge[at + 8..at + 16].copy_from_slice(&[30_000i32.to_le_bytes(), 30_000i32.to_le_bytes()].concat());
        all.push((huge, "a huge window"));
    }
    if name.ends_with(".bin") {
        all.push(([&u64::MAX.to_le_bytes()[..], &whole[8..]].concat(), "a huge count"));
        all.push(([&(1u64 << 40).to_le_bytes()[..], &whole[8..]].concat(), "a large count"));
    }
    all
}

/// The checksum of a chunk of PNG.
fn crc(bytes: &[u8]) -> u32 {
    let step = |c: u32, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 };
    !bytes.iter().fold(!0, |c, b| (0..8).fold(c ^ u32::from(*b), step))
}
