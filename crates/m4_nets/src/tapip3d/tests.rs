//! The network against its fixture: weights by the formula, damped where a random network would be
//! chaotic.

use super::config::Config;
use super::frame::{Frame, Geometry, PosedPinhole, Sides, image_tensor, map_sizes, maps, sampled};
use super::source::sides;
use super::track::track_within;
use super::window::{State, Window};
use super::*;
use crate::fixture::{Fixture, assert_close, assert_near};
use crate::ops::tensor;
use crate::{ClipError, cpu};
use burn_core::tensor::DType;
use m4_core::nalgebra::{Matrix4, Vector3};
use m4_core::{Camera, DepthMap, Intrinsics, Plane, RgbImage, Se3, Silent};
use m4_testkit::FormulaWeights;
use std::sync::Arc;
use tempfile::TempDir;

const KEYS: &str = include_str!("../../../../fixtures/tapip3d/keys.txt");
const CONFIG: &str = include_str!("../../../../fixtures/tapip3d/config.json");
const SIZE: (usize, usize) = (224, 160);
const FRAMES: usize = 24;
const WINDOW: usize = 16;
/// Queries that begin in the first window.
const FIRST: usize = 29;

fn network(fixture: &Fixture) -> Tapip3d {
    let damped = |s: usize| 0.5f32.powi(s.saturating_sub(4) as i32);
    let mut weights = FormulaWeights::of_keys(KEYS)
        .with("time_emb", &fixture.floats("time_emb").0)
        .scaled("point_updater.flow_head.weight", 0.005)
        .scaled_by("point_updater.input_transform.weight", |i| {
            (i % 711)
                .checked_sub(513 + 6)
                .map_or(1.0, |j| damped(j % 96 / 6))
        });
    for level in 0..4 {
        let name = format!("corr_processor.posenc_mlps.{level}.0.weight");
        weights = weights.scaled_by(&name, |j| {
            j.checked_sub(3).map_or(1.0, |j| damped(j % 48 / 3))
        });
    }
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("weights.safetensors");
    weights.write_with(Some(("config", CONFIG)), &path);
    Tapip3d::load(&path, cpu()).unwrap()
}

struct Clip(Fixture);

impl Clip {
    fn depth_of(&self, frame: usize) -> Vec<f32> {
        let (small, ramp) = (
            self.0.floats("depth_small").0,
            self.0.floats("depth_ramp").0,
        );
        let small = &small[frame * 40 * 56..];
        let z = (0..160 * 224).map(|i| match small[i / 224 / 4 * 56 + i % 224 / 4] {
            z if z > 0.0 => z + ramp[i],
            _ => 0.0,
        });
        z.collect()
    }
}

impl PosedClip for Clip {
    fn frames(&self) -> usize {
        FRAMES
    }

    fn image(&self, frame: usize) -> Result<RgbImage, ClipError> {
        let bytes = self.0.bytes("frames_u8");
        let small = &bytes[frame * 40 * 56 * 3..];
        Ok(Plane::from_fn(224, 160, |x, y| {
            [0, 1, 2].map(|c| small[(y / 4 * 56 + x / 4) * 3 + c])
        }))
    }

    fn depth(&self, frame: usize) -> Result<DepthMap, ClipError> {
        Ok(Plane::from_vec(224, 160, self.depth_of(frame))?)
    }

    fn camera(&self, frame: usize) -> Result<Camera, ClipError> {
        let k: Vec<f64> = self.0.floats("intrinsics").0[frame * 9..][..9]
            .iter()
            .map(|&x| f64::from(x))
            .collect();
        let w2c = self.0.floats("extrinsics").0[frame * 16..][..16].to_vec();
        let w2c = Matrix4::from_row_iterator(w2c.into_iter().map(f64::from));
        Ok(Camera {
            intrinsics: Intrinsics {
                width: 224,
                height: 160,
                fx: k[0],
                fy: k[4],
                cx: k[2] + 0.5,
                cy: k[5] + 0.5,
            },
            c2w: Se3::from_matrix(&w2c).inverse(),
        })
    }
}

