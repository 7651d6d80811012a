//! Readers of `m4_io`, but for those of clips of other tools.

use super::{alone, among, within};
use crate::files::{Wrap, fixture_bytes, members};
use crate::reader::{self, Around, Outcome, Reader};
use m4_core::{Plane, Silent};
use m4_io::capture::{self, CaptureOptions, Split};
use m4_io::npy::{Array, Npz};
use m4_io::scene::safetensors;
use m4_io::scene::{fourdgs, ply};
use m4_io::trajectory;
use m4_io::video::{self, Mp4Writer, VideoOptions};
use m4_io::{Fault, image, tracks};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Bytes that an array may take.
const MAX_ARRAY_BYTES: u64 = 64 << 20;

pub fn rows() -> Vec<Reader> {
    [
        images(),
        arrays(),
        paths(),
        captures(),
        scenes(),
        videos(),
        splats(),
    ]
    .into_iter()
    .flatten()
    .collect()
}

fn png(reader: Reader) -> Reader {
    Reader {
        wrap: Wrap::Png,
        ..reader
    }
}

fn images() -> Vec<Reader> {
    let jpegs = || {
        vec![
            super::image("a.jpg"),
            fixture_bytes("import/nerfstudio/images/frame_1.jpg"),
            with_exif(&fixture_bytes(
                "import/davis/JPEGImages/480p/ball/00001.jpg",
            )),
        ]
    };
    let pngs = || {
        vec![
            super::image("a.png"),
            fixture_bytes("import/side/masks_palette/frame8.png"),
        ]
    };
    let depths = || vec![fixture_bytes("import/side/depth_png/frame8.png")];
    let greys = || {
        vec![
            fixture_bytes("import/nvidia/motion_masks/001.png"),
            fixture_bytes("import/side/depth_png/frame8.png"),
        ]
    };
    let read_rgb = |p: &Path| Outcome::of(image::read_rgb(p), |_| None);
    let photo = |p: &Path| {
        Outcome::of(image::read_photo(p), |photo| {
            let odd = photo.focal_px.is_some_and(|f| !f.is_finite());
            odd.then(|| "the focal length".into())
        })
    };
    let bytes = |p: &Path| {
        let bytes = std::fs::read(p).unwrap_or_default();
        Outcome::of(image::decode_rgb(&bytes, p, 1 << 20), |_| None)
    };
    let depth = |p: &Path| Outcome::of(image::read_depth(p, 0.001), reader::depth);
    let ids = |p: &Path| Outcome::of(image::read_ids(p), |_| None);
    let ids_of_bytes = |p: &Path| {
        let bytes = std::fs::read(p).unwrap_or_default();
        Outcome::of(image::ids_of_bytes(p, &bytes), |_| None)
    };
    vec![
        alone("io-jpeg", "a.jpg", jpegs, read_rgb),
        png(alone("io-png", "a.png", pngs, read_rgb)),
        alone("io-jpeg-photo", "a.jpg", jpegs, photo),
        png(alone("io-png-photo", "a.png", pngs, photo)),
        alone("io-jpeg-bytes", "a.jpg", jpegs, bytes),
        png(alone("io-png-bytes", "a.png", pngs, bytes)),
        png(alone("io-png-depth", "a.png", depths, depth)),
        png(alone("io-png-ids", "a.png", greys, ids)),
        png(alone("io-png-ids-bytes", "a.png", greys, ids_of_bytes)),
        png(alone("io-png-mask", "a.png", greys, |p| {
            Outcome::of(image::read_mask(p), |_| None)
        })),
        alone("io-jpeg-grey", "a.jpg", jpegs, |p| {
            Outcome::of(image::read_grey(p), |_| None)
        }),
    ]
}

/// A JPEG file with an EXIF block: orientation 6, focal length 26 mm of 35 mm film.
fn with_exif(jpeg: &[u8]) -> Vec<u8> {
    let mut tiff = b"II*\0\x08\0\0\0\x02\0".to_vec();
    tiff.extend([0x12, 0x01, 3, 0, 1, 0, 0, 0, 6, 0, 0, 0]);
    tiff.extend([0x69, 0x87, 4, 0, 1, 0, 0, 0, 38, 0, 0, 0]);
    tiff.extend([0, 0, 0, 0]);
    tiff.extend([1, 0, 0x05, 0xa4, 3, 0, 1, 0, 0, 0, 26, 0, 0, 0, 0, 0, 0, 0]);
    let mut out = jpeg[..2].to_vec();
    out.extend([0xff, 0xe1]);
    out.extend(((tiff.len() + 8) as u16).to_be_bytes());
    out.extend(b"Exif\0\0");
    out.extend(tiff);
    out.extend(&jpeg[2..]);
    out
}

