//! Nothing of the user's is removed or replaced: inputs, files that are not ours, and results until
//! the new ones are complete.

use crate::common::clips::{frame_image, walk, write};
use crate::common::{Ended, Scratch, device, write_capture, write_video};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Files in a folder with their contents, without hidden ones.
fn state(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut open = vec![folder.to_path_buf()];
    while let Some(at) = open.pop() {
        for entry in fs::read_dir(&at).unwrap() {
            let path = entry.unwrap().path();
            if path.file_name().unwrap().to_string_lossy().starts_with('.') {
                continue;
            }
            if path.is_dir() {
                open.push(path);
            } else {
                files.insert(
                    path.strip_prefix(folder).unwrap().to_path_buf(),
                    fs::read(&path).unwrap(),
                );
            }
        }
    }
    files
}

const TRAIN: &str = "train capture --iterations 30 --set preview.panel_px=64";
const ENHANCE: &str = "enhance capture --segmenter none --tracker flow";

fn with_capture() -> Scratch {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), true);
    dir
}

#[test]
fn no_command_replaces_its_input() {
    let dir = with_capture();
    dir.succeed(&format!("{ENHANCE} -o own"));
    dir.succeed(&format!("{TRAIN} -o run"));
    dir.succeed("export run --format ply -o run/scene.ply");
    #[cfg(unix)]
    std::os::unix::fs::symlink(dir.path("own"), dir.path("alias")).unwrap();
    let before = state(&dir.path(""));
    let mut lines = vec![
        "enhance own -o own --segmenter none --tracker flow".to_owned(),
        "enhance own/transforms_train.json -o own --segmenter none --tracker flow".to_owned(),
        "geometry own -o own".to_owned(),
        "geometry own/train -o own".to_owned(),
        "geometry own/../own/train -o own".to_owned(),
        "geometry run/preview.mp4 -o own --masks own/mask".to_owned(),
        "geometry run/preview.mp4 -o own --poses own/transforms_train.json".to_owned(),
        "run run/preview.mp4 -o run".to_owned(),
        "split own -o own --protocol holdout".to_owned(),
        "import own -o own".to_owned(),
        "import own/transforms_train.json -o own".to_owned(),
        "export run --format ply -o run/scene.safetensors".to_owned(),
    ];
    if cfg!(unix) {
        lines.push("enhance alias -o own --segmenter none --tracker flow".to_owned());
        lines.push("enhance own -o alias --segmenter none --tracker flow".to_owned());
        lines.push("geometry own/train -o alias".to_owned());
    }
    for line in lines {
        for how in ["--force", "--resume"] {
            if how == "--resume"
                && ["export", "split", "import"]
                    .iter()
                    .any(|command| line.starts_with(command))
            {
                continue;
            }
            dir.refused(
                &format!("{line} {how}"),
                73,
                &["is an input of this command", "choose another place"],
            );
            assert!(state(&dir.path("")) == before, "{line} {how}");
        }
    }
}

/// File names are bytes on this system: a path that is no text is an input all the same.
#[cfg(target_os = "linux")]
#[test]
fn no_command_replaces_an_input_whose_path_is_no_text() {
    use std::os::unix::ffi::OsStrExt;
    let dir = with_capture();
    dir.succeed(&format!("{TRAIN} -o run"));
    let run = dir.path("").join(std::ffi::OsStr::from_bytes(b"caf\xe9"));
    fs::rename(dir.path("run"), &run).unwrap();
    let before = state(&run);
    let mut command = dir.command("run --force");
    command.arg(run.join("preview.mp4")).arg("-o").arg(&run);
    let ended = Ended::of(command.output().unwrap());
    assert_eq!(ended.code, 73, "{}", ended.stderr);
    assert!(
        ended.stderr.contains("is an input of this command"),
        "{}",
        ended.stderr
    );
    assert!(state(&run) == before);
}