impl Clip {
    fn range(&self) -> [f32; 2] {
        self.0.floats("depth_roi").0.try_into().unwrap()
    }

    fn geometry(&self, frame: usize) -> Geometry {
        let lens =
            PosedPinhole::new(&self.camera(frame).unwrap(), SIZE, &Vector3::zeros()).unwrap();
        Geometry::new(lens, &self.depth_of(frame), SIZE, self.range(), 4)
    }

    /// Frame and place of every query.
    fn queries(&self) -> Vec<(usize, [f32; 3])> {
        let rows = self.0.floats("query_point").0;
        let rows = rows.as_chunks::<4>().0.iter();
        rows.map(|&[t, x, y, z]| (t as usize, [x, y, z])).collect()
    }

    fn maps(&self, net: &Tapip3d, frame: usize) -> Vec<Tensor<2>> {
        let image = self.image(frame).unwrap();
        let image = image_tensor(&image, SIZE, &net.device, DType::F32);
        maps(&net.net, image, 4)
    }

    /// The first window, and the sides of its queries in the order of the fixture.
    fn first_window(&self, net: &Tapip3d) -> (Window, Sides) {
        let queries = self.queries();
        let mut frames = Vec::new();
        let mut of: Vec<Option<Sides>> = vec![None; queries.len()];
        for frame in 0..WINDOW {
            let (maps, geometry) = (self.maps(net, frame), self.geometry(frame));
            for (side, (t, p)) in of.iter_mut().zip(&queries) {
                if *t == frame {
                    *side = Some(sides(
                        &net.net,
                        &maps,
                        &geometry.points,
                        &geometry.lens,
                        SIZE,
                        &[*p],
                        32,
                    ));
                }
            }
            let prepared = |map| net.net.corr_processor.prepared(map);
            frames.push(Arc::new(Frame {
                features: maps.into_iter().map(prepared).collect(),
                points: geometry.points,
                moments: geometry.moments,
            }));
        }
        let begun: Vec<&Sides> = of.iter().flatten().collect();
        assert_eq!(begun.len(), FIRST);
        let sides = Sides::together(&begun).unwrap();
        (Window::new(frames, &net.config).unwrap(), sides)
    }
}

fn clip() -> Clip {
    Clip(Fixture::open("tapip3d/tracker.safetensors"))
}

/// Channels `0, step, ...` of `map` `[pixels, channels]` as planes.
fn planes(map: &Tensor<2>, step: usize) -> Vec<f32> {
    let [n, c] = map.dims();
    let some = map.clone().reshape([n, c / step, step]).narrow(2, 0, 1);
    some.squeeze_dim::<2>(2)
        .transpose()
        .try_into_vec_as()
        .unwrap()
}

#[test]
fn features_and_points_of_frames() {
    let clip = clip();
    let net = network(&clip.0);
    let mut got = Vec::new();
    for frame in [0, 7] {
        let maps = clip.maps(&net, frame);
        got.extend(planes(&maps[0], 8));
        if frame == 0 {
            let points = clip.geometry(0).points;
            for (level, (map, points)) in maps.iter().zip(points).enumerate() {
                let want = clip.0.floats(&format!("feat_level{level}_f0_strided")).0;
                assert_close(
                    &format!("features of level {level}"),
                    &planes(map, 8),
                    &want,
                    3e-5,
                );
                let want = clip.0.floats(&format!("pcd_level{level}_f0")).0;
                let axis = |axis: usize| points.iter().map(move |p: &[f32; 3]| p[axis]);
                let points: Vec<f32> = (0..3).flat_map(axis).collect();
                assert_close(&format!("points of level {level}"), &points, &want, 3e-6);
            }
        }
    }
    assert_close(
        "features",
        &got,
        &clip.0.floats("features_f0_f7_strided").0,
        3e-5,
    );
}

