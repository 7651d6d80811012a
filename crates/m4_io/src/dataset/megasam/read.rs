//! Reads a file or folder of MegaSaM.

use super::{BLOCK, Stored, candidates, check_polarity, depth_of, mask_of};
use crate::dataset::files::{self, duration_s, given_fps};
use crate::dataset::{FrameSource, ImportOptions, Lens, ListedFrame, Listing, step};
use crate::error::AtPath;
use crate::npy::{Array, Npz, Number};
use crate::{Fault, ReadError, pose, range};
use m4_core::{CompactMask, DepthMap, Intrinsics, Plane, Progress, RgbImage, Se3};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Bytes per pixel: colour and depth, and room for a mask.
const BYTES_PER_PIXEL: u64 = 8;
const HINT: &str = "give the files that MegaSaM wrote";

/// The number of frames, and their width and height.
#[derive(Clone, Copy)]
struct ClipSize {
    frames: usize,
    size: (usize, usize),
}

/// Lists a `.npz` file or a folder of reconstructions; what was assumed is reported to `progress`.
pub fn list(
    path: &Path,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Listing, ReadError> {
    let here = |cause: Fault| cause.at(path);
    given_fps(options).map_err(here)?;
    let mut input = Input::open(path, options.max_memory_bytes).map_err(here)?;
    let clip = input.clip().map_err(here)?;
    let cameras = if matches!(input.from, Storage::Folder(_)) {
        input.quaternions(clip)
    } else {
        input.matrices(clip)
    };
    let cameras = cameras.map_err(here)?;
    let images = input.images(clip, progress).map_err(here)?;
    let depths = input.depths(path, clip, progress).map_err(here)?;
    let mut masks = masks(path, clip, options, progress)?.map(Vec::into_iter);
    let duration_s = duration_s(clip.frames, options, progress);
    let frames = images.into_iter().zip(depths).zip(cameras).enumerate();
    let frames = frames.map(|(i, ((rgb, depth), (intrinsics, c2w)))| {
        let (mask, motion) = masks.as_mut().and_then(Iterator::next).unzip();
        ListedFrame {
            depth: Some(FrameSource::held(depth.into())),
            mask: mask.map(FrameSource::held),
            motion: motion.map(FrameSource::held),
            ..ListedFrame::new(
                format!("{i:05}"),
                Lens::pinhole(intrinsics),
                c2w,
                i as f64,
                FrameSource::held(rgb),
            )
        }
    });
    Ok(Listing::of_video(frames.collect(), clip.frames, duration_s))
}

enum Storage {
    Archive(Npz),
    Folder(PathBuf),
}

/// Named arrays of an archive or a folder.
struct Input {
    from: Storage,
    limit_bytes: u64,
}

impl Input {
    fn open(path: &Path, limit_bytes: u64) -> Result<Self, Fault> {
        let from = if path.is_dir() {
            Storage::Folder(path.to_path_buf())
        } else {
            Storage::Archive(Npz::open(path)?)
        };
        Ok(Self { from, limit_bytes })
    }

    /// An array, its header read; `None` if it is missing.
    fn find(&mut self, name: &str) -> Result<Option<Array<'_>>, Fault> {
        match &mut self.from {
            Storage::Archive(npz) => npz.array(name, self.limit_bytes),
            Storage::Folder(folder) => {
                match open(&folder.join(format!("{name}.npy")), name, self.limit_bytes) {
                    Err(Fault::Io(e)) if e.kind() == ErrorKind::NotFound => Ok(None),
                    other => other.map(Some),
                }
            }
        }
    }

    /// An array that must be there.
    fn array(&mut self, name: &str) -> Result<Array<'_>, Fault> {
        let has = match &self.from {
            Storage::Archive(npz) => {
                format!(
                    "it has {}; images, depths, intrinsic and cam_c2w are needed",
                    npz.names()
                )
            }
            Storage::Folder(_) => {
                "images.npy, disps.npy, poses.npy and intrinsics.npy are needed".to_owned()
            }
        };
        self.find(name)?
            .ok_or_else(|| Fault::missing(format!("the array `{name}`"), has))
    }

    /// All numbers of an array of that shape, which is not large.
    fn all(&mut self, name: &str, shape: &[usize], is: &str) -> Result<Vec<f64>, Fault> {
        let array = self.array(name)?;
        check_shape(name, &array, shape, is)?;
        Ok(array.numbers()?.values)
    }

    /// The size of the clip by the shape of the images; refuses what would not fit into memory.
    fn clip(&mut self) -> Result<ClipSize, Fault> {
        let planar = matches!(self.from, Storage::Folder(_));
        let limit_bytes = self.limit_bytes;
        let images = self.array("images")?;
        if images.number != Number::U8 {
            let what = format!(
                "the array `images` holds numbers of type {:?}",
                images.number
            );
            return Err(Fault::bad(what, "save it as uint8"));
        }
        let clip = match (images.shape.as_slice(), planar) {
            (&[frames, h, w, 3], false) | (&[frames, 3, h, w], true) if frames * h * w > 0 => {
                ClipSize {
                    frames,
                    size: (w, h),
                }
            }
            (_, true) => return Err(shape_error("images", &images, "(frames, 3, height, width)")),
            (_, false) => return Err(shape_error("images", &images, "(frames, height, width, 3)")),
        };
        // no overflow: `images` fits into a file
        let pixels = (clip.frames * clip.size.0 * clip.size.1) as u64;
        let needed_bytes = pixels.saturating_mul(BYTES_PER_PIXEL);
        if needed_bytes > limit_bytes {
            let (w, h) = clip.size;
            let what = format!("a clip of {} frames of {w} x {h} pixels", clip.frames);
            return Err(Fault::too_large(&what, needed_bytes, limit_bytes));
        }
        Ok(clip)
    }

    /// One lens, and matrices camera to world.
    fn matrices(&mut self, clip: ClipSize) -> Result<Vec<(Intrinsics, Se3<f64>)>, Fault> {
        let k = self.all("intrinsic", &[3, 3], "one matrix")?;
        let zeros = [k[1], k[3], k[6], k[7]];
        if k[8] != 1.0
            || zeros
                .iter()
                .any(|v| v.is_nan() || v.abs() > 1e-6 * k[0].abs())
        {
            let what = format!("the array `intrinsic` is {k:?}");
            return Err(Fault::bad(
                what,
                "[fx, 0, cx, 0, fy, cy, 0, 0, 1] was expected (is it transposed?)",
            ));
        }
        let lens = pinhole([k[0], k[4], k[2], k[5]], clip, "intrinsic", 0)?;
        let is = "a matrix for each of the frames of `images`";
        let m = self.all("cam_c2w", &[clip.frames, 4, 4], is)?;
        let poses = m.chunks_exact(16).enumerate();
        poses
            .map(|(i, m)| {
                Ok((
                    lens,
                    pose::of_matrix(&format!("the array `cam_c2w`, frame {i}: the matrix"), m)?,
                ))
            })
            .collect()
    }

    /// A lens per frame, and translations with quaternions world to camera.
    fn quaternions(&mut self, clip: ClipSize) -> Result<Vec<(Intrinsics, Se3<f64>)>, Fault> {
        let is = "fx fy cx cy for each of the frames of `images`";
        let k = self.all("intrinsics", &[clip.frames, 4], is)?;
        let is = "tx ty tz qx qy qz qw for each of the frames of `images`";
        let p = self.all("poses", &[clip.frames, 7], is)?;
        let frames = k
            .as_chunks::<4>()
            .0
            .iter()
            .zip(p.as_chunks::<7>().0)
            .enumerate();
        frames
            .map(|(i, (k, &[x, y, z, qx, qy, qz, qw]))| {
                let w2c = pose::of_quaternion([x, y, z], [qw, qx, qy, qz]);
                let w2c = w2c
                    .map_err(|e| Fault::bad(format!("the array `poses`, frame {i}: {e}"), HINT))?;
                Ok((pinhole(*k, clip, "intrinsics", i)?, w2c.inverse()))
            })
            .collect()
    }

    fn images(&mut self, clip: ClipSize, progress: &dyn Progress) -> Result<Vec<RgbImage>, Fault> {
        let (w, h) = clip.size;
        let planar = matches!(self.from, Storage::Folder(_));
        let mut array = self.array("images")?;
        let mut images = Vec::new();
        for i in 0..clip.frames {
            step("read images", i, clip.frames, progress)?;
            let bytes = array.next_bytes(3 * w * h)?;
            let pixels = if planar {
                // blue, green, red, a plane each
                let plane = |c: usize| &bytes[c * w * h..(c + 1) * w * h];
                let (b, g, r) = (plane(0), plane(1), plane(2));
                (0..w * h).map(|k| [r[k], g[k], b[k]]).collect()
            } else {
                bytes.as_chunks::<3>().0.to_vec()
            };
            images.push(plane(w, h, pixels)?);
        }
        array.end()?;
        Ok(images)
    }

    fn depths(
        &mut self,
        path: &Path,
        clip: ClipSize,
        progress: &dyn Progress,
    ) -> Result<Vec<DepthMap>, Fault> {
        let folder = matches!(self.from, Storage::Folder(_));
        let name = if folder {
            "disps"
        } else if self.find("depths")?.is_none() && self.find("depths_raw")?.is_some() {
            // the key of upstream variants
            "depths_raw"
        } else {
            "depths"
        };
        let mut array = self.array(name)?;
        let file = path.file_name().unwrap_or_default().to_string_lossy();
        let stored = if folder {
            Stored::Disparity
        } else if array.number == Number::F16 || file.contains("cvd") {
            Stored::Clipped
        } else {
            Stored::Depth
        };
        check_floats(name, &array)?;
        let (w, h) = clip.size;
        check_shape(
            name,
            &array,
            &[clip.frames, h, w],
            "a map for each of the frames of `images`",
        )?;
        let (mut maps, mut n_known) = (Vec::new(), 0);
        for i in 0..clip.frames {
            step("read depth", i, clip.frames, progress)?;
            let values = array.next_f64(w * h)?;
            let map: Vec<f32> = values.iter().map(|&v| depth_of(stored, v)).collect();
            n_known += map.iter().filter(|z| **z > 0.0).count();
            maps.push(plane(w, h, map)?);
        }
        array.end()?;
        let share = n_known as f64 / (clip.frames * w * h) as f64;
        if share < 0.5 {
            progress.warn(&format!(
                "the depth of only {:.0} % of the pixels is known",
                100.0 * share
            ));
        }
        Ok(maps)
    }
}

