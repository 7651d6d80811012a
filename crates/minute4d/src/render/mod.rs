//! Renders images of a trained scene along a camera path into files.

mod draw;
mod options;
mod path;
mod region;
mod spline;
mod swing;
mod time;

pub use draw::{Painter, SceneRenderer, to_rgb, view};
pub use options::{PathConfig, PathOptions};
pub use path::{CameraPath, Plan, SourcePath, Stop};
pub use region::Region;
pub use spline::{PoseSpline, Spline};
pub use swing::{SwingConfig, swing};
pub use time::{Moment, Span, TimeError, TimePath};

use crate::device::DeviceChoice;
use crate::folder::SCENE_FILE;
use crate::{Error, Observer, Refusal};
use draw::Sink;
use m4_core::{Intrinsics, Scene};
use m4_io::scene::safetensors;
use m4_kernels::SimdLevel;
use std::path::Path;
use std::time::Instant;

/// Frames a second where the scene does not say.
pub const DEFAULT_FPS: f64 = 30.0;

/// A rendering job.
#[derive(Debug, Clone, PartialEq)]
pub struct RenderJob {
    /// Cameras.
    pub path: CameraPath,
    /// The options of the path.
    pub options: PathOptions,
    /// The defaults of the path.
    pub config: PathConfig,
    /// Moments.
    pub time: TimePath,
    /// Frames a second; `None` for that of the file of cameras or of the source.
    pub fps: Option<f64>,
    /// Columns and rows of the images; `None` for those of the cameras.
    pub size: Option<(usize, usize)>,
    /// Treatment of a different aspect ratio.
    pub fit: Fit,
    /// Times the focal length.
    pub zoom: f64,
    /// Replace existing files.
    pub replace: bool,
    /// The device that renders.
    pub device: DeviceChoice,
}

impl RenderJob {
    /// A path as it is by itself.
    pub fn new(path: CameraPath) -> Self {
        Self {
            path,
            options: PathOptions::default(),
            config: PathConfig::default(),
            time: TimePath::Source,
            fps: None,
            size: None,
            fit: Fit::default(),
            zoom: 1.0,
            replace: false,
            device: DeviceChoice::default(),
        }
    }

    /// Every camera and moment of the images.
    ///
    /// # Errors
    ///
    /// As [`CameraPath::plan`]; [`Error::Time`] if a moment lies outside the scene, [`Error::Refused`] for
    /// sizes that are not rendered.
    pub fn plan(&self, scene: &Scene, painter: &mut Painter<'_>) -> Result<Plan, Error> {
        let mut plan = self.path.plan(scene, painter, self)?;
        let own: Vec<f64> = plan.stops.iter().map(|stop| stop.t).collect();
        let moments = self.time.moments(&own, plan.fps, &path::span(scene))?;
        for (stop, t) in plan.stops.iter_mut().zip(moments) {
            stop.t = t;
            let k = &mut stop.camera.intrinsics;
            *k = zoomed(k, self.zoom);
            if let Some(size) = self.size {
                *k = fitted(k, size, self.fit)?;
            }
        }
        Ok(plan)
    }
}

/// The report of a rendering.
#[derive(Debug, Clone, PartialEq)]
pub struct Rendered {
    /// Images written.
    pub frames: usize,
    /// Images a second of the path.
    pub fps: f64,
    /// Columns and rows of the first image.
    pub size: (usize, usize),
    /// Wall-clock seconds.
    pub seconds: f64,
    /// The GPU that drew, or the processor's vector instructions.
    pub device: String,
}

/// Renders a scene (a file, or the folder of a run) to a folder of PNG images, to an MP4 where `out`
/// ends in `.mp4`, or to one image where it ends in `.png` or `.jpg`. An MP4 is read back and its frames
/// are counted before it gets its name.
///
/// # Errors
///
/// [`Error`]: the scene or the cameras cannot be read, a moment lies outside the scene, options cannot
/// work, or the images cannot be written.
pub fn make(scene: &Path, out: &Path, job: &RenderJob, observer: &dyn Observer) -> Result<Rendered, Error> {
    let start = Instant::now();
    Sink::check(out, job.replace)?;
    let level = SimdLevel::detect()?;
    let file = if scene.is_dir() { scene.join(SCENE_FILE) } else { scene.to_path_buf() };
    let scene = safetensors::read(&file)?.scene;
    let gpu = job.device.open()?;
    let mut renderer = SceneRenderer::new(&scene, level, gpu.as_ref())?;
    let plan = job.plan(&scene, renderer.painter())?;
    let stops = &plan.stops;
    let mut sink = Sink::open(out, stops, plan.fps, job.replace)?;
    for (i, stop) in stops.iter().enumerate() {
        if observer.cancelled() {
            return Err(Error::Stopped { stage: "render", saved: false });
        }
        let image = renderer.image(&stop.camera, stop.t, &stop.exposure)?;
        sink.push(&image)?;
        observer.update("render", i + 1, stops.len(), "");
    }
    sink.finish()?;
    let size = stops.first().map_or((0, 0), |s| (s.camera.intrinsics.width, s.camera.intrinsics.height));
    Ok(Rendered {
        frames: stops.len(),
        fps: plan.fps,
        size,
        seconds: start.elapsed().as_secs_f64(),
        device: gpu.map_or_else(|| level.name().to_owned(), |gpu| gpu.name().to_owned()),
    })
}

