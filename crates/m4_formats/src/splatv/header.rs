//! The JSON of a `.splatv` file.

use crate::cameras_check::usable;
use m4_math::Se3;
use m4_math::nalgebra::{Matrix3, Vector3};
use m4_scene::{Camera, Exposure, Intrinsics, Scene, SourceFrame};
use serde::{Deserialize, Serialize};

/// Longest clip that is read, frames; more is a damaged number.
const MAX_FRAMES: usize = 100_000;

/// A part of the file; players read the first alone.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Part {
    #[serde(rename = "type")]
    pub kind: String,
    pub size: u64,
    #[serde(default)]
    pub texwidth: u64,
    #[serde(default)]
    pub texheight: u64,
    #[serde(default)]
    pub cameras: Vec<View>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub minute4d: Option<Facts>,
}

/// A camera as in the `cameras.json` of 3DGS: OpenCV axes, `rotation` is camera to world, row by row.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct View {
    #[serde(default)]
    pub id: u64,
    #[serde(default)]
    pub img_name: String,
    pub width: u64,
    pub height: u64,
    pub position: [f64; 3],
    pub rotation: [[f64; 3]; 3],
    pub fy: f64,
    pub fx: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cx: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cy: Option<f64>,
    /// Of the clip, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<f64>,
}

/// What players do not need.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Facts {
    pub time_frames: usize,
    #[serde(default)]
    pub duration_s: Option<f64>,
    pub background: [f32; 3],
    pub near: f32,
    pub mip: bool,
}

impl Facts {
    pub fn of(scene: &Scene) -> Self {
        Self {
            time_frames: scene.time_frames,
            duration_s: scene.duration_s,
            background: scene.background,
            near: scene.near,
            mip: scene.mip,
        }
    }

    /// The facts, if they make sense.
    pub fn checked(self) -> Option<Self> {
        let sound = (1..=MAX_FRAMES).contains(&self.time_frames)
            && self.duration_s.is_none_or(|s| s.is_finite() && s >= 0.0)
            && self.background.iter().all(|v| v.is_finite())
            && self.near.is_finite()
            && self.near >= 0.0;
        sound.then_some(self)
    }
}

/// The cameras of a scene; `last` is its last frame.
pub(super) fn views(scene: &Scene, last: f64) -> Vec<View> {
    let view = |(i, frame): (usize, &SourceFrame)| {
        let Camera { intrinsics: k, c2w } = &frame.camera;
        View {
            id: i as u64,
            img_name: format!("{i:05}"),
            width: k.width as u64,
            height: k.height as u64,
            position: c2w.translation.into(),
            rotation: std::array::from_fn(|r| std::array::from_fn(|c| c2w.rotation[(r, c)])),
            fy: k.fy,
            fx: k.fx,
            cx: Some(k.cx),
            cy: Some(k.cy),
            time: Some(frame.t / last),
        }
    };
    scene.source.iter().enumerate().map(view).collect()
}

/// The cameras of a file. Those without a time are spread evenly over the clip; `None` where one of them
/// makes no picture.
pub(super) fn source(views: &[View], last: f64) -> Option<Vec<SourceFrame>> {
    let share = last / (views.len().max(2) - 1) as f64;
    let frame = |(i, view): (usize, &View)| {
        let (width, height) = (usize::try_from(view.width).ok()?, usize::try_from(view.height).ok()?);
        let frame = SourceFrame {
            camera: Camera {
                intrinsics: Intrinsics {
                    width,
                    height,
                    fx: view.fx,
                    fy: view.fy,
                    cx: view.cx.unwrap_or(width as f64 / 2.0),
                    cy: view.cy.unwrap_or(height as f64 / 2.0),
                },
                c2w: Se3 {
                    rotation: Matrix3::from_fn(|r, c| view.rotation[r][c]),
                    translation: Vector3::from(view.position),
                },
            },
            t: view.time.map_or(i as f64 * share, |t| t * last),
            exposure: Exposure::IDENTITY,
        };
        usable(&frame).then_some(frame)
    };
    let mut frames: Vec<SourceFrame> = views.iter().enumerate().map(frame).collect::<Option<_>>()?;
    frames.sort_by(|a, b| a.t.total_cmp(&b.t));
    Some(frames)
}
