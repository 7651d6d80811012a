//! A scene to USD text.

use super::camera;
use super::error::WriteUsdError;
use super::moving::Moving;
use super::number::{decimals, significant};
use super::options::{UsdOptions, UsdPositions};
use crate::clock::Clock;
use crate::rub::turn_splats;
use crate::verified::VerifiedFile;
use crate::{Loss, WriteFileError, Written, plural};
use m4_scene::Scene;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Writes the splats that some sample sees, and the source camera. The bytes are compared with what was
/// written before the file gets its name.
///
/// # Errors
///
/// [`WriteUsdError`]; what was at `path` is then still there.
pub fn write(path: &Path, scene: &Scene, options: &UsdOptions) -> Result<Written, WriteUsdError> {
    let io = |e| WriteUsdError::File(WriteFileError::io(path, e));
    check(path, scene, options)?;
    let clock = Clock::of(scene);
    let fps = options.fps.unwrap_or(1.0 / clock.step_s);
    let last = scene.time_frames.max(1) - 1;
    let mut samples: Vec<f64> = (0..last).step_by(options.step_frames).map(|t| t as f64).collect();
    samples.push(last as f64);
    let mut splats = scene.splats.clone();
    turn_splats(&mut splats);
    let moving = Moving::new(scene, &splats, &samples);
    if moving.rows.is_empty() {
        return Err(WriteUsdError::BadScene {
            path: path.to_path_buf(),
            what: "no splat is seen at any sample; take more samples (step_frames)".into(),
        });
    }
    let mut file = VerifiedFile::create(path).map_err(io)?;
    let mut out = BufWriter::with_capacity(1 << 16, &mut file);
    let mut all = || {
        header(&mut out, last, fps)?;
        field(&mut out, scene, &moving, &samples, options.positions)?;
        camera::write(&mut out, scene)?;
        out.write_all(b"}\n")?;
        out.flush()
    };
    all().map_err(io)?;
    drop(out);
    file.verify().map_err(|e| WriteFileError::verify(path, e))?;
    let dropped = scene.splats.n() - moving.rows.len();
    let mut losses = vec![
        Loss::Baked(format!(
            "opacities, at {} of {} frames; in between they change linearly",
            samples.len(),
            scene.time_frames
        )),
        Loss::Quantised("opacities to 0.001, rotations and colours to 0.0001, scales to 0.05 %".into()),
        Loss::Dropped(format!(
            "{} that no sample sees, the background and the colour corrections of the frames",
            plural(dropped, "splat")
        )),
    ];
    losses.extend(Loss::of_mip(scene));
    if scene.splats.layout().time_degree > 0 {
        losses.push(Loss::Baked(format!(
            "the harmonics of time, at {} frames",
            samples.len()
        )));
    }
    if clock.assumed && options.fps.is_none() {
        losses.push(Loss::Dropped(format!(
            "nothing of the speed of the clip, which is not recorded: it plays at {fps} frames a second (set fps)"
        )));
    }
    Ok(Written {
        path: path.to_path_buf(),
        bytes: file.commit().map_err(io)?,
        splats: moving.rows.len(),
        losses,
    })
}

fn check(path: &Path, scene: &Scene, options: &UsdOptions) -> Result<(), WriteUsdError> {
    let bad = |setting, value: String, expected| {
        Err(WriteUsdError::BadOption {
            path: path.to_path_buf(),
            setting,
            value,
            expected,
        })
    };
    if path.extension().is_none_or(|e| !e.eq_ignore_ascii_case("usda")) {
        return Err(WriteUsdError::NotText {
            path: path.to_path_buf(),
        });
    }
    if options.step_frames == 0 {
        return bad("step_frames", "0".into(), "1 or more");
    }
    if let Some(fps) = options.fps
        && !(fps.is_finite() && fps > 0.0)
    {
        return bad("fps", fps.to_string(), "frames a second above 0");
    }
    let cameras = scene.source.iter().all(|f| {
        let k = &f.camera.intrinsics;
        let numbers = [k.fx, k.fy, k.cx, k.cy, f.t];
        f.camera.c2w.matrix().iter().chain(&numbers).all(|v| v.is_finite()) && k.width > 0 && k.height > 0
    });
    if !(scene.splats.is_finite() && cameras) {
        return Err(WriteUsdError::BadScene {
            path: path.to_path_buf(),
            what: "it holds a value that is not a number; `minute4d inspect` says which".into(),
        });
    }
    Ok(())
}