#[test]
fn windows_are_brought_to_the_network_s_space() {
    let clip = clip();
    let config = Config::read(&serde_json::from_str(CONFIG).unwrap()).unwrap();
    for (name, first) in [("w0", 0), ("w1", 8)] {
        let all = (first..first + WINDOW).map(|frame| clip.geometry(frame).moments);
        let all = all.fold(window::Moments::default(), |sum, m| sum.with(&m));
        let space = all.space(config.norm_scale).unwrap();
        assert_close(
            "mean",
            &space.mean,
            &clip.0.floats(&format!("norm_mean_{name}")).0,
            1e-5,
        );
        assert_close(
            "deviation",
            &[space.std; 3],
            &clip.0.floats(&format!("norm_std_{name}")).0,
            1e-5,
        );
        if first == 0 {
            let begun = clip.queries().into_iter().filter(|(t, _)| *t < WINDOW);
            let got: Vec<f32> = begun
                .flat_map(|(t, p)| {
                    let p = space.enter(p);
                    [t as f32, p[0], p[1], p[2]]
                })
                .collect();
            assert_close(
                "queries",
                &got,
                &clip.0.floats("queries_normalised_w0").0,
                1e-5,
            );
        }
    }
}

/// How many of `got` are not in `want`, both in rows of 32.
fn others(got: &[u32], want: &[i16]) -> usize {
    assert_eq!(got.len(), want.len());
    let rows = got.as_chunks::<32>().0.iter().zip(want.as_chunks::<32>().0);
    rows.map(|(got, want)| got.iter().filter(|&&i| !want.contains(&(i as i16))).count())
        .sum()
}

#[test]
fn neighbours_and_queries_of_a_window() {
    let clip = clip();
    let net = network(&clip.0);
    let (window, sides) = clip.first_window(&net);
    let at = clip.0.floats("corr_it0_coords").0;
    let at = &at.as_chunks::<3>().0[..4 * FIRST];
    for level in [0, 3] {
        let all: Vec<[f32; 3]> = at.iter().cycle().take(WINDOW * FIRST).copied().collect();
        let near = window.near(level, &all, 32);
        let want = clip.0.shorts(&format!("knn_it0_level{level}_frames0to3"));
        let wrong = others(&near[..4 * FIRST * 32], &want);
        assert!(
            wrong <= 4,
            "{wrong} of {} neighbours of level {level}",
            want.len()
        );

        let (want, _) = clip.0.floats(&format!("support_offset_level{level}_w0"));
        let here: Vec<[f32; 3]> = sides.points[level]
            .iter()
            .map(|&p| window.space.enter(p))
            .collect();
        // of points at the same distance the order is open
        let lengths = |all: &[[f32; 3]]| -> Vec<f32> {
            all.iter()
                .map(|p| p.iter().map(|x| x * x).sum::<f32>().sqrt())
                .collect()
        };
        let minus = |a: [f32; 3], b: [f32; 3]| [0, 1, 2].map(|i| a[i] - b[i]);
        let got: Vec<[f32; 3]> = here
            .chunks_exact(33)
            .flat_map(|around| around.iter().map(|&p| minus(p, around[0])))
            .collect();
        assert_close(
            "distances",
            &lengths(&got),
            &lengths(want.as_chunks::<3>().0),
            3e-5,
        );

        let sizes = map_sizes(SIZE, 4);
        let begun: Vec<(usize, [f32; 3])> = clip
            .queries()
            .into_iter()
            .filter(|(t, _)| *t < WINDOW)
            .collect();
        let own: Vec<Tensor<2>> = begun
            .iter()
            .map(|&(t, p)| {
                let lens = clip.geometry(t).lens;
                let [x, y] = lens.project(&Vector3::from(p.map(f64::from)));
                let (w, h) = sizes[level];
                let place = [x * w as f64 / 224.0, y * h as f64 / 160.0];
                sampled(&clip.maps(&net, t)[level], (w, h), &[place])
            })
            .collect();
        let own = Tensor::cat(own, 0).reshape([FIRST, 32, 4]).narrow(2, 0, 1);
        let name = format!("query_feat_level{level}_w0");
        assert_near(own.squeeze_dim::<2>(2), &clip.0, &name, 1e-4);
    }
}

