//! Record3D's `.r3d`: a zip archive (or the folder that it was unpacked to) of images, depth and
//! poses of an iPhone.
//!
//! ```text
//! metadata        JSON: w h (of K), dw dh (of depth), fps, K (9 numbers, columns first), perFrameIntrinsicCoeffs [n][fx fy cx cy],
//!                 poses [n][qx qy qz qw px py pz] camera to world, frameTimestamps [n] in seconds
//! rgbd/N.jpg      the image, as large as w x h or another multiple
//! rgbd/N.depth    z-depth, metres, 32-bit floats [dh][dw], LZFSE; 0 or NaN where unknown
//! rgbd/N.conf     0, 1 or 2, bytes [dh][dw], LZFSE; depth where it is 0 is dropped
//! ```
//!
//! Camera axes are ARKit's (x right, y up, z back): y and z turn round here. The principal point is
//! measured from the corner.
//!
//! Images are taken as they are stored: poses, `K` and depth are those of the stored rows and
//! columns, whatever an EXIF block says about turning. Images that a tool turned for good (their
//! longer side is not that of `w` and `h`) are refused. `K` is of `w x h` and grows with the image.
//! Source: the notes on the format in marek-simonik/record3d, `record3d_utils.py` of nerfstudio.

use super::depth::depth_in_range;
use super::files::{Inside, Members, fps_of, given_fps, in_frames, pinhole, resized};
use super::{FrameSource, ImportOptions, Lens, ListedFrame, Listing};
use crate::error::AtPath;
use crate::files::{first_bytes, parse_json, utf8};
use crate::pose::{self, Axes};
use crate::{Fault, ReadError, image, range};
use lzfse_rust::LzfseRingDecoder;
use m4_core::{CompactDepth, Intrinsics, Plane, Progress, RgbImage, Se3};
use serde::Deserialize;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

const HINT: &str = "export the recording again as .r3d";
/// Largest image file and what a decoded one may have.
const MAX_IMAGE_BYTES: u64 = 64 << 20;
const MAX_PIXELS: u64 = 64 << 20;

/// Detects a file or folder of the format.
pub(crate) fn detect(path: &Path) -> bool {
    if path.is_dir() {
        return path.join("metadata").is_file() && path.join("rgbd").is_dir();
    }
    let named = path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("r3d"));
    named && first_bytes::<2>(path) == b"PK"
}

