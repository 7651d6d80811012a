//! Clips and scenes of other tools, as they are read ([`m4_io::dataset`], [`m4_io::scene`]): the
//! capture of a clip is written, and a scene gets cameras if it has none.

use crate::Error;
use crate::layout::COVISIBLE_FOLDER;
use crate::render::{SWING_FRAMES, swing};
use m4_core::nalgebra::{Matrix3, Vector3};
use m4_core::{
    Camera, Capture, Column, Exposure, Intrinsics, Progress, Scene, Se3, SourceFrame, Splats,
};
use m4_io::capture::{self, Split};
use m4_io::dataset::{Imported, SourceFormat, dycheck};
use m4_io::image::{read_mask, write_mask};
use std::fs;
use std::path::{Path, PathBuf};

/// Size of the images, pixels.
const SIZE_PX: (usize, usize) = (640, 480);
/// Horizontal field of view, degrees.
const FOV_DEG: f64 = 50.0;
/// Share of the splats that is in view: the rest may be far outliers and background.
const SHARE: f64 = 0.8;
/// Frames that a scene without time gets, for the swing.
const STILL_FRAMES: usize = 60;
/// Up where the file does not say, as in scenes of COLMAP and 3DGS: y points down.
const UP: [f64; 3] = [0.0, -1.0, 0.0];

/// Puts a row of cameras, one per frame, in front of the middle of the splats, swinging to both
/// sides. A scene of a single frame gets 60, so that there is something to play.
pub fn default_cameras(scene: &mut Scene, up: Option<[f64; 3]>) {
    let (middle, radius) = extent(&scene.splats);
    let down = -Vector3::from(up.unwrap_or(UP));
    // Forward is z where that is level, as in a world of a first camera.
    let across = if down.z.abs() < 0.9 {
        Vector3::z()
    } else {
        Vector3::y()
    };
    let forward = (across - down * down.dot(&across)).normalize();
    let right = down.cross(&forward);
    let (width, height) = SIZE_PX;
    let focal = width as f64 / (2.0 * (FOV_DEG.to_radians() / 2.0).tan());
    // The shorter side shows all of it.
    let distance = radius * 2.0 * focal / width.min(height) as f64;
    let camera = Camera {
        intrinsics: Intrinsics::centred(width, height, focal),
        c2w: Se3 {
            rotation: Matrix3::from_columns(&[right, down, forward]),
            translation: middle - forward * distance,
        },
    };
    if scene.time_frames < 2 {
        scene.time_frames = STILL_FRAMES;
    }
    let n = scene.time_frames;
    let cameras = swing(&camera, distance, n, SWING_FRAMES);
    scene.source = cameras
        .into_iter()
        .enumerate()
        .map(|(i, camera)| SourceFrame {
            camera,
            t: i as f64,
            exposure: Exposure::IDENTITY,
            distance_sigma: None,
        })
        .collect();
    // Nothing of the scene is nearer than a thousandth of the way to it.
    scene.near = scene.near.min((1e-3 * distance) as f32);
}

/// The median of the means, and the distance within which [`SHARE`] of them lie.
fn extent(splats: &Splats) -> (Vector3<f64>, f64) {
    let n = splats.n();
    let columns: [&[f32]; 3] = std::array::from_fn(|k| splats.column(Column::Mean, k));
    let nth = |mut values: Vec<f64>, share: f64| {
        let at = ((n as f64 * share) as usize).min(n.saturating_sub(1));
        if values.is_empty() {
            0.0
        } else {
            *values.select_nth_unstable_by(at, f64::total_cmp).1
        }
    };
    let median = |k: usize| nth(columns[k].iter().map(|&v| f64::from(v)).collect(), 0.5);
    let middle = Vector3::new(median(0), median(1), median(2));
    let distance = |i: usize| (Vector3::from_fn(|k, _| f64::from(columns[k][i])) - middle).norm();
    let radius = nth((0..n).map(distance).collect(), SHARE);
    let largest = f64::from(
        splats
            .column(Column::LogScale, 0)
            .first()
            .copied()
            .unwrap_or(0.0),
    )
    .exp();
    // One splat, or many in one place: as large as it is.
    (
        middle,
        if radius > 0.0 {
            radius
        } else {
            largest.clamp(1e-6, 1e6)
        },
    )
}

