//! Sources that name files outside of their folder, or lead to them by links.

use crate::dataset::{copied, fixture, refused, refuses, says};
use m4_core::Silent;
use m4_core::advice::OUTSIDE;
use m4_io::dataset::SourceFormat::{self, Nerfstudio};
use m4_io::dataset::{ImportOptions, read};
use m4_io::reach::Reach;
use std::fs;
use std::path::Path;

fn anywhere() -> ImportOptions {
    ImportOptions {
        reach: Reach::Anywhere,
        ..ImportOptions::default()
    }
}

#[test]
fn folders_that_the_options_name_may_be_read() {
    let options = ImportOptions {
        images: Some(fixture("import/clip")),
        ..ImportOptions::default()
    };
    read(&fixture("import/blender"), Nerfstudio, &options, &Silent).unwrap();
    refuses(
        &fixture("import/blender"),
        Nerfstudio,
        &["transforms_train.json", "clip/images", OUTSIDE],
    );
}

#[cfg(unix)]
#[test]
fn links_out_of_a_source_are_not_followed() {
    use SourceFormat::{Colmap, Dycheck, Nvidia, Vipe};
    for (name, format, files) in [
        ("colmap_opencv", Colmap, &["images/00000.png", "images"][..]),
        (
            "dycheck",
            Dycheck,
            &["rgb/2x/0_00001.png", "depth/2x/0_00002.npy", "rgb"],
        ),
        (
            "nvidia",
            Nvidia,
            &[
                "images_2/002.png",
                "disp/003.npy",
                "motion_masks/000.png",
                "gt/v000_t001.png",
            ],
        ),
        (
            "nerfstudio",
            Nerfstudio,
            &["images/frame_2.jpg", "depth/3.png", "masks/2.png"],
        ),
        (
            "vipe",
            Vipe,
            &["rgb/dog.mp4", "depth/dog.zip", "mask/dog.zip"],
        ),
    ] {
        for file in files {
            let (dir, here) = copied(&format!("import/{name}"));
            link(&here.join(file), dir.path());
            refuses(
                &here,
                format,
                &[file.rsplit('/').next().unwrap(), "private", OUTSIDE],
            );
            if let Err(e) = read(&here, format, &anywhere(), &Silent) {
                panic!("{name}, {file}: {e}");
            }
        }
    }
}

/// Moves a file or folder away, and leaves a link to it.
#[cfg(unix)]
fn link(file: &Path, to: &Path) {
    let away = to.join(format!(
        "private-{}",
        file.file_name().unwrap().to_string_lossy()
    ));
    fs::rename(file, &away).unwrap();
    std::os::unix::fs::symlink(&away, file).unwrap();
}

#[cfg(unix)]
#[test]
fn links_out_of_folders_that_the_options_name_are_not_followed() {
    let clip = fixture("import/record3d/clip.r3d");
    let of = |reach, depth: &Path| ImportOptions {
        depth: Some(depth.to_owned()),
        reach,
        ..ImportOptions::default()
    };
    let (dir, here) = copied("import/side/depth_png");
    link(&here.join("frame9.png"), dir.path());
    let message = refused(&clip, SourceFormat::Record3d, &of(Reach::Inside, &here));
    says(&message, &["frame9.png", OUTSIDE]);
    read(
        &clip,
        SourceFormat::Record3d,
        &of(Reach::Anywhere, &here),
        &Silent,
    )
    .unwrap();
}