fn arrays() -> Vec<Reader> {
    let npys = || {
        let mut all: Vec<Vec<u8>> = members("megasam/outputs/dog_droid.npz")
            .into_iter()
            .filter(|(name, _)| name != "images.npy")
            .map(|(_, bytes)| bytes)
            .collect();
        all.push(fixture_bytes("import/side/depth_npy/frame9.npy"));
        all
    };
    let numbers = |p: &Path| Outcome::of(npy(p, false), |_| None);
    let bytes = |p: &Path| Outcome::of(npy(p, true), |_| None);
    vec![
        alone("io-npy", "a.npy", npys, numbers),
        alone(
            "io-npy-bytes",
            "a.npy",
            || vec![members("tracks/numpy.npz")[1].1.clone()],
            bytes,
        ),
        among("io-npz", "tracks/numpy.npz", "", |p| {
            Outcome::of(npz(p), |_| None)
        }),
        alone(
            "io-tracks",
            "tracks.npz",
            || {
                vec![super::written("t.npz", |p| {
                    tracks::write(p, &super::tracks())
                })]
            },
            |p| Outcome::of(tracks::read(p, 2, MAX_ARRAY_BYTES), reader::tracks),
        ),
        within(
            "io-tracks-coords",
            "coords.npy",
            among("", "tracks/numpy.npz", "", numpy_tracks),
        ),
        within(
            "io-tracks-visibs",
            "visibs.npy",
            among("", "tracks/numpy.npz", "", numpy_tracks),
        ),
    ]
}

fn numpy_tracks(path: &Path) -> Outcome {
    Outcome::of(tracks::read(path, 3, MAX_ARRAY_BYTES), reader::tracks)
}

fn npy(path: &Path, whole: bool) -> Result<(), Fault> {
    let bytes = std::fs::read(path)?;
    let mut array = Array::open(
        "the array",
        bytes.as_slice(),
        bytes.len() as u64,
        MAX_ARRAY_BYTES,
    )?;
    drain(&mut array, whole)
}

fn npz(path: &Path) -> Result<(), Fault> {
    let mut npz = Npz::open(path)?;
    for name in ["coords", "visibs", "intrinsics"] {
        if let Some(mut array) = npz.array(name, MAX_ARRAY_BYTES)? {
            drain(&mut array, false)?;
        } else {
            return Err(Fault::missing(name, format!("there are: {}", npz.names())));
        }
    }
    Ok(())
}

fn drain(array: &mut Array<'_>, whole: bool) -> Result<(), Fault> {
    let n = array.shape.iter().product();
    if whole {
        array.next_bytes(n)?;
    } else {
        array.next_f64(n)?;
    }
    array.end()
}

fn paths() -> Vec<Reader> {
    let seeds = || {
        let texts: [&str; 2] = [
            r#"{"fl_x": 30, "w": 20, "h": 10, "axes": "opencv", "frames": [
              {"transform_matrix": [[1,0,0,3],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "time": 1.0}]}"#,
            r#"{"format": "minute4d-path", "version": 1, "width": 40, "height": 30, "fps": 24, "back_s": 2, "keyframes": [
              {"time_s": 0, "c2w": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "fov_y_deg": 45, "scene_s": 1.5},
              {"time_s": 2, "position": [1, 2, 3], "look_at": [0, 0, 0], "up": [0, -1, 0], "scene_frame": 4, "speed": 0}]}"#,
        ];
        texts.map(|t| t.as_bytes().to_vec()).to_vec()
    };
    vec![alone("io-camera-path", "path.json", seeds, |p| {
        Outcome::of(trajectory::load(p, 11), reader::trajectory)
    })]
}

/// A row for one file of a capture of ours.
fn of_capture(name: &'static str, file: &str, split: Split) -> Reader {
    Reader {
        name,
        file: file.to_owned(),
        given: String::new(),
        around: Around::Made(super::capture_into),
        wrap: if file.ends_with(".png") {
            Wrap::Png
        } else {
            Wrap::Plain
        },
        seeds: Box::new(|file| {
            vec![std::fs::read(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()))]
        }),
        call: Box::new(move |folder| {
            let read = capture::read(folder, split, &CaptureOptions::default(), &Silent);
            Outcome::of(read, reader::capture)
        }),
    }
}

