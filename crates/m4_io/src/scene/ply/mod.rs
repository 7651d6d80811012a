//! PLY files in the layout of 3DGS: one instant, or a folder with one file per frame.
//!
//! A file is a header of text and a table of 32-bit numbers, little-endian, a row per splat:
//!
//! ```text
//! x y z            mean, world units             nx ny nz         0
//! f_dc_0..2        constant colour coefficient: colour = 1/2 + C0 f_dc
//! f_rest_0..       the other harmonics, channel major: all of red, then green, then blue
//! opacity          logit                          scale_0..2       logarithms, world units
//! rot_0..3         quaternion (w, x, y, z)
//! ```
//!
//! Where opacities want the Mip filter, a comment says so as Brush writes it and splat-transform
//! and others read it: `SplatRenderMode: mip`.
//!
//! Read are also: other orders of the properties, missing normals, harmonics of degree 0 to 3, and
//! further properties.

mod read;
pub use read::{parse, read};

use super::splats::Row;
use super::{Loss, Written, check_finite, check_unbound, instant, plural, publish};
use crate::WriteError;
use crate::results::{Kind, ResultFolder};
use m4_core::{Column, Scene, Splats};
use std::borrow::Cow;
use std::fmt::Write as _;
use std::path::Path;

/// Line of the header that says that opacities want the Mip filter.
pub(super) const MIP_COMMENT: &str = "comment SplatRenderMode: mip\n";

/// Writes the splats that time `t` (frames) sees, atomically; all values must be finite.
pub fn write(path: &Path, scene: &Scene, t: f64) -> Result<Written, WriteError> {
    check_finite(path, scene)?;
    check_unbound(path, &scene.splats)?;
    let splats = instant_splats(scene, &scene.splats, t);
    let bytes = encode(&splats, t, scene.mip);
    publish(path, &bytes)?;
    let mut losses = Vec::new();
    if scene.splats.n_dynamic() > 0 {
        losses.push(Loss::Baked(format!("time, at frame {t}")));
    }
    let unseen = scene.splats.n() - splats.n();
    if unseen > 0 {
        losses.push(Loss::Dropped(format!(
            "{} that this instant does not see",
            plural(unseen, "splat")
        )));
    }
    losses.extend(unheld(scene));
    Ok(Written {
        path: path.to_path_buf(),
        bytes: bytes.len() as u64,
        splats: splats.n(),
        losses,
    })
}

/// The splats of an instant, frames.
fn instant_splats(scene: &Scene, splats: &Splats, t: f64) -> Splats {
    instant(splats, t, scene.period_frames())
}

/// Returns the properties of a scene that PLY cannot store.
pub(super) fn unheld(scene: &Scene) -> Vec<Loss> {
    let mut losses = Vec::new();
    if scene.mip {
        losses.push(Loss::Dropped(
            "the Mip filter, for players that do not know the comment SplatRenderMode".to_owned(),
        ));
    }
    if !scene.source.is_empty() {
        losses.push(Loss::Dropped("the cameras of the video".to_owned()));
    }
    if scene.background != [0.0; 3] {
        losses.push(Loss::Dropped("the colour of the background".to_owned()));
    }
    losses
}

/// The bytes of a file with static splats; `mip` where their opacities want the Mip filter.
fn encode(splats: &Splats, t: f64, mip: bool) -> Vec<u8> {
    let mut text = String::from("ply\nformat binary_little_endian 1.0\n");
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "comment minute4d {}, frame {t}",
        env!("CARGO_PKG_VERSION")
    );
    if mip {
        text.push_str(MIP_COMMENT);
    }
    let _ = writeln!(text, "element vertex {}", splats.n());
    let names: Vec<String> = properties(splats.layout().sh_degree).collect();
    for name in &names {
        let _ = writeln!(text, "property float {name}");
    }
    text.push_str("end_header\n");

    let mut bytes = text.into_bytes();
    bytes.reserve(4 * splats.n() * names.len());
    for i in 0..splats.n() {
        bytes.extend(numbers(splats, i).flat_map(f32::to_le_bytes));
    }
    bytes
}

/// The names of the properties of splats of a degree.
pub(super) fn properties(sh_degree: usize) -> impl Iterator<Item = String> {
    let start = [
        "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2",
    ];
    let end = [
        "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
    ];
    let rest = (0..3 * ((sh_degree + 1) * (sh_degree + 1) - 1)).map(|k| format!("f_rest_{k}"));
    start
        .into_iter()
        .map(str::to_owned)
        .chain(rest)
        .chain(end.into_iter().map(str::to_owned))
}

