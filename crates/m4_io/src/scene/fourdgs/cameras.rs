//! What goes into records beside the splats: the cameras of the video as a sensor on a rig, an
//! initial view for viewers, and the properties of a scene without a field in the format as our own
//! metadata record.

use super::convert::ClipTime;
use crate::scene::{Loss, usable};
use ::fourdgs::provenance::Provenance;
use ::fourdgs::records::{POSE_TO_RIG, POSE_TO_SCENE, TRAJECTORY_LINEAR};
use ::fourdgs::{Camera as View, CoordinateFrame, Metadata, RigTrajectory, SensorCalibration};
use m4_core::nalgebra::{Quaternion, Rotation3, UnitQuaternion, Vector3};
use m4_core::{Camera, Column, Exposure, Intrinsics, Scene, Se3, SourceFrame, median};
use std::collections::BTreeMap;

/// Name of the rig, its sensor and the frame of the world.
const NAME: &str = "source";
/// A pinhole without distortion, in the registry of the format.
const PINHOLE: u8 = 1;
/// Right-handed, in the registry of the format.
const RIGHT_HANDED: u8 = 1;
/// Axes of the registry of the format: +x, +y, +z, -x, -y, -z.
const AXES: [[f64; 3]; 6] = [
    [1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, 1.0],
    [-1.0, 0.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, 0.0, -1.0],
];

fn seconds(frame: &SourceFrame, clip: &ClipTime) -> f64 {
    frame.t * clip.step_s
}

/// Where the cameras were, and which way is up.
pub(super) fn provenance(scene: &Scene, clip: &ClipTime) -> (Provenance, Vec<Loss>) {
    let world = CoordinateFrame {
        name: NAME.to_owned(),
        handedness: RIGHT_HANDED,
        up_axis: 4,
        forward_axis: 2,
        length_unit: 0,
        metres_per_unit: 0.0,
    };
    let mut out = Provenance {
        frames: vec![world],
        ..Provenance::default()
    };
    let mut losses = Vec::new();
    let Some(first) = scene.source.first() else {
        return (out, losses);
    };
    if scene
        .source
        .iter()
        .any(|s| s.exposure != Exposure::IDENTITY)
    {
        losses.push(Loss::Dropped("the exposure of every frame".to_owned()));
    }
    let in_order = scene
        .source
        .windows(2)
        .all(|pair| seconds(&pair[0], clip) < seconds(&pair[1], clip));
    if !in_order {
        losses.push(Loss::Dropped(
            "the cameras of the video: several are of the same moment".to_owned(),
        ));
        return (out, losses);
    }
    let lens = first.camera.intrinsics;
    if scene.source.iter().any(|s| s.camera.intrinsics != lens) {
        losses.push(Loss::Dropped(
            "intrinsics of all frames but the first".to_owned(),
        ));
    }
    let size = |v: usize| u32::try_from(v).unwrap_or(u32::MAX);
    out.sensors.push(SensorCalibration {
        name: NAME.to_owned(),
        modality: "camera".to_owned(),
        camera_model: PINHOLE,
        width_px: size(lens.width),
        height_px: size(lens.height),
        fx: lens.fx,
        fy: lens.fy,
        cx: lens.cx,
        cy: lens.cy,
        distortion: Vec::new(),
        rotation: [0.0, 0.0, 0.0, 1.0],
        translation: [0.0; 3],
        pose_reference: POSE_TO_RIG,
        rig_name: NAME.to_owned(),
    });
    let rotation = |s: &SourceFrame| {
        let turn = Rotation3::from_matrix_unchecked(s.camera.c2w.rotation);
        let q = UnitQuaternion::from_rotation_matrix(&turn);
        [q.i, q.j, q.k, q.w]
    };
    out.trajectories.push(RigTrajectory {
        name: NAME.to_owned(),
        interpolation: TRAJECTORY_LINEAR,
        times: scene.source.iter().map(|s| seconds(s, clip)).collect(),
        rotations: scene.source.iter().map(rotation).collect(),
        translations: scene
            .source
            .iter()
            .map(|s| s.camera.c2w.translation.into())
            .collect(),
    });
    (out, losses)
}

/// The way of the cameras as a player may follow it; it starts in the middle of the clip.
pub(super) fn view(scene: &Scene, clip: &ClipTime) -> Option<View> {
    let middle = scene.source.get(scene.source.len() / 2)?;
    let distance = median_depth(scene, &middle.camera);
    let target =
        |c: &Camera| -> [f64; 3] { c.c2w.transform(&Vector3::new(0.0, 0.0, distance)).into() };
    let lens = middle.camera.intrinsics;
    Some(View {
        fov_y_deg: 2.0 * (lens.height as f64 / (2.0 * lens.fy)).atan().to_degrees(),
        position: middle.camera.centre().into(),
        target: target(&middle.camera),
        times: scene.source.iter().map(|s| seconds(s, clip)).collect(),
        positions: scene
            .source
            .iter()
            .map(|s| s.camera.centre().into())
            .collect(),
        targets: scene.source.iter().map(|s| target(&s.camera)).collect(),
        interpolation: "linear".to_owned(),
        loop_: false,
    })
}

/// Median z-depth of the means in front of a camera, world units; 1 where there is none.
fn median_depth(scene: &Scene, camera: &Camera) -> f64 {
    let axis = camera.c2w.rotation.column(2).into_owned();
    let centre = camera.centre();
    let [x, y, z]: [&[f32]; 3] = std::array::from_fn(|k| scene.splats.column(Column::Mean, k));
    let mut depths: Vec<f64> = (0..scene.splats.n())
        .map(|i| {
            (Vector3::new(f64::from(x[i]), f64::from(y[i]), f64::from(z[i])) - centre).dot(&axis)
        })
        .filter(|&d| d > 0.0)
        .collect();
    median(&mut depths).unwrap_or(1.0)
}

