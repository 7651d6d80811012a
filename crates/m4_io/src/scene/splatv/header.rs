//! The JSON of a `.splatv` file.

use m4_core::{Camera, Scene, SourceFrame};
use serde::Serialize;

/// A part of the file; players read the first alone.
#[derive(Debug, Serialize)]
pub(super) struct Part {
    #[serde(rename = "type")]
    pub kind: String,
    pub size: u64,
    pub texwidth: u64,
    pub texheight: u64,
    pub cameras: Vec<View>,
    pub minute4d: Facts,
}

/// A camera as in the `cameras.json` of 3DGS: OpenCV axes, `rotation` is camera to world, row by row.
#[derive(Debug, Serialize)]
pub(super) struct View {
    pub id: u64,
    pub img_name: String,
    pub width: u64,
    pub height: u64,
    pub position: [f64; 3],
    pub rotation: [[f64; 3]; 3],
    pub fy: f64,
    pub fx: f64,
    pub cx: f64,
    pub cy: f64,
    /// Of the clip, 0 to 1.
    pub time: f64,
}

/// Metadata that viewers ignore.
#[derive(Debug, Serialize)]
pub(super) struct Facts {
    pub time_frames: usize,
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
            cx: k.cx,
            cy: k.cy,
            time: frame.t / last,
        }
    };
    scene.source.iter().enumerate().map(view).collect()
}
