//! ViPE's artifacts.
//!
//! ```text
//! PATH                       the folder of the run, or its pose/NAME.npz where it has several clips
//! rgb/NAME.mp4               the clip (or options.images)
//! pose/NAME.npz              data [n][4][4] camera to world, inds [n]: which frames of the clip they are of
//! intrinsics/NAME.npz        data [n][4] fx fy cx cy, pixels, inds [n]; NAME_camera.txt: "0: PINHOLE", a line per frame
//! depth/NAME.zip             00000.exr, ...: halves, channel Z, metres; NaN where unknown (optional)
//! mask/NAME.zip, NAME.txt    00000.png, ...: which instance a pixel shows, 0 = none; "1: person", what each is (optional)
//! flow, vipe                 are not read
//! ```
//!
//! **What is converted.** Poses are OpenCV's and depth is z-depth: nothing is turned. Principal
//! points are taken as they are, from the image's corner: ViPE starts from half of the width and
//! counts pixels from their centres, as MegaSaM does (see [`super::megasam`]). The dynamic part is
//! what ViPE was told to look for (people, animals, vehicles, ...): every instance but those whose
//! phrase is `sky`. Metric, as ViPE's depth is. Frames of the clip without a pose are left out and
//! keep their place in time.
//!
//! Source: `vipe/utils/io.py` of NVIDIA's repository (Apache-2.0).

use super::depth::decode_exr;
use super::files::{Inside, Members, duration_of, given_fps, pinhole, read_images};
use super::{FrameSource, ImportOptions, Lens, ListedFrame, Listing};
use crate::error::AtPath;
use crate::files::text;
use crate::npy::{Array, Npz, Numbers};
use crate::{Fault, ReadError, image, pose};
use m4_core::{CompactDepth, CompactIds, CompactMask, Progress};
use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Bytes of an array of poses or lenses: a quarter of a million frames.
const MAX_SMALL_BYTES: u64 = 16 << 20;
/// Largest depth map or mask, unpacked.
const MAX_MEMBER_BYTES: u64 = 1 << 30;

/// Whether it is the folder of a run, or a pose file in one.
pub(super) fn detect(path: &Path) -> bool {
    if path.is_dir() {
        return path.join("intrinsics").is_dir() && !names(path).is_empty();
    }
    run_of(path).is_some()
}

/// The run and the name of the clip of `RUN/pose/NAME.npz`.
fn run_of(file: &Path) -> Option<(PathBuf, String)> {
    let folder = file.parent()?;
    let run = folder.parent()?;
    let name = file.file_stem()?.to_str()?.to_owned();
    let fits = folder.file_name()? == "pose" && file.extension()? == "npz";
    (fits && run.join("intrinsics").join(format!("{name}.npz")).is_file())
        .then(|| (run.to_path_buf(), name))
}

/// Names of the clips of a run, in order.
fn names(run: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(run.join("pose"))
        .into_iter()
        .flatten()
        .flatten();
    let mut names: Vec<String> = entries
        .filter_map(|entry| run_of(&entry.path()).map(|(_, name)| name))
        .collect();
    names.sort();
    names
}