/// The cameras of a file: those of its first pinhole sensor, one per pose of its rig.
pub(super) fn source(
    provenance: &Provenance,
    clip: &ClipTime,
    losses: &mut Vec<Loss>,
) -> Vec<SourceFrame> {
    let Some(sensor) = provenance.sensors.iter().find(|s| s.is_camera()) else {
        return Vec::new();
    };
    if provenance.sensors.len() > 1 {
        losses.push(Loss::Dropped(format!(
            "the sensors besides {:?}",
            sensor.name
        )));
    }
    if sensor.distortion.iter().any(|&d| d != 0.0) {
        losses.push(Loss::Dropped(format!(
            "the distortion of the lens {:?}",
            sensor.name
        )));
    }
    let intrinsics = Intrinsics {
        width: sensor.width_px as usize,
        height: sensor.height_px as usize,
        fx: sensor.fx,
        fy: sensor.fy,
        cx: sensor.cx,
        cy: sensor.cy,
    };
    let on_rig = pose(&sensor.rotation, &sensor.translation);
    let frame = |c2w: Se3<f64>, t: f64| SourceFrame {
        camera: Camera { intrinsics, c2w },
        t,
        exposure: Exposure::IDENTITY,
        distance_sigma: None,
    };
    let source: Vec<SourceFrame> = match sensor.pose_reference {
        POSE_TO_SCENE => (0..clip.frames).map(|t| frame(on_rig, t as f64)).collect(),
        _ => {
            let rig = provenance
                .trajectories
                .iter()
                .find(|r| r.name == sensor.rig_name);
            let poses = rig.map(|rig| {
                let poses = rig.rotations.iter().zip(&rig.translations);
                rig.times
                    .iter()
                    .zip(poses)
                    .map(|(t, (r, x))| frame(pose(r, x).compose(&on_rig), t / clip.step_s))
                    .collect()
            });
            poses.unwrap_or_default()
        }
    };
    if source.iter().all(usable) {
        return source;
    }
    losses.push(Loss::Dropped(format!(
        "the camera {:?}: its lens or its poses make no image",
        sensor.name
    )));
    Vec::new()
}

fn pose(rotation: &[f64; 4], translation: &[f64; 3]) -> Se3<f64> {
    let [x, y, z, w] = *rotation;
    let unit = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    Se3 {
        rotation: unit.to_rotation_matrix().into_inner(),
        translation: Vector3::from(*translation),
    }
}

/// Which way is up: as the coordinate frame says, else as the header does.
pub(super) fn up(provenance: &Provenance, coordinate_system: Option<&str>) -> Option<[f64; 3]> {
    if let Some(frame) = provenance.frames.first() {
        return AXES.get(usize::from(frame.up_axis)).copied();
    }
    match coordinate_system? {
        s if s.starts_with("y-up") => Some(AXES[1]),
        s if s.starts_with("z-up") => Some(AXES[2]),
        _ => None,
    }
}

/// Name of the record.
const RECORD: &str = "minute4d";
/// Longest clip that is read, frames; more is a damaged number.
pub(super) const MAX_FRAMES: usize = 100_000;

/// The facts of the record; those that are missing or make no sense are `None`.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Notes {
    pub time_frames: Option<usize>,
    pub duration_s: Option<f64>,
    pub background: Option<[f32; 3]>,
    pub near: Option<f32>,
    pub mip: Option<bool>,
}

/// The metadata record of a scene. Numbers are written so that they come back bit by bit.
pub(super) fn record(scene: &Scene) -> Metadata {
    let [r, g, b] = scene.background;
    let mut entries = BTreeMap::from([
        ("time_frames".to_owned(), scene.time_frames.to_string()),
        ("background".to_owned(), format!("{r} {g} {b}")),
        ("near".to_owned(), scene.near.to_string()),
        ("mip".to_owned(), scene.mip.to_string()),
    ]);
    if let Some(s) = scene.duration_s {
        entries.insert("duration_s".to_owned(), s.to_string());
    }
    Metadata {
        name: RECORD.to_owned(),
        entries,
    }
}

impl Notes {
    /// The facts in the records of a file.
    pub(super) fn read(records: &[Metadata]) -> Self {
        let Some(record) = records.iter().find(|r| r.name == RECORD) else {
            return Self::default();
        };
        let text = |key: &str| record.entries.get(key).map(String::as_str);
        let colour = |text: &str| {
            let parts: Vec<f32> = text.split(' ').map_while(|v| v.parse().ok()).collect();
            <[f32; 3]>::try_from(parts).ok()
        };
        Self {
            time_frames: text("time_frames")
                .and_then(|v| v.parse().ok())
                .filter(|n| (1..=MAX_FRAMES).contains(n)),
            duration_s: text("duration_s")
                .and_then(|v| v.parse().ok())
                .filter(|s: &f64| s.is_finite() && *s >= 0.0),
            background: text("background")
                .and_then(colour)
                .filter(|c| c.iter().all(|v| v.is_finite())),
            near: text("near")
                .and_then(|v| v.parse().ok())
                .filter(|v: &f32| v.is_finite() && *v >= 0.0),
            mip: text("mip").and_then(|v| v.parse().ok()),
        }
    }
}
