//! A front end of networks with synthetic weights, and `minute4d weights` with a server of the
//! test's in place of Hugging Face.
#![cfg(feature = "nets")]

use crate::common::{Ended, Scratch, read_capture, text};
use m4_core::{Capture, Plane};
use m4_geometry::megasam::tracker::TrackerSettings;
use m4_io::capture::Split;
use m4_io::image::write_rgb;
use m4_testkit::{FormulaWeights, Server, write_formula_weights};
use minute4d::device::{DeviceChoice, DeviceRequest};
use minute4d::{Existing, Settings, Silent};
use minute4d_cli::run::{Job, geometry};
use serde_json::Value;
use std::path::Path;
use std::process::Command;
use std::{env, fs};

const FRAMES: usize = 24;
/// The least that the tracking network takes.
const SIDE: usize = 128;

fn write_clip(folder: &Path) {
    fs::create_dir(folder).unwrap();
    for k in 0..FRAMES {
        let frame = Plane::from_fn(SIDE, SIDE, |x, y| {
            let (x, y) = (x as f32 + 3.0 * k as f32, y as f32 + k as f32);
            let wave = |a: f32, b: f32| {
                (127.0 + 60.0 * (a * x).sin() + 60.0 * (b * y + 0.03 * x).cos()) as u8
            };
            [wave(0.21, 0.13), wave(0.09, 0.31), wave(0.37, 0.05)]
        });
        write_rgb(&folder.join(format!("{k:03}.png")), &frame).unwrap();
    }
}

fn write_weights(store: &Path) {
    let droid = include_str!("../../../fixtures/droid/keys.txt");
    let raft = include_str!("../../../fixtures/raft/keys.txt");
    for (name, file, keys) in [
        ("megasam", "megasam_final.pth", droid),
        ("raft-things", "raft-things.pth", raft),
    ] {
        fs::create_dir_all(store.join(name)).unwrap();
        write_formula_weights(keys, &store.join(name).join(file));
    }
}

/// Few updates, for the time that they take: settings of callers in Rust. Synthetic weights show
/// hardly any motion, so thresholds of motion are low.
fn few() -> Settings {
    let mut settings = Settings::fast();
    let megasam = &mut settings.megasam;
    megasam.tracking_pixels = (SIDE * SIDE) as f64;
    megasam.flow_iterations = 1;
    megasam.cvd_steps = [2, 3];
    megasam.tracker = TrackerSettings {
        motion_filter_px: 0.01,
        keyframe_px: 1.1,
        initial_updates: 1,
        first_updates: 1,
        second_updates: 1,
        probe_updates: 1,
        backend_updates: 1,
        backend_factors: 2,
        final_updates: 1,
        filler_updates: 1,
        ..TrackerSettings::default()
    };
    settings
}

/// What the process of [`library_caller_makes_a_capture`] reads.
const CLIP: &str = "MINUTE4D_TEST_CLIP";
const OUT: &str = "MINUTE4D_TEST_OUT";
const FRONTEND: &str = "MINUTE4D_TEST_FRONTEND";

/// The process that makes a capture: the store of weights is that of its environment.
#[test]
#[ignore = "a process that the other tests start with its arguments in the environment"]
fn library_caller_makes_a_capture() {
    let clip = env::var(CLIP).unwrap();
    let mut settings = few();
    settings.geometry.frontend = env::var(FRONTEND).unwrap().parse().unwrap();
    let job = Job {
        settings,
        device: DeviceRequest {
            choice: DeviceChoice::Cpu,
            max_vram_mb: None,
        },
        existing: Existing::Refuse,
        observer: &Silent,
    };
    geometry::make(Path::new(&clip), Path::new(&env::var(OUT).unwrap()), &job).unwrap();
}

