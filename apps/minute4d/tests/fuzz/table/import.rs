//! Readers of data sets: one row for each file that a format parses, in an otherwise valid clip,
//! and for each file of depth or masks that accompanies a clip.

use super::{alone, among, within};
use crate::files::{Wrap, fixture, fixture_bytes};
use crate::reader::{self, Around, Outcome, Reader};
use m4_core::Silent;
use m4_io::dataset::ImportOptions;
use m4_io::dataset::SourceFormat::{
    self, Colmap, Dycheck, Megasam, Nerfstudio, Nvidia, Record3d, Vipe,
};
use m4_io::dataset::depth::{decode_exr, read_depth};
use m4_io::dataset::side::read_mask;
use m4_io::reach::Reach;
use std::path::Path;

/// Reads a clip, and detects its format.
fn clip(path: &Path, format: SourceFormat, options: &ImportOptions) -> Outcome {
    let _ = m4_io::dataset::detect(path);
    Outcome::of(
        m4_io::dataset::read(path, format, options, &Silent),
        |captures| {
            reader::capture(&captures.train)
                .or_else(|| captures.test.as_ref().and_then(reader::capture))
        },
    )
}

fn plain(name: &'static str, format: SourceFormat, source: &str, file: &str) -> Reader {
    let reader = among(name, &format!("import/{source}"), file, move |p| {
        clip(p, format, &ImportOptions::default())
    });
    let wrap = if file.ends_with(".png") {
        Wrap::Png
    } else {
        Wrap::Plain
    };
    Reader { wrap, ..reader }
}

/// A file of a fixture whose images lie elsewhere.
fn with_images(name: &'static str, format: SourceFormat, source: &str, file: &str) -> Reader {
    let options = ImportOptions {
        images: Some(fixture("import/clip/images")),
        ..ImportOptions::default()
    };
    among(name, &format!("import/{source}"), file, move |p| {
        clip(p, format, &options)
    })
}

fn member(
    name: &'static str,
    format: SourceFormat,
    source: &str,
    file: &str,
    inside: &'static str,
) -> Reader {
    within(name, inside, plain(name, format, source, file))
}

pub fn rows() -> Vec<Reader> {
    [
        cameras_of_tools(),
        archives_of_tools(),
        megasam(),
        phones(),
        data_sets(),
        side_files(),
    ]
    .into_iter()
    .flatten()
    .collect()
}

fn cameras_of_tools() -> Vec<Reader> {
    vec![
        with_images(
            "import-colmap-cameras-txt",
            Colmap,
            "colmap_text",
            "sparse/0/cameras.txt",
        ),
        with_images(
            "import-colmap-images-txt",
            Colmap,
            "colmap_text",
            "sparse/0/images.txt",
        ),
        with_images(
            "import-colmap-cameras-bin",
            Colmap,
            "colmap_binary",
            "sparse/0/cameras.bin",
        ),
        with_images(
            "import-colmap-images-bin",
            Colmap,
            "colmap_binary",
            "sparse/0/images.bin",
        ),
        plain(
            "import-colmap-opencv",
            Colmap,
            "colmap_opencv",
            "sparse/0/cameras.txt",
        ),
        plain(
            "import-colmap-fisheye",
            Colmap,
            "colmap_fisheye",
            "sparse/0/cameras.bin",
        ),
        plain(
            "import-nerfstudio",
            Nerfstudio,
            "nerfstudio",
            "transforms.json",
        ),
        plain(
            "import-nerfstudio-depth",
            Nerfstudio,
            "nerfstudio",
            "depth/2.png",
        ),
        plain(
            "import-nerfstudio-mask",
            Nerfstudio,
            "nerfstudio",
            "masks/2.png",
        ),
        plain(
            "import-nerfstudio-image",
            Nerfstudio,
            "nerfstudio",
            "images/frame_2.jpg",
        ),
        beside_clip("import-instant4d", "transforms.json"),
        beside_clip("import-instant4d-depth", "depth_2.npy"),
    ]
}

/// The same with the images that its list names beside it.
fn beside_clip(name: &'static str, file: &str) -> Reader {
    let options = ImportOptions {
        reach: Reach::Anywhere,
        ..ImportOptions::default()
    };
    let reader = among(name, "import/instant4d", file, move |p| {
        clip(p, Nerfstudio, &options)
    });
    let Around::Fixtures(mut all) = reader.around else {
        panic!("{} is among no fixtures", reader.name)
    };
    all.push(("import/clip".to_owned(), "clip".to_owned()));
    Reader {
        around: Around::Fixtures(all),
        ..reader
    }
}

fn megasam() -> Vec<Reader> {
    let read = |p: &Path| clip(p, Megasam, &ImportOptions::default());
    let droid = |name| among(name, "megasam/outputs/dog_droid.npz", "", read);
    let of_folder = |name, file| among(name, "megasam/reconstructions/dog", file, read);
    vec![
        droid("import-megasam"),
        within("import-megasam-images", "images.npy", droid("")),
        within("import-megasam-depths", "depths.npy", droid("")),
        within("import-megasam-intrinsic", "intrinsic.npy", droid("")),
        within("import-megasam-poses", "cam_c2w.npy", droid("")),
        among(
            "import-megasam-cvd",
            "megasam/outputs_cvd/dog_sgd_cvd_hr.npz",
            "",
            read,
        ),
        of_folder("import-megasam-folder-images", "images.npy"),
        of_folder("import-megasam-folder-disps", "disps.npy"),
        of_folder("import-megasam-folder-poses", "poses.npy"),
        of_folder("import-megasam-folder-intrinsics", "intrinsics.npy"),
        of_folder("import-megasam-folder-motion", "motion_prob.npy"),
    ]
}

