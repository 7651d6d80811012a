//! Readers of files that accompany a clip: depth, masks and tracks.

use super::import::clip;
use super::{alone, among, within};
use crate::fixture::{fixture, fixture_bytes};
use crate::reader::{Outcome, Reader};
use crate::valid;
use crate::wrap::Wrap;
use m4_io::dataset::side::depth::{decode_exr, decode_pfm, read_depth};
use m4_io::dataset::side::mask::read_mask;
use m4_io::dataset::{ImportOptions, SourceFormat};
use std::path::{Path, PathBuf};

/// A valid clip with side files.
fn beside(change: impl FnOnce(&mut ImportOptions)) -> Outcome {
    let mut options = ImportOptions {
        depth_unit: Some(0.0005),
        ..ImportOptions::default()
    };
    change(&mut options);
    clip(&fixture("import/record3d/clip.r3d"), SourceFormat::Record3d, &options)
}

/// A file that `set` makes the depth, masks or tracks of the clip.
fn given(name: &'static str, source: &str, file: &str, set: fn(&mut ImportOptions, PathBuf)) -> Reader {
    among(name, &format!("import/side/{source}"), file, move |p| {
        beside(|o| set(o, p.to_path_buf()))
    })
}

fn tracks(options: &mut ImportOptions, path: PathBuf) {
    options.tracks = Some(path);
}

fn depth(options: &mut ImportOptions, path: PathBuf) {
    options.depth = Some(path);
}

fn masks(options: &mut ImportOptions, path: PathBuf) {
    options.masks = Some(path);
}

fn contents(files: &'static [&'static str]) -> impl Fn() -> Vec<Vec<u8>> + Send + Sync {
    move || {
        files
            .iter()
            .map(|f| fixture_bytes(&format!("import/side/{f}")))
            .collect()
    }
}

fn one_map(path: &Path) -> Outcome {
    Outcome::of(read_depth(path, 0.001), valid::depth)
}

pub fn rows() -> Vec<Reader> {
    let bytes = |p: &Path| std::fs::read(p).unwrap_or_default();
    let exrs = &["depth_exr/frame9.exr", "depth_exr/frame10.exr", "exr_other/parts.exr"];
    let pfms = &["depth_pfm/frame8.pfm", "depth_pfm/frame9.pfm"];
    let pngs = &["masks_palette/frame8.png", "masks_png/frame8.png"];
    let seen = |p: &Path| Outcome::of(read_mask(p, false), |_| None);
    let jpegs = || vec![fixture_bytes("import/nerfstudio/images/frame_1.jpg")];
    vec![
        alone("side-exr", "a.exr", contents(exrs), move |p| {
            Outcome::of(decode_exr(&bytes(p)), valid::map)
        }),
        alone("side-pfm", "a.pfm", contents(pfms), move |p| {
            Outcome::of(decode_pfm(&bytes(p)), valid::map)
        }),
        alone(
            "side-depth",
            "a",
            contents(&["depth_exr/frame9.exr", "depth_pfm/frame8.pfm", "depth_npy/frame8.npy"]),
            one_map,
        ),
        Reader {
            wrap: Wrap::Png,
            ..alone("side-depth-png", "a.png", contents(&["depth_png/frame8.png"]), one_map)
        },
        given("side-depth-stack", "depth.npz", "", depth),
        within(
            "side-depth-stack-array",
            "depths.npy",
            given("", "depth.npz", "", depth),
        ),
        given("side-depth-folder", "depth_npy", "frame9.npy", depth),
        Reader {
            wrap: Wrap::Png,
            ..alone("side-mask-png", "a.png", contents(pngs), seen)
        },
        alone("side-mask-jpeg", "a.jpg", jpegs, seen),
        given("side-mask-stack", "masks.npz", "", masks),
        within("side-mask-stack-array", "masks.npy", given("", "masks.npz", "", masks)),
        given("side-tracks-tapip3d", "tapip3d.npz", "", tracks),
        within("side-tracks-coords", "coords.npy", given("", "tapip3d.npz", "", tracks)),
        within(
            "side-tracks-cameras",
            "extrinsics.npy",
            given("", "tapip3d.npz", "", tracks),
        ),
        within("side-tracks-colours", "colors.npy", given("", "world.npz", "", tracks)),
        given("side-tracks-cotracker", "cotracker.npz", "", tracks),
        within(
            "side-tracks-pixels",
            "tracks.npy",
            given("", "cotracker.npz", "", tracks),
        ),
        given("side-tracks-spatracker", "spatracker.npz", "", tracks),
    ]
}