/// Dynamic pixels, and how likely each cell is dynamic.
type Motion = (CompactMask, Plane<u8>);

/// Masks by the motion map; `None` where there is no map.
fn masks(
    path: &Path,
    clip: ClipSize,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Option<Vec<Motion>>, ReadError> {
    let candidates = candidates(path);
    let Some(file) = candidates.iter().find(|p| p.is_file()) else {
        let at: Vec<String> = candidates.iter().map(|p| p.display().to_string()).collect();
        progress.warn(&format!(
            "no motion map was found ({}), so every pixel counts as static; copy motion_prob.npy there, \
             which MegaSaM writes into reconstructions/NAME",
            at.join(", ")
        ));
        return Ok(None);
    };
    let read = || -> Result<Vec<Motion>, Fault> {
        const NAME: &str = "motion_prob";
        let mut array = open(file, NAME, options.max_memory_bytes)?;
        check_floats(NAME, &array)?;
        let map = map_size(&array, clip)?;
        let mut masks = Vec::new();
        for i in 0..clip.frames {
            step("read masks", i, clip.frames, progress)?;
            let values = array.next_f64(map.0 * map.1)?;
            let mask = mask_of(i, &values, map, clip.size)?;
            let dynamic = |x: usize, y: usize| {
                (255.0 * (1.0 - values[y * map.0 + x]).clamp(0.0, 1.0)).round() as u8
            };
            masks.push((mask, Plane::from_fn(map.0, map.1, dynamic)));
        }
        if array.shape[0] == clip.frames {
            array.end()?;
        }
        Ok(masks)
    };
    let masks = read().at(file)?;
    check_polarity(masks.iter().map(|m| &m.0), progress);
    Ok(Some(masks))
}

/// Width and height of the motion map: an eighth of the image, or all of it.
fn map_size(array: &Array<'_>, clip: ClipSize) -> Result<(usize, usize), Fault> {
    let (w, h) = clip.size;
    let small = (w / BLOCK, h / BLOCK);
    let size = match array.shape.as_slice() {
        // MegaSaM writes at most 1000 frames into an npz, and the maps of all
        &[frames, mh, mw]
            if frames == clip.frames || (frames > clip.frames && clip.frames == 1000) =>
        {
            (mw, mh)
        }
        _ => (0, 0),
    };
    if size.0 * size.1 > 0 && (size == small || size == clip.size) {
        return Ok(size);
    }
    let expected = format!(
        "({} frames, {}, {}), an eighth of the images, or their size (is it of another clip?)",
        clip.frames, small.1, small.0
    );
    Err(shape_error("motion_prob", array, &expected))
}

/// The array of a `.npy` file, its header read.
fn open(path: &Path, name: &str, limit_bytes: u64) -> Result<Array<'static>, Fault> {
    Array::of_file(&format!("the array `{name}`"), path, limit_bytes)
}

