//! Scenes to the files of other tools and back, from outside.

use crate::common::Scratch;
use crate::render::difference;
use m4_core::{Column, Exposure, Intrinsics, Scene, SourceFrame, SplatLayout};
use m4_io::scene::safetensors;
use m4_testkit::{SceneSpec, bare_scene, moving_scene, random_camera, random_splats};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;

const FRAMES: usize = 12;

/// A ball in front of a wall, trained without the Mip filter, or with it and of small splats.
fn write_scene(dir: &Scratch, mip: bool) {
    let mut fixture = moving_scene(Intrinsics::centred(96, 72, 90.0), FRAMES);
    if mip {
        // a fifth of a pixel: what the filter is for
        let sizes = fixture.splats.column_mut(Column::LogScale, 0);
        sizes.iter_mut().for_each(|size| *size -= 3.0);
    }
    let frame = |(i, camera)| SourceFrame {
        camera,
        t: i as f64,
        exposure: Exposure::IDENTITY,
        distance_sigma: None,
    };
    let scene = Scene {
        splats: fixture.splats,
        background: [0.2, 0.3, 0.4],
        time_frames: FRAMES,
        duration_s: Some(0.5),
        mip,
        near: 0.02,
        source: fixture.cameras.into_iter().enumerate().map(frame).collect(),
    };
    fs::create_dir_all(dir.path("out")).unwrap();
    safetensors::write(
        &dir.path("out/scene.safetensors"),
        &scene,
        None,
        &BTreeMap::new(),
    )
    .unwrap();
}

fn number(value: &Value) -> f64 {
    value
        .as_f64()
        .unwrap_or_else(|| panic!("{value} is not a number"))
}

#[test]
fn every_format_is_written_once() {
    let dir = Scratch::new();
    write_scene(&dir, false);
    for (format, file) in [
        ("4dgs", "scene.4dgs"),
        ("ftgs", "scene.ftgs.ply"),
        ("splatv", "scene.splatv"),
        ("ply", "scene.ply"),
        ("ply-sequence", "ply"),
        ("spz", "scene.spz"),
        ("gltf", "scene.glb"),
    ] {
        let report = dir
            .succeed(&format!("export out --format {format} --json"))
            .result();
        assert_eq!(report["path"], format!("out/{file}"));
        assert_eq!(report["format"], format);
        assert!(number(&report["bytes"]) > 1000.0 && number(&report["bytes_per_splat"]) > 5.0);
        dir.refused(&format!("export out --format {format}"), 73, &["--force"]);
    }
    dir.refused(
        "export out --format colmap",
        65,
        &["colmap", "stores captures"],
    );
    // 17 numbers per splat, besides the header
    let still = dir
        .succeed("export out --format ply --force --json")
        .result();
    assert!(
        (68.0..69.5).contains(&number(&still["bytes_per_splat"])),
        "{still}"
    );
    assert_eq!(dir.count("out/ply"), FRAMES);
    let half = dir.succeed("export out --format ply-sequence --fps 11 --force --json");
    let half = half.result();
    assert_eq!(half["moments"].as_array().unwrap().len(), 6);
    assert_eq!(dir.count("out/ply"), 6);
}

#[test]
fn mip_filter_is_baked() {
    let dir = Scratch::new();
    write_scene(&dir, true);
    let report = |more: &str| {
        let report = dir
            .succeed(&format!("export out --force --json {more}"))
            .result();
        ["baked", "dropped"].map(|sort| report["losses"][sort].to_string())
    };
    for format in [
        "4dgs",
        "ftgs",
        "splatv",
        "ply",
        "ply-sequence",
        "spz",
        "gltf",
    ] {
        let [baked, dropped] = report(&format!("--format {format}"));
        assert!(baked.contains("Mip filter"), "{format}: {baked}");
        assert!(
            !dropped.contains("Mip") && !dropped.contains("opacity-compensated"),
            "{format}: {dropped}"
        );
    }
}

