//! Readers of scene files of other tools, and of points of COLMAP.

use super::{alone, made};
use crate::reader::{Outcome, Reader};
use crate::valid;
use m4_core::Silent;
use m4_io::dataset::colmap;
use m4_io::scene::{fourdgs, ply};
use std::path::Path;

pub fn rows() -> Vec<Reader> {
    let points = || {
        let dir = tempfile::tempdir().unwrap_or_else(|e| panic!("no temporary folder: {e}"));
        let folder = dir.path().join("c");
        let written = colmap::write(&folder, &made::clip(), &Silent);
        written.unwrap_or_else(|e| panic!("a valid model: {e}"));
        let bytes = std::fs::read(folder.join("sparse/0/points3D.bin"));
        vec![bytes.unwrap_or_else(|e| panic!("a valid model: {e}"))]
    };
    let mut all = splats();
    all.push(alone("formats-colmap-points", "points3D.bin", points, |p| {
        let folder = p.parent().unwrap_or(p);
        Outcome::of(colmap::read_points(folder), |_| None)
    }));
    all
}

/// The scenes that are written: without and with harmonics.
const DEGREES: [usize; 2] = [0, 2];

fn splats() -> Vec<Reader> {
    let clips = || {
        let one = |degree| {
            let encoded = fourdgs::encode(
                Path::new("a.4dgs"),
                &made::scene(degree),
                &fourdgs::FourdgsConfig::default(),
            );
            encoded.unwrap_or_else(|e| panic!("a valid clip: {e}")).0
        };
        DEGREES.map(one).to_vec()
    };
    let instants = || {
        let one = |degree| made::written("a.ply", |p| ply::write(p, &made::scene(degree), 1.0));
        let mut all = DEGREES.map(one).to_vec();
        all.push(text_of(&all[0]));
        all
    };
    vec![
        alone("formats-4dgs", "a.4dgs", clips, |p| {
            Outcome::of(fourdgs::read(p), |found| valid::scene(&found.scene))
        }),
        alone("formats-ply", "a.ply", instants, |p| {
            Outcome::of(ply::read(p), |found| valid::scene(&found.scene))
        }),
    ]
}

/// A binary PLY file of 32-bit numbers as text.
fn text_of(binary: &[u8]) -> Vec<u8> {
    let end = b"end_header\n";
    let at = binary.windows(end.len()).position(|w| w == end);
    let at = at.unwrap_or_else(|| panic!("our PLY file has a header")) + end.len();
    let header = String::from_utf8_lossy(&binary[..at]);
    let mut text = header.replace("binary_little_endian", "ascii");
    for word in binary[at..].as_chunks::<4>().0 {
        text.push_str(&format!("{} ", f32::from_le_bytes(*word)));
    }
    text.into_bytes()
}