#[test]
fn a_window_is_revised() {
    let clip = clip();
    let net = network(&clip.0);
    let (window, sides) = clip.first_window(&net);
    let begun: Vec<[f32; 3]> = clip
        .queries()
        .into_iter()
        .filter(|(t, _)| *t < WINDOW)
        .map(|(_, p)| window.space.enter(p))
        .collect();
    let mut state = State {
        at: begun.iter().cycle().take(WINDOW * FIRST).copied().collect(),
        logits: vec![0.0; WINDOW * FIRST],
    };
    assert_close(
        "points",
        state.at.as_flattened(),
        &clip.0.floats("corr_it0_coords").0,
        1e-5,
    );
    let sides = window.query_sides(&net.net, &sides);
    let compared = window.compared(&net.net, &sides, &state.at, 32);
    let [t, n, c] = compared.dims();
    let strided = compared.clone().reshape([t, n, c / 4, 4]).narrow(3, 0, 1);
    assert_near(strided, &clip.0, "corr_it0_out_strided", 1e-4);
    let input = window.input(&net.net, &state, compared);
    let [_, _, c] = input.dims();
    let some = [0, 5, 10, 15]
        .map(|t| input.clone().narrow(0, t, 1))
        .to_vec();
    assert_eq!(c, 711);
    assert_near(
        Tensor::cat(some, 0),
        &clip.0,
        "updater_it0_in_strided",
        1e-4,
    );
    assert_near(
        net.net.point_updater.forward(input),
        &clip.0,
        "updater_it0_out",
        1e-4,
    );
    for iteration in 0..2 {
        state = window.moved(&net.net, &sides, state, 32).unwrap();
        let world: Vec<[f32; 3]> = state.at.iter().map(|&p| window.space.leave(p)).collect();
        let begun = |width: usize, values: Vec<f32>| -> Vec<f32> {
            let rows = values
                .chunks_exact(width)
                .zip(clip.queries().into_iter().cycle());
            rows.filter(|(_, (t, _))| *t < WINDOW)
                .flat_map(|(x, _)| x.to_vec())
                .collect()
        };
        let want = begun(3, clip.0.floats(&format!("out{iteration}_coords")).0);
        assert_close(
            &format!("iteration {iteration}"),
            world.as_flattened(),
            &want,
            1e-4,
        );
        let want = begun(1, clip.0.floats(&format!("out{iteration}_visibs")).0);
        assert_close(
            &format!("visibility {iteration}"),
            &state.logits,
            &want,
            1e-4,
        );
    }
}

fn fixture_queries(clip: &Clip) -> Vec<PointQuery> {
    let query = |(frame, p): (usize, [f32; 3])| PointQuery {
        frame,
        world: p.map(f64::from),
    };
    clip.queries().into_iter().map(query).collect()
}

fn fixture_options() -> Tapip3dOptions {
    Tapip3dOptions {
        iterations: 2,
        support_grid: 0,
        backward: false,
        clean_edges: false,
        ..Tapip3dOptions::at(SIZE)
    }
}

#[test]
fn whole_clip_matches_the_reference() {
    let clip = clip();
    let net = network(&clip.0);
    let queries = fixture_queries(&clip);
    let range = Some(clip.range());
    let tracks = track_within(&net, &clip, &queries, &fixture_options(), range, &Silent).unwrap();
    let (want, logits) = (
        clip.0.floats("pred_coords").0,
        clip.0.floats("pred_visibs").0,
    );
    let n = queries.len();
    // frames before a query's own are not followed
    let followed: Vec<(usize, usize)> = (0..n)
        .flat_map(|i| (queries[i].frame..FRAMES).map(move |t| (i, t)))
        .collect();
    let got: Vec<f32> = followed
        .iter()
        .flat_map(|&(i, t)| tracks.world[i * FRAMES + t])
        .collect();
    let coords: Vec<f32> = followed
        .iter()
        .flat_map(|&(i, t)| want[(t * n + i) * 3..][..3].to_vec())
        .collect();
    assert_close("tracks", &got, &coords, 1e-4);
    let got: Vec<f32> = followed
        .iter()
        .map(|&(i, t)| tracks.visibility[i * FRAMES + t])
        .collect();
    let visibility: Vec<f32> = followed
        .iter()
        .map(|&(i, t)| 1.0 / (1.0 + (-logits[t * n + i]).exp()))
        .collect();
    assert_close("visibility", &got, &visibility, 1e-4);
}