#[test]
fn files_that_are_not_ours_are_named_and_left() {
    let dir = with_capture();
    write_video(&dir.path("clip.mp4"), 8);
    dir.succeed(&format!("{TRAIN} -o run"));
    for name in ["train", "depth", "images", "checkpoints", "frames", "ply"] {
        fs::create_dir_all(dir.path(&format!("mine/{name}"))).unwrap();
    }
    for name in [
        "train/thesis.txt",
        "depth/1.png",
        "images/dog.jpg",
        "checkpoints/0000001.safetensors",
        "00000.png",
    ] {
        dir.write(&format!("mine/{name}"), "mine");
    }
    dir.write("mine/frames/00001.png", "mine");
    dir.write("mine/ply/frame_00002.ply", "mine");
    let before = state(&dir.path("mine"));
    for (line, names) in [
        (
            "geometry clip.mp4 -o mine",
            &[
                "mine/train/thesis.txt",
                "no list names it as a result of minute4d",
            ][..],
        ),
        (
            "enhance capture -o mine --segmenter none --tracker flow",
            &["thesis.txt"],
        ),
        (
            "train capture -o mine --iterations 5",
            &["0000001.safetensors"],
        ),
        ("run clip.mp4 -o mine", &["0000001.safetensors"]),
        ("split capture -o mine --protocol holdout", &["thesis.txt"]),
        (
            "export capture --format colmap -o mine",
            &["mine/images/dog.jpg"],
        ),
        (
            "export run --format ply-sequence -o mine/ply",
            &["frame_00002.ply"],
        ),
        ("render run --path train -o mine", &["00000.png"]),
        ("render run --path train -o mine/frames", &["00001.png"]),
    ] {
        dir.refused(&format!("{line} --force"), 73, names);
        assert!(state(&dir.path("mine")) == before, "{line}");
    }
    // Beside other names there is room, and results of earlier commands are replaced without them.
    fs::create_dir_all(dir.path("notes")).unwrap();
    dir.write("notes/thesis.txt", "mine");
    for line in ["render run --path train", "render run --path source --at 1"] {
        dir.succeed(&format!("{line} -o notes --force"));
    }
    assert_eq!(dir.read("notes/thesis.txt"), b"mine");
    let names: Vec<_> = state(&dir.path("notes")).into_keys().collect();
    assert_eq!(names, [Path::new("00000.png"), Path::new("thesis.txt")]);
}

#[cfg(unix)]
#[test]
fn devices_pipes_and_dangling_links_are_no_outputs() {
    let dir = with_capture();
    dir.succeed(&format!("{TRAIN} -o run"));
    assert!(
        std::process::Command::new("mkfifo")
            .arg(dir.path("pipe.ply"))
            .status()
            .unwrap()
            .success()
    );
    device(&dir, "full");
    std::os::unix::fs::symlink("full", dir.path("device.png")).unwrap();
    std::os::unix::fs::symlink("nowhere/at/all", dir.path("link.mp4")).unwrap();
    for line in [
        "export run --format ply -o full",
        "export run --format spz -o pipe.ply",
        "render run --path source --at 1 -o device.png",
        "render run -o link.mp4",
        "render run -o device.png/frames",
    ] {
        dir.refused(&format!("{line} --force"), 73, &["cannot write"]);
    }
    use std::os::unix::fs::FileTypeExt;
    assert!(
        fs::metadata(dir.path("full"))
            .unwrap()
            .file_type()
            .is_char_device()
    );
    assert!(
        fs::metadata(dir.path("pipe.ply"))
            .unwrap()
            .file_type()
            .is_fifo()
    );
}

