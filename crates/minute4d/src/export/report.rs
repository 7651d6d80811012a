//! What an export says of its file: losses, and how renders of it compare with those of the scene.

use super::{Format, Time};
use crate::import::read_back;
use crate::render::Painter;
use crate::{Category, Error, Observer, Refusal};
use m4_core::{Camera, Scene};
use m4_eval::image::{PlanarImage, PsnrKind, psnr_db};
use m4_io::scene::{Loss, Written};
use m4_kernels::SimdLevel;
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What was exported, how large it is and what it lost.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ExportReport {
    /// The format.
    pub format: Format,
    /// The file; for a sequence the folder.
    pub path: PathBuf,
    /// Size of all files.
    pub bytes: u64,
    /// Splats in the file; in a sequence the sum over its files.
    pub splats: usize,
    /// Bytes a splat: of the scene, or, for one instant, of those that it sees; `None` for files without splats.
    pub bytes_per_splat: Option<f64>,
    /// Bytes a second of the clip, where its length is known and the file has time.
    pub bytes_per_s: Option<f64>,
    /// The moments that are in the file, frames; empty where all are.
    pub moments: Vec<f64>,
    /// Wall-clock seconds of encoding, checking and writing.
    pub encode_s: f64,
    /// What the file holds differently.
    pub losses: Losses,
    /// How close it is; `None` where that was not asked for, and for formats that are not read.
    pub comparison: Option<Comparison>,
}

/// What a file holds differently, by sort.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Losses {
    /// Evaluated at fixed instants.
    pub baked: Vec<String>,
    /// Dropped properties.
    pub dropped: Vec<String>,
    /// Stored with fewer digits.
    pub quantised: Vec<String>,
}

impl Losses {
    /// Sorts losses by kind.
    pub fn of(losses: Vec<Loss>) -> Self {
        let mut all = Self::default();
        for loss in losses {
            match loss {
                Loss::Baked(what) => all.baked.push(what),
                Loss::Dropped(what) => all.dropped.push(what),
                Loss::Quantised(what) => all.quantised.push(what),
            }
        }
        all
    }
}

impl ExportReport {
    pub(super) fn new(
        scene: &Scene,
        format: Format,
        moments: &[f64],
        written: Written,
        encode_s: f64,
        comparison: Option<Comparison>,
    ) -> Self {
        let per = |whole: f64| (whole > 0.0).then(|| written.bytes as f64 / whole);
        let splats = match format.time() {
            Time::Instant => written.splats,
            _ => scene.splats.n(),
        };
        let has_splats = format.time() != Time::Video;
        let has_time = matches!(format.time(), Time::Clip | Time::Sequence | Time::Video);
        Self {
            format,
            bytes: written.bytes,
            splats: written.splats,
            bytes_per_splat: per(splats as f64).filter(|_| has_splats),
            bytes_per_s: scene.duration_s.filter(|_| has_time).and_then(per),
            moments: moments.to_vec(),
            encode_s,
            losses: Losses::of(written.losses),
            comparison,
            path: written.path,
        }
    }

    /// What was written of a capture.
    pub(super) fn of_capture(format: Format, path: PathBuf, bytes: u64, losses: Losses, encode_s: f64) -> Self {
        Self {
            format,
            path,
            bytes,
            splats: 0,
            bytes_per_splat: None,
            bytes_per_s: None,
            moments: Vec::new(),
            encode_s,
            losses,
            comparison: None,
        }
    }
}

impl fmt::Display for ExportReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {:.2} MB", self.format.name(), self.bytes as f64 / 1e6)?;
        if let Some(bytes) = self.bytes_per_splat {
            write!(f, ", {bytes:.1} bytes per splat")?;
        }
        if let Some(bytes) = self.bytes_per_s {
            write!(f, ", {:.2} MB per second of the clip", bytes / 1e6)?;
        }
        write!(f, ", written in {:.1} s", self.encode_s)?;
        let losses = &self.losses;
        for (sort, all) in [("baked", &losses.baked), ("dropped", &losses.dropped), ("quantised", &losses.quantised)] {
            for what in all {
                write!(f, "\n{sort}: {what}")?;
            }
        }
        let Some(c) = &self.comparison else { return Ok(()) };
        write!(
            f,
            "\nagainst the scene: {:.2} dB in {} views, {:.2} dB in the worst",
            c.psnr_db, c.views, c.lowest_psnr_db
        )
    }
}