pub(crate) fn list(
    path: &Path,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Listing, ReadError> {
    let members = Arc::new(Members::open(path, Inside::of(path, options)).at(path)?);
    let metadata = Metadata::read(&members, path)?;
    let numbers = image_numbers(&members).at(path)?;
    let poses = metadata.poses.len();
    let Some(&last) = numbers.last() else {
        return Err(Fault::missing("every rgbd/N.jpg", HINT).at(path));
    };
    if last >= poses {
        return Err(Fault::bad(
            format!("the image rgbd/{last}.jpg has no pose: metadata has {poses}"),
            HINT,
        )
        .at(path));
    }
    if numbers.len() < poses {
        progress.warn(&format!(
            "{} of {poses} poses of {} have no image and are ignored",
            poses - numbers.len(),
            path.display()
        ));
    }
    // of the first image; `load` compares the others
    let size = image(&members, numbers[0]).at(path)?.size();
    let option_fps = given_fps(options).at(path)?;
    let fps = metadata.fps.or(option_fps);
    let (times, duration_s) = metadata.clock(&numbers, fps, path)?;
    let frames = numbers.iter().zip(&times).map(|(&n, &t)| {
        let place = |cause: Fault| cause.within(path, format!("frame {n}"));
        let k = metadata.intrinsics(n).map_err(place)?;
        let intrinsics = resized(&k, size).map_err(place)?;
        let (for_rgb, for_depth) = (Arc::clone(&members), Arc::clone(&members));
        let (dw, dh) = metadata.depth_size();
        let c2w = metadata.c2w(n).map_err(place)?;
        let rgb = FrameSource::new(move || image(&for_rgb, n));
        Ok(ListedFrame {
            depth: members
                .has(&format!("rgbd/{n}.depth"))
                .map_err(place)?
                .then(|| FrameSource::new(move || sensor_depth(&for_depth, n, dw, dh))),
            ..ListedFrame::new(
                format!("rgbd/{n}.jpg"),
                Lens::pinhole(intrinsics),
                c2w,
                t,
                rgb,
            )
        })
    });
    let train = frames.collect::<Result<_, _>>()?;
    Ok(Listing {
        metric: true,
        ..Listing::of_video(train, numbers.len(), duration_s)
    })
}

/// The numbers of the images, in order.
fn image_numbers(members: &Members) -> Result<Vec<usize>, Fault> {
    let names = members.names("rgbd")?;
    let mut numbers: Vec<usize> = names
        .iter()
        .filter_map(|n| n.strip_suffix(".jpg"))
        .filter_map(|n| n.parse().ok())
        .collect();
    numbers.sort_unstable();
    numbers.dedup();
    Ok(numbers)
}

fn image(members: &Members, n: usize) -> Result<RgbImage, Fault> {
    let name = format!("rgbd/{n}.jpg");
    let bytes = members.read(&name, MAX_IMAGE_BYTES)?;
    let bytes = bytes.ok_or_else(|| Fault::missing(&name, HINT))?;
    // a JPEG makes some 400 pixels of a byte at most
    let most = MAX_PIXELS.min((1 << 20) + 1032 * bytes.len() as u64);
    Ok(image::decode_rgb(&bytes, &PathBuf::from(name), most)?)
}

/// Largest metadata: a frame takes some 300 bytes.
const MAX_METADATA_BYTES: u64 = 64 << 20;
/// Depth of the rear sensor where the file, of an early version, does not say: long and short side.
const SENSOR: (usize, usize) = (256, 192);
/// Longest side of depth maps, pixels; sensors have 640 at most.
const MAX_SENSOR_SIDE: usize = 4096;

#[derive(Deserialize)]
struct Metadata {
    w: usize,
    h: usize,
    dw: Option<usize>,
    dh: Option<usize>,
    fps: Option<f64>,
    #[serde(rename = "K")]
    k: [f64; 9],
    poses: Vec<[f64; 7]>,
    #[serde(rename = "perFrameIntrinsicCoeffs")]
    coefficients: Option<Vec<[f64; 4]>>,
    #[serde(rename = "frameTimestamps")]
    timestamps: Option<Vec<f64>>,
}

impl Metadata {
    fn read(members: &Members, path: &Path) -> Result<Self, ReadError> {
        let bytes = members.read("metadata", MAX_METADATA_BYTES).at(path)?;
        let bytes = bytes.ok_or_else(|| Fault::missing("metadata", HINT).at(path))?;
        let bad = |what: String| Fault::bad(what, HINT).within(path, "metadata");
        let text = utf8(&bytes)
            .map_err(|(at, fault)| fault.within(path, format!("metadata, byte {at}")))?;
        let metadata: Self = parse_json(text).at(&path.join("metadata"))?;
        let n = metadata.poses.len();
        for (key, count) in [
            (
                "perFrameIntrinsicCoeffs",
                metadata.coefficients.as_ref().map(Vec::len),
            ),
            (
                "frameTimestamps",
                metadata.timestamps.as_ref().map(Vec::len),
            ),
        ] {
            // an empty list stands for none
            if let Some(count) = count.filter(|&c| c != n && c != 0) {
                return Err(bad(format!("{key} has {count} entries for {n} poses")));
            }
        }
        let k = &metadata.k;
        if [k[1], k[2], k[3], k[5]] != [0.0; 4] || k[8] != 1.0 {
            return Err(bad(format!(
                "K is {k:?}; fx 0 0, 0 fy 0, cx cy 1 was expected"
            )));
        }
        let side = |v: usize| (1..=1 << 16).contains(&v);
        let (dw, dh) = metadata.depth_size();
        let sensed = |v: usize| (1..=MAX_SENSOR_SIDE).contains(&v);
        if !(side(metadata.w) && side(metadata.h) && sensed(dw) && sensed(dh)) {
            return Err(bad(format!(
                "images of {} x {} and depth of {dw} x {dh} pixels",
                metadata.w, metadata.h
            )));
        }
        if (dw > dh) != (metadata.w > metadata.h) {
            return Err(bad(format!(
                "images of {} x {} but depth of {dw} x {dh} pixels: one of them was rotated",
                metadata.w, metadata.h
            )));
        }
        Ok(metadata)
    }

    /// Width and height of depth maps.
    fn depth_size(&self) -> (usize, usize) {
        let (long, short) = SENSOR;
        let (w, h) = if self.w > self.h {
            (long, short)
        } else {
            (short, long)
        };
        (self.dw.unwrap_or(w), self.dh.unwrap_or(h))
    }

    /// Of images of `w x h`.
    fn intrinsics(&self, n: usize) -> Result<Intrinsics, Fault> {
        let own = self.coefficients.as_ref().and_then(|c| c.get(n));
        let numbers = own
            .copied()
            .unwrap_or([self.k[0], self.k[4], self.k[6], self.k[7]]);
        let k = pinhole(numbers, (self.w, self.h));
        Lens::pinhole(k).check()?;
        Ok(k)
    }

    /// The pose of frame `n`, which there is.
    fn c2w(&self, n: usize) -> Result<Se3<f64>, Fault> {
        let Some(&[qx, qy, qz, qw, x, y, z]) = self.poses.get(n) else {
            return Err(Fault::missing("the pose", HINT));
        };
        let arkit = pose::of_quaternion([x, y, z], [qw, qx, qy, qz])?;
        Ok(Axes::OpenGl.to_opencv(&arkit))
    }

    /// When `frames` were taken, 0 to the number of frames - 1, and the seconds from the first to
    /// the last: by their time stamps, else evenly.
    fn clock(
        &self,
        frames: &[usize],
        fps: Option<f64>,
        path: &Path,
    ) -> Result<(Vec<f64>, Option<f64>), ReadError> {
        let bad = |what: String| Err(Fault::bad(what, HINT).within(path, "metadata"));
        let steps = (frames.len() - 1) as f64;
        if let Some(fps) = fps {
            fps_of("fps", fps).map_err(|e| e.within(path, "metadata"))?;
        }
        let stamps = self.timestamps.as_ref().filter(|s| !s.is_empty());
        let Some(stamps) = stamps else {
            return Ok((
                (0..frames.len()).map(|i| i as f64).collect(),
                fps.map(|fps| steps / fps),
            ));
        };
        let times: Vec<f64> = frames
            .iter()
            .filter_map(|&n| stamps.get(n))
            .copied()
            .collect();
        let apart = times.windows(2).all(|p| p[1] > p[0])
            && times.iter().all(|t| range::SECONDS.contains(t));
        if times.len() != frames.len() || !apart {
            return bad(
                "frameTimestamps do not grow from frame to frame, or are no seconds".into(),
            );
        }
        let (t, span_s) = in_frames(&times);
        Ok((t, Some(span_s)))
    }
}

/// z-depth of frame `n`, metres, 0 where it is unknown or of no confidence.
fn sensor_depth(members: &Members, n: usize, dw: usize, dh: usize) -> Result<CompactDepth, Fault> {
    let bytes = unpacked(members, &format!("rgbd/{n}.depth"), dw * dh * 4)?;
    let bytes = bytes.ok_or_else(|| Fault::missing(format!("rgbd/{n}.depth"), HINT))?;
    let values = bytes.as_chunks::<4>().0;
    let confidence = unpacked(members, &format!("rgbd/{n}.conf"), dw * dh)?;
    let map = Plane::from_fn(dw, dh, |x, y| {
        let at = y * dw + x;
        if confidence.as_ref().is_some_and(|steps| steps[at] == 0) {
            0.0
        } else {
            depth_in_range(f32::from_le_bytes(values[at]))
        }
    });
    Ok(map.into())
}

/// The `expected` bytes of a member that is packed with LZFSE, or plain.
fn unpacked(members: &Members, name: &str, expected: usize) -> Result<Option<Vec<u8>>, Fault> {
    // LZFSE stores what it cannot pack, with some bytes around each block
    let most = 2 * expected as u64 + 4096;
    let Some(packed) = members.read(name, most)? else {
        return Ok(None);
    };
    if packed.len() == expected {
        return Ok(Some(packed));
    }
    let mut out = Vec::new();
    let mut decoder = LzfseRingDecoder::default();
    // one byte more than there may be
    let read = decoder
        .reader_bytes(&packed)
        .take(expected as u64 + 1)
        .read_to_end(&mut out);
    if let Err(e) = read {
        return Err(Fault::bad(format!("{name} cannot be unpacked ({e})"), HINT));
    }
    if out.len() != expected {
        return Err(Fault::bad(
            format!("{name} does not unpack to the {expected} bytes that metadata says"),
            HINT,
        ));
    }
    Ok(Some(out))
}
