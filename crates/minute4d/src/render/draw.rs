//! Draws scenes, on the processor or a GPU, and writes the images to their destination.

mod images;

use crate::device::{Draw, OpenGpu};
use crate::error::OutputError;
use crate::{Error, Observer, Refusal};
use images::ImageWriters;
use m4_core::{Camera, Exposure, Plane, RgbImage, Scene, SourceFrame};
use m4_io::image;
use m4_io::results::{self, Kind, ResultFolder};
use m4_io::video::Mp4Writer;
use m4_kernels::{Frame, Renderer, SimdLevel, View};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Draws images of one scene, one after the other.
pub struct Painter<'a> {
    scene: &'a Scene,
    renderer: Renderer,
}

impl<'a> Painter<'a> {
    /// Draws `scene` on the vector instructions given.
    pub fn new(scene: &'a Scene, level: SimdLevel) -> Self {
        Self {
            scene,
            renderer: Renderer::new(level),
        }
    }

    /// Renders a camera at a time (frames), before exposure.
    pub fn frame(&mut self, camera: &Camera, t: f64, with_depth: bool) -> &Frame {
        let view = View {
            with_depth,
            ..view(self.scene, camera, t)
        };
        self.renderer.render(&self.scene.splats, &view)
    }

    /// Renders an 8-bit image with an exposure.
    pub fn image(&mut self, camera: &Camera, t: f64, exposure: &Exposure) -> RgbImage {
        to_rgb(self.frame(camera, t, false), exposure)
    }

    /// Median z-depth of a view at a time (frames), world units; `None` for an empty view.
    pub fn median_depth(&mut self, camera: &Camera, t: f64) -> Option<f64> {
        let frame = self.frame(camera, t, true);
        let depth = frame.depth.iter().zip(&frame.transmittance);
        let mut depths: Vec<f32> = depth
            .filter(|&(_, &passed)| passed < 0.5)
            .map(|(&sum, &passed)| sum / (1.0 - passed))
            .filter(|z| z.is_finite() && *z > 0.0)
            .collect();
        m4_core::median(&mut depths).map(f64::from)
    }
}

/// A view of a scene as it was trained to be seen.
pub fn view(scene: &Scene, camera: &Camera, t: f64) -> View {
    View {
        camera: *camera,
        t,
        background: scene.background,
        near: scene.near,
        mip: scene.mip,
        period: scene.period_frames() as f32,
        with_depth: false,
    }
}

/// Exposed, clamped and rounded to 8 bits per channel.
pub fn to_rgb(frame: &Frame, exposure: &Exposure) -> RgbImage {
    let (m, o) = (&exposure.matrix, &exposure.offset);
    let mut out = Plane::filled(frame.width, frame.height, [0; 3]);
    let rows = out
        .data_mut()
        .par_chunks_exact_mut(frame.width.max(1))
        .enumerate();
    rows.for_each(|(y, row)| {
        for (x, out) in row.iter_mut().enumerate() {
            let i = y * frame.width + x;
            let c = [frame.rgb[0][i], frame.rgb[1][i], frame.rgb[2][i]];
            *out = std::array::from_fn(|r| {
                let value = m[r][0] * c[0] + m[r][1] * c[1] + m[r][2] * c[2] + o[r];
                (value.clamp(0.0, 1.0) * 255.0).round() as u8
            });
        }
    });
    out
}

/// Renders a scene on a GPU if there is one, else on the CPU, and from the image on at which a GPU
/// fails that no one asked for.
pub struct SceneRenderer<'a> {
    scene: &'a Scene,
    painter: Painter<'a>,
    on_gpu: Option<OnGpu>,
    observer: &'a dyn Observer,
}

/// What draws on a GPU.
struct OnGpu {
    frame: Box<Draw>,
    /// Whether the CPU may take over.
    automatic: bool,
}