fn capture_of(clip: &Path, out: &Path, store: &Path, frontend: &str) -> Capture {
    let mut command = Command::new(env::current_exe().unwrap());
    command
        .args([
            "--exact",
            "networks::library_caller_makes_a_capture",
            "--ignored",
            "--nocapture",
        ])
        .env("MINUTE4D_WEIGHTS", store)
        .env(CLIP, clip)
        .env(OUT, out)
        .env(FRONTEND, frontend);
    let ended = Ended::of(command.output().unwrap());
    assert_eq!(ended.code, 0, "{} {}", ended.stdout, ended.stderr);
    read_capture(out, Split::Train)
}

#[test]
fn megasam_front_end_makes_a_capture_and_records_its_networks() {
    let dir = Scratch::new();
    let (clip, store) = (dir.path("clip"), dir.path("weights"));
    write_clip(&clip);
    write_weights(&store);
    let out = dir.path("out");
    let capture = capture_of(&clip, &out, &store, "megasam");
    let record: Value =
        serde_json::from_str(&fs::read_to_string(out.join("geometry.json")).unwrap()).unwrap();
    // The choice, and the lack of a depth network, is reported.
    let warnings = record["warnings"].to_string();
    assert!(
        warnings.contains("raft") && warnings.contains("no depth from one image"),
        "{warnings}"
    );
    let summary = &record["found"];
    assert_eq!(
        (&summary["frontend"], &summary["frames"]),
        (&Value::from("megasam+raft"), &Value::from(FRAMES))
    );
    let networks = summary["networks"].as_array().unwrap();
    let licences: Vec<&str> = networks
        .iter()
        .map(|n| n["licence"].as_str().unwrap())
        .collect();
    assert_eq!(licences, ["CC-BY 4.0", "BSD-3-Clause"]);
    assert!(
        summary["keyframes"].as_array().unwrap().len() > 2,
        "{summary}"
    );
    assert_eq!((capture.frames.len(), capture.metric), (FRAMES, false));
    assert!(
        capture
            .frames
            .iter()
            .all(|f| f.motion.is_some() && f.mask.is_some() && f.depth.is_some())
    );
}

#[test]
fn incompatible_or_missing_front_end_parts_are_rejected() {
    let dir = Scratch::new();
    let store = dir.path("weights");
    write_clip(&dir.path("clip"));
    write_weights(&store);
    let env = [("MINUTE4D_WEIGHTS", text(&store))];
    for (options, code, words) in [
        (
            "megasam+moge",
            66,
            &[
                "moge",
                "minute4d weights fetch moge-2-l-normal",
                "--frontend classical",
            ][..],
        ),
        ("classical+raft", 2, &["classical", "raft", "flow"]),
        ("gmflow", 2, &["gmflow", "raft"]),
        ("megasan", 2, &["megasan", "moge"]),
        (
            "megasam --segmenter mobilesam",
            66,
            &["minute4d weights fetch mobile-sam"],
        ),
    ] {
        dir.refused_with(
            &format!("geometry clip -o out --frontend {options}"),
            &env,
            code,
            words,
        );
    }
    // a file that is no checkpoint
    fs::write(store.join("raft-things/raft-things.pth"), "no weights").unwrap();
    let words = ["raft-things.pth", "RAFT", "--frontend classical"];
    dir.refused_with("geometry clip -o out --frontend raft", &env, 69, &words);
}

/// Calls `weights LINE --json` with the store in `store`, and `mirror` in place of Hugging Face;
/// without one the network is switched off.
fn weights_of(dir: &Scratch, line: &str, mirror: Option<&Server>) -> Ended {
    let mut command = dir.command(&format!("weights {line} --json"));
    for proxy in ["HTTPS_PROXY", "HTTP_PROXY", "ALL_PROXY"] {
        command
            .env_remove(proxy)
            .env_remove(proxy.to_ascii_lowercase());
    }
    match mirror {
        Some(server) => command
            .env("HF_ENDPOINT", server.url())
            .env("HF_TOKEN", "secret")
            .env_remove("HF_HUB_OFFLINE"),
        None => command
            .env_remove("HF_ENDPOINT")
            .env_remove("HF_TOKEN")
            .env("HF_HUB_OFFLINE", "1"),
    };
    command.env("MINUTE4D_WEIGHTS", dir.path("store"));
    Ended::of(command.output().unwrap())
}