#[test]
fn exports_round_trip_through_import() {
    let dir = Scratch::new();
    write_scene(&dir, false);
    dir.succeed("export out");
    let report = dir.succeed("import out/scene.4dgs -o back --json").result();
    assert_eq!(
        (&report["cameras"], &report["time_frames"]),
        (&FRAMES.into(), &FRAMES.into())
    );
    assert_eq!(
        (&report["splats_static"], &report["splats_dynamic"]),
        (&576.into(), &60.into())
    );
    assert_eq!(dir.json("back/run.json")["status"], "finished");
    assert_eq!(
        safetensors::read(&dir.path("back/scene.safetensors"))
            .unwrap()
            .scene
            .source
            .len(),
        FRAMES
    );
    dir.succeed("render back -o png");
    assert_eq!(dir.count("png"), FRAMES);
    dir.succeed("render out -o original");
    for i in 0..FRAMES {
        let frame = format!("{i:05}.png");
        let off = difference(
            &dir.path("original").join(&frame),
            &dir.path("png").join(&frame),
        );
        assert!(off < 1.5, "frame {i}: {off} levels");
    }
    dir.refused("import out/scene.4dgs -o back", 73, &["--force"]);
    dir.succeed("import out/scene.4dgs -o back --force");
}

#[test]
fn static_ply_of_another_program_gets_cameras() {
    let dir = Scratch::new();
    let spec = SceneSpec {
        layout: SplatLayout {
            isotropic: false,
            sh_degree: 2,
            time_degree: 0,
        },
        n_static: 200,
        n_dynamic: 0,
        ..SceneSpec::default()
    };
    let scene = bare_scene(random_splats(5, &random_camera(3, 64, 48), &spec), 1);
    safetensors::write(&dir.path("a.safetensors"), &scene, None, &BTreeMap::new()).unwrap();
    let report = dir
        .succeed("export a.safetensors --format ply -o a.ply --json")
        .result();
    assert!(report["bytes_per_s"].is_null());

    let ended = dir.succeed("import a.ply -o in");
    assert!(ended.stderr.contains("no cameras"), "{}", ended.stderr);
    let scene = safetensors::read(&dir.path("in/scene.safetensors"))
        .unwrap()
        .scene;
    assert_eq!(
        (scene.source.len(), scene.splats.layout().sh_degree),
        (60, 2)
    );
    dir.succeed("render in -o png");
    let middle = dir.read("png/00000.png").len();
    assert!(
        middle > 20_000,
        "the splats are in the image: {middle} bytes"
    );
}

#[test]
fn invalid_requests_are_rejected_with_a_hint() {
    let dir = Scratch::new();
    write_scene(&dir, false);
    dir.write("a.obj", "v 0 0 0\n");
    dir.write(
        "a.ply",
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n",
    );
    dir.write("a.spz", "\x1f");
    for (line, code, says) in [
        ("export out --time 3", 2, "a time has no meaning for 4dgs"),
        (
            "export out --fps 10",
            2,
            "a rate (fps) has no meaning for 4dgs",
        ),
        ("export out --format ply --time 99", 2, "frames 0 to 11"),
        ("export out --format ply --time soon", 2, "soon"),
        ("export out --format obj", 2, "choose one of 4dgs"),
        ("export out -o a.mp4", 2, "minute4d render"),
        ("export nowhere", 66, "nowhere"),
        ("import a.obj -o in", 2, "add --format"),
        ("import a.ply -o in", 65, "stored as ascii"),
        ("import a.spz -o in", 2, "spz files cannot be imported"),
        ("import out -o in", 65, "is a folder"),
        ("import gone.ply -o in", 66, "gone.ply"),
        ("import gone.mp4 -o in", 66, "gone.mp4"),
    ] {
        dir.refused(line, code, &[says]);
    }
    assert!(
        !dir.path("in").exists(),
        "a file that cannot be used leaves nothing behind"
    );
}