/// Backward is forward on the reversed clip.
#[test]
fn backward_is_forward_on_the_reversed_clip() {
    struct Reversed<'a>(&'a Clip);
    impl PosedClip for Reversed<'_> {
        fn frames(&self) -> usize {
            FRAMES
        }
        fn image(&self, frame: usize) -> Result<RgbImage, ClipError> {
            self.0.image(FRAMES - 1 - frame)
        }
        fn depth(&self, frame: usize) -> Result<DepthMap, ClipError> {
            self.0.depth(FRAMES - 1 - frame)
        }
        fn camera(&self, frame: usize) -> Result<Camera, ClipError> {
            self.0.camera(FRAMES - 1 - frame)
        }
    }
    let clip = clip();
    let net = network(&clip.0);
    let queries: Vec<PointQuery> = fixture_queries(&clip)
        .into_iter()
        .filter(|q| q.frame == 17)
        .collect();
    let turned: Vec<PointQuery> = queries
        .iter()
        .map(|q| PointQuery {
            frame: FRAMES - 1 - q.frame,
            ..*q
        })
        .collect();
    let options = Tapip3dOptions {
        iterations: 1,
        support_grid: 3,
        backward: true,
        ..fixture_options()
    };
    let forward = net.track(&clip, &queries, &options, &Silent).unwrap();
    let backward = net
        .track(&Reversed(&clip), &turned, &options, &Silent)
        .unwrap();
    assert_eq!(forward.world.len(), queries.len() * FRAMES);
    for i in 0..queries.len() {
        let at = |tracks: &PointTracks, t: usize| tracks.world[i * FRAMES + t];
        let before: Vec<[f32; 3]> = (0..17).map(|t| at(&forward, t)).collect();
        let after: Vec<[f32; 3]> = (0..17).map(|t| at(&backward, FRAMES - 1 - t)).collect();
        // the origin is another
        assert_close(
            "way back",
            before.as_flattened(),
            after.as_flattened(),
            1e-4,
        );
    }
}

#[test]
fn edges_of_depth_are_replaced() {
    let fixture = Fixture::open("ops/depth_edge_filter.safetensors");
    let (z, shape) = fixture.floats("depth");
    let k = fixture.doubles("K");
    let camera = Camera {
        intrinsics: Intrinsics {
            width: shape[1],
            height: shape[0],
            fx: k[0],
            fy: k[4],
            cx: k[2] + 0.5,
            cy: k[5] + 0.5,
        },
        c2w: Se3::identity(),
    };
    let size = (shape[1], shape[0]);
    let lens = PosedPinhole::new(&camera, size, &Vector3::zeros()).unwrap();
    let got = depth::cleaned(&z, size, &lens);
    let want = fixture.floats("filtered").0;
    let changed = want.iter().zip(&z).filter(|(a, b)| a != b).count();
    let wrong = got.iter().zip(&want).filter(|(a, b)| a != b).count();
    println!("{changed} pixels are replaced, {wrong} otherwise");
    assert!(changed > 50 && wrong == 0, "{wrong} of {changed}");
}

#[test]
fn queries_outside_every_view_and_samples_out_of_bounds_stay_finite() {
    let clip = clip();
    let net = network(&clip.0);
    // a query far outside is not seen, and is followed anyway
    let queries = [[1e6, -1e6, 5.0], [0.0, 0.0, -3.0]].map(|world| PointQuery { frame: 3, world });
    let tracks = net
        .track(&clip, &queries, &fixture_options(), &Silent)
        .unwrap();
    assert!(tracks.world.as_flattened().iter().all(|x| x.is_finite()));
    let x = tensor(vec![1.0, 2.0, 3.0, 4.0], [4, 1], &cpu());
    let far = sampled(&x, (2, 2), &[[f64::NAN, 0.0], [1e300, -5.0], [0.5, 0.5]]);
    let far: Vec<f32> = far.try_into_vec_as().unwrap();
    assert_eq!(far, [1.0, 2.0, 2.5]);
}