/// Frames a second of the video that a scene was made of.
pub fn source_fps(scene: &Scene) -> f64 {
    let steps = scene.time_frames.saturating_sub(1) as f64;
    match scene.duration_s {
        Some(duration_s) if duration_s > 0.0 && steps > 0.0 => (steps / duration_s).clamp(1.0, 240.0),
        _ => DEFAULT_FPS,
    }
}

/// Longest side of an image, pixels.
pub const MAX_SIDE_PX: usize = 16_384;

/// Treatment of a different aspect ratio.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Fit {
    /// The middle of the view fills the image; the rest is cut off.
    #[default]
    Crop,
    /// All of the view is in the image, and beside it what lies beyond.
    Extend,
}

/// The same view on an image of `width` x `height` pixels: pixels keep their shape, the middle of the
/// image stays the middle, and the principal point moves with it.
pub fn fitted(k: &Intrinsics, (width, height): (usize, usize), fit: Fit) -> Result<Intrinsics, Refusal> {
    let fits = |side: usize| (1..=MAX_SIDE_PX).contains(&side);
    if !fits(width) || !fits(height) {
        return Err(Refusal::usage(format!(
            "images of {width} x {height} pixels are not supported; each side must have 1 to {MAX_SIDE_PX}"
        )));
    }
    let (w, h) = (width as f64, height as f64);
    let (across, down) = (w / k.width as f64, h / k.height as f64);
    let scale = match fit {
        Fit::Crop => across.max(down),
        Fit::Extend => across.min(down),
    };
    Ok(Intrinsics {
        width,
        height,
        fx: k.fx * scale,
        fy: k.fy * scale,
        cx: 0.5 * w + (k.cx - 0.5 * k.width as f64) * scale,
        cy: 0.5 * h + (k.cy - 0.5 * k.height as f64) * scale,
    })
}

/// The same image with everything `factor` times as large about the principal point.
pub fn zoomed(k: &Intrinsics, factor: f64) -> Intrinsics {
    Intrinsics { fx: k.fx * factor, fy: k.fy * factor, ..*k }
}

#[cfg(test)]
mod tests {
    use super::{Fit, fitted};
    use m4_core::Intrinsics;

    const K: Intrinsics = Intrinsics { width: 480, height: 360, fx: 400.0, fy: 410.0, cx: 250.0, cy: 170.0 };

    #[test]
    fn fitting_keeps_the_ray_through_the_image_centre() {
        // The ray through the middle of the image, whatever the size.
        let middle = |k: &Intrinsics| {
            let (w, h) = (k.width as f64, k.height as f64);
            ((0.5 * w - k.cx) / k.fx, (0.5 * h - k.cy) / k.fy)
        };
        for size in [(960, 720), (333, 111), (111, 333), (481, 361)] {
            for fit in [Fit::Crop, Fit::Extend] {
                let got = fitted(&K, size, fit).unwrap();
                let ((a, b), (c, d)) = (middle(&K), middle(&got));
                assert!((a - c).abs() < 1e-12 && (b - d).abs() < 1e-12, "{size:?} {fit:?}");
                assert!((got.fx / got.fy - K.fx / K.fy).abs() < 1e-12);
            }
        }
        assert_eq!(fitted(&K, (960, 720), Fit::Crop).unwrap(), K.resized(960, 720));
    }

    #[test]
    fn a_crop_shows_less_and_an_extension_more() {
        // A square out of 4:3: cropped, it has the height of the view; extended, its width.
        let crop = fitted(&K, (360, 360), Fit::Crop).unwrap();
        assert_eq!((crop.fx, crop.cx, crop.cy), (400.0, 190.0, 170.0));
        let extended = fitted(&K, (480, 480), Fit::Extend).unwrap();
        assert_eq!((extended.fx, extended.cx, extended.cy), (400.0, 250.0, 230.0));
        assert!(fitted(&K, (0, 9), Fit::Crop).is_err() && fitted(&K, (9, 20_000), Fit::Crop).is_err());
    }
}