fn archives_of_tools() -> Vec<Reader> {
    vec![
        plain("import-vipe-pose", Vipe, "vipe", "pose/dog.npz"),
        member(
            "import-vipe-pose-data",
            Vipe,
            "vipe",
            "pose/dog.npz",
            "data.npy",
        ),
        member(
            "import-vipe-pose-inds",
            Vipe,
            "vipe",
            "pose/dog.npz",
            "inds.npy",
        ),
        plain("import-vipe-lens", Vipe, "vipe", "intrinsics/dog.npz"),
        member(
            "import-vipe-lens-data",
            Vipe,
            "vipe",
            "intrinsics/dog.npz",
            "data.npy",
        ),
        plain(
            "import-vipe-camera",
            Vipe,
            "vipe",
            "intrinsics/dog_camera.txt",
        ),
        plain("import-vipe-depth", Vipe, "vipe", "depth/dog.zip"),
        member(
            "import-vipe-depth-exr",
            Vipe,
            "vipe",
            "depth/dog.zip",
            "00002.exr",
        ),
        plain("import-vipe-mask", Vipe, "vipe", "mask/dog.zip"),
        member(
            "import-vipe-mask-png",
            Vipe,
            "vipe",
            "mask/dog.zip",
            "00002.png",
        ),
        plain("import-vipe-names", Vipe, "vipe", "mask/dog.txt"),
        plain("import-vipe-video", Vipe, "vipe", "rgb/dog.mp4"),
    ]
}

fn phones() -> Vec<Reader> {
    vec![
        plain("import-record3d", Record3d, "record3d/clip.r3d", ""),
        member(
            "import-record3d-metadata",
            Record3d,
            "record3d/clip.r3d",
            "",
            "metadata",
        ),
        member(
            "import-record3d-depth",
            Record3d,
            "record3d/clip.r3d",
            "",
            "rgbd/1.depth",
        ),
        member(
            "import-record3d-confidence",
            Record3d,
            "record3d/clip.r3d",
            "",
            "rgbd/1.conf",
        ),
        member(
            "import-record3d-image",
            Record3d,
            "record3d/clip.r3d",
            "",
            "rgbd/1.jpg",
        ),
        member(
            "import-record3d-large",
            Record3d,
            "record3d/large.r3d",
            "",
            "rgbd/0.depth",
        ),
    ]
}

fn data_sets() -> Vec<Reader> {
    vec![
        plain("import-dycheck-scene", Dycheck, "dycheck", "scene.json"),
        plain("import-dycheck-extra", Dycheck, "dycheck", "extra.json"),
        plain(
            "import-dycheck-split",
            Dycheck,
            "dycheck",
            "splits/train.json",
        ),
        plain(
            "import-dycheck-camera",
            Dycheck,
            "dycheck",
            "camera/0_00001.json",
        ),
        plain(
            "import-dycheck-depth",
            Dycheck,
            "dycheck",
            "depth/2x/0_00001.npy",
        ),
        plain("import-nvidia-poses", Nvidia, "nvidia", "poses_bounds.npy"),
        plain("import-nvidia-disparity", Nvidia, "nvidia", "disp/001.npy"),
        plain(
            "import-nvidia-mask",
            Nvidia,
            "nvidia",
            "motion_masks/001.png",
        ),
    ]
}

fn contents(files: &'static [&'static str]) -> impl Fn() -> Vec<Vec<u8>> + Send + Sync {
    move || {
        files
            .iter()
            .map(|f| fixture_bytes(&format!("import/side/{f}")))
            .collect()
    }
}

fn one_map(path: &Path) -> Outcome {
    Outcome::of(read_depth(path, 0.001), reader::depth)
}

fn side_files() -> Vec<Reader> {
    let bytes = |p: &Path| std::fs::read(p).unwrap_or_default();
    let exrs = &[
        "depth_exr/frame9.exr",
        "depth_exr/frame10.exr",
        "exr_other/parts.exr",
    ];
    let pngs = &["masks_palette/frame8.png", "masks_png/frame8.png"];
    let outcome_of = |p: &Path| Outcome::of(read_mask(p), |_| None);
    vec![
        alone("side-exr", "a.exr", contents(exrs), move |p| {
            Outcome::of(decode_exr(&bytes(p)), reader::map)
        }),
        alone(
            "side-depth",
            "a",
            contents(&["depth_exr/frame9.exr", "depth_npy/frame8.npy"]),
            one_map,
        ),
        Reader {
            wrap: Wrap::Png,
            ..alone(
                "side-depth-png",
                "a.png",
                contents(&["depth_png/frame8.png"]),
                one_map,
            )
        },
        Reader {
            wrap: Wrap::Png,
            ..alone("side-mask-png", "a.png", contents(pngs), outcome_of)
        },
    ]
}
