//! Makes hostile inputs in the folder of a test.

use crate::common::{Scratch, device, edit_transforms, write_capture};
use flate2::write::ZlibEncoder;
use flate2::{Compression, Crc};
use serde_json::{Value, json};
use std::fs;
use std::io::Write;
use std::process::Command;

pub const fn nothing(_: &Scratch) {}

pub fn pipe(dir: &Scratch, name: &str) {
    assert!(
        Command::new("mkfifo")
            .arg(dir.path(name))
            .status()
            .unwrap()
            .success()
    );
}

pub fn full_device(dir: &Scratch) {
    device(dir, "full");
}

pub fn pipe_clip(dir: &Scratch) {
    pipe(dir, "clip.mp4");
}

pub fn folder_with_pipe(dir: &Scratch) {
    fs::create_dir(dir.path("clips")).unwrap();
    pipe(dir, "clips/clip.mp4");
}

pub fn capture(dir: &Scratch) {
    write_capture(&dir.path("capture"), false);
}

pub fn capture_and_pipe(dir: &Scratch) {
    capture(dir);
    pipe(dir, "pipe.json");
}

/// A capture whose list, or a file of whose frames, is a pipe.
pub fn capture_of_pipe(dir: &Scratch, name: &str) {
    capture(dir);
    fs::remove_file(dir.path("capture").join(name)).unwrap();
    pipe(dir, &format!("capture/{name}"));
}

pub fn list_is_pipe(dir: &Scratch) {
    capture_of_pipe(dir, "transforms_train.json");
}

pub fn record_is_pipe(dir: &Scratch) {
    capture(dir);
    fs::create_dir(dir.path("out")).unwrap();
    pipe(dir, "out/run.json");
}

pub fn scene_is_pipe(dir: &Scratch) {
    pipe(dir, "scene.safetensors");
    pipe(dir, "splats.ply");
}

pub fn huge_config(dir: &Scratch) {
    dir.write("huge.toml", "# nothing\n".repeat(200_000));
}

pub fn acting_names(dir: &Scratch) {
    fs::write(dir.path("a\x1b[2J\u{202e}.mp4"), "").unwrap();
}

/// A capture whose list is edited.
pub fn edited(dir: &Scratch, edit: impl FnOnce(&mut Value)) {
    capture(dir);
    edit_transforms(&dir.path("capture"), edit);
}

pub fn far_camera(dir: &Scratch) {
    edited(dir, |list| {
        list["frames"][2]["transform_matrix"][0][3] = json!(1e39)
    });
}

pub fn distant_camera(dir: &Scratch) {
    edited(dir, |list| {
        list["frames"][2]["transform_matrix"][0][3] = json!(1e30)
    });
}

pub fn no_focal_length(dir: &Scratch) {
    edited(dir, |list| {
        list["frames"]
            .as_array_mut()
            .unwrap()
            .iter_mut()
            .for_each(|frame| frame["fl_x"] = json!(1e-30));
    });
}

pub fn endless_depth(dir: &Scratch) {
    edited(dir, |list| list["depth_unit_scale_factor"] = json!(1e30));
}

pub fn one_moment(dir: &Scratch) {
    edited(dir, |list| {
        list["frames"]
            .as_array_mut()
            .unwrap()
            .iter_mut()
            .for_each(|frame| frame["time"] = json!(0.5))
    });
}

pub fn one_image(dir: &Scratch) {
    edited(dir, |list| {
        let name = list["frames"][0]["file_path"].clone();
        list["frames"]
            .as_array_mut()
            .unwrap()
            .iter_mut()
            .for_each(|frame| frame["file_path"] = name.clone());
    });
}

/// A capture with other bytes of a file.
pub fn changed(dir: &Scratch, name: &str, change: impl FnOnce(Vec<u8>) -> Vec<u8>) {
    capture(dir);
    let path = dir.path("capture").join(name);
    fs::write(&path, change(fs::read(&path).unwrap())).unwrap();
}

pub fn third_of_an_image(dir: &Scratch) {
    changed(dir, "train/00002.png", |bytes| {
        bytes[..bytes.len() / 3].to_vec()
    });
}

pub fn third_of_a_depth_map(dir: &Scratch) {
    changed(dir, "depth/00002.png", |bytes| {
        bytes[..bytes.len() / 3].to_vec()
    });
}

pub fn empty_image(dir: &Scratch) {
    changed(dir, "train/00002.png", |_| Vec::new());
}

pub fn wide_text(dir: &Scratch) {
    changed(dir, "transforms_train.json", |bytes| {
        let text = String::from_utf8(bytes).unwrap();
        [0xfeff]
            .into_iter()
            .chain(text.encode_utf16())
            .flat_map(u16::to_le_bytes)
            .collect()
    });
}

pub fn half_a_list(dir: &Scratch) {
    changed(dir, "transforms_train.json", |bytes| {
        bytes[..bytes.len() / 2].to_vec()
    });
}

pub fn nested_list(dir: &Scratch) {
    changed(dir, "transforms_train.json", |_| vec![b'['; 1 << 20]);
}

#[cfg(unix)]
pub fn link_in_a_circle(dir: &Scratch) {
    capture(dir);
    fs::remove_file(dir.path("capture/train/00002.png")).unwrap();
    std::os::unix::fs::symlink("00002.png", dir.path("capture/train/00002.png")).unwrap();
}

pub fn private_file(dir: &Scratch) {
    edited(dir, |list| {
        list["frames"][0]["file_path"] = json!("../private.png")
    });
    fs::copy(dir.path("capture/train/00000.png"), dir.path("private.png")).unwrap();
}

/// 16000 x 16000 pixels in some 100 kB.
pub fn bombs(dir: &Scratch) {
    let side = 16_000_u32;
    let mut rows = ZlibEncoder::new(Vec::new(), Compression::fast());
    (0..side).for_each(|_| rows.write_all(&vec![0; side as usize + 1]).unwrap());
    let header = [
        &side.to_be_bytes()[..],
        &side.to_be_bytes(),
        &[8, 0, 0, 0, 0],
    ]
    .concat();
    let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
    for (name, data) in [
        (b"IHDR", header),
        (b"IDAT", rows.finish().unwrap()),
        (b"IEND", Vec::new()),
    ] {
        let mut sum = Crc::new();
        [&name[..], &data].iter().for_each(|part| sum.update(part));
        file.extend((data.len() as u32).to_be_bytes());
        file.extend([&name[..], &data].concat());
        file.extend(sum.sum().to_be_bytes());
    }
    fs::create_dir(dir.path("bombs")).unwrap();
    for i in 0..3 {
        fs::write(dir.path(&format!("bombs/{i}.png")), &file).unwrap();
    }
}

pub fn planned(dir: &Scratch) {
    write_capture(&dir.path("clips"), false);
}
