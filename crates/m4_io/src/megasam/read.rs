//! Reads a file or folder of MegaSaM as a [`Capture`].

use super::depth::{self, Stored};
use super::input::{self, Input};
use super::{MegasamFault, MegasamOptions, ReadMegasamError, lens, motion, pose};
use crate::npy::{Array, Number};
use m4_core::{Camera, Capture, CaptureFrame, CompactMask, DepthMap, Intrinsics, Plane, Progress, RgbImage, Se3};
use std::path::Path;

/// Frames a second where nothing says it.
const DEFAULT_FPS: f64 = 30.0;
/// Bytes a pixel: colour and depth, and room for a mask.
const BYTES_A_PIXEL: u64 = 8;

/// Reads a `.npz` file or a folder of reconstructions; see [the module](super) for what is converted.
///
/// What was assumed (frames per second, a motion map that is missing or looks turned round) is reported to `progress`.
///
/// # Errors
///
/// [`ReadMegasamError`], which names the file, the array and the frame at fault.
pub fn read(path: &Path, options: &MegasamOptions, progress: &dyn Progress) -> Result<Capture, ReadMegasamError> {
    inner(path, options, progress).map_err(|(path, fault)| ReadMegasamError { path, fault })
}

/// How many frames there are, and their width and height.
#[derive(Clone, Copy)]
struct Clip {
    frames: usize,
    size: (usize, usize),
}

type Fault = (std::path::PathBuf, MegasamFault);

fn inner(path: &Path, options: &MegasamOptions, progress: &dyn Progress) -> Result<Capture, Fault> {
    let here = |fault| (path.to_path_buf(), fault);
    check(options).map_err(here)?;
    let limit = options.max_memory_bytes;
    let mut input = Input::open(path).map_err(here)?;
    let planar = matches!(input, Input::Folder(_));
    let clip = clip(&mut input, planar, limit).map_err(here)?;
    let (lenses, poses) = if planar {
        trajectory(&mut input, clip, limit)
    } else {
        cameras(&mut input, clip, limit)
    }
    .map_err(here)?;
    let pictures = pictures(&mut input, clip, planar, limit, progress).map_err(here)?;
    let depths = depths(path, &mut input, clip, limit, progress).map_err(here)?;
    let masks = masks(path, clip, options, progress)?;

    let fps = options.fps.unwrap_or_else(|| {
        progress.warn(&format!(
            "the files of MegaSaM do not state the frame rate; {DEFAULT_FPS} frames per second are assumed (fps)"
        ));
        DEFAULT_FPS
    });
    let mut masks = masks.map(Vec::into_iter);
    let frames = pictures.into_iter().zip(depths).zip(lenses.into_iter().zip(poses));
    let frames = frames.enumerate().map(|(i, ((rgb, depth), (intrinsics, c2w)))| {
        let (mask, motion) = masks.as_mut().and_then(Iterator::next).unzip();
        CaptureFrame {
            name: format!("{i:05}"),
            camera: Camera { intrinsics, c2w },
            t: i as f64,
            rgb,
            depth: Some(depth.into()),
            mask,
            motion,
            instances: None,
            camera_index: None,
        }
    });
    Ok(Capture {
        frames: frames.collect(),
        time_frames: clip.frames,
        duration_s: Some((clip.frames - 1) as f64 / fps),
        metric: false,
        tracks: None,
    })
}

fn check(options: &MegasamOptions) -> Result<(), MegasamFault> {
    let bad = |option, value, expected| {
        Err(MegasamFault::Option {
            option,
            value,
            expected,
        })
    };
    if let Some(fps) = options.fps.filter(|fps| !(fps.is_finite() && *fps > 0.0)) {
        return bad("fps", fps, "frames per second, above 0, were expected");
    }
    let tau = options.tau_motion;
    if !(0.0..=1.0).contains(&tau) {
        return bad("tau_motion", tau, "a probability, 0 to 1, was expected");
    }
    Ok(())
}