impl<'a> SceneRenderer<'a> {
    /// Copies the splats to the GPU, if there is one; `observer` is warned where the CPU takes
    /// over.
    ///
    /// # Errors
    ///
    /// [`Error`] of a GPU that was asked for and cannot hold the splats.
    pub fn new(
        scene: &'a Scene,
        level: SimdLevel,
        gpu: Option<&OpenGpu>,
        observer: &'a dyn Observer,
    ) -> Result<Self, Error> {
        let mut out = Self {
            scene,
            painter: Painter::new(scene, level),
            on_gpu: None,
            observer,
        };
        if let Some(gpu) = gpu {
            match gpu.painter(&scene.splats) {
                Ok(frame) => {
                    let automatic = gpu.is_automatic();
                    out.on_gpu = Some(OnGpu { frame, automatic });
                }
                Err(error) if gpu.is_automatic() => out.leave_gpu(&error),
                Err(error) => return Err(error),
            }
        }
        Ok(out)
    }

    /// The CPU painter, for planning paths.
    pub fn painter(&mut self) -> &mut Painter<'a> {
        &mut self.painter
    }

    /// Whether the next image is drawn on the GPU.
    pub fn is_on_gpu(&self) -> bool {
        self.on_gpu.is_some()
    }

    /// Renders a camera at a time (frames) as the kernels give it: without exposure, clamping or
    /// rounding.
    ///
    /// # Errors
    ///
    /// [`Error`] of a GPU that was asked for and fails.
    pub fn frame(&mut self, camera: &Camera, t: f64) -> Result<Frame, Error> {
        match self.frame_on_gpu(camera, t)? {
            Some(frame) => Ok(frame),
            None => Ok(self.painter.frame(camera, t, false).clone()),
        }
    }

    /// Renders a camera at a time (frames) to eight bits per channel, with an exposure.
    ///
    /// # Errors
    ///
    /// As [`Self::frame`].
    pub fn image(
        &mut self,
        camera: &Camera,
        t: f64,
        exposure: &Exposure,
    ) -> Result<RgbImage, Error> {
        match self.frame_on_gpu(camera, t)? {
            Some(frame) => Ok(to_rgb(&frame, exposure)),
            None => Ok(self.painter.image(camera, t, exposure)),
        }
    }

    /// `None` where the CPU is to draw.
    fn frame_on_gpu(&mut self, camera: &Camera, t: f64) -> Result<Option<Frame>, Error> {
        let Some(gpu) = &mut self.on_gpu else {
            return Ok(None);
        };
        match (gpu.frame)(&view(self.scene, camera, t)) {
            Ok(frame) => Ok(Some(frame)),
            Err(error) if gpu.automatic => {
                self.leave_gpu(&error);
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    fn leave_gpu(&mut self, error: &Error) {
        self.observer
            .warn(&format!("{error}; the CPU draws from here on"));
        self.on_gpu = None;
    }
}

/// Video files that are not written, and would otherwise become folders.
const OTHER_VIDEOS: [&str; 8] = ["mov", "avi", "mkv", "webm", "m4v", "gif", "webp", "apng"];
const IMAGE_EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];

/// The destination of images.
pub(super) enum Sink {
    /// `00000.png` and so on.
    Folder {
        results: ResultFolder,
        images: ImageWriters,
    },
    /// One image.
    Image(PathBuf),
    /// A clip.
    Video(Box<Mp4Writer>),
}

impl Sink {
    /// Refuses names that cannot work, before anything is computed.
    pub fn check(out: &Path, replace: bool, inputs: &[&Path]) -> Result<(), Error> {
        let extension = extension(out);
        if OTHER_VIDEOS.contains(&extension.as_str()) {
            let path = out.display();
            return Err(Refusal::usage(format!(
                "{path} has the extension {extension}, which is not supported; name an .mp4 file, a .png file or a folder"
            ))
            .into());
        }
        if !is_file(&extension) {
            return Ok(());
        }
        results::check_target(out, inputs)?;
        if out.exists() && !replace {
            return Err(OutputError::would_replace(out).into());
        }
        Ok(())
    }

    /// Makes the place for the images of `stops`.
    pub fn open(out: &Path, stops: &[SourceFrame], fps: f64, replace: bool) -> Result<Self, Error> {
        let path = out.to_path_buf();
        let extension = extension(out);
        if IMAGE_EXTENSIONS.contains(&extension.as_str()) {
            if stops.len() != 1 {
                let (path, frames) = (path.display(), stops.len());
                return Err(Refusal::usage(format!(
                    "{path} is one image, but the path has {frames}; name a folder or an .mp4 file, or choose the path source and \
                     one time"
                ))
                .into());
            }
            return Ok(Self::Image(path));
        }
        if !is_file(&extension) {
            let mut results = ResultFolder::open(out, Kind::Render)?;
            if !results.is_empty() && !replace {
                return Err(OutputError::WouldReplace { path }.into());
            }
            let names: Vec<String> = (0..stops.len()).map(images::numbered).collect();
            results.check_free(names.iter().map(String::as_str))?;
            let images = ImageWriters::new(results.begin()?);
            return Ok(Self::Folder { results, images });
        }
        let size = stops.first().map_or((0, 0), |s| {
            (s.camera.intrinsics.width, s.camera.intrinsics.height)
        });
        Ok(Self::Video(Box::new(Mp4Writer::create(
            out, size.0, size.1, fps,
        )?)))
    }

    /// The next image, which is encoded while others are drawn.
    pub fn push(&mut self, rgb: RgbImage) -> Result<(), Error> {
        match self {
            Self::Folder { images, .. } => images.push(rgb)?,
            Self::Image(path) => image::write_rgb(path, &rgb)?,
            Self::Video(writer) => writer.push(rgb)?,
        }
        Ok(())
    }

    /// Completes the file, or puts the images into the place of those of an earlier render.
    pub fn finish(self) -> Result<(), Error> {
        match self {
            Self::Folder {
                mut results,
                images,
            } => {
                images.finish()?;
                results.commit(None)?;
                Ok(())
            }
            Self::Image(_) => Ok(()),
            Self::Video(writer) => Ok(writer.finish()?),
        }
    }
}

fn extension(out: &Path) -> String {
    out.extension()
        .map_or_else(String::new, |e| e.to_string_lossy().to_lowercase())
}

fn is_file(extension: &str) -> bool {
    extension == "mp4" || IMAGE_EXTENSIONS.contains(&extension)
}

#[cfg(test)]
mod tests {
    use super::{OnGpu, Painter, SceneRenderer};
    use crate::Error;
    use crate::observer::RecordingObserver;
    use m4_core::{Camera, Exposure, Intrinsics, Se3, Silent};
    use m4_kernels::SimdLevel;
    use m4_testkit::{SceneSpec, random_scene};

    #[test]
    fn the_cpu_takes_over_from_a_gpu_that_no_one_asked_for() {
        let scene = random_scene(&SceneSpec::default());
        let camera = Camera {
            intrinsics: Intrinsics::centred(48, 32, 40.0),
            c2w: Se3::identity(),
        };
        let level = SimdLevel::detect().unwrap();
        let drawn = Painter::new(&scene, level).image(&camera, 1.0, &Exposure::IDENTITY);
        let observer = RecordingObserver::new(&Silent);
        let with = |automatic: bool| {
            let frame = Box::new(|_: &_| Err(Error::internal("device lost")));
            let on_gpu = Some(OnGpu { frame, automatic });
            SceneRenderer {
                on_gpu,
                ..SceneRenderer::new(&scene, level, None, &observer).unwrap()
            }
        };
        let mut automatic = with(true);
        for _ in 0..2 {
            assert!(automatic.image(&camera, 1.0, &Exposure::IDENTITY).unwrap() == drawn);
            assert!(!automatic.is_on_gpu());
        }
        let warnings = observer.warnings();
        assert!(
            warnings.len() == 1
                && warnings[0].contains("device lost")
                && warnings[0].contains("CPU"),
            "{warnings:?}"
        );
        assert!(
            with(false)
                .image(&camera, 1.0, &Exposure::IDENTITY)
                .is_err()
        );
    }
}
