//! The metadata of a scene that the page gets in addition to its splats.

use crate::payload::Payload;
use m4_core::{Scene, SourceFrame};
use serde::{Deserialize, Serialize};

/// Version of the manifest; a page reads one.
pub const MANIFEST_VERSION: u32 = 2;

/// The JSON in the page. Axes, units and colours are those of [`m4_core`].
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`MANIFEST_VERSION`].
    pub version: u32,
    /// For the title of the page.
    pub title: String,
    /// Contents of the payload.
    pub splats: SplatFacts,
    /// Colour behind everything, 0..1.
    pub background: [f32; 3],
    /// Time runs from 0 to one less than this, frames.
    pub time_frames: usize,
    /// Seconds from the first to the last frame, where known.
    pub duration_s: Option<f64>,
    /// Frames a second of the source; a guess where the scene does not say.
    pub fps: f64,
    /// Opacity-compensated 2D filter on.
    pub mip: bool,
    /// Splats nearer than this z-depth are not drawn, world units.
    pub near: f32,
    /// Period of the first temporal harmonic of the colour, frames.
    pub period_frames: f64,
    /// Those of the source, in order of time.
    pub cameras: Vec<SourceCamera>,
    /// The point at the median depth on the axis of the middle camera: what an orbit goes about.
    pub centre: [f64; 3],
    /// Range of cameras from which the scene looks right.
    pub safe: SafeOrbit,
    /// The frames of the source in the page, one per camera.
    pub frames: Option<FrameIndex>,
    /// Where the page hears of newer scenes; none in a file.
    pub live: Option<Live>,
}

/// Number of splats by kind.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SplatFacts {
    /// Splats without time parameters.
    pub r#static: usize,
    /// Splats with time parameters.
    pub dynamic: usize,
    /// Those of them that are bound to nodes.
    #[serde(default, skip_serializing_if = "is_none")]
    pub bound: usize,
    /// Degree of the spatial harmonics of the colour.
    pub sh_degree: usize,
    /// Highest temporal harmonic of the colour.
    pub time_degree: usize,
    /// One scale per splat and no rotation.
    pub isotropic: bool,
    /// Bytes of the payload before gzip.
    pub bytes: usize,
}

/// Whether a number may be left out: pages before bound splats do not have it.
#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde hands over a reference"
)]
fn is_none(count: &usize) -> bool {
    *count == 0
}

impl From<&Payload> for SplatFacts {
    fn from(payload: &Payload) -> Self {
        Self {
            r#static: payload.n_static,
            dynamic: payload.n_dynamic,
            bound: payload.n_bound,
            sh_degree: payload.layout.sh_degree,
            time_degree: payload.layout.time_degree,
            isotropic: payload.layout.isotropic,
            bytes: payload.bytes.len(),
        }
    }
}

/// A camera of the source.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SourceCamera {
    /// Frames.
    pub t: f64,
    /// Camera to world, 4x4 row-major, OpenCV axes.
    pub c2w: [f64; 16],
    /// Horizontal focal length, pixels.
    pub fx: f64,
    /// Vertical focal length, pixels.
    pub fy: f64,
    /// Principal point from the left edge, pixels.
    pub cx: f64,
    /// Principal point from the top edge, pixels.
    pub cy: f64,
    /// Columns of its images.
    pub width: usize,
    /// Rows of its images.
    pub height: usize,
    /// Relative standard deviation of the distance of the frame's dynamic objects, where known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distance_sigma: Option<f32>,
}

impl From<&SourceFrame> for SourceCamera {
    fn from(frame: &SourceFrame) -> Self {
        let k = &frame.camera.intrinsics;
        let m = frame.camera.c2w.matrix();
        Self {
            t: frame.t,
            c2w: std::array::from_fn(|i| m[(i / 4, i % 4)]),
            fx: k.fx,
            fy: k.fy,
            cx: k.cx,
            cy: k.cy,
            width: k.width,
            height: k.height,
            distance_sigma: frame.distance_sigma,
        }
    }
}

/// Camera distance at which the page begins to fade.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct SafeOrbit {
    /// From the nearest source camera, world units.
    pub radius: f64,
}