/// Looks at the shape of the images, and at what all frames will take.
fn clip(input: &mut Input, planar: bool, limit_bytes: u64) -> Result<Clip, MegasamFault> {
    let images = input.array("images", limit_bytes)?;
    input::numbers("images", &images, true)?;
    let clip = match (images.shape.as_slice(), planar) {
        (&[frames, h, w, 3], false) | (&[frames, 3, h, w], true) if frames * h * w > 0 => Clip { frames, size: (w, h) },
        (found, _) => {
            let expected = if planar {
                "(frames, 3, height, width)"
            } else {
                "(frames, height, width, 3)"
            };
            return Err(MegasamFault::Shape {
                array: "images",
                found: found.to_vec(),
                expected: expected.into(),
            });
        }
    };
    // no overflow: `images` fits into a file
    let pixels = (clip.frames * clip.size.0 * clip.size.1) as u64;
    let needed_bytes = pixels.saturating_mul(BYTES_A_PIXEL);
    if needed_bytes > limit_bytes {
        let (w, h) = clip.size;
        return Err(MegasamFault::TooLarge {
            what: format!("a clip of {} frames of {w} x {h} pixels", clip.frames),
            needed_bytes,
            limit_bytes,
        });
    }
    Ok(clip)
}

type Cameras = (Vec<Intrinsics>, Vec<Se3<f64>>);

/// One lens, and matrices camera to world.
fn cameras(input: &mut Input, clip: Clip, limit: u64) -> Result<Cameras, MegasamFault> {
    let k = input.array("intrinsic", limit)?;
    input::shape("intrinsic", &k, &[3, 3], "one matrix")?;
    let k = lens::of_matrix(&input::all("intrinsic", k)?, clip.size)?;
    let m = input.array("cam_c2w", limit)?;
    input::shape(
        "cam_c2w",
        &m,
        &[clip.frames, 4, 4],
        "a matrix for each of the frames of `images`",
    )?;
    let m = input::all("cam_c2w", m)?;
    let poses = m.chunks_exact(16).enumerate().map(|(i, m)| pose::of_matrix(i, m));
    Ok((vec![k; clip.frames], poses.collect::<Result<_, _>>()?))
}

/// A lens per frame, and translations with quaternions world to camera.
fn trajectory(input: &mut Input, clip: Clip, limit: u64) -> Result<Cameras, MegasamFault> {
    let k = input.array("intrinsics", limit)?;
    input::shape(
        "intrinsics",
        &k,
        &[clip.frames, 4],
        "fx fy cx cy for each of the frames of `images`",
    )?;
    let k = input::all("intrinsics", k)?;
    let lenses = k.as_chunks::<4>().0.iter().enumerate();
    let lenses = lenses.map(|(i, k)| lens::of_numbers("intrinsics", i, *k, clip.size));
    let p = input.array("poses", limit)?;
    input::shape(
        "poses",
        &p,
        &[clip.frames, 7],
        "tx ty tz qx qy qz qw for each of the frames of `images`",
    )?;
    let p = input::all("poses", p)?;
    let poses = p.chunks_exact(7).enumerate().map(|(i, p)| pose::of_w2c(i, p));
    Ok((lenses.collect::<Result<_, _>>()?, poses.collect::<Result<_, _>>()?))
}

fn pictures(
    input: &mut Input,
    clip: Clip,
    planar: bool,
    limit: u64,
    progress: &dyn Progress,
) -> Result<Vec<RgbImage>, MegasamFault> {
    let (w, h) = clip.size;
    let mut array = input.array("images", limit)?;
    let mut pictures = Vec::new();
    for i in 0..clip.frames {
        step("read images", i, clip.frames, progress)?;
        let bytes = array.next_u8(3 * w * h).map_err(MegasamFault::of("images"))?;
        let pixels = if planar {
            // blue, green, red, a plane each
            let plane = |c: usize| &bytes[c * w * h..(c + 1) * w * h];
            let (b, g, r) = (plane(0), plane(1), plane(2));
            (0..w * h).map(|k| [r[k], g[k], b[k]]).collect()
        } else {
            bytes.as_chunks::<3>().0.to_vec()
        };
        pictures.push(plane("images", w, h, pixels)?);
    }
    array.end().map_err(MegasamFault::of("images"))?;
    Ok(pictures)
}