pub(super) fn list(
    path: &Path,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Listing, ReadError> {
    given_fps(options).at(path)?;
    let (run, name) = match run_of(path) {
        Some(capture) => capture,
        None => {
            let names = names(path);
            match names.as_slice() {
                [one] => (path.to_path_buf(), one.clone()),
                [] => {
                    let hint = "give the folder of a run, with pose, intrinsics and rgb";
                    return Err(
                        Fault::missing("pose/NAME.npz with its intrinsics/NAME.npz", hint).at(path),
                    );
                }
                several => {
                    let what = format!(
                        "the run has {} clips: {}",
                        several.len(),
                        several.join(", ")
                    );
                    return Err(
                        Fault::unsupported(what, "give pose/NAME.npz of one of them").at(path),
                    );
                }
            }
        }
    };
    let inside = Inside::of(&run, options);
    let part = |folder: &str, file: &str| run.join(folder).join(file);
    let (pose_file, poses) = indexed(&part("pose", &format!("{name}.npz")), 16)?;
    let (lens_file, lenses) = indexed(&part("intrinsics", &format!("{name}.npz")), 4)?;
    pinholes(&part("intrinsics", &format!("{name}_camera.txt")))?;
    let clip = options
        .images
        .clone()
        .unwrap_or_else(|| part("rgb", &format!("{name}.mp4")));
    if !clip.exists() {
        let hint = "give the clip or the folder of its images (images)";
        return Err(Fault::missing("the clip", hint).at(&clip));
    }
    let images = read_images(&clip, &inside, options, progress)?;
    let zipped = |folder: &str| -> Result<Option<Arc<Zipped>>, ReadError> {
        let file = inside.file(part(folder, &format!("{name}.zip")))?;
        if !file.is_file() {
            return Ok(None);
        }
        let members = Members::open(&file, inside.clone()).at(&file)?;
        Ok(Some(Arc::new(Zipped {
            path: file,
            members,
        })))
    };
    let (depths, masks) = (zipped("depth")?, zipped("mask")?);
    let still = Arc::new(sky(&part("mask", &format!("{name}.txt")))?);
    let time_frames = images.all.len();
    if let Some((&last, _)) = poses
        .last_key_value()
        .filter(|(last, _)| **last >= time_frames)
    {
        let what = format!("it has a pose of frame {last}, but the clip has {time_frames}");
        return Err(Fault::bad(what, "give the clip of this run").at(&pose_file));
    }
    let last_s = images.times_s.and_then(|times| times.last().copied());
    let duration_s = duration_of(last_s, time_frames, options, progress);
    let mut train = Vec::with_capacity(poses.len());
    for (i, image) in images.all.into_iter().enumerate() {
        let Some(matrix) = poses.get(&i) else {
            continue;
        };
        let c2w = pose::of_matrix("the matrix", matrix)
            .map_err(|e| e.within(&pose_file, format!("array `data`, frame {i}")))?;
        let k = lenses.get(&i).ok_or_else(|| {
            let hint = "give the files of one run";
            Fault::missing(format!("the line of frame {i}"), hint)
                .within(&lens_file, "array `inds`")
        })?;
        let member =
            |zip: &Option<Arc<Zipped>>, extension: &str| -> Result<Option<Member>, ReadError> {
                let Some(zip) = zip else { return Ok(None) };
                let name = format!("{i:05}.{extension}");
                Ok(zip.members.has(&name).at(&zip.path)?.then(|| Member {
                    zip: Arc::clone(zip),
                    name,
                }))
            };
        let (depth, mask) = (member(&depths, "exr")?, member(&masks, "png")?);
        let k = pinhole([k[0], k[1], k[2], k[3]], image.size);
        train.push(ListedFrame {
            depth: depth.map(|member| FrameSource::new(move || member.depth())),
            mask: mask.clone().map(|member| {
                let still = Arc::clone(&still);
                FrameSource::new(move || {
                    let ids = member.ids()?.to_plane();
                    let (w, h) = ids.size();
                    Ok(CompactMask::from_fn(w, h, |x, y| {
                        ids[(x, y)] != 0 && !still.contains(&ids[(x, y)])
                    }))
                })
            }),
            instances: mask.map(|member| FrameSource::new(move || member.ids())),
            ..ListedFrame::new(
                format!("{i:05}"),
                Lens::pinhole(k),
                c2w,
                i as f64,
                image.rgb,
            )
        });
    }
    Ok(Listing {
        metric: true,
        ..Listing::of_video(train, time_frames, duration_s)
    })
}

/// The arrays `data` and `inds`: the `width` numbers of each frame that has some.
fn indexed(file: &Path, width: usize) -> Result<(PathBuf, BTreeMap<usize, Vec<f64>>), ReadError> {
    let mut npz = Npz::open(file).at(file)?;
    let mut array = |name: &str| {
        npz.need(name, MAX_SMALL_BYTES)
            .and_then(Array::numbers)
            .at(file)
    };
    let (
        Numbers {
            shape,
            values: data,
            ..
        },
        inds,
    ) = (array("data")?, array("inds")?.values);
    if inds.is_empty() || data.len() != inds.len() * width {
        let what = format!(
            "data has shape {shape:?} and there are {} inds; {width} numbers for each were expected",
            inds.len()
        );
        return Err(Fault::bad(
            what,
            "other camera models have more; run ViPE with a pinhole camera",
        )
        .at(file));
    }
    let mut all = BTreeMap::new();
    for (index, numbers) in inds.iter().zip(data.chunks_exact(width)) {
        let whole = *index >= 0.0 && index.fract() == 0.0 && *index < f64::from(u32::MAX);
        if !whole || all.insert(*index as usize, numbers.to_vec()).is_some() {
            let what = format!("it holds {index}, no frame or one that was there before");
            return Err(
                Fault::bad(what, "give the file that ViPE wrote").within(file, "array `inds`")
            );
        }
    }
    Ok((file.to_path_buf(), all))
}

/// Refuses lenses that are no pinholes; a file that is missing says nothing, as in ViPE.
fn pinholes(path: &Path) -> Result<(), ReadError> {
    if !path.is_file() {
        return Ok(());
    }
    for (i, line) in text(path)?.lines().enumerate() {
        let kind = line.split_once(':').map_or("", |(_, kind)| kind.trim());
        if !(line.trim().is_empty() || kind == "PINHOLE") {
            let what = format!("the camera is {line:?}; only PINHOLE is read");
            let hint = "run ViPE with a pinhole camera (`pipeline=default`)";
            return Err(Fault::unsupported(what, hint).within(path, format!("line {}", i + 1)));
        }
    }
    Ok(())
}

/// Numbers of instances that are static: the sky.
fn sky(path: &Path) -> Result<HashSet<u16>, ReadError> {
    if !path.is_file() {
        return Ok(HashSet::new());
    }
    let mut phrases = HashMap::new();
    for (i, line) in text(path)?
        .lines()
        .enumerate()
        .filter(|(_, l)| !l.trim().is_empty())
    {
        let parsed = line
            .split_once(':')
            .and_then(|(id, phrase)| Some((id.trim().parse().ok()?, phrase)));
        let (id, phrase) = parsed.ok_or_else(|| {
            let what = format!("{line:?} is not a number with a phrase, such as `1: person`");
            Fault::bad(what, "give the file that ViPE wrote")
                .within(path, format!("line {}", i + 1))
        })?;
        phrases.insert(id, phrase.trim().to_ascii_lowercase());
    }
    Ok(phrases
        .into_iter()
        .filter(|(_, p)| p == "sky")
        .map(|(id, _): (u16, _)| id)
        .collect())
}

/// An archive of maps, one per frame.
struct Zipped {
    path: PathBuf,
    members: Members,
}

/// One map of an archive.
#[derive(Clone)]
struct Member {
    zip: Arc<Zipped>,
    name: String,
}

impl Member {
    fn path(&self) -> PathBuf {
        self.zip.path.join(&self.name)
    }

    fn bytes(&self) -> Result<Vec<u8>, Fault> {
        let bytes = self.zip.members.read(&self.name, MAX_MEMBER_BYTES)?;
        bytes.ok_or_else(|| Fault::missing(&self.name, "copy the archive again"))
    }

    fn depth(&self) -> Result<CompactDepth, Fault> {
        let decoded = self.bytes().and_then(|bytes| decode_exr(&bytes));
        Ok(decoded.map_err(|e| e.of_file(&self.path()))?.into())
    }

    fn ids(&self) -> Result<CompactIds, Fault> {
        let bytes = self.bytes().map_err(|e| e.of_file(&self.zip.path))?;
        Ok(image::ids_of_bytes(&self.path(), &bytes)?)
    }
}
