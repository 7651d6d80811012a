//! Camera paths: the cameras and their times.

mod keyed;
mod source;

pub use source::SourcePath;

use super::options::unused;
use super::swing::{Bullet, swing_camera};
use super::{Painter, PathOptions, Region, RenderJob, Span, TimePath, source_fps};
use crate::{Error, Refusal};
use keyed::KeyedPath;
use m4_core::{Exposure, Scene, SourceFrame};
use m4_io::trajectory::{self, Trajectory};
use std::fmt;
use std::path::{Path, PathBuf};

const MAX_FRAMES: usize = 100_000;
/// Length of a swing, seconds; it goes there and back twice.
const SWING_S: f64 = 4.0;
/// Sources with fewer frames per second than this do not look smooth, so paths that can have more
/// get [`super::DEFAULT_FPS`].
const SMOOTH_FPS: f64 = 20.0;
/// The words for camera paths.
pub const WORDS: [&str; 5] = ["train", "source", "stabilised", "swing", "bullet"];

/// A row of cameras.
#[derive(Debug, Clone, PartialEq)]
pub enum CameraPath {
    /// `train`: those that took the video, each once, with their exposures.
    Train,
    /// `source`: the camera that took the video, at any frame rate.
    Source,
    /// `stabilised`: the same without its tremble.
    Stabilised,
    /// `swing`: a figure of eight about what one camera sees.
    Swing,
    /// `bullet`: the source, which is static in time once while the camera goes round.
    Bullet,
    /// `test:TRANSFORMS` or another file: the cameras or keyframes there, in the scene's world.
    File(PathBuf),
}

impl fmt::Display for CameraPath {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Train => "train",
            Self::Source => "source",
            Self::Stabilised => "stabilised",
            Self::Swing => "swing",
            Self::Bullet => "bullet",
            Self::File(path) => return write!(f, "{}", path.display()),
        })
    }
}

/// Every camera of a path.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// One per image.
    pub stops: Vec<SourceFrame>,
    /// Images a second.
    pub fps: f64,
}

impl CameraPath {
    /// The path of that name; a name that is none of the words is a file.
    pub fn named(name: &str) -> Self {
        match name {
            "train" => Self::Train,
            "source" => Self::Source,
            "stabilised" | "stabilized" => Self::Stabilised,
            "swing" => Self::Swing,
            "bullet" => Self::Bullet,
            _ => Self::File(name.strip_prefix("test:").unwrap_or(name).into()),
        }
    }

    /// Its cameras in a scene.
    ///
    /// # Errors
    ///
    /// [`Error::Refused`] for options that cannot work, [`Error::Time`] for moments outside the
    /// scene, [`Error::ReadData`] for a file that cannot be used.
    pub fn plan(
        &self,
        scene: &Scene,
        painter: &mut Painter<'_>,
        job: &RenderJob,
    ) -> Result<Plan, Error> {
        job.options.check(self)?;
        let fps = job.fps.unwrap_or_else(|| self.own_fps(scene));
        if let Self::File(path) = self {
            return file(path, scene, job);
        }
        let source = SourcePath::new(scene, &self.to_string())?;
        let maker = Maker {
            scene,
            source: &source,
            options: &job.options,
            fps,
            at: anchor(job, &Span::of(scene))?,
        };
        Ok(Plan {
            stops: maker.stops(self, painter)?,
            fps,
        })
    }

    fn own_fps(&self, scene: &Scene) -> f64 {
        let own = source_fps(scene);
        if *self == Self::Train || own >= SMOOTH_FPS {
            own
        } else {
            super::DEFAULT_FPS
        }
    }
}

/// The moment that was asked for, frames: where to start, or where time is frozen.
fn anchor(job: &RenderJob, span: &Span) -> Result<Option<f64>, Error> {
    let frozen = match job.time {
        TimePath::Freeze(moment) => Some(moment),
        _ => None,
    };
    Ok(job
        .options
        .at
        .or(frozen)
        .map(|m| span.frames(m))
        .transpose()?)
}

/// Images of an open path: one at both ends, if the rate meets them.
fn open_frames(seconds: f64, fps: f64) -> Result<usize, Refusal> {
    limited((seconds * fps + 1e-6).floor() + 1.0, seconds, fps)
}

/// Images of a path that is closed: the last is the one before the first.
fn closed_frames(seconds: f64, fps: f64) -> Result<usize, Refusal> {
    limited((seconds * fps).round().max(1.0), seconds, fps)
}

fn limited(frames: f64, seconds: f64, fps: f64) -> Result<usize, Refusal> {
    if frames <= MAX_FRAMES as f64 {
        Ok(frames as usize)
    } else {
        Err(Refusal::usage(format!(
            "the path takes {seconds} s, which is {frames} images at {fps} per second; at most {MAX_FRAMES} are rendered, so choose fewer \
             seconds or a lower rate"
        )))
    }
}

struct Maker<'a> {
    scene: &'a Scene,
    source: &'a SourcePath,
    options: &'a PathOptions,
    fps: f64,
    /// Frames.
    at: Option<f64>,
}