fn header(out: &mut impl Write, last: usize, fps: f64) -> io::Result<()> {
    let version = env!("CARGO_PKG_VERSION");
    write!(
        out,
        r#"#usda 1.0
(
    customLayerData = {{
        string creator = "minute4d {version}"
    }}
    defaultPrim = "scene"
    endTimeCode = {last}
    framesPerSecond = {fps}
    metersPerUnit = 1
    startTimeCode = 0
    timeCodesPerSecond = {fps}
    upAxis = "Y"
)

def Xform "scene" (
    kind = "component"
)
{{
"#
    )
}

fn field(
    out: &mut impl Write,
    scene: &Scene,
    moving: &Moving<'_>,
    samples: &[f64],
    positions: UsdPositions,
) -> io::Result<()> {
    let layout = scene.splats.layout();
    let rows = &moving.rows;
    let [low, high] = moving
        .extent
        .map(|[x, y, z]| format!("({}, {}, {})", x as f32, y as f32, z as f32));
    writeln!(out, "    def ParticleField3DGaussianSplat \"splats\"\n    {{")?;
    writeln!(out, "        float3[] extent = [{low}, {high}]")?;
    writeln!(out, "        uniform token projectionModeHint = \"perspective\"")?;
    writeln!(out, "        uniform token sortingModeHint = \"zDepth\"")?;
    writeln!(
        out,
        "        uniform int radiance:sphericalHarmonicsDegree = {}",
        layout.sh_degree
    )?;
    constant(out, "quatf[] orientations", rows, |out, row| {
        tuple(out, moving.quat(row), |out, v| decimals::<4>(out, f64::from(v)))
    })?;
    constant(out, "float3[] scales", rows, |out, row| {
        tuple(out, [0, 1, 2], |out, k| {
            significant(out, moving.log_scale(row, k).exp())
        })
    })?;
    let middle = samples[samples.len() / 2];
    let ends = [samples[0], samples[samples.len() - 1]];
    let places = match positions {
        UsdPositions::Ends if samples.len() > 1 => &ends,
        _ => samples,
    };
    sampled(out, "point3f[] positions", rows, places, middle, |out, row, t| {
        // as short as reads back to the same f32
        tuple(out, moving.mean(row, t), |out, v| write!(out, "{}", v as f32 + 0.0))
    })?;
    sampled(out, "float[] opacities", rows, samples, middle, |out, row, t| {
        decimals::<3>(out, moving.opacity(row, t))
    })?;
    let name = "float3[] radiance:sphericalHarmonicsCoefficients";
    let colour = |out: &mut _, row: usize, t: f64| {
        for term in 0..layout.sh_terms() {
            if term > 0 {
                Write::write_all(out, b",")?;
            }
            tuple(out, moving.harmonic(row, term, t), decimals::<4>)?;
        }
        Ok(())
    };
    if layout.time_degree > 0 {
        sampled(out, name, rows, samples, middle, colour)?;
    } else {
        constant(out, name, rows, |out, row| colour(out, row, 0.0))?;
    }
    writeln!(out, "    }}")
}

/// `NAME = [...]`.
fn constant<W: Write>(
    out: &mut W,
    name: &str,
    rows: &[usize],
    value: impl Fn(&mut W, usize) -> io::Result<()>,
) -> io::Result<()> {
    write!(out, "        {name} = ")?;
    list(out, rows, value)?;
    writeln!(out)
}

/// `NAME = [...]` in the middle of the clip, for tools that ask for no time, and
/// `NAME.timeSamples = { t: [...], }`.
fn sampled<W: Write>(
    out: &mut W,
    name: &str,
    rows: &[usize],
    samples: &[f64],
    middle: f64,
    value: impl Fn(&mut W, usize, f64) -> io::Result<()>,
) -> io::Result<()> {
    constant(out, name, rows, |out, row| value(out, row, middle))?;
    writeln!(out, "        {name}.timeSamples = {{")?;
    for &t in samples {
        write!(out, "            {t}: ")?;
        list(out, rows, |out, row| value(out, row, t))?;
        writeln!(out, ",")?;
    }
    writeln!(out, "        }}")
}

fn list<W: Write>(out: &mut W, rows: &[usize], value: impl Fn(&mut W, usize) -> io::Result<()>) -> io::Result<()> {
    for (i, &row) in rows.iter().enumerate() {
        out.write_all(if i == 0 { b"[" } else { b"," })?;
        value(out, row)?;
    }
    out.write_all(b"]")
}

fn tuple<W: Write, T: Copy, const N: usize>(
    out: &mut W,
    values: [T; N],
    number: impl Fn(&mut W, T) -> io::Result<()>,
) -> io::Result<()> {
    for (i, value) in values.into_iter().enumerate() {
        out.write_all(if i == 0 { b"(" } else { b"," })?;
        number(out, value)?;
    }
    out.write_all(b")")
}
