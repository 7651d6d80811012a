//! Captures with poses from other tools, through the program.

use crate::common::{Scratch, read_capture, write_capture};
use m4_core::Capture;
use m4_io::capture::Split;
use std::fs;

fn fixture(name: &str) -> String {
    format!(
        "{}/../../fixtures/import/{name}",
        env!("CARGO_MANIFEST_DIR")
    )
}

/// Fixtures whose folder says what they are.
#[test]
fn source_formats_are_detected_and_imported() {
    let dir = Scratch::new();
    for (name, format, held_out) in [
        ("colmap_text", "colmap", 0),
        ("nerfstudio", "nerfstudio", 0),
        ("vipe", "vipe", 0),
        ("dycheck", "dycheck", 2),
        ("nvidia", "nvidia", 0),
        ("record3d/clip.r3d", "record3d", 0),
        ("../megasam/outputs/dog_droid.npz", "megasam", 0),
    ] {
        let more = match format {
            "colmap" => format!("--images '{}'", fixture("clip/images")),
            _ => String::new(),
        };
        let line = format!("import '{}' -o {format} --json {more}", fixture(name));
        let report = dir.succeed(&line).result();
        assert_eq!(report["format"], format, "{name}");
        assert!(report["frames"].as_u64().unwrap() > 2, "{name}: {report}");
        let train = read_capture(&dir.path(format), Split::Train);
        assert_eq!(
            train.frames.len() as u64,
            report["frames"].as_u64().unwrap()
        );
        assert!(
            report["held_out"].as_u64().unwrap() >= held_out,
            "{name}: {report}"
        );
        let listed = dir.path(format).join(Split::Test.file_name()).is_file();
        assert_eq!(listed, report["held_out"] != 0, "{name}");
    }
    // held-out views of an earlier import do not stay behind
    assert!(dir.path("dycheck").join(Split::Test.file_name()).is_file());
    let recording = fixture("record3d/clip.r3d");
    dir.succeed(&format!("import '{recording}' -o dycheck --force"));
    assert!(!dir.path("dycheck").join(Split::Test.file_name()).exists());
    write_capture(&dir.path("capture"), false);
    dir.refused(
        "export capture -o out",
        65,
        &["is a capture, which the format 4dgs cannot store"],
    );
    let trained = dir.call("train colmap -o out --iterations 5");
    assert!(
        trained.code == 0 || trained.stderr.contains("depth"),
        "{}",
        trained.stderr
    );
}

#[test]
fn invalid_requests_are_rejected_with_a_hint() {
    let dir = Scratch::new();
    fs::create_dir_all(dir.path("empty")).unwrap();
    let recording = fixture("record3d/clip.r3d");
    let davis = fixture("davis/JPEGImages/480p/ball");
    let droid = fixture("../megasam/outputs/dog_droid.npz");
    dir.write("bad_droid.npz", b"no archive");
    dir.write("a.ply", b"ply");
    for (args, code, says) in [
        ("empty", 65, "none of the known layouts"),
        ("empty --format vipe", 65, "pose"),
        ("bad_droid.npz", 65, "not an npz archive"),
        ("a.ply --fps 3", 2, "--fps has no meaning for ply"),
        (
            &*format!("'{droid}' --depth maps"),
            2,
            "--depth has no meaning for megasam",
        ),
        ("empty --format obj", 2, "no format is called obj"),
        (&format!("'{davis}'"), 65, "no camera poses"),
        (&format!("'{recording}' --depth /nowhere"), 66, "/nowhere"),
    ] {
        dir.refused(&format!("import -o out {args}"), code, &[says]);
    }
    assert!(
        !dir.path("out").exists(),
        "what cannot be used leaves nothing behind"
    );
}

/// What is exported comes back by the importer, which was written against the formats and not
/// against the exporter.
#[test]
fn exported_captures_import_to_the_same_capture() {
    let dir = Scratch::new();
    dir.succeed(&format!("import '{}' -o own", fixture("dycheck")));
    let read = |name: &str| read_capture(&dir.path(name), Split::Train);
    let train = read("own");
    let moves = |c: &Capture| {
        c.frames
            .iter()
            .filter_map(|f| f.mask.as_ref())
            .map(|m| m.count())
            .sum::<usize>()
    };
    let line = "export own --format colmap -o colmap";
    let report = dir.succeed(&format!("{line} --json")).result();
    assert!(report["bytes"].as_u64().unwrap() > 1000, "{report}");
    assert!(
        report["losses"]["dropped"]
            .to_string()
            .contains("held-out views"),
        "{report}"
    );
    dir.succeed("import colmap -o again");
    let back = read("again");
    assert_eq!(back.frames.len(), train.frames.len());
    for (a, b) in back.frames.iter().zip(&train.frames) {
        assert!((a.camera.c2w.matrix() - b.camera.c2w.matrix()).amax() < 1e-6);
        assert!((a.camera.intrinsics.fx - b.camera.intrinsics.fx).abs() < 1e-9);
        assert_eq!(a.rgb, b.rgb);
    }
    assert_eq!(moves(&back), moves(&train));
    dir.refused(line, 73, &["already exists", "--force"]);
}

#[test]
fn data_sets_that_name_outside_files_need_permission() {
    let dir = Scratch::new();
    let line = format!("import '{}' -o out", fixture("blender"));
    let words = ["transforms_train.json", "clip/images/", "--allow-outside"];
    dir.refused(&line, 65, &words);
    assert!(!dir.path("out").exists());
    dir.succeed(&format!("{line} --allow-outside"));
    // The same of a capture, by every command that reads one.
    let list = dir.path("out/transforms_train.json");
    let text = fs::read_to_string(&list).unwrap();
    fs::rename(dir.path("out/train"), dir.path("private")).unwrap();
    fs::write(&list, text.replace("\"train/", "\"../private/")).unwrap();
    for line in [
        "split out -o made --protocol holdout",
        "export out --format colmap -o made",
        "train out -o made --iterations 1",
        "run out -o made --iterations 1",
        "enhance out -o made",
    ] {
        dir.refused(
            line,
            65,
            &["transforms_train.json", "private/", "--allow-outside"],
        );
    }
    dir.succeed("export out --format colmap -o exported --allow-outside");
    let set = "run out -o made --set capture.reach=\"Anywhere\"";
    dir.refused(set, 78, &["capture.reach"]);
}