fn weights(dir: &Scratch, line: &str) -> Ended {
    weights_of(dir, line, None)
}

/// A server that has `bytes` alone.
fn serving(bytes: Vec<u8>) -> Server {
    Server::start(move |_| {
        let head = format!("HTTP/1.1 200 OK\r\nContent-Length: {}\r\n\r\n", bytes.len());
        Some([head.as_bytes(), &bytes].concat())
    })
}

fn reason(ended: &Ended, code: i32, words: &[&str]) {
    let end = ended.end();
    let reason = end["reason"].as_str().unwrap();
    assert_eq!(ended.code, code, "{reason}");
    for word in words {
        assert!(reason.contains(word), "{word:?} is not in {reason:?}");
    }
}

#[test]
fn weights_list_names_known_and_installed_files() {
    let dir = Scratch::new();
    let ended = weights(&dir, "list");
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    let rows = ended.result();
    let row = |name: &str| {
        rows.as_array()
            .unwrap()
            .iter()
            .find(|r| r["name"] == name)
            .unwrap()
            .clone()
    };
    assert_eq!(row("mobile-sam")["bytes"], 40_728_226);
    assert!(row("mobile-sam")["path"].is_null());
    assert_eq!(row("tapip3d")["commercial"], false);
    assert_eq!(row("megasam")["command"], "minute4d weights fetch megasam");
    assert!(
        row("megasam")["without"]
            .as_str()
            .unwrap()
            .contains("classical")
    );
}

#[test]
fn unfetchable_weights_are_rejected_with_a_reason() {
    let dir = Scratch::new();
    reason(
        &weights(&dir, "fetch mobile-sm"),
        2,
        &["did you mean mobile-sam"],
    );
    // without a network: where it would come from, and how to install a file got by hand
    reason(
        &weights(&dir, "fetch megasam"),
        66,
        &[
            "HF_HUB_OFFLINE",
            "https://raw.githubusercontent.com/mega-sam/mega-sam/",
            "weights add megasam FILE",
        ],
    );
    // a licence is asked for before anything is fetched
    let server = serving(b"a checkpoint".to_vec());
    reason(
        &weights_of(&dir, "fetch moge-2-s-normal paper", Some(&server)),
        2,
        &["unidepth-v2-l", "--accept-license"],
    );
    assert!(server.requests().is_empty());
    dir.write("mine.pkl", b"something else");
    reason(
        &weights(&dir, "add mobile-sam mine.pkl"),
        65,
        &["mine.pkl", "40728226 bytes"],
    );
    reason(
        &weights(&dir, "add tapip3d mine.pkl"),
        2,
        &["--accept-license"],
    );
    reason(
        &weights(&dir, "verify mobile-sam"),
        66,
        &["weights fetch mobile-sam"],
    );
}

#[test]
fn added_file_is_installed_and_verified() {
    let dir = Scratch::new();
    dir.write("mine.pth", b"a checkpoint");
    let ended = weights(&dir, "add megasam mine.pth");
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    assert!(
        ended.stderr.contains("no published checksum"),
        "{}",
        ended.stderr
    );
    dir.write("empty.pth", b"");
    reason(
        &weights(&dir, "add megasam empty.pth"),
        65,
        &["an empty file"],
    );
    let report = weights(&dir, "verify").result();
    assert_eq!(report[0]["condition"], "as added", "{report}");
    fs::write(dir.path("store/megasam/megasam_final.pth"), b"a chackpoint").unwrap();
    reason(&weights(&dir, "verify"), 65, &["megasam is damaged"]);
}