fn captures() -> Vec<Reader> {
    vec![
        of_capture("io-capture", "transforms_train.json", Split::Train),
        of_capture("io-capture-test", "transforms_test.json", Split::Test),
        of_capture("io-capture-tracks", "tracks.npz", Split::Train),
    ]
}

fn scenes() -> Vec<Reader> {
    let seeds = || {
        let write = |scene| {
            let pairs = BTreeMap::from([("a".to_owned(), "b".to_owned())]);
            super::written("s", |p| safetensors::write(p, &scene, None, &pairs))
        };
        vec![
            write(super::scene(0)),
            write(super::scene(2)),
            write(super::bound_scene()),
        ]
    };
    vec![alone(
        "io-scene-file",
        "scene.safetensors",
        seeds,
        sealed_scene,
    )]
}

/// Reads a scene file; where only its checksum is wrong, once more with the right one.
fn sealed_scene(path: &Path) -> Outcome {
    let read = safetensors::read(path);
    let message = read
        .as_ref()
        .err()
        .map(ToString::to_string)
        .unwrap_or_default();
    if let Some((actual, expected)) = checksums(&message) {
        let mut bytes = std::fs::read(path).unwrap_or_default();
        let at = bytes
            .windows(expected.len())
            .position(|w| w == expected.as_bytes());
        if let Some(at) = at.filter(|_| expected.len() == actual.len()) {
            bytes[at..at + actual.len()].copy_from_slice(actual.as_bytes());
            if std::fs::write(path, bytes).is_ok() {
                return Outcome::of(safetensors::read(path), |file| reader::scene(&file.scene));
            }
        }
    }
    Outcome::of(read, |file| reader::scene(&file.scene))
}

/// The checksum that a file has, and the one that it says.
fn checksums(message: &str) -> Option<(&str, &str)> {
    let (actual, rest) = message
        .split_once("its checksum is ")?
        .1
        .split_once(" where ")?;
    Some((actual, rest.split_once(" was written")?.0))
}

/// Nothing but what is decoded here, and few frames.
fn own_video() -> VideoOptions {
    VideoOptions {
        size: Some(64),
        max_frames: Some(4),
        ffmpeg: PathBuf::from("/nonexistent/ffmpeg"),
        ..VideoOptions::default()
    }
}

fn videos() -> Vec<Reader> {
    let seeds = || {
        let ours = super::written("a.mp4", |path| {
            let mut to = Mp4Writer::create(path, 32, 16, 24.0)?;
            for i in 0..3u8 {
                to.push(Plane::from_fn(32, 16, |x, y| {
                    [x as u8 * 8, y as u8 * 8, i * 40]
                }))?;
            }
            to.finish()
        });
        vec![ours, fixture_bytes("import/vipe/rgb/dog.mp4")]
    };
    let read = |p: &Path| Outcome::of(video::read(p, &own_video(), &Silent), reader::video);
    // else what is damaged is left out
    let strict = VideoOptions {
        strict: true,
        max_frames: None,
        ..own_video()
    };
    let folder = move |p: &Path| Outcome::of(video::read(p, &strict, &Silent), reader::video);
    vec![
        alone("io-mp4", "a.mp4", seeds, read),
        png(among(
            "io-video-folder",
            "import/clip/images",
            "00002.png",
            folder,
        )),
    ]
}

/// The scenes that are written: without and with harmonics.
const DEGREES: [usize; 2] = [0, 2];

fn splats() -> Vec<Reader> {
    let clips = || {
        let one = |degree| {
            let encoded = fourdgs::encode(Path::new("a.4dgs"), &super::scene(degree));
            encoded.unwrap_or_else(|e| panic!("a valid clip: {e}")).0
        };
        DEGREES.map(one).to_vec()
    };
    let instants = || {
        let one = |degree| super::written("a.ply", |p| ply::write(p, &super::scene(degree), 1.0));
        DEGREES.map(one).to_vec()
    };
    vec![
        alone("formats-4dgs", "a.4dgs", clips, |p| {
            Outcome::of(fourdgs::read(p), |file| reader::scene(&file.scene))
        }),
        alone("formats-ply", "a.ply", instants, |p| {
            Outcome::of(ply::read(p), |file| reader::scene(&file.scene))
        }),
    ]
}
