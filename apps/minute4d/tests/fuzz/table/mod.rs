//! All readers, and valid files written by our own writers.
//!
//! ```text
//! io        images, arrays, tracks, camera paths, captures, scene files, splats and cameras of other tools, video
//! import    clips of other tools: one row for each file that is parsed; depth, masks and tracks that are given with a clip
//! program   settings, records, manifests of batches and records of their jobs
//! ```

mod import;
mod io;
mod program;

use crate::files::{Wrap, fixture_bytes, members};
use crate::reader::{Around, Outcome, Reader};
use m4_core::{
    Camera, Capture, CaptureFrame, CompactDepth, CompactIds, CompactMask, Intrinsics, Plane, Scene,
    Se3, Silent, SplatLayout, Tracks,
};
use m4_io::capture::{self, Split};
use m4_testkit::{SceneSpec, random_scene};
use std::path::Path;
use std::{fmt, fs};

/// Every reader, in the order of the crates; names are unique.
pub fn readers() -> Vec<Reader> {
    [io::rows(), import::rows(), program::rows()]
        .into_iter()
        .flatten()
        .collect()
}

/// The families of readers: what their names begin with, in the order of the alphabet.
pub fn families() -> Vec<&'static str> {
    let mut all: Vec<_> = readers().iter().map(Reader::family).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// A reader of one file that is called `file`.
pub fn alone(
    name: &'static str,
    file: &str,
    seeds: impl Fn() -> Vec<Vec<u8>> + Send + Sync + 'static,
    call: impl Fn(&Path) -> Outcome + Send + Sync + 'static,
) -> Reader {
    Reader {
        name,
        file: file.to_owned(),
        given: file.to_owned(),
        around: Around::Nothing,
        wrap: Wrap::Plain,
        seeds: Box::new(move |_| seeds()),
        call: Box::new(call),
    }
}

/// A reader of a copy of `fixtures/SOURCE`, in which the bytes take the place of `file` (empty: of
/// the source itself).
fn among(
    name: &'static str,
    source: &str,
    file: &str,
    call: impl Fn(&Path) -> Outcome + Send + Sync + 'static,
) -> Reader {
    let base = source.rsplit('/').next().unwrap_or(source);
    let of = |from: &str| {
        if file.is_empty() {
            from.to_owned()
        } else {
            format!("{from}/{file}")
        }
    };
    let seed = of(source);
    Reader {
        name,
        file: of(base),
        given: base.to_owned(),
        around: Around::Fixtures(vec![(source.to_owned(), base.to_owned())]),
        wrap: Wrap::Plain,
        seeds: Box::new(move |_| vec![fixture_bytes(&seed)]),
        call: Box::new(call),
    }
}

/// The same where the bytes are one member of the archive.
fn within(name: &'static str, member: &'static str, of: Reader) -> Reader {
    let archive = match &of.around {
        Around::Fixtures(all) => {
            let (from, to) = &all[0];
            if of.file == *to {
                from.clone()
            } else {
                format!("{from}{}", &of.file[to.len()..])
            }
        }
        _ => panic!("{name} is within no fixture"),
    };
    let wrap = Wrap::member(&archive, member);
    Reader {
        name,
        wrap,
        seeds: Box::new(move |_| {
            let all = members(&archive);
            all.into_iter()
                .filter(|(n, _)| n == member)
                .map(|(_, bytes)| bytes)
                .collect()
        }),
        ..of
    }
}

/// What `write` writes into a temporary folder under that name.
pub fn written<T, E: fmt::Display>(
    name: &str,
    write: impl FnOnce(&Path) -> Result<T, E>,
) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("no temporary folder: {e}"));
    let path = folder.path().join(name);
    if let Err(e) = write(&path) {
        panic!("cannot write the valid {name}: {e}");
    }
    fs::read(&path).unwrap_or_else(|e| panic!("cannot read the valid {name}: {e}"))
}

/// Few splats, of harmonics of that degree.
pub fn scene(sh_degree: usize) -> Scene {
    random_scene(&SceneSpec {
        layout: SplatLayout {
            isotropic: false,
            sh_degree,
            time_degree: 0,
        },
        n_static: 3,
        n_dynamic: 4,
        time_frames: 5,
        ..SceneSpec::default()
    })
}

/// The same with bound splats.
pub fn bound_scene() -> Scene {
    m4_testkit::bound_scene(&SceneSpec {
        n_static: 2,
        n_dynamic: 6,
        time_frames: 5,
        ..SceneSpec::default()
    })
}

/// Two posed frames of 12 x 8 pixels with all that a capture can have.
pub fn clip() -> Capture {
    let frame = |i: usize| CaptureFrame {
        name: format!("{i}.png"),
        camera: Camera {
            intrinsics: Intrinsics::centred(12, 8, 14.0),
            c2w: Se3::identity(),
        },
        t: i as f64,
        rgb: Plane::from_fn(12, 8, |x, y| [x as u8 * 9, y as u8 * 7, i as u8]),
        depth: Some(CompactDepth::from(Plane::from_fn(12, 8, |x, y| {
            1.0 + (x + y) as f32 * 0.1
        }))),
        mask: Some(CompactMask::from_fn(12, 8, |x, y| x > y)),
        motion: Some(Plane::from_fn(12, 8, |x, _| x as u8 * 20)),
        instances: Some(CompactIds::from(&Plane::from_fn(12, 8, |x, _| {
            u16::from(x > 5)
        }))),
        camera_index: None,
        distance_sigma: None,
    };
    let xyz = (0..6).map(|i| [i as f32 * 0.2, 0.1, 2.0]).collect();
    let tracks =
        Tracks::new(2, 3, xyz, vec![true; 6]).and_then(|t| t.with_colours(vec![[9, 8, 7]; 3]));
    Capture {
        frames: (0..2).map(frame).collect(),
        time_frames: 2,
        duration_s: Some(0.5),
        metric: true,
        tracks: Some(tracks.unwrap_or_else(|e| panic!("tracks: {e}"))),
    }
}

pub fn tracks() -> Tracks {
    clip()
        .tracks
        .unwrap_or_else(|| panic!("the clip has tracks"))
}

/// Writes [`clip`] as a capture: the training split, and the same as held-out views.
pub fn capture_into(folder: &Path) {
    let test = Capture {
        tracks: None,
        ..clip()
    };
    for (capture, split) in [(clip(), Split::Train), (test, Split::Test)] {
        capture::write(folder, &capture, split, &Silent)
            .unwrap_or_else(|e| panic!("a capture: {e}"));
    }
}

/// A small image as a PNG file (of `name.png`) or a JPEG file.
pub fn image(name: &str) -> Vec<u8> {
    let image = Plane::from_fn(24, 18, |x, y| [x as u8 * 9, y as u8 * 11, (x * y) as u8]);
    written(name, |path| m4_io::image::write_rgb(path, &image))
}