/// Kills the program with SIGKILL once `condition` holds, and checks what it left.
#[cfg(unix)]
fn killed(dir: &Scratch, line: &str, condition: impl Fn() -> bool) {
    let mut command = dir.command(line);
    let mut child = command
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    while !condition() {
        assert!(
            child.try_wait().unwrap().is_none(),
            "it ended before it was killed: {line}"
        );
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
}

#[cfg(unix)]
#[test]
fn old_results_are_whole_until_new_ones_are_complete() {
    let dir = Scratch::new();
    write(&dir.path("walk"), walk(8).iter().map(frame_image));
    let run = "run walk --set dense.working_side_px=160 --set preview.panel_px=64 --iterations";
    dir.succeed(&format!("{run} 30 -o out"));
    dir.succeed(&format!("{run} 60 -o other"));
    dir.write("out/notes.txt", "mine");
    fs::create_dir(dir.path("out/capture/mine")).unwrap();
    dir.write("out/capture/mine/notes.txt", "mine");
    let old = state(&dir.path("out"));
    // geometry of a capture alone
    let geometry = "geometry walk -o out/capture --set dense.working_side_px=120";
    killed(&dir, &format!("{geometry} --force"), || {
        dir.path("out/capture/.minute4d-steps/cameras").exists()
    });
    assert!(state(&dir.path("out")) == old, "geometry");
    // a run from its geometry on, and one in training
    let next = dir.path("out/.minute4d-run-next");
    killed(&dir, &format!("{run} 60 -o out --force"), || {
        next.join("capture/.minute4d-steps/cameras").exists()
    });
    assert!(state(&dir.path("out")) == old, "run");
    let checkpoint =
        || fs::read_dir(next.join("checkpoints")).is_ok_and(|mut entries| entries.next().is_some());
    killed(&dir, &format!("{run} 60 -o out --resume"), checkpoint);
    assert!(state(&dir.path("out")) == old, "training");
    dir.refused(
        &format!("{run} 60 -o out"),
        73,
        &["a finished run", "--resume", "--force"],
    );
    // what reads the folder has the old scene, and the run goes on
    dir.succeed("render out --path source --at 1 -o old.png");
    dir.succeed(&format!("{run} 60 -o out --resume"));
    for name in ["scene.safetensors", "capture/transforms_train.json"] {
        assert!(
            dir.read(&format!("out/{name}")) == dir.read(&format!("other/{name}")),
            "{name}"
        );
    }
    assert!(!next.exists() && !dir.path("out/checkpoints").exists());
    assert_eq!(dir.json("out/run.json")["status"], "finished");
    for name in ["notes.txt", "capture/mine/notes.txt"] {
        assert_eq!(dir.read(&format!("out/{name}")), b"mine");
    }
    // with the same settings nothing is made again
    let new = state(&dir.path("out"));
    dir.succeed(&format!("{run} 60 -o out --resume"));
    let same = |name: &str| state(&dir.path("out"))[Path::new(name)] == new[Path::new(name)];
    assert!(same("scene.safetensors") && same("viewer.html") && same("capture/train/00003.png"));
}

#[test]
fn captures_of_the_run_itself_can_be_trained_again() {
    let dir = Scratch::new();
    write(&dir.path("walk"), walk(8).iter().map(frame_image));
    let options = "--set dense.working_side_px=160 --set preview.panel_px=64 --iterations";
    dir.succeed(&format!("run walk {options} 20 -o out"));
    let capture = state(&dir.path("out/capture"));
    let scene = dir.read("out/scene.safetensors");
    dir.succeed(&format!("train out/capture {options} 30 -o out --force"));
    assert!(
        state(&dir.path("out/capture")) == capture && dir.read("out/scene.safetensors") != scene
    );
    // of another capture, the old one goes with the old scene
    write_capture(&dir.path("capture"), false);
    dir.succeed(&format!("{TRAIN} -o out --force"));
    assert!(!dir.path("out/capture").exists() && dir.path("out/scene.safetensors").exists());
}

#[test]
fn results_may_be_in_the_folder_that_they_are_made_from() {
    let dir = Scratch::new();
    write(&dir.path("walk"), walk(8).iter().map(frame_image));
    let line = "run walk --set dense.working_side_px=160 --set preview.panel_px=64 --iterations 20 -o walk/out";
    dir.succeed(line);
    let files = state(&dir.path("walk"));
    let again = dir.succeed(&format!("{line} --resume --json"));
    let reused = again
        .events()
        .iter()
        .filter(|e| e.to_string().contains("reused"))
        .count();
    assert!(reused >= 2, "{}", again.stdout);
    assert!(
        state(&dir.path("walk"))[Path::new("out/scene.safetensors")]
            == files[Path::new("out/scene.safetensors")]
    );
    // The folder itself has no room for them.
    for line in ["run walk -o walk --force", "geometry walk -o walk --force"] {
        dir.refused(line, 73, &["is an input of this command"]);
    }
}

#[test]
fn a_run_that_left_nothing_does_not_block_the_next() {
    let dir = Scratch::new();
    dir.write("bad.mp4", [0; 5000]);
    write(&dir.path("walk"), walk(8).iter().map(frame_image));
    let options =
        "--set dense.working_side_px=160 --set preview.panel_px=64 --iterations 20 -o out";
    dir.refused(&format!("run bad.mp4 {options}"), 65, &["bad.mp4"]);
    dir.succeed(&format!("run walk {options}"));
    // one with finished steps does, and says so
    #[cfg(unix)]
    {
        killed(&dir, "run walk -o cut", || {
            dir.path("cut/capture/.minute4d-steps/cameras").exists()
        });
        dir.refused(
            "run walk -o cut",
            73,
            &[
                "an unfinished run (finished steps of geometry)",
                "--resume",
                "--force",
            ],
        );
    }
}

#[test]
fn man_pages_and_completions_name_every_command() {
    let dir = Scratch::new();
    dir.succeed("manual out");
    let page = String::from_utf8(dir.read("out/man1/minute4d-render.1")).unwrap();
    assert!(
        page.contains("camera paths") || page.contains("path"),
        "{page}"
    );
    for file in [
        "minute4d.bash",
        "_minute4d",
        "minute4d.fish",
        "_minute4d.ps1",
    ] {
        let text = String::from_utf8(dir.read(&format!("out/{file}"))).unwrap();
        assert!(text.contains("render") && text.contains("eval"), "{file}");
    }
}
