//! The import formats (splats as a scene, clips with poses as a capture), and default cameras for a
//! scene without any.

use m4_core::nalgebra::{Matrix3, Vector3};
use m4_core::{Camera, Column, Exposure, Intrinsics, Scene, Se3, SourceFrame, Splats};
use m4_io::dataset::{SourceFormat, megasam};
use m4_io::scene::ply::frame_name;
use minute4d::Refusal;
use minute4d::export::Format;
use minute4d::render::{SWING_FRAMES, swing};
use std::path::Path;
use std::str::FromStr;

const SCENES: [Format; 2] = [Format::Fourdgs, Format::Ply];

/// A format of a file or folder to import.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImportFormat {
    /// Splats.
    Scene(Format),
    /// A clip that another tool posed.
    Source(SourceFormat),
}

impl ImportFormat {
    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Scene(format) => format.name(),
            Self::Source(format) => format.name(),
        }
    }

    /// Everything that can be imported, the names in one line.
    pub fn names() -> String {
        let scenes = SCENES.into_iter().map(Format::name);
        let all: Vec<&str> = scenes
            .chain(SourceFormat::all().map(SourceFormat::name))
            .collect();
        all.join(", ")
    }

    /// The format of what is at `path`: the one asked for, or the one that its name and first bytes
    /// say.
    ///
    /// # Errors
    ///
    /// A refusal where nothing says it, or it cannot be imported.
    pub fn of(path: &Path, asked: Option<Self>) -> Result<Self, Refusal> {
        if let Some(asked) = asked {
            return Ok(asked);
        }
        if let Some(source) = m4_io::dataset::detect(path) {
            return Ok(Self::Source(source));
        }
        // by its name alone: its reader says what is wrong with it
        if megasam::detect_name(path) {
            return Ok(Self::Source(SourceFormat::Megasam));
        }
        if path.is_dir() {
            if m4_io::dataset::davis::detect(path) {
                return Err(Refusal::bad_input(format!(
                    "{} is a DAVIS clip, which has no camera poses; estimate them with `minute4d run IMAGES --masks ANNOTATIONS -o \
                     OUT`, with the folders of one clip",
                    path.display()
                )));
            }
            let first = path.join(frame_name(0));
            let (path, names) = (path.display(), Self::names());
            return Err(Refusal::bad_input(if first.is_file() {
                format!(
                    "{path} is a folder: a sequence cannot be imported as a clip, since the correspondence of splats between files is \
                     unknown; give one of its files, such as {}",
                    first.display()
                )
            } else {
                format!(
                    "{path} is a folder with none of the known layouts; if it has one, select it with --format, one of {names}"
                )
            }));
        }
        let format = Format::of_path(path).ok_or_else(|| {
            let (path, names) = (path.display(), Self::names());
            Refusal::usage(format!(
                "the format of {path} is not recognised by its name; add --format, one of {names}"
            ))
        })?;
        if SCENES.contains(&format) {
            Ok(Self::Scene(format))
        } else {
            Err(write_only(format))
        }
    }
}

/// The refusal of a format that is written only.
pub(super) fn write_only(format: Format) -> Refusal {
    let (name, names) = (format.name(), ImportFormat::names());
    Refusal::usage(format!("{name} files cannot be imported; {names} can"))
}

impl FromStr for ImportFormat {
    type Err = Refusal;

    fn from_str(text: &str) -> Result<Self, Refusal> {
        if let Some(format) = SCENES.into_iter().find(|f| f.name() == text) {
            return Ok(Self::Scene(format));
        }
        if let Some(source) = SourceFormat::all().find(|f| f.name() == text) {
            return Ok(Self::Source(source));
        }
        let written = Format::all().find(|f| f.name() == text);
        Err(written.map_or_else(
            || {
                let names = Self::names();
                Refusal::usage(format!(
                    "no format is called {text}; these can be imported: {names}"
                ))
            },
            write_only,
        ))
    }
}

const SIZE_PX: (usize, usize) = (640, 480);
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

#[cfg(test)]
mod tests {
    use super::{ImportFormat, default_cameras};
    use m4_core::nalgebra::Vector3;
    use m4_core::{Column, Scene, SplatLayout, Splats};
    use m4_io::dataset::SourceFormat;
    use minute4d::export::Format;

    #[test]
    fn every_name_is_of_one_format() {
        let names = ImportFormat::names();
        let mut all: Vec<&str> = names.split(", ").collect();
        for name in &all {
            assert_eq!(name.parse::<ImportFormat>().unwrap().name(), *name);
        }
        let count = all.len();
        all.sort_unstable();
        all.dedup();
        assert!(all.len() == count && count > 8, "{names}");
        let colmap: ImportFormat = "colmap".parse().unwrap();
        assert_eq!(colmap, ImportFormat::Source(SourceFormat::Colmap));
        let ply: ImportFormat = "ply".parse().unwrap();
        assert_eq!(ply, ImportFormat::Scene(Format::Ply));
        assert!(
            "spz"
                .parse::<ImportFormat>()
                .unwrap_err()
                .to_string()
                .contains("cannot be imported")
        );
        assert!(
            "obj"
                .parse::<ImportFormat>()
                .unwrap_err()
                .to_string()
                .contains("colmap")
        );
    }

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
