//! Scene files: every bit comes back, and no damaged file is taken for a whole one.

use crate::common::temporary;
use m4_core::{
    Camera, Column, CounterRng, Exposure, Intrinsics, Scene, Se3, SourceFrame, SplatLayout, Splats,
    StateTensor, TrainState, nalgebra::Vector6,
};
use m4_io::ErrorKind;
use m4_io::scene::safetensors::{read, write};
use m4_testkit::SceneSpec;
use std::collections::BTreeMap;
use std::path::Path;

fn splats(layout: SplatLayout, n_static: usize, n_dynamic: usize) -> Splats {
    let mut rng = CounterRng::new(5, 1, (layout.sh_degree + 10 * layout.time_degree) as u64);
    let mut splats = Splats::zeros(layout, n_static, n_dynamic);
    let trend = layout.column(Column::Trend);
    for column in splats.columns_mut().take(trend) {
        column.fill_with(|| rng.normal() as f32);
    }
    splats
}

fn scene(layout: SplatLayout, n_static: usize, n_dynamic: usize) -> Scene {
    let source = |i: usize| SourceFrame {
        camera: Camera {
            intrinsics: Intrinsics {
                width: 480,
                height: 360,
                fx: 374.714_591_263 + i as f64,
                fy: 1000.0 / 3.0,
                cx: 240.1,
                cy: 180.0,
            },
            c2w: Se3::identity().retract(&Vector6::new(0.1, 0.2, 0.3, 0.4, i as f64 * 0.1, 0.6)),
        },
        t: i as f64 * 1.01,
        exposure: Exposure {
            matrix: [[1.0, 0.1, 0.2], [0.3, 0.9, 1e-7], [-0.5, 0.0, 1.5]],
            offset: [0.01, -0.02, i as f32],
        },
        distance_sigma: (i % 2 == 1).then_some(0.12 * i as f32),
    };
    Scene {
        splats: splats(layout, n_static, n_dynamic),
        background: [0.1, 0.2, 1.0 / 3.0],
        time_frames: 96,
        duration_s: Some(3.958_333_333_333_333_5),
        mip: true,
        near: 0.01,
        source: (0..4).map(source).collect(),
    }
}

fn layouts() -> impl Iterator<Item = SplatLayout> {
    [
        (false, 0, 0),
        (true, 0, 0),
        (false, 3, 2),
        (true, 1, 1),
        (false, 2, 0),
    ]
    .into_iter()
    .map(|(isotropic, sh_degree, time_degree)| SplatLayout {
        isotropic,
        sh_degree,
        time_degree,
    })
}

fn state() -> TrainState<'static> {
    BTreeMap::from([
        (
            "adam.m".to_owned(),
            StateTensor::f32(vec![1.0, f32::NAN, -0.0, f32::INFINITY]),
        ),
        (
            "adam.v".to_owned(),
            StateTensor::F32 {
                shape: vec![2, 3],
                data: vec![0.5; 6].into(),
            },
        ),
        ("rng".to_owned(), StateTensor::u32(vec![u32::MAX, 7])),
        ("losses".to_owned(), StateTensor::f64(vec![0.1, 1e-300])),
        (
            "config".to_owned(),
            StateTensor::u8(b"iterations = 5\n".to_vec()),
        ),
        ("empty".to_owned(), StateTensor::f32(vec![])),
    ])
}

#[test]
fn every_layout_round_trips_exactly() {
    let (_dir, path) = temporary("deep/scene.safetensors");
    let pairs = BTreeMap::from([("key".to_owned(), "wert \"ü\"\n".to_owned())]);
    for layout in layouts() {
        for (n_static, n_dynamic) in [(5, 3), (0, 4), (6, 0), (0, 0)] {
            let scene = scene(layout, n_static, n_dynamic);
            write(&path, &scene, Some(&state()), &pairs).unwrap();
            let back = read(&path).unwrap();
            assert_eq!(back.scene, scene, "{layout:?}");
            let back_state = back.state.unwrap();
            assert_eq!(format!("{back_state:?}"), format!("{:?}", state()));
            assert_eq!(back.metadata, pairs);
        }
    }
    write(
        &path,
        &scene(layouts().next().unwrap(), 2, 2),
        None,
        &BTreeMap::new(),
    )
    .unwrap();
    let plain = read(&path).unwrap();
    assert!(plain.state.is_none() && plain.metadata.is_empty());
    let first = std::fs::read(&path).unwrap();
    write(&path, &plain.scene, None, &BTreeMap::new()).unwrap();
    assert!(
        std::fs::read(&path).unwrap() == first,
        "the same scene gave other bytes"
    );
    assert_eq!(
        std::fs::read_dir(path.parent().unwrap()).unwrap().count(),
        1
    );
}

