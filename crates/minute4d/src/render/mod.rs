//! Renders images of a trained scene along a camera path into files.

mod draw;
mod options;
mod path;
mod region;
mod spline;
mod swing;

pub use draw::{Painter, SceneRenderer, to_rgb, view};
pub use options::PathOptions;
pub use path::{CameraPath, Plan, SourcePath};
pub use region::Region;
pub use spline::{PoseSpline, Spline};
pub use swing::{SWING_FRAMES, swing};

pub use crate::time::{DEFAULT_FPS, Moment, Span, TimeError, TimePath};

use crate::device::DeviceChoice;
use crate::layout::SCENE_FILE;
use crate::observer::check_stop;
use crate::{Error, Observer, Refusal};
use draw::Sink;
use m4_core::{Intrinsics, Scene};
use m4_io::scene::safetensors;
use m4_kernels::SimdLevel;
use std::path::Path;
use std::time::Instant;

/// A rendering job.
#[derive(Debug, Clone, PartialEq)]
pub struct RenderJob {
    /// Cameras.
    pub path: CameraPath,
    /// The options of the path.
    pub options: PathOptions,
    /// Moments.
    pub time: TimePath,
    /// Frames a second; `None` for that of the file of cameras or of the source.
    pub fps: Option<f64>,
    /// Columns and rows of the images; `None` for those of the cameras. A view of another aspect
    /// ratio is cropped.
    pub size: Option<(usize, usize)>,
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
            time: TimePath::Source,
            fps: None,
            size: None,
            replace: false,
            device: DeviceChoice::default(),
        }
    }

    /// Every camera and moment of the images.
    ///
    /// # Errors
    ///
    /// As [`CameraPath::plan`]; [`Error::Time`] if a moment lies outside the scene,
    /// [`Error::Refused`] for sizes that are not rendered.
    pub fn plan(&self, scene: &Scene, painter: &mut Painter<'_>) -> Result<Plan, Error> {
        let mut plan = self.path.plan(scene, painter, self)?;
        let own: Vec<f64> = plan.stops.iter().map(|stop| stop.t).collect();
        let moments = self.time.moments(&own, plan.fps, &Span::of(scene))?;
        for (stop, t) in plan.stops.iter_mut().zip(moments) {
            stop.t = t;
            if let Some(size) = self.size {
                stop.camera.intrinsics = cropped(&stop.camera.intrinsics, size)?;
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
    /// The GPU that drew all images, or the processor's vector instructions.
    pub device: String,
}

/// Renders a scene (a file, or the folder of a run) to a folder of PNG images, to an MP4 where
/// `out` ends in `.mp4`, or to one image where it ends in `.png` or `.jpg`. An MP4 is read back and
/// its frames are counted before it gets its name.
///
/// # Errors
///
/// [`Error`]: the scene or the cameras cannot be read, a moment lies outside the scene, options cannot
/// work, or the images cannot be written.
pub fn make(
    scene: &Path,
    out: &Path,
    job: &RenderJob,
    observer: &dyn Observer,
) -> Result<Rendered, Error> {
    let start = Instant::now();
    Sink::check(out, job.replace, &[scene])?;
    let level = SimdLevel::detect()?;
    crate::layout::settle(scene)?;
    let file = if scene.is_dir() {
        scene.join(SCENE_FILE)
    } else {
        scene.to_path_buf()
    };
    let scene = safetensors::read(&file)?.scene;
    let gpu = job.device.open(|why| observer.warn(why))?;
    let mut renderer = SceneRenderer::new(&scene, level, gpu.as_ref(), observer)?;
    let plan = job.plan(&scene, renderer.painter())?;
    let stops = &plan.stops;
    let mut sink = Sink::open(out, stops, plan.fps, job.replace)?;
    for (i, stop) in stops.iter().enumerate() {
        check_stop(observer, "render", false)?;
        let image = renderer.image(&stop.camera, stop.t, &stop.exposure)?;
        sink.push(image)?;
        observer.update("render", i + 1, stops.len(), "");
    }
    sink.finish()?;
    let size = stops.first().map_or((0, 0), |s| {
        (s.camera.intrinsics.width, s.camera.intrinsics.height)
    });
    Ok(Rendered {
        frames: stops.len(),
        fps: plan.fps,
        size,
        seconds: start.elapsed().as_secs_f64(),
        device: gpu
            .as_ref()
            .filter(|_| renderer.is_on_gpu())
            .map_or(level.name(), |gpu| gpu.name())
            .to_owned(),
    })
}

/// Frames a second of the video that a scene was made of.
pub fn source_fps(scene: &Scene) -> f64 {
    let steps = scene.time_frames.saturating_sub(1) as f64;
    match scene.duration_s {
        Some(duration_s) if duration_s > 0.0 && steps > 0.0 => {
            (steps / duration_s).clamp(1.0, 240.0)
        }
        _ => DEFAULT_FPS,
    }
}

/// Longest side of an image, pixels.
pub const MAX_SIDE_PX: usize = 16_384;

/// The same view on an image of `width` x `height` pixels, cut off where the aspect ratio differs:
/// pixels keep their shape, the middle of the image stays the middle, and the principal point moves
/// with it.
fn cropped(k: &Intrinsics, (width, height): (usize, usize)) -> Result<Intrinsics, Refusal> {
    let fits = |side: usize| (1..=MAX_SIDE_PX).contains(&side);
    if !fits(width) || !fits(height) {
        return Err(Refusal::usage(format!(
            "images of {width} x {height} pixels are not supported; each side must have 1 to {MAX_SIDE_PX}"
        )));
    }
    let (w, h) = (width as f64, height as f64);
    let scale = (w / k.width as f64).max(h / k.height as f64);
    Ok(Intrinsics {
        width,
        height,
        fx: k.fx * scale,
        fy: k.fy * scale,
        cx: 0.5 * w + (k.cx - 0.5 * k.width as f64) * scale,
        cy: 0.5 * h + (k.cy - 0.5 * k.height as f64) * scale,
    })
}

#[cfg(test)]
mod tests {
    use super::cropped;
    use m4_core::Intrinsics;

    const K: Intrinsics = Intrinsics {
        width: 480,
        height: 360,
        fx: 400.0,
        fy: 410.0,
        cx: 250.0,
        cy: 170.0,
    };

    #[test]
    fn a_crop_keeps_the_ray_through_the_image_centre() {
        // The ray through the middle of the image, whatever the size.
        let middle = |k: &Intrinsics| {
            let (w, h) = (k.width as f64, k.height as f64);
            ((0.5 * w - k.cx) / k.fx, (0.5 * h - k.cy) / k.fy)
        };
        for size in [(960, 720), (333, 111), (111, 333), (481, 361)] {
            let got = cropped(&K, size).unwrap();
            let ((a, b), (c, d)) = (middle(&K), middle(&got));
            assert!((a - c).abs() < 1e-12 && (b - d).abs() < 1e-12, "{size:?}");
            assert!((got.fx / got.fy - K.fx / K.fy).abs() < 1e-12);
        }
        assert_eq!(cropped(&K, (960, 720)).unwrap(), K.resized(960, 720));
        // A square out of 4:3 has the height of the view.
        let square = cropped(&K, (360, 360)).unwrap();
        assert_eq!((square.fx, square.cx, square.cy), (400.0, 190.0, 170.0));
        assert!(cropped(&K, (0, 9)).is_err() && cropped(&K, (9, 20_000)).is_err());
    }
}