/// Where each frame begins in the clip, which is H.264 as a byte stream (Annex B).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameIndex {
    /// Columns of every frame.
    pub width: usize,
    /// Rows of every frame.
    pub height: usize,
    /// Profile and level, as a browser is asked for them: `avc1.64001E`.
    pub codec: String,
    /// Frames from one at which decoding can begin to the next; the first is one.
    pub key_every: usize,
    /// Bytes from the first; one more than there are frames.
    pub offsets: Vec<usize>,
}

/// Where a page from a server hears of newer scenes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Live {
    /// Address of an event stream; each event is a JSON object with an `event`.
    pub events: String,
    /// Address of the newest scene, see [`crate::server`].
    pub scene: String,
    /// Token that every request must carry.
    pub token: String,
}

/// Metadata that a scene does not contain.
#[derive(Debug, Clone, PartialEq)]
pub struct About<'a> {
    /// For the title of the page.
    pub title: &'a str,
    /// Median z-depth of what the middle source camera sees, world units.
    pub median_depth: f64,
    /// Frames a second of the source.
    pub fps: f64,
}

impl Manifest {
    /// Describes a scene and its payload; without frames and without a server.
    pub fn new(scene: &Scene, payload: &Payload, about: &About<'_>) -> Self {
        let middle = scene.source.get(scene.source.len() / 2).map(|s| s.camera);
        let depth = usable_depth(about.median_depth);
        let centre = middle.map_or([0.0; 3], |camera| {
            let axis: [f64; 3] = camera.c2w.rotation.column(2).into_owned().into();
            let eye: [f64; 3] = camera.centre().into();
            std::array::from_fn(|k| eye[k] + depth * axis[k])
        });
        Self {
            version: MANIFEST_VERSION,
            title: about.title.to_owned(),
            splats: payload.into(),
            background: scene.background,
            time_frames: scene.time_frames,
            duration_s: scene.duration_s,
            fps: about.fps,
            mip: scene.mip,
            near: scene.near,
            period_frames: (scene.time_frames.max(2) - 1) as f64,
            cameras: scene.source.iter().map(SourceCamera::from).collect(),
            centre,
            safe: SafeOrbit::new(scene, depth),
            frames: None,
            live: None,
        }
    }

    /// Describes nothing yet: for the page of a server whose first scene is still to come.
    pub fn waiting(title: &str) -> Self {
        Self {
            version: MANIFEST_VERSION,
            title: title.to_owned(),
            time_frames: 1,
            fps: 30.0,
            mip: true,
            period_frames: 1.0,
            ..Self::default()
        }
    }
}

fn usable_depth(median_depth: f64) -> f64 {
    if median_depth.is_finite() && median_depth > 0.0 {
        median_depth
    } else {
        1.0
    }
}

/// Share of the extent of the camera's path within which a scene is shown without a fade: what lies
/// behind an edge was seen as far as the camera moved, and half as far again what is there is
/// guessed well from what is beside it.
const PATH_SHARE: f64 = 0.5;
/// At least this share of the median depth: the tangent of the 8 degrees by which the preview
/// swings about any scene.
const LEAST_SHARE: f64 = 0.14;
/// At most this share of the median depth: beyond it nearer things leave their place in the frame
/// altogether.
const MOST_SHARE: f64 = 0.5;

impl SafeOrbit {
    /// A share of the extent of the camera's path (the diagonal of the box about it), between two
    /// shares of the median depth.
    fn new(scene: &Scene, median_depth: f64) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for source in &scene.source {
            let eye: [f64; 3] = source.camera.centre().into();
            for k in 0..3 {
                low[k] = low[k].min(eye[k]);
                high[k] = high[k].max(eye[k]);
            }
        }
        let extent = (0..3)
            .map(|k| (high[k] - low[k]).max(0.0).powi(2))
            .sum::<f64>()
            .sqrt();
        let radius = (PATH_SHARE * extent).max(LEAST_SHARE * median_depth);
        Self {
            radius: radius.min(MOST_SHARE * median_depth),
        }
    }
}
