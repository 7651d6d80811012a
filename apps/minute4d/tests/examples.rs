//! The programs of `examples/` do what they say.

use crate::common::clips::{self, frame_image, walk};
use crate::common::{Scratch, frames_of, write_capture};
use m4_io::image::read_rgb;

#[path = "../../../examples/render_path.rs"]
#[expect(dead_code, reason = "tests call what main calls")]
mod render_path;
#[path = "../../../examples/train_capture.rs"]
#[expect(dead_code, reason = "tests call what main calls")]
mod train_capture;
#[path = "../../../examples/video_to_frames.rs"]
#[expect(dead_code, reason = "tests call what main calls")]
mod video_to_frames;

fn words(text: &[&str]) -> impl Iterator<Item = String> {
    text.iter()
        .map(|word| (*word).to_owned())
        .collect::<Vec<_>>()
        .into_iter()
}

#[test]
fn a_video_becomes_frames_and_a_scene_becomes_a_video() {
    let dir = Scratch::new();
    clips::write(&dir.path("clip"), walk(12).iter().map(frame_image));
    video_to_frames::run(words(&[&dir.at("clip"), &dir.at("out"), "1"])).unwrap();
    let page = String::from_utf8(dir.read("out/viewer.html")).unwrap();
    assert!(m4_viewer::page::read(&page).is_ok());
    let frame = read_rgb(&dir.path("out/00003.png")).unwrap();
    assert_eq!(frame.size(), clips::SIZE);
    assert!(
        frame.data().iter().any(|rgb| rgb[0] > 60),
        "the image is not black"
    );
    render_path::run(words(&[
        &dir.at("out/scene.safetensors"),
        &dir.at("path.mp4"),
    ]))
    .unwrap();
    assert_eq!(frames_of(&dir.path("path.mp4")), (12, clips::SIZE));
    assert!(
        render_path::run(words(&["only"]))
            .unwrap_err()
            .to_string()
            .starts_with("usage")
    );
}

#[test]
fn a_capture_becomes_splats_of_other_tools() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    train_capture::run(words(&[&dir.at("capture"), &dir.at("scene.ply"), "20"])).unwrap();
    assert!(dir.read("scene.ply").starts_with(b"ply"));
    let again =
        train_capture::run(words(&[&dir.at("capture"), &dir.at("scene.ply"), "20"])).unwrap_err();
    assert!(again.to_string().contains("already exists"), "{again}");
    let unknown =
        train_capture::run(words(&[&dir.at("capture"), &dir.at("scene.obj"), "1"])).unwrap_err();
    assert!(unknown.to_string().contains("names no format"), "{unknown}");
}