/// Writes a clip as a capture into the folder `out`: the held-out views with the masks of
/// co-visibility that their data set, at `source`, publishes, then the frames. `factor` is the one
/// of its images.
///
/// # Errors
///
/// [`Error::WriteData`], [`Error::Write`]; [`Error::ReadData`] of a mask.
pub fn write_capture(
    out: &Path,
    imported: &Imported,
    (source, format): (&Path, SourceFormat),
    factor: Option<u32>,
    progress: &dyn Progress,
) -> Result<(), Error> {
    if let Some(test) = &imported.test {
        capture::write(out, test, Split::Test, progress)?;
        if format == SourceFormat::Dycheck {
            let masks = copy_covisible(out, test, |name| dycheck::covisible(source, name, factor))?;
            // Nerfies and HyperNeRF publish none
            if (1..test.frames.len()).contains(&masks) {
                progress.warn(&format!(
                    "{} of {} views of {} have no published co-visibility mask",
                    test.frames.len() - masks,
                    test.frames.len(),
                    source.display()
                ));
            }
        }
    }
    Ok(capture::write(
        out,
        &imported.train,
        Split::Train,
        progress,
    )?)
}

/// Copies published masks into a capture: `from(name)` is the file of a view, whose name in the
/// capture is that of its image. Files that do not exist are passed over; says how many were
/// copied.
fn copy_covisible(
    capture: &Path,
    views: &Capture,
    from: impl Fn(&str) -> PathBuf,
) -> Result<usize, Error> {
    let folder = capture.join(COVISIBLE_FOLDER);
    let mut copied = 0;
    for (i, view) in views.frames.iter().enumerate() {
        let source = from(&view.name);
        if !source.is_file() {
            continue;
        }
        let mask = read_mask(&source)?.to_mask();
        if copied == 0 {
            fs::create_dir_all(&folder).map_err(Error::write(&folder))?;
        }
        write_mask(&folder.join(format!("{i:05}.png")), &mask)?;
        copied += 1;
    }
    Ok(copied)
}

#[cfg(test)]
mod tests {
    use super::default_cameras;
    use m4_core::nalgebra::Vector3;
    use m4_core::{Column, Scene, SplatLayout, Splats};

    fn scene(means: &[[f32; 3]]) -> Scene {
        let layout = SplatLayout {
            isotropic: false,
            sh_degree: 0,
            time_degree: 0,
        };
        let mut splats = Splats::zeros(layout, means.len(), 0);
        for (i, mean) in means.iter().enumerate() {
            for k in 0..3 {
                splats.column_mut(Column::Mean, k)[i] = mean[k];
            }
        }
        m4_testkit::bare_scene(splats, 1)
    }

    #[test]
    fn the_centre_of_the_scene_projects_to_the_centre_of_every_image() {
        for up in [None, Some([0.0, 1.0, 0.0]), Some([0.0, 0.0, 1.0])] {
            let mut scene = scene(&[
                [4.0, 1.0, 0.0],
                [6.0, 1.0, 0.0],
                [5.0, 2.0, 0.0],
                [5.0, 0.0, 0.0],
                [5.0, 1.0, 1.0],
            ]);
            default_cameras(&mut scene, up);
            assert_eq!((scene.source.len(), scene.time_frames), (60, 60));
            for frame in &scene.source {
                let camera = frame.camera;
                let ([u, v], z) = camera.project(&Vector3::new(5.0, 1.0, 0.0));
                assert!((u - 319.5).abs() < 1e-6 && (v - 239.5).abs() < 1e-6 && z > 1.0);
                // up in the world is up in the image
                let up = Vector3::from(up.unwrap_or([0.0, -1.0, 0.0]));
                let ([_, above], _) = camera.project(&(Vector3::new(5.0, 1.0, 0.0) + up * 0.5));
                assert!(above < v);
                assert!((camera.c2w.rotation.determinant() - 1.0).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn one_splat_is_looked_at_too() {
        let mut scene = scene(&[[1.0, 2.0, 3.0]]);
        default_cameras(&mut scene, None);
        let (_, z) = scene.source[0].camera.project(&Vector3::new(1.0, 2.0, 3.0));
        assert!(z > 0.0 && z.is_finite() && f64::from(scene.near) < z);
    }
}
