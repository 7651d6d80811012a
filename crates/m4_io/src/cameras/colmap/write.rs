//! Writes the cameras and points of a scene as a sparse model.

use super::error::WriteColmapError;
use super::model::{ColmapPoint, Tables};
use super::{binary, text};
use crate::cameras::names::names;
use crate::scene::cameras_check::usable;
use crate::scene::row::sigmoid;
use crate::scene::verified::VerifiedFile;
use crate::scene::{C0, Loss, WriteFileError, Written, instant, plural};
use m4_core::{Camera, Column, Scene};
use serde::{Deserialize, Serialize};
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Text or binary.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ColmapEncoding {
    /// `.bin`: what COLMAP writes by default.
    #[default]
    Binary,
    /// `.txt`.
    Text,
}

impl ColmapEncoding {
    fn extension(self) -> &'static str {
        match self {
            Self::Binary => "bin",
            Self::Text => "txt",
        }
    }
}

/// Settings of [`write()`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ColmapOptions {
    /// Text or binary. Default: binary.
    pub encoding: ColmapEncoding,
    /// Names of the images, one per camera of the scene. Default: `00000.png`, `00001.png`, ...
    pub names: Option<Vec<String>>,
    /// The instant whose splats become points, frames. Default 0.
    pub t: f64,
    /// Fainter splats are no points. Default 0.5: what is more solid than not.
    pub least_opacity: f64,
    /// Where there are more, every second, third, ... is taken. Default 100,000, the order of what COLMAP
    /// itself makes of a few hundred images.
    pub max_points: usize,
}

impl Default for ColmapOptions {
    fn default() -> Self {
        Self {
            encoding: ColmapEncoding::Binary,
            names: None,
            t: 0.0,
            least_opacity: 0.5,
            max_points: 100_000,
        }
    }
}

/// Writes `cameras`, `images` and `points3D` into `folder` and reads them back before they get their names.
///
/// # Errors
///
/// [`WriteColmapError`]; nothing is then changed, unless the last renames fail.
pub fn write(folder: &Path, scene: &Scene, options: &ColmapOptions) -> Result<Written, WriteColmapError> {
    let path = || folder.to_path_buf();
    let bad = |what: String| WriteColmapError::BadScene { path: path(), what };
    if scene.source.is_empty() {
        return Err(bad("the scene has no cameras".into()));
    }
    if let Some(i) = scene.source.iter().position(|f| !usable(f)) {
        return Err(bad(format!(
            "camera {i} of the scene is none: {:?}",
            scene.source[i].camera
        )));
    }
    if !options.t.is_finite() {
        return Err(bad(format!("t = {}; a number of frames was expected", options.t)));
    }
    let names =
        names(scene, options.names.as_deref()).map_err(|source| WriteColmapError::Names { path: path(), source })?;
    let cameras: Vec<Camera> = scene.source.iter().map(|f| f.camera).collect();
    let points = points(scene, options);
    if let Some(p) = points.iter().find(|p| !p.position.iter().all(|v| v.is_finite())) {
        return Err(bad(format!("a splat lies at {:?}", p.position)));
    }
    let tables = Tables::new(&cameras, names, points);
    let bytes = write_tables(folder, &tables, options.encoding)?;
    Ok(Written {
        path: path(),
        bytes,
        splats: tables.points.len(),
        losses: vec![
            Loss::Dropped("splat parameters except positions and colours of some splats; times of the images".into()),
            Loss::Baked(format!("points, at frame {}", options.t)),
        ],
    })
}

/// Writes the three tables and reads them back; the size of the files, bytes.
pub(crate) fn write_tables(folder: &Path, tables: &Tables, encoding: ColmapEncoding) -> Result<u64, WriteFileError> {
    let extension = encoding.extension();
    type Writer<'a> = &'a dyn Fn(&mut BufWriter<&mut VerifiedFile>) -> io::Result<()>;
    let writers: [(&str, Writer<'_>); 3] = match encoding {
        ColmapEncoding::Binary => [
            ("cameras", &|out| binary::write_cameras(out, &tables.cameras)),
            ("images", &|out| binary::write_images(out, &tables.images)),
            ("points3D", &|out| binary::write_points(out, &tables.points)),
        ],
        ColmapEncoding::Text => [
            ("cameras", &|out| text::write_cameras(out, &tables.cameras)),
            ("images", &|out| text::write_images(out, &tables.images)),
            ("points3D", &|out| text::write_points(out, &tables.points)),
        ],
    };
    let mut files = Vec::new();
    for (name, writer) in writers {
        let path = folder.join(format!("{name}.{extension}"));
        let io = |e| WriteFileError::io(&path, e);
        let mut file = VerifiedFile::create(&path).map_err(io)?;
        let mut out = BufWriter::new(&mut file);
        writer(&mut out).and_then(|()| out.flush()).map_err(io)?;
        drop(out);
        file.verify().map_err(|e| WriteFileError::verify(&path, e))?;
        files.push((path, file));
    }
    let mut bytes = 0;
    for (path, file) in files {
        bytes += file.commit().map_err(|e| WriteFileError::io(&path, e))?;
    }
    let verify = |reason: String| WriteFileError::verify(folder, reason);
    let back = super::read(folder).map_err(|e| verify(e.to_string()))?;
    if (back.images.len(), back.points.len()) != (tables.images.len(), tables.points.len()) {
        return Err(verify(format!(
            "it has {} and {}",
            plural(back.images.len(), "image"),
            plural(back.points.len(), "point")
        )));
    }
    Ok(bytes)
}

/// Solid splats of the instant.
fn points(scene: &Scene, options: &ColmapOptions) -> Vec<ColmapPoint> {
    let splats = instant(&scene.splats, options.t, scene.time_frames as f64);
    let opacity = splats.column(Column::Opacity, 0);
    let solid: Vec<usize> = (0..splats.n())
        .filter(|&i| sigmoid(opacity[i]) >= options.least_opacity)
        .collect();
    let step = solid.len().div_ceil(options.max_points.max(1)).max(1);
    let at = |column, k, i: usize| f64::from(splats.column(column, k)[i]);
    let point = |&i: &usize| ColmapPoint {
        position: [0, 1, 2].map(|k| at(Column::Mean, k, i)),
        // a cast to u8 clips
        colour: [0, 1, 2].map(|k| ((0.5 + C0 * at(Column::Colour, k, i)) * 255.0).round() as u8),
    };
    let some = if options.max_points == 0 { &[] } else { solid.as_slice() };
    some.iter().step_by(step).map(point).collect()
}