/// The numbers of splat `i`, in the order of [`properties`].
pub(super) fn numbers(splats: &Splats, i: usize) -> impl Iterator<Item = f32> {
    let row = Row::of(splats, i);
    let terms = splats.layout().sh_terms() - 1;
    let colour = move |k: usize| splats.column(Column::Colour, k)[i];
    let harmonics = (0..3 * terms).map(move |k| colour(3 * (k % terms + 1) + k / terms));
    let start = row
        .mean
        .into_iter()
        .chain([0.0; 3])
        .chain((0..3).map(colour));
    start
        .chain(harmonics)
        .chain([row.opacity])
        .chain(row.log_scale)
        .chain(row.quat)
}

/// Name of file `i` of a sequence: `frame_00012.ply`.
#[must_use]
pub fn frame_name(i: usize) -> String {
    format!("frame_{i:05}.ply")
}

/// Writes a file for each of `times` (frames) into `folder`, in the place of those of an earlier
/// sequence once all are complete. `splats_at` gives the splats of the scene for a moment: the
/// same, or with what is drawn of bound ones then. `each` is called after every file, and may stop
/// the work by returning false; nothing is replaced then. Fails when the scene has values that are
/// NaN or infinite, `splats_at` gives bound splats, where other files have those names, or the file
/// system refuses.
pub fn write_sequence<'a>(
    folder: &Path,
    scene: &Scene,
    times: &[f64],
    mut splats_at: impl FnMut(f64) -> Cow<'a, Splats>,
    mut each: impl FnMut(usize) -> bool,
) -> Result<Written, WriteError> {
    check_finite(folder, scene)?;
    let mut results = ResultFolder::open(folder, Kind::PlySequence)?;
    let names: Vec<String> = (0..times.len()).map(frame_name).collect();
    results.check_free(names.iter().map(String::as_str))?;
    let next = results.begin()?;
    let mut written = Written {
        path: folder.to_path_buf(),
        bytes: 0,
        splats: 0,
        losses: Vec::new(),
    };
    for (i, &t) in times.iter().enumerate() {
        let path = next.join(&names[i]);
        let all = splats_at(t);
        check_unbound(&path, &all)?;
        let splats = instant_splats(scene, &all, t);
        let bytes = encode(&splats, t, scene.mip);
        publish(&path, &bytes)?;
        written.bytes += bytes.len() as u64;
        written.splats += splats.n();
        if !each(i + 1) {
            results.discard()?;
            return Ok(written);
        }
    }
    results.commit(None)?;
    if scene.splats.n_dynamic() > 0 {
        written
            .losses
            .push(Loss::Baked(format!("time, at {} instants", times.len())));
    }
    written.losses.extend(unheld(scene));
    Ok(written)
}

#[cfg(test)]
mod tests {
    use super::{frame_name, parse, read, write, write_sequence};
    use crate::ErrorKind;
    use crate::scene::Loss;
    use crate::scene::splats::Row;
    use m4_core::{Column, Scene, SplatLayout};
    use m4_testkit::{SceneSpec, bound_scene, random_scene};
    use serde::Deserialize;
    use std::borrow::Cow;
    use std::collections::HashMap;
    use std::path::Path;

    fn scene(sh_degree: usize) -> Scene {
        let scene = random_scene(&SceneSpec {
            layout: SplatLayout {
                isotropic: false,
                sh_degree,
                time_degree: 0,
            },
            n_static: 50,
            n_dynamic: 70,
            time_frames: 11,
            ..SceneSpec::default()
        });
        // what a PLY file has no place for
        Scene {
            background: [0.0; 3],
            mip: false,
            source: Vec::new(),
            ..scene
        }
    }

    #[test]
    fn ply_instants_round_trip_exactly() {
        let dir = tempfile::tempdir().unwrap();
        for sh_degree in 0..=3 {
            let scene = scene(sh_degree);
            let path = dir.path().join("a.ply");
            let written = write(&path, &scene, 4.0).unwrap();
            let instant_splats = crate::scene::instant(&scene.splats, 4.0, 10.0);
            assert_eq!(
                (written.splats, written.bytes),
                (instant_splats.n(), std::fs::metadata(&path).unwrap().len())
            );
            assert!(instant_splats.n() > 50 && instant_splats.n() < 120);
            let back = read(&path).unwrap();
            assert!(back.losses.is_empty());
            let mut unit = instant_splats.clone();
            for i in 0..unit.n() {
                let row = Row::of(&instant_splats, i);
                for k in 0..4 {
                    unit.column_mut(Column::Quat, k)[i] = row.quat[k];
                }
            }
            for c in 0..unit.columns().len() {
                // a quaternion of length 1 may lose a bit when it is normalised again
                let close = |a: &f32, b: &f32| (a - b).abs() <= f32::EPSILON * a.abs().max(0.5);
                let same = unit.columns()[c]
                    .iter()
                    .zip(&back.scene.splats.columns()[c]);
                let is_quat = unit.layout().range(Column::Quat).contains(&c);
                assert!(
                    same.clone()
                        .all(|(a, b)| if is_quat { close(a, b) } else { a == b }),
                    "column {c}"
                );
            }
        }
    }