#[test]
fn scene_arrays_match_documentation() {
    let (_dir, path) = temporary("scene.safetensors");
    let layout = layouts().nth(2).unwrap();
    let scene = scene(layout, 5, 3);
    write(&path, &scene, None, &BTreeMap::new()).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let shape = |name: &str| file.tensor(name).unwrap().shape().to_vec();
    assert_eq!(shape("splats.mean"), [8, 3]);
    assert_eq!(shape("splats.quat"), [8, 4]);
    assert_eq!(shape("splats.colour"), [8, 3, 16, 3]);
    assert_eq!(shape("splats.velocity"), [3, 3]);
    assert_eq!(shape("source.c2w"), [4, 3, 4]);
    assert_eq!(shape("source.distance_sigma"), [4]);
    let of_splats = [
        "colour",
        "log_scale",
        "log_time_sd",
        "mean",
        "opacity",
        "quat",
        "time_mean",
        "velocity",
    ];
    let of_source = ["c2w", "distance_sigma", "exposure", "intrinsics", "t"];
    let mut names = file.names();
    names.sort_unstable();
    let expected = of_source
        .map(|n| format!("source.{n}"))
        .into_iter()
        .chain(of_splats.map(|n| format!("splats.{n}")));
    assert_eq!(
        names,
        expected.collect::<Vec<_>>(),
        "nothing of bindings where there are none"
    );
    let head = String::from_utf8_lossy(&bytes).into_owned();
    assert!(head.contains(r#"{\"version\":1,"#) && !head.contains("splats_bound"));
    let mean = file.tensor("splats.mean").unwrap();
    let at = |row: usize, c: usize| {
        f32::from_le_bytes(mean.data()[4 * (3 * row + c)..][..4].try_into().unwrap())
    };
    assert_eq!(at(6, 1), scene.splats.column(Column::Mean, 1)[6]);

    let bound = m4_testkit::bound_scene(&SceneSpec::default());
    write(&path, &bound, None, &BTreeMap::new()).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let shape = |name: &str| file.tensor(name).unwrap().shape().to_vec();
    assert_eq!(
        (shape("windows.counts"), shape("windows.key")),
        (vec![2, 2], vec![10])
    );
    assert_eq!(
        (shape("windows.anchor"), shape("windows.position")),
        (vec![12, 3], vec![60, 3])
    );
    assert_eq!(
        (shape("windows.rotation"), shape("bound.window")),
        (vec![60, 4], vec![20])
    );
    assert_eq!(
        (shape("bound.node"), shape("bound.weight")),
        (vec![20, 4], vec![20, 4])
    );
    assert_eq!(
        (shape("bound.life"), shape("bound.trend")),
        (vec![20, 2], vec![20, 3])
    );
    assert!(
        file.tensor("source.distance_sigma").is_err(),
        "no frame has one"
    );
    let node = file.tensor("bound.node").unwrap();
    assert_eq!(node.dtype(), safetensors::Dtype::U16);
    let pose = bound.splats.windows()[1].poses(3)[2].position;
    let position = file.tensor("windows.position").unwrap();
    let row = 5 * 6 + 3 * 6 + 2;
    assert_eq!(
        position.data()[12 * row..][..4],
        pose[0].to_le_bytes(),
        "window after window, key by key"
    );
}

#[test]
fn bindings_round_trip_exactly() {
    let (_dir, path) = temporary("scene.safetensors");
    for layout in layouts() {
        let mut scene = m4_testkit::bound_scene(&SceneSpec {
            layout,
            ..SceneSpec::default()
        });
        let infinite = |s: &Scene| {
            s.splats
                .bindings()
                .iter()
                .filter(|b| b.life[0] == f32::NEG_INFINITY)
                .count()
        };
        assert!(infinite(&scene) > 2);
        write(&path, &scene, Some(&state()), &BTreeMap::new()).unwrap();
        let back = read(&path).unwrap();
        assert_eq!(back.scene, scene, "{layout:?}");
        assert_eq!(
            format!("{:?}", back.state.unwrap()),
            format!("{:?}", state())
        );
        // windows without splats stay too: the state of the optimiser has them
        let rows: Vec<u32> = (0..scene.splats.n() as u32)
            .filter(|&r| !scene.splats.bound().contains(&(r as usize)))
            .collect();
        scene.splats.rearrange(&rows).unwrap();
        write(&path, &scene, None, &BTreeMap::new()).unwrap();
        let back = read(&path).unwrap().scene;
        assert_eq!(
            (back.splats.windows().len(), back.splats.bindings().len()),
            (2, 0)
        );
        assert_eq!(back, scene);
    }
}

#[test]
fn rotations_of_nodes_get_length_1_and_other_lengths_are_refused() {
    let (_dir, path) = temporary("scene.safetensors");
    let mut scene = m4_testkit::bound_scene(&SceneSpec::default());
    let scale = |scene: &mut Scene, by: f32| {
        let pose = &mut scene.splats.windows_mut()[1].poses_mut(0)[2];
        pose.rotation = [by, 0.0, 0.0, 0.0];
    };
    scale(&mut scene, 1.009);
    write(&path, &scene, None, &BTreeMap::new()).unwrap();
    let back = read(&path).unwrap().scene;
    assert_eq!(
        back.splats.windows()[1].poses(0)[2].rotation,
        [1.0, 0.0, 0.0, 0.0]
    );
    scale(&mut scene, 1.5);
    let error = write(&path, &scene, None, &BTreeMap::new())
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("window 1") && error.contains("node 2 at key 0"),
        "{error}"
    );
    scene.splats.column_mut(Column::Trend, 0)[1] = f32::NAN;
    assert!(write(&path, &scene, None, &BTreeMap::new()).is_err());
}

/// A change of the bytes of an array.
type Change = Box<dyn FnOnce(&mut [u8])>;

/// The file of a scene with bindings, with `change` made to the bytes of one array and the checksum
/// to match.
fn changed(path: &Path, array: &str, change: impl FnOnce(&mut [u8])) -> String {
    write(
        path,
        &m4_testkit::bound_scene(&SceneSpec::default()),
        None,
        &BTreeMap::new(),
    )
    .unwrap();
    let mut bytes = std::fs::read(path).unwrap();
    let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let data = file.tensor(array).unwrap().data();
    let (start, len) = (data.as_ptr() as usize - bytes.as_ptr() as usize, data.len());
    change(&mut bytes[start..start + len]);
    std::fs::write(path, &bytes).unwrap();
    let error = read(path).unwrap_err().to_string();
    // the reader says both checksums: the second is the one that fits
    let word = |after: &str| {
        error
            .split(after)
            .nth(1)
            .unwrap()
            .split(' ')
            .next()
            .unwrap()
            .to_owned()
    };
    let (actual, written) = (word("its checksum is "), word(" where "));
    let at = bytes
        .windows(written.len())
        .position(|w| w == written.as_bytes())
        .unwrap();
    bytes[at..at + actual.len()].copy_from_slice(actual.as_bytes());
    std::fs::write(path, &bytes).unwrap();
    match read(path) {
        Ok(_) => "read".to_owned(),
        Err(error) => {
            assert_eq!(error.kind(), ErrorKind::BadData);
            error.to_string()
        }
    }
}

#[test]
fn numbers_of_bindings_that_do_not_fit_are_refused_with_their_place() {
    let (_dir, path) = temporary("scene.safetensors");
    let f32_at = |i: usize, v: f32| {
        move |bytes: &mut [u8]| bytes[4 * i..4 * i + 4].copy_from_slice(&v.to_le_bytes())
    };
    let u32_at = |i: usize, v: u32| {
        move |bytes: &mut [u8]| bytes[4 * i..4 * i + 4].copy_from_slice(&v.to_le_bytes())
    };
    let cases: [(&str, Change, &str); 13] = [
        (
            "windows.counts",
            Box::new(u32_at(0, 4)),
            "array \"windows.key\" is f32",
        ),
        (
            "windows.counts",
            Box::new(u32_at(1, u32::MAX)),
            "array \"windows.anchor\" is f32",
        ),
        (
            "windows.key",
            Box::new(f32_at(1, 0.0)),
            "keys 0 and 1 of window 0 are 0 and 0",
        ),
        (
            "windows.key",
            Box::new(f32_at(0, f32::NAN)),
            "keys 0 and 1 of window 0 are NaN and 1",
        ),
        (
            "windows.key",
            Box::new(f32_at(0, -1e30)),
            "window 0 has a key -1e30",
        ),
        (
            "windows.anchor",
            Box::new(f32_at(4, 1e30)),
            "window 0 has an anchor that holds 1e30",
        ),
        (
            "windows.position",
            Box::new(f32_at(0, f32::INFINITY)),
            "window 0 has a position that holds inf",
        ),
        (
            "windows.rotation",
            Box::new(f32_at(1, 7.0)),
            "window 0 has a rotation whose length is off 1",
        ),
        (
            "bound.window",
            Box::new(u32_at(3, 2)),
            "bound splat 3 is in window 2, and there are 2",
        ),
        (
            "bound.node",
            Box::new(|b: &mut [u8]| b[8] = 6),
            "bound splat 1 has node 6, and window",
        ),
        (
            "bound.weight",
            Box::new(f32_at(2, -1.0)),
            "bound splat 0 has a weight -1",
        ),
        (
            "bound.life",
            Box::new(f32_at(3, f32::NEG_INFINITY)),
            "bound splat 1 has a life from",
        ),
        (
            "bound.trend",
            Box::new(f32_at(5, f32::NAN)),
            "trend of bound splat 1 is NaN",
        ),
    ];
    for (array, change, want) in cases {
        let said = changed(&path, array, change);
        assert!(
            said.contains(want) && said.contains("scene.safetensors"),
            "{array}: {said}"
        );
    }
    assert_eq!(
        changed(&path, "bound.life", f32_at(2, f32::NEG_INFINITY)),
        "read"
    );
}

#[test]
fn deviations_out_of_range_are_refused() {
    let (_dir, path) = temporary("scene.safetensors");
    for sigma in [0.0, -0.1, f32::NAN, f32::INFINITY] {
        let mut scene = scene(layouts().next().unwrap(), 2, 2);
        scene.source[2].distance_sigma = Some(sigma);
        let error = write(&path, &scene, None, &BTreeMap::new()).unwrap_err();
        let text = error.to_string();
        assert!(
            text.contains("frame 2") && text.contains("distance_sigma"),
            "{text}"
        );
    }
}

#[test]
fn damaged_scene_files_are_refused() {
    let layout = layouts().next().unwrap();
    damage(&scene(layout, 20, 10));
    damage(&m4_testkit::bound_scene(&SceneSpec::default()));
}

fn damage(scene: &Scene) {
    let (_dir, path) = temporary("scene.safetensors");
    write(&path, scene, Some(&state()), &BTreeMap::new()).unwrap();
    let original = std::fs::read(&path).unwrap();
    let mut rng = CounterRng::new(9, 9, 9);
    let (mut by_checksum, mut damaged) = (0, 0);
    for i in 0..600 {
        let mut bytes = original.clone();
        let at = if i < 200 {
            i * 3
        } else {
            rng.below(original.len())
        };
        if i % 3 == 0 {
            bytes.truncate(at);
        } else {
            bytes[at] ^= 1 << rng.below(8);
        }
        std::fs::write(&path, &bytes).unwrap();
        let error = match read(&path) {
            Err(error) => error,
            // Spaces that pad the header mean nothing, nor does the order of keys.
            Ok(file) => {
                assert!(
                    original[at] == b' ' || file.scene == *scene,
                    "byte {at} of {}",
                    original.len()
                );
                continue;
            }
        };
        let text = error.to_string();
        assert!(text.contains("scene.safetensors"), "{text}");
        by_checksum += usize::from(text.contains("its checksum is"));
        damaged += usize::from(text.contains("it is damaged"));
    }
    assert!(by_checksum > 100 && damaged > 50, "{by_checksum} {damaged}");
}

#[test]
fn newer_versions_are_refused() {
    let (_dir, path) = temporary("scene.safetensors");
    write(
        &path,
        &scene(layouts().next().unwrap(), 1, 1),
        None,
        &BTreeMap::new(),
    )
    .unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    let key = br#"{\"version\":1,"#;
    let at = bytes.windows(key.len()).position(|w| w == key).unwrap() + key.len() - 2;
    bytes[at] = b'7';
    std::fs::write(&path, bytes).unwrap();
    let error = read(&path).unwrap_err();
    let text = error.to_string();
    assert!(
        text.contains("version 7") && text.contains("up to 2") && text.contains("update minute4d"),
        "{text}"
    );
    assert_eq!(error.kind(), ErrorKind::Unsupported);
}