fn shape_error(name: &str, array: &Array<'_>, expected: &str) -> Fault {
    Fault::bad(
        format!(
            "the array `{name}` has shape {:?} where {expected} was expected",
            array.shape
        ),
        HINT,
    )
}

fn check_shape(name: &str, array: &Array<'_>, expected: &[usize], is: &str) -> Result<(), Fault> {
    if array.shape == expected {
        return Ok(());
    }
    Err(shape_error(name, array, &format!("{is} = {expected:?}")))
}

fn check_floats(name: &str, array: &Array<'_>) -> Result<(), Fault> {
    if array.number.is_float() {
        return Ok(());
    }
    let what = format!(
        "the array `{name}` holds numbers of type {:?}",
        array.number
    );
    Err(Fault::bad(what, "save it as float16, float32 or float64"))
}

/// The pinhole of `fx fy cx cy`, pixels; principal points are measured from the image's corner (see
/// [the module](super)).
fn pinhole(
    numbers: [f64; 4],
    clip: ClipSize,
    array: &str,
    frame: usize,
) -> Result<Intrinsics, Fault> {
    let lens = files::pinhole(numbers, clip.size);
    match range::of_lens(&lens) {
        Some(what) => Err(Fault::bad(
            format!("the array `{array}`, frame {frame}: {what}"),
            HINT,
        )),
        None => Ok(lens),
    }
}

fn plane<T>(w: usize, h: usize, data: Vec<T>) -> Result<Plane<T>, Fault> {
    Plane::from_vec(w, h, data).map_err(|e| Fault::bad(e.to_string(), HINT))
}