    /// The same file through a reader that is not ours.
    #[test]
    fn serde_ply_reads_written_properties() {
        #[derive(Deserialize)]
        struct File {
            vertex: Vec<HashMap<String, f32>>,
        }
        let dir = tempfile::tempdir().unwrap();
        let (path, scene) = (dir.path().join("a.ply"), scene(2));
        write(&path, &scene, 4.0).unwrap();
        let file: File =
            serde_ply::from_reader(std::io::BufReader::new(std::fs::File::open(&path).unwrap()))
                .unwrap();
        let instant_splats = crate::scene::instant(&scene.splats, 4.0, 10.0);
        assert_eq!(file.vertex.len(), instant_splats.n());
        for (i, vertex) in file.vertex.iter().enumerate() {
            assert_eq!(vertex.len(), 17 + 24);
            assert_eq!(vertex["y"], instant_splats.column(Column::Mean, 1)[i]);
            assert_eq!(vertex["nz"], 0.0);
            assert_eq!(
                vertex["scale_2"],
                instant_splats.column(Column::LogScale, 2)[i]
            );
            assert_eq!(
                vertex["opacity"],
                instant_splats.column(Column::Opacity, 0)[i]
            );
            assert_eq!(
                vertex["f_dc_1"],
                instant_splats.column(Column::Colour, 1)[i]
            );
            // green of the third of eight terms: channel major
            assert_eq!(
                vertex["f_rest_10"],
                instant_splats.column(Column::Colour, 3 * 3 + 1)[i]
            );
            let norm: f32 = (0..4).map(|k| vertex[&format!("rot_{k}")].powi(2)).sum();
            assert!((norm - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn sequences_write_one_file_per_frame_and_remove_old_ones() {
        let dir = tempfile::tempdir().unwrap();
        let scene = scene(0);
        let same = |_| Cow::Borrowed(&scene.splats);
        write_sequence(dir.path(), &scene, &[0.0, 5.0, 10.0], same, |_| true).unwrap();
        let written = write_sequence(dir.path(), &scene, &[0.0, 10.0], same, |_| true).unwrap();
        assert!(!dir.path().join(frame_name(2)).exists());
        let counts: Vec<usize> = (0..2)
            .map(|i| {
                read(&dir.path().join(frame_name(i)))
                    .unwrap()
                    .scene
                    .splats
                    .n()
            })
            .collect();
        assert_eq!(counts.iter().sum::<usize>(), written.splats);
        assert_eq!(
            counts[0],
            crate::scene::instant(&scene.splats, 0.0, 10.0).n()
        );
        let stopped =
            write_sequence(dir.path(), &scene, &[0.0, 5.0, 10.0], same, |done| done < 2).unwrap();
        assert_eq!(
            stopped.splats,
            counts[0] + crate::scene::instant(&scene.splats, 5.0, 10.0).n()
        );
    }

    #[test]
    fn a_comment_says_that_opacities_want_the_mip_filter() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.ply");
        for mip in [false, true] {
            let scene = Scene { mip, ..scene(0) };
            let written = write(&path, &scene, 4.0).unwrap();
            let bytes = std::fs::read(&path).unwrap();
            let text = String::from_utf8_lossy(&bytes[..400]).into_owned();
            assert_eq!(
                text.contains("\ncomment SplatRenderMode: mip\nelement vertex"),
                mip,
                "{text}"
            );
            assert_eq!(
                written
                    .losses
                    .iter()
                    .any(|l| l.to_string().contains("Mip filter")),
                mip
            );
            assert_eq!(read(&path).unwrap().scene.splats.n(), written.splats);
        }
    }

    #[test]
    fn bound_splats_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let (path, bound) = (dir.path().join("a.ply"), bound_scene(&SceneSpec::default()));
        let error = write(&path, &bound, 4.0).unwrap_err().to_string();
        assert!(
            error.contains("20 splats bound to nodes") && error.contains("pose::at"),
            "{error}"
        );
        let same = |_| Cow::Borrowed(&bound.splats);
        assert!(write_sequence(dir.path(), &bound, &[0.0, 5.0], same, |_| true).is_err());
        assert!(!path.exists() && !dir.path().join(frame_name(0)).exists());
    }

    #[test]
    fn ply_property_orders_are_read() {
        let mut bytes =
            b"ply\r\nformat binary_little_endian 1.0\ncomment by hand\nelement vertex 1\n".to_vec();
        bytes.extend(b"property uchar red\nproperty double trbf_center\n");
        let names = [
            "rot_3", "rot_2", "rot_1", "rot_0", "f_dc_2", "f_dc_1", "f_dc_0", "opacity",
        ];
        let more = ["scale_0", "scale_1", "scale_2", "x", "y", "z"];
        for name in names.iter().chain(&more) {
            bytes.extend(format!("property float32 {name}\n").bytes());
        }
        bytes.extend(b"element face 0\nproperty list uchar int i\nend_header\n");
        bytes.extend([0; 9]);
        for v in 1..=14 {
            // converters write infinite logarithms
            let value = if v == 9 { f32::NEG_INFINITY } else { v as f32 };
            bytes.extend(value.to_le_bytes());
        }
        let file = parse(Path::new("other.ply"), &bytes).unwrap();
        let splats = file.scene.splats;
        assert_eq!(
            (
                splats.n_static(),
                splats.n_dynamic(),
                file.scene.time_frames
            ),
            (1, 0, 1)
        );
        let row = Row::of(&splats, 0);
        assert_eq!(
            (row.mean, row.log_scale, row.opacity),
            ([12.0, 13.0, 14.0], [-20.0, 10.0, 11.0], 8.0)
        );
        assert_eq!(splats.column(Column::Colour, 0), &[7.0]);
        assert!((row.quat[0] - 4.0 / 30f32.sqrt()).abs() < 1e-6);
        assert!(
            matches!(&file.losses[..], [Loss::Dropped(what)] if what.contains("red, trbf_center"))
        );
    }

    #[test]
    fn malformed_ply_is_rejected_with_a_reason() {
        let at = Path::new("other.ply");
        let head = |count: &str, names: &[&str]| {
            let properties: String = names
                .iter()
                .map(|n| format!("property float {n}\n"))
                .collect();
            format!("ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{properties}end_header\n")
                .into_bytes()
        };
        let all = [
            "x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2",
            "rot_3", "f_dc_0", "f_dc_1", "f_dc_2",
        ];
        let mut huge = head("4000000000000000000", &all);
        huge.extend([0; 560]);
        let error = parse(at, &huge).unwrap_err();
        assert!(error.to_string().contains("560 bytes"), "{error}");

        let one = |names: &[&str], value: f32| {
            let mut bytes = head("1", names);
            bytes.extend(names.iter().flat_map(|_| value.to_le_bytes()));
            parse(at, &bytes)
        };
        assert_eq!(one(&all, 0.5).unwrap().scene.splats.n(), 1);
        let nan = one(&all, f32::NAN).unwrap_err();
        assert!(nan.to_string().contains("of splat 0 is NaN"), "{nan}");
        for left_out in ["x", "opacity", "scale_2", "rot_2", "f_dc_1"] {
            let names: Vec<&str> = all.into_iter().filter(|n| *n != left_out).collect();
            assert_eq!(
                one(&names, 0.5).unwrap_err().kind(),
                ErrorKind::Unsupported,
                "{left_out}"
            );
        }
        let rest: Vec<String> = (0..5).map(|k| format!("f_rest_{k}")).collect();
        let names: Vec<&str> = all
            .into_iter()
            .chain(rest.iter().map(String::as_str))
            .collect();
        assert!(
            one(&names, 0.5)
                .unwrap_err()
                .to_string()
                .contains("5 properties f_rest_")
        );
        for (text, reason) in [
            ("\u{89}PNG\n", "not a PLY file"),
            ("ply\nformat ascii 1.0\n", "stored as ascii"),
            (
                "ply\nelement chunk 1\nproperty float min_x\nelement vertex 9\nproperty uint packed_position\n",
                "compressed",
            ),
            ("ply\nend_header\n", "damaged"),
            ("ply\nproperty float x\nend_header\n", "damaged"),
            ("ply\nelement vertex -1\nend_header\n", "damaged"),
            (
                "ply\nelement vertex 99999999999999999999\nend_header\n",
                "damaged",
            ),
            (
                "ply\nelement vertex 1\nproperty quad x\nend_header\n",
                "damaged",
            ),
            ("ply\nelement vertex 1\n", "damaged"),
            (
                "ply\nformat binary_little_endian 2.0\nend_header\n",
                "damaged",
            ),
            (
                "ply\nelement vertex 1\nproperty list uchar int i\nend_header\n",
                "lists",
            ),
        ] {
            let error = parse(at, text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(reason), "{text}: {error}");
        }
    }
}
