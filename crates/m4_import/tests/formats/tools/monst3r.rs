//! Folders of MonST3R.

use super::truth::{Truth, read, with_pictures};
use crate::support::{Heard, copied, refused};
use m4_import::ImportOptions;
use m4_import::SourceFormat::Monst3r;

#[test]
fn a_folder_is_the_clip() {
    let truth = Truth::read();
    for options in [ImportOptions::default(), with_pictures()] {
        let got = read("import/monst3r", Monst3r, &options).unwrap().train;
        truth.same_cameras(&got, (0, 0.0));
        truth.same_depth(&got, 1e-6, 0.0);
        truth.same_masks(&got);
    }
}

#[test]
fn the_other_order_of_a_quaternion_is_told_by_the_first_pose() {
    let (_dir, here) = copied("import/monst3r");
    let file = here.join("pred_traj.txt");
    let text = std::fs::read_to_string(&file).unwrap();
    let turned = text.lines().map(|line| {
        let words: Vec<&str> = line.split(' ').collect();
        [&words[..4], &words[5..], &words[4..5]].concat().join(" ") + "\n"
    });
    std::fs::write(&file, turned.collect::<String>()).unwrap();
    let heard = Heard::default();
    let got = m4_import::read(&here, Monst3r, &ImportOptions::default(), &heard)
        .unwrap()
        .train;
    Truth::read().same_cameras(&got, (0, 0.0));
    assert!(heard.all().contains("qx qy qz qw"));
    std::fs::remove_file(here.join("frame_0003.npy")).unwrap();
    let message = refused(&here, Monst3r, &ImportOptions::default());
    assert!(
        message.contains("frame_0003.npy") && message.contains("frame 3"),
        "{message}"
    );
    std::fs::write(&file, "0 0 0 0 1 0 0\n").unwrap();
    let message = refused(&here, Monst3r, &ImportOptions::default());
    assert!(
        message.contains("pred_traj.txt") && message.contains("7 numbers"),
        "{message}"
    );
}