#[test]
fn a_dry_run_uses_no_network() {
    let dir = Scratch::new();
    let server = serving(b"a checkpoint".to_vec());
    let line = "fetch recommended paper recommended --dry-run";
    let rows = weights_of(&dir, line, Some(&server)).result();
    let named = |name: &str| {
        let rows = rows.as_array().unwrap().iter();
        let rows: Vec<&Value> = rows.filter(|row| row["name"] == name).collect();
        assert_eq!(rows.len(), 1, "{name} in {rows:?}");
        rows[0].clone()
    };
    let moge = named("moge-2-s-normal");
    assert_eq!(
        moge["url"],
        format!(
            "{}/Ruicheng/moge-2-vits-normal/resolve/main/model.pt",
            server.url()
        )
    );
    assert_eq!(
        (&moge["licence"], &moge["installed"], &moge["needs_consent"]),
        (&"MIT".into(), &false.into(), &false.into())
    );
    assert_eq!(named("unidepth-v2-l")["needs_consent"], true);
    assert!(server.requests().is_empty() && !dir.path("store").exists());
    let ended = dir.succeed("weights fetch mobile-sam tapip3d --dry-run");
    for words in [
        "mobile-sam: 40.7 MB from https://",
        "licence: Apache-2.0; SHA-256 6dbb",
        "forbids commercial use (--accept-license)",
        "the first download is trusted",
    ] {
        assert!(ended.stdout.contains(words), "{}", ended.stdout);
    }
}

/// A static camera, which says nothing of depth.
fn write_static_clip(folder: &Path) {
    fs::create_dir(folder).unwrap();
    let frame = Plane::from_fn(96, 64, |x, y| {
        let (x, y) = (x as f32, y as f32);
        let wave = |a: f32, b: f32| (127.0 + 60.0 * (a * x).sin() + 60.0 * (b * y).cos()) as u8;
        [wave(0.21, 0.13), wave(0.09, 0.31), wave(0.37, 0.05)]
    });
    for k in 0..3 {
        write_rgb(&folder.join(format!("{k}.png")), &frame).unwrap();
    }
}

#[test]
fn fetched_depth_is_used_by_the_next_run() {
    let dir = Scratch::new();
    write_static_clip(&dir.path("clip"));
    let line = "geometry clip -o out --force --segmenter none --json";
    let run = || {
        let mut command = dir.command(line);
        command.env("MINUTE4D_WEIGHTS", dir.path("store"));
        let ended = Ended::of(command.output().unwrap());
        assert_eq!(ended.code, 0, "{}", ended.stderr);
        ended
    };
    // the first that is said of a clip without parallax is what gives it depth
    let before = run();
    let record = before.result()["record"].clone();
    assert_eq!(record["found"]["frontend"], "classical", "{record}");
    let first = before.stderr.lines().next().unwrap();
    for words in ["MoGe-2 S", "MIT", "minute4d weights fetch moge-2-s-normal"] {
        assert!(first.contains(words), "{}", before.stderr);
    }
    let file = dir.path("model.safetensors");
    FormulaWeights::of_keys(include_str!("../../../fixtures/moge2/vits_normal.keys.txt"))
        .with("mask_head.output_blocks.4.bias", &[0.3])
        .scaled("points_head.output_blocks.4.weight", 0.3)
        .write(&file);
    let server = serving(fs::read(&file).unwrap());
    let fetched = weights_of(&dir, "fetch moge-2-s-normal", Some(&server));
    assert_eq!(fetched.code, 0, "{}", fetched.stderr);
    let installed = fetched.result()[0].clone();
    assert_eq!(installed["published"], false, "{installed}");
    assert_eq!(installed["sha256"].as_str().unwrap().len(), 64);
    assert!(
        server.requests()[0]
            .to_lowercase()
            .contains("bearer secret")
    );
    let after = run();
    let record = after.result()["record"].clone();
    assert_eq!(record["found"]["frontend"], "classical+moge", "{record}");
    assert_eq!(
        record["found"]["networks"][0]["weights"], "moge-2-s-normal",
        "{record}"
    );
    assert!(
        !after.stderr.contains("weights fetch moge"),
        "{}",
        after.stderr
    );
}