fn depths(
    path: &Path,
    input: &mut Input,
    clip: Clip,
    limit: u64,
    progress: &dyn Progress,
) -> Result<Vec<DepthMap>, MegasamFault> {
    let (name, mut array, stored) = match input {
        Input::Folder(_) => ("disps", input.array("disps", limit)?, Stored::Disparity),
        Input::Archive(_) => {
            let mut has = |name| input.find(name, limit).map(|found| found.is_some());
            // the key of upstream variants
            let raw = !has("depths")? && has("depths_raw")?;
            let name = if raw { "depths_raw" } else { "depths" };
            let array = input.array(name, limit)?;
            let file = path.file_name().unwrap_or_default().to_string_lossy();
            let clipped = array.number == Number::F16 || file.contains("cvd");
            (name, array, if clipped { Stored::Clipped } else { Stored::Depth })
        }
    };
    input::numbers(name, &array, false)?;
    let (w, h) = clip.size;
    input::shape(
        name,
        &array,
        &[clip.frames, h, w],
        "a map for each of the frames of `images`",
    )?;
    let (mut maps, mut known) = (Vec::new(), 0);
    for i in 0..clip.frames {
        step("read depth", i, clip.frames, progress)?;
        let values = array.next_f64(w * h).map_err(MegasamFault::of(name))?;
        let map: Vec<f32> = values.iter().map(|&v| depth::depth(stored, v)).collect();
        known += map.iter().filter(|z| **z > 0.0).count();
        maps.push(plane(name, w, h, map)?);
    }
    array.end().map_err(MegasamFault::of(name))?;
    let share = known as f64 / (clip.frames * w * h) as f64;
    if share < 0.5 {
        progress.warn(&format!(
            "the depth of only {:.0} % of the pixels is known",
            100.0 * share
        ));
    }
    Ok(maps)
}

/// The dynamic part, and how likely each cell does.
type Moving = (CompactMask, Plane<u8>);

/// Masks, and how likely each cell moves; `None` where there is no map of motion.
fn masks(
    path: &Path,
    clip: Clip,
    options: &MegasamOptions,
    progress: &dyn Progress,
) -> Result<Option<Vec<Moving>>, Fault> {
    let Some(file) = motion::find(path, options) else {
        let at: Vec<String> = motion::candidates(path)
            .iter()
            .map(|p| p.display().to_string())
            .collect();
        progress.warn(&format!(
            "no motion map was found ({}), so every pixel counts as static; give the file motion_prob.npy \
             that MegaSaM wrote into reconstructions/NAME",
            at.join(", ")
        ));
        return Ok(None);
    };
    let there = |fault| (file.clone(), fault);
    let of = MegasamFault::of("motion_prob");
    let mut array = input::file(&file, "motion_prob", options.max_memory_bytes).map_err(there)?;
    input::numbers("motion_prob", &array, false).map_err(there)?;
    let map = map_size(&array, clip).map_err(there)?;
    let mut masks = Vec::new();
    for i in 0..clip.frames {
        step("read masks", i, clip.frames, progress).map_err(there)?;
        let values = array.next_f64(map.0 * map.1).map_err(|e| there(of(e)))?;
        let mask = motion::mask(i, &values, map, clip.size, options.tau_motion).map_err(there)?;
        let moves = |x: usize, y: usize| (255.0 * (1.0 - values[y * map.0 + x]).clamp(0.0, 1.0)).round() as u8;
        masks.push((mask, Plane::from_fn(map.0, map.1, moves)));
    }
    if array.shape[0] == clip.frames {
        array.end().map_err(|e| there(of(e)))?;
    }
    motion::check_polarity(masks.iter().map(|m| &m.0), options.tau_motion, progress);
    Ok(Some(masks))
}

/// Width and height of the map of motion: an eighth of the image, or all of it.
fn map_size(array: &Array<'_>, clip: Clip) -> Result<(usize, usize), MegasamFault> {
    let (w, h) = clip.size;
    let small = (w / motion::BLOCK, h / motion::BLOCK);
    let size = match array.shape.as_slice() {
        // MegaSaM writes at most 1000 frames into an npz, and the maps of all
        &[frames, mh, mw] if frames == clip.frames || (frames > clip.frames && clip.frames == 1000) => (mw, mh),
        _ => (0, 0),
    };
    if size.0 * size.1 > 0 && (size == small || size == clip.size) {
        return Ok(size);
    }
    Err(MegasamFault::Shape {
        array: "motion_prob",
        found: array.shape.clone(),
        expected: format!(
            "({} frames, {}, {}), an eighth of the images, or their size; is it of another clip?",
            clip.frames, small.1, small.0
        ),
    })
}

fn step(phase: &str, done: usize, total: usize, progress: &dyn Progress) -> Result<(), MegasamFault> {
    if progress.cancelled() {
        return Err(MegasamFault::Cancelled);
    }
    progress.update(phase, done + 1, total, "");
    Ok(())
}

fn plane<T>(array: &'static str, w: usize, h: usize, data: Vec<T>) -> Result<Plane<T>, MegasamFault> {
    Plane::from_vec(w, h, data).map_err(|e| MegasamFault::Array {
        array,
        reason: e.to_string(),
    })
}