const VIEWS: usize = 4;

/// How close the file is to the scene.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Comparison {
    /// Cameras of the source that were rendered, spread over the clip.
    pub views: usize,
    /// Mean PSNR of the render of the file against that of the scene, dB; 100 for equal images.
    pub psnr_db: f64,
    /// That of the worst view, dB.
    pub lowest_psnr_db: f64,
    /// Wall-clock seconds of reading back and rendering.
    pub seconds: f64,
}

/// A view, and which of the moments of the file it sees; 0 where the file holds all of them.
struct Look {
    camera: Camera,
    t: f64,
    moment: usize,
}

/// Reads the file back and renders both; `None` for formats that are not read back, and for scenes without
/// cameras.
pub(super) fn compare(
    scene: &Scene,
    path: &Path,
    format: Format,
    moments: &[f64],
    observer: &dyn Observer,
) -> Result<Option<Comparison>, Error> {
    let start = Instant::now();
    let looks = looks(scene, format, moments);
    if looks.is_empty() {
        return Ok(None);
    }
    let level = SimdLevel::detect()?;
    let mut painter = Painter::new(scene, level);
    let mut scores = Vec::new();
    let mut last: Option<(usize, Scene)> = None;
    for (i, look) in looks.iter().enumerate() {
        if observer.cancelled() {
            return Err(Error::Stopped { stage: "export", saved: false });
        }
        if last.as_ref().is_none_or(|(moment, _)| *moment != look.moment) {
            let Some(read) = read_back(format, path, look.moment) else {
                return Ok(None);
            };
            let read = read.map_err(|e| {
                let name = format.name();
                let message =
                    format!("the {name} file was written but does not read back; this is a bug, please report it: {e}");
                Refusal::new(Category::Internal, message)
            })?;
            // Background and near plane are the player's.
            let mut back = read.scene;
            (back.background, back.near) = (scene.background, scene.near);
            if format.time() != Time::Clip {
                back.time_frames = scene.time_frames;
            }
            last = Some((look.moment, back));
        }
        let Some((_, back)) = &last else { continue };
        let reference = rendered(&mut painter, look)?;
        let drawn = rendered(&mut Painter::new(back, level), look)?;
        scores.push(psnr_db(PsnrKind::Joint, &drawn, &reference, None)?.unwrap_or(f64::NAN));
        observer.update("compare", i + 1, looks.len(), "");
    }
    Ok(Some(Comparison {
        views: scores.len(),
        psnr_db: scores.iter().sum::<f64>() / scores.len() as f64,
        lowest_psnr_db: scores.iter().copied().fold(f64::INFINITY, f64::min),
        seconds: start.elapsed().as_secs_f64(),
    }))
}

fn rendered(painter: &mut Painter<'_>, look: &Look) -> Result<PlanarImage, Error> {
    let frame = painter.frame(&look.camera, look.t, false);
    let planes = [&frame.rgb[0][..], &frame.rgb[1][..], &frame.rgb[2][..]];
    Ok(PlanarImage::from_planes(frame.width, frame.height, planes)?)
}

/// Cameras of the source, evenly spread: at their own moments, or at those of the file.
fn looks(scene: &Scene, format: Format, moments: &[f64]) -> Vec<Look> {
    let n = scene.source.len();
    let views = n.min(VIEWS);
    let sources = (0..views).map(|k| &scene.source[(2 * k + 1) * n / (2 * views)]);
    let nearest =
        |t: f64| (0..moments.len()).min_by(|&a, &b| (moments[a] - t).abs().total_cmp(&(moments[b] - t).abs()));
    sources
        .filter_map(|frame| {
            let camera = frame.camera;
            match format.time() {
                Time::Clip => Some(Look { camera, t: frame.t, moment: 0 }),
                Time::Instant | Time::Sequence => {
                    let moment = nearest(frame.t)?;
                    let t = moments[moment];
                    Some(Look { camera, t, moment })
                }
                Time::Video | Time::Capture => None,
            }
        })
        .collect()
}
