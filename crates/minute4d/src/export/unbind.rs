//! Turns splats that are bound to nodes into those that a format has: of one instant, or on
//! straight lines.

use super::{Format, Time};
use m4_core::nalgebra::Vector3;
use m4_core::{Scene, Se3, SourceFrame};
use m4_io::scene::Loss;
use m4_kernels::pose;

/// How far a piece may be off its path, pixels of the source. Half a pixel makes four million
/// pieces of a clip with fast rotation, which no format holds well.
const TOLERANCE_PX: f64 = 2.0;

/// The scene for a format: with pieces for one of the whole clip, as at `t`, frames, for one of an
/// instant; a sequence poses splats by itself. `None` where nothing changes.
pub(super) fn unbind(scene: &Scene, format: Format, t: f64) -> Option<(Scene, Loss)> {
    let bound = scene.splats.bindings().len();
    let of = |splats| Scene {
        splats,
        source: scene.source.clone(),
        ..*scene
    };
    match format.time() {
        _ if bound == 0 => None,
        Time::Sequence | Time::Capture => None,
        Time::Instant => {
            let splats = pose::at(&scene.splats, t as f32).into_owned();
            let n_live = splats.n_static() - scene.splats.n_static();
            let what = format!(
                "the motion of {bound} splats that nodes carry, at frame {t}: {n_live} of them live then"
            );
            Some((of(splats), Loss::Baked(what)))
        }
        Time::Clip => {
            let pixels = Pixels::of(scene);
            let clip = [0.0, scene.time_frames.saturating_sub(1) as f64];
            let pieces = pose::pieces(
                &scene.splats,
                clip,
                |place, t| pixels.size(place, t),
                TOLERANCE_PX,
            );
            let error = |share: f64| {
                let last = pieces.errors_px.len().saturating_sub(1) as f64;
                pieces
                    .errors_px
                    .get((share * last).round() as usize)
                    .copied()
                    .unwrap_or(0.0)
            };
            let off = match pixels.views.is_empty() {
                true => {
                    "the scene has no cameras to say by how many pixels they are off".to_owned()
                }
                false => format!(
                    "half of the splats are off by up to {:.2} pixels, 95 % by up to {:.2}, all by up to {:.2}, while a piece has half of its opacity",
                    error(0.5),
                    error(0.95),
                    error(1.0)
                ),
            };
            let what = format!(
                "the motion of {bound} splats that nodes carry, into {} on straight lines; {off}; rotations and trends of colours are those of the middle of \
                 a piece",
                pieces.count
            );
            Some((of(pieces.splats), Loss::Baked(what)))
        }
    }
}

/// How large a pixel of the source is, by place and time.
struct Pixels {
    /// In order of time: frames, world to camera, focal length, pixels.
    views: Vec<(f64, Se3<f64>, f64)>,
    near: f64,
}

impl Pixels {
    fn of(scene: &Scene) -> Self {
        let view = |frame: &SourceFrame| (frame.t, frame.camera.w2c(), frame.camera.intrinsics.fx);
        let mut views: Vec<_> = scene.source.iter().map(view).collect();
        views.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self {
            views,
            near: f64::from(scene.near),
        }
    }

    /// World units per pixel of the camera that is nearest in time: by depth, or by distance where
    /// the place is not in front of it. 0 without cameras.
    fn size(&self, place: &Vector3<f64>, t: f64) -> f64 {
        let after = self.views.partition_point(|view| view.0 < t);
        let around = &self.views[after.saturating_sub(1)..(after + 1).min(self.views.len())];
        let nearest = around
            .iter()
            .min_by(|a, b| (a.0 - t).abs().total_cmp(&(b.0 - t).abs()));
        nearest.map_or(0.0, |(_, w2c, focal_px)| {
            let point = w2c.transform(place);
            let depth = if point.z > self.near {
                point.z
            } else {
                point.norm().max(self.near)
            };
            depth / focal_px
        })
    }
}

#[cfg(test)]
mod tests {
    use super::{Pixels, TOLERANCE_PX, unbind};
    use crate::export::{ExportJob, Format, make};
    use m4_core::nalgebra::Vector3;
    use m4_core::{Column, Silent};
    use m4_io::scene::{instant, ply, safetensors};
    use m4_kernels::pose::at;
    use m4_testkit::{SceneSpec, bound_scene, random_scene};
    use std::collections::BTreeMap;

    #[test]
    fn each_format_gets_splats_that_it_has() {
        let scene = bound_scene(&SceneSpec::default());
        for format in Format::all() {
            let result = unbind(&scene, format, 3.0);
            let keeps = matches!(format, Format::PlySequence | Format::Colmap);
            assert_eq!(result.is_none(), keeps, "{format:?}");
            let Some((output, loss)) = result else {
                continue;
            };
            assert!(output.splats.bindings().is_empty());
            assert!(
                loss.to_string().contains("20 splats that nodes carry"),
                "{loss}"
            );
        }
        let (output, loss) = unbind(&scene, Format::Fourdgs, 0.0).unwrap();
        assert!(
            output.splats.n_dynamic() > 60 && loss.to_string().contains("95 % by up to 0."),
            "{loss}"
        );
        assert!(unbind(&random_scene(&SceneSpec::default()), Format::Fourdgs, 0.0).is_none());
        let mut blind = bound_scene(&SceneSpec::default());
        blind.source.clear();
        let (finest, loss) = unbind(&blind, Format::Fourdgs, 0.0).unwrap();
        assert!(
            finest.splats.n_dynamic() > output.splats.n_dynamic()
                && loss.to_string().contains("no cameras")
        );
    }

    #[test]
    fn a_scene_with_bound_splats_is_exported_to_every_format() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("scene.safetensors");
        let scene = bound_scene(&SceneSpec::default());
        safetensors::write(&file, &scene, None, &BTreeMap::new()).unwrap();
        for format in Format::all().filter(|format| !format.takes_capture()) {
            let report = make(&file, &ExportJob::new(format), &Silent).unwrap();
            for expected in ["20 splats that nodes carry", "Mip filter"] {
                assert!(
                    report
                        .losses
                        .baked
                        .iter()
                        .any(|what| what.contains(expected)),
                    "{format:?}: {report}"
                );
            }
        }
        let first = ply::read(&dir.path().join("ply").join(ply::frame_name(0)))
            .unwrap()
            .scene
            .splats;
        let want = instant(&at(&scene.splats, 0.0), 0.0, 9.0);
        assert_eq!(first.n(), want.n());
        for k in 0..3 {
            assert_eq!(first.column(Column::Mean, k), want.column(Column::Mean, k));
        }
    }

    #[test]
    fn a_pixel_is_as_large_as_at_its_depth() {
        let scene = random_scene(&SceneSpec::default());
        let pixels = Pixels::of(&scene);
        let camera = &scene.source[4].camera;
        let place = camera.c2w.transform(&Vector3::new(0.3, 0.2, 2.0));
        assert!((pixels.size(&place, 4.2) - 2.0 / 50.0).abs() < 1e-9 && TOLERANCE_PX < 3.0);
        let behind = camera.c2w.transform(&Vector3::new(0.0, 0.0, -3.0));
        assert!((pixels.size(&behind, 3.9) - 3.0 / 50.0).abs() < 1e-9);
        assert!(pixels.size(&place, 1e6) > 0.0 && pixels.size(&place, -1e6) > 0.0);
    }
}
