//! Readers of scene files and camera files of other tools.

use super::{alone, made};
use crate::dress::Dress;
use crate::reader::{Around, Outcome, Reader};
use crate::sound;
use m4_io::cameras::colmap::{self, ColmapEncoding, ColmapOptions};
use m4_io::cameras::nerfstudio::{self, NerfstudioOptions};
use m4_io::scene::{fourdgs, ply};
use std::path::Path;

pub fn rows() -> Vec<Reader> {
    [splats(), cameras()].into_iter().flatten().collect()
}

/// The scenes that are written: without and with harmonics.
const DEGREES: [usize; 2] = [0, 2];

fn splats() -> Vec<Reader> {
    let clips = || {
        let one = |degree| {
            let encoded = fourdgs::encode(&made::scene(degree), &fourdgs::FourdgsConfig::default());
            encoded.unwrap_or_else(|e| panic!("a sound clip: {e}")).0
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
            Outcome::of(fourdgs::read(p), |found| sound::scene(&found.scene))
        }),
        alone("formats-ply", "a.ply", instants, |p| {
            Outcome::of(ply::read(p), |found| sound::scene(&found.scene))
        }),
    ]
}

/// A binary PLY file of 32-bit numbers as text.
fn text_of(binary: &[u8]) -> Vec<u8> {
    let end = b"end_header\n";
    let at = binary.windows(end.len()).position(|w| w == end);
    let at = at.unwrap_or_else(|| panic!("our PLY file has a head")) + end.len();
    let head = String::from_utf8_lossy(&binary[..at]);
    let mut text = head.replace("binary_little_endian", "ascii");
    for word in binary[at..].as_chunks::<4>().0 {
        text.push_str(&format!("{} ", f32::from_le_bytes(*word)));
    }
    text.into_bytes()
}

fn model(folder: &Path, encoding: ColmapEncoding) {
    let options = ColmapOptions {
        encoding,
        t: 1.0,
        least_opacity: 0.0,
        ..ColmapOptions::default()
    };
    let written = colmap::write(folder, &made::scene(0), &options);
    written.unwrap_or_else(|e| panic!("a sound model: {e}"));
}

/// A row for one file of a model.
fn of_model(name: &'static str, file: &'static str) -> Reader {
    let around: fn(&Path) = if file.ends_with(".bin") {
        |folder| model(folder, ColmapEncoding::Binary)
    } else {
        |folder| model(folder, ColmapEncoding::Text)
    };
    Reader {
        name,
        file: file.to_owned(),
        given: String::new(),
        around: Around::Made(around),
        dress: Dress::Plain,
        seeds: Box::new(|file| vec![std::fs::read(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()))]),
        call: Box::new(|folder| {
            let tables = colmap::read_tables(folder);
            if let Err(e) = &tables {
                let said = Outcome::Refused(e.to_string());
                // the whole model reads the points too
                return match colmap::read(folder) {
                    Ok(_) => Outcome::Unsound("read as a model, but not as tables".into()),
                    Err(_) => said,
                };
            }
            Outcome::of(colmap::read(folder), |model| {
                let of_images = model.images.iter().find_map(|i| sound::camera(&i.camera));
                let finite = model.points.iter().all(|p| p.position.iter().all(|v| v.is_finite()));
                of_images.or_else(|| (!finite).then(|| "a point".into()))
            })
        }),
    }
}

fn cameras() -> Vec<Reader> {
    let list = || {
        vec![made::written("t.json", |p| {
            nerfstudio::write(p, &made::scene(0), &NerfstudioOptions::default())
        })]
    };
    vec![
        of_model("formats-colmap-cameras-bin", "cameras.bin"),
        of_model("formats-colmap-images-bin", "images.bin"),
        of_model("formats-colmap-points-bin", "points3D.bin"),
        of_model("formats-colmap-cameras-txt", "cameras.txt"),
        of_model("formats-colmap-images-txt", "images.txt"),
        of_model("formats-colmap-points-txt", "points3D.txt"),
        alone("formats-nerfstudio", "transforms.json", list, |p| {
            Outcome::of(m4_io::trajectory::load(p, 5), sound::trajectory)
        }),
    ]
}