impl Maker<'_> {
    fn stops(
        &self,
        path: &CameraPath,
        painter: &mut Painter<'_>,
    ) -> Result<Vec<SourceFrame>, Refusal> {
        match path {
            // A file does not come here: it has no need of a maker.
            CameraPath::Train | CameraPath::File(_) => Ok(match self.options.at {
                Some(_) => vec![self.source.at(self.at.unwrap_or(0.0))],
                None => self.scene.source.clone(),
            }),
            CameraPath::Source => self.along(|t| self.source.at(t)),
            CameraPath::Stabilised => self.stabilised(painter),
            CameraPath::Bullet => self.bullet(painter),
            CameraPath::Swing => self.swing(painter),
        }
    }

    /// From the first to the last frame of the source, or the one moment that is asked for.
    fn along(&self, stop: impl Fn(f64) -> SourceFrame) -> Result<Vec<SourceFrame>, Refusal> {
        if let (Some(t), Some(_)) = (self.at, self.options.at) {
            return Ok(vec![stop(t)]);
        }
        let own_s = self.source.seconds();
        let seconds = self.options.seconds.unwrap_or(own_s);
        let pace = if seconds > 0.0 { own_s / seconds } else { 0.0 };
        let n = open_frames(seconds, self.fps)?;
        Ok((0..n)
            .map(|i| stop(self.source.moment(pace * i as f64 / self.fps)))
            .collect())
    }

    fn stabilised(&self, painter: &mut Painter<'_>) -> Result<Vec<SourceFrame>, Refusal> {
        let region = self.region(painter);
        let smoothed = source::stabilised(self.source, region.distance);
        self.along(|t| {
            let mut stop = self.source.at(t);
            stop.camera.c2w = smoothed.at(t);
            stop
        })
    }

    /// About what one camera sees, in the moment of that camera.
    fn swing(&self, painter: &mut Painter<'_>) -> Result<Vec<SourceFrame>, Refusal> {
        let region = self.region(painter);
        let seconds = self.options.seconds.unwrap_or(SWING_S);
        let n = closed_frames(seconds, self.fps)?;
        let stops = (0..n).map(|i| SourceFrame {
            camera: swing_camera(&region, i as f64 / n as f64, self.options),
            t: region.stop.t,
            exposure: Exposure::IDENTITY,
            distance_sigma: None,
        });
        Ok(stops.collect())
    }

    fn bullet(&self, painter: &mut Painter<'_>) -> Result<Vec<SourceFrame>, Refusal> {
        let region = self.region(painter);
        let (first, _) = self.source.span();
        let freeze_s = (region.stop.t - first) / self.source.frames_per_s;
        let bullet = Bullet::new(freeze_s, self.source.seconds(), self.options.seconds)?;
        let n = open_frames(bullet.seconds(), self.fps)?;
        let stop = |i: usize| bullet.stop(i as f64 / self.fps, self.source, &region, self.options);
        Ok((0..n).map(stop).collect())
    }

    /// Where a path starts: at the moment asked for, or at the source's middle frame.
    fn region(&self, painter: &mut Painter<'_>) -> Region {
        let middle = self
            .scene
            .source
            .get(self.scene.source.len() / 2)
            .map_or(0.0, |s| s.t);
        let stop = self.source.at(self.at.unwrap_or(middle));
        Region::of(self.scene, painter, stop)
    }
}

fn file(path: &Path, scene: &Scene, job: &RenderJob) -> Result<Plan, Error> {
    if path.extension().is_none() && !path.exists() {
        let (name, words) = (path.display().to_string(), WORDS.join(", "));
        return Err(Refusal::usage(format!(
            "there is no camera path {name:?}; write {words}, or the name of a file"
        ))
        .into());
    }
    match trajectory::load(path, scene.time_frames)? {
        Trajectory::Listed(listed) => {
            if job.options.seconds.is_some() {
                return Err(unused("seconds", &path.display().to_string(), &[]).into());
            }
            let stops = listed.into_iter().map(|(camera, t)| SourceFrame {
                camera,
                t,
                exposure: Exposure::IDENTITY,
                distance_sigma: None,
            });
            Ok(Plan {
                stops: stops.collect(),
                fps: job.fps.unwrap_or_else(|| source_fps(scene)),
            })
        }
        Trajectory::Keyed(keyed) => {
            let source = SourcePath::new(scene, &path.display().to_string())?;
            let through = KeyedPath::new(&keyed, &source, &Span::of(scene))?;
            let fps = job
                .fps
                .or(keyed.fps)
                .unwrap_or_else(|| CameraPath::Source.own_fps(scene));
            let seconds = job.options.seconds.unwrap_or(through.seconds);
            let pace = if seconds > 0.0 {
                through.seconds / seconds
            } else {
                0.0
            };
            let n = if through.closed {
                closed_frames(seconds, fps)?
            } else if through.seconds > 0.0 {
                open_frames(seconds, fps)?
            } else {
                1
            };
            Ok(Plan {
                stops: (0..n).map(|i| through.at(pace * i as f64 / fps)).collect(),
                fps,
            })
        }
    }
}

#[cfg(test)]
mod tests;
