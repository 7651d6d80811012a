//! Pictures of a trained scene: along which cameras, at which moments, into which files.

mod draw;
mod path;
mod swing;
mod time;

pub use draw::{Painter, to_rgb, view};
pub use path::{CameraPath, Stop};
pub use swing::{SwingConfig, swing};
pub use time::{Moment, Span, TimeError, TimePath};

use crate::folder::{self, SCENE_FILE};
use crate::{Error, Observer};
use m4_io::{image, scene_file, video::Mp4Writer};
use m4_kernels::SimdLevel;
use m4_scene::{RgbImage, Scene};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Frames a second where the scene does not say.
pub const DEFAULT_FPS: f64 = 30.0;

/// What to render.
#[derive(Debug, Clone, PartialEq)]
pub struct RenderJob {
    /// Cameras.
    pub path: CameraPath,
    /// Moments.
    pub time: TimePath,
    /// Frames a second of an MP4; `None` for that of the source.
    pub fps: Option<f64>,
    /// Replace what is there.
    pub replace: bool,
}

/// What was rendered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rendered {
    /// Pictures written.
    pub frames: usize,
    /// Wall-clock seconds.
    pub seconds: f64,
}

/// Renders a scene (a file, or the folder of a run) to a folder of PNG pictures, or to an MP4 where
/// `out` ends in `.mp4`.
///
/// # Errors
///
/// [`Error`]: the scene or the cameras cannot be read, a moment lies outside the scene, or the
/// pictures cannot be written.
pub fn make(scene: &Path, out: &Path, job: &RenderJob, observer: &dyn Observer) -> Result<Rendered, Error> {
    let start = Instant::now();
    let level = SimdLevel::detect()?;
    let file = if scene.is_dir() {
        scene.join(SCENE_FILE)
    } else {
        scene.to_path_buf()
    };
    let scene = scene_file::read(&file)?.scene;
    let mut painter = Painter::new(&scene, level);
    let config = SwingConfig::default();
    let stops = job.path.stops(&scene, &config, |stop| {
        painter.median_depth(&stop.camera, stop.t).unwrap_or(1.0)
    })?;
    let own: Vec<f64> = stops.iter().map(|stop| stop.t).collect();
    let span = Span {
        time_frames: scene.time_frames,
        duration_s: scene.duration_s,
    };
    let moments = job.time.moments(&own, &span)?;
    let mut sink = Sink::open(out, &stops, job.fps.unwrap_or_else(|| source_fps(&scene)), job.replace)?;
    for (i, (stop, t)) in stops.iter().zip(moments).enumerate() {
        if observer.cancelled() {
            return Err(Error::Stopped {
                stage: "render",
                saved: false,
            });
        }
        sink.push(&painter.picture(&stop.camera, t, &stop.exposure))?;
        observer.update("render", i + 1, stops.len(), "");
    }
    sink.finish()?;
    Ok(Rendered {
        frames: stops.len(),
        seconds: start.elapsed().as_secs_f64(),
    })
}

/// Frames a second of the video that a scene was made of.
#[must_use]
pub fn source_fps(scene: &Scene) -> f64 {
    let steps = scene.time_frames.saturating_sub(1) as f64;
    match scene.duration_s {
        Some(duration_s) if duration_s > 0.0 && steps > 0.0 => (steps / duration_s).clamp(1.0, 240.0),
        _ => DEFAULT_FPS,
    }
}

/// Where pictures go.
enum Sink {
    Folder { path: PathBuf, next: usize },
    Video(Box<Mp4Writer>),
}

impl Sink {
    fn open(out: &Path, stops: &[Stop], fps: f64, replace: bool) -> Result<Self, Error> {
        let would_replace = || Error::WouldReplace {
            path: out.to_path_buf(),
        };
        let is_video = out.extension().is_some_and(|e| e.eq_ignore_ascii_case("mp4"));
        if !is_video {
            if folder::make(out)? && !replace {
                return Err(would_replace());
            }
            return Ok(Self::Folder {
                path: out.to_path_buf(),
                next: 0,
            });
        }
        if out.exists() && !replace {
            return Err(would_replace());
        }
        let size = stops
            .first()
            .map_or((0, 0), |s| (s.camera.intrinsics.width, s.camera.intrinsics.height));
        Ok(Self::Video(Box::new(Mp4Writer::create(out, size.0, size.1, fps)?)))
    }

    fn push(&mut self, picture: &RgbImage) -> Result<(), Error> {
        match self {
            Self::Folder { path, next } => {
                image::write_rgb(&path.join(format!("{next:05}.png")), picture)?;
                *next += 1;
            }
            Self::Video(writer) => writer.push(picture)?,
        }
        Ok(())
    }

    fn finish(self) -> Result<(), Error> {
        match self {
            Self::Folder { .. } => {}
            Self::Video(writer) => writer.finish()?,
        }
        Ok(())
    }
}
