//! What is damaged, and how it is read.

use crate::fixtures::fixture;
use m4_core::{Capture, Silent};
use m4_io::dataset::SourceFormat::{self, Colmap, Dycheck, Megasam, Nerfstudio, Nvidia, Record3d, Vipe};
use m4_io::dataset::davis;
use m4_io::dataset::{ImportOptions, read};
use m4_io::reach::Reach;
use m4_io::video::VideoOptions;
use std::path::Path;

/// The captures of a source.
pub type Read = Box<dyn Fn(&Path) -> Result<Vec<Capture>, String>>;

/// One parser.
pub struct Case {
    /// Below `fixtures`, or one of what [`crate::datasets::prepared`] makes.
    pub source: &'static str,
    /// Parts of names of the files that are damaged, below the source; all files where it is empty.
    pub files: &'static [&'static str],
    /// How many of the damaged copies must be refused at least.
    pub refused: usize,
    pub read: Read,
}

fn of(path: &Path, format: SourceFormat, options: &ImportOptions) -> Result<Vec<Capture>, String> {
    // looks at the same damage
    let _ = m4_io::dataset::detect(path);
    let clip = read(path, format, options, &Silent).map_err(|e| e.to_string())?;
    Ok(std::iter::once(clip.train).chain(clip.test).collect())
}

/// A sound clip with side files out of `path`.
fn beside(path: &Path, change: impl Fn(&mut ImportOptions, &Path)) -> Result<Vec<Capture>, String> {
    let mut options = ImportOptions {
        depth_unit: Some(0.0005),
        ..ImportOptions::default()
    };
    change(&mut options, path);
    of(&fixture("import/record3d/clip.r3d"), Record3d, &options)
}

/// A side file or folder, as the option that `set` sets.
fn side(files: &'static [&'static str], set: fn(&mut ImportOptions, &Path)) -> Case {
    Case {
        source: "import/side",
        files,
        refused: 15,
        read: Box::new(move |path| {
            let mut captures = Vec::new();
            for file in files {
                captures = beside(path, |options, path| set(options, &path.join(file)))?;
            }
            Ok(captures)
        }),
    }
}

fn plain(source: &'static str, format: SourceFormat, files: &'static [&'static str], refused: usize) -> Case {
    Case {
        source,
        files,
        refused,
        read: Box::new(move |path| of(path, format, &ImportOptions::default())),
    }
}

/// The same with the images of the clip.
fn pictured(source: &'static str, format: SourceFormat, files: &'static [&'static str], refused: usize) -> Case {
    let options = ImportOptions {
        pictures: Some(fixture("import/clip/images")),
        ..ImportOptions::default()
    };
    Case {
        read: Box::new(move |path| of(path, format, &options)),
        ..plain(source, format, files, refused)
    }
}

pub fn all() -> Vec<Case> {
    vec![
        plain("import/dycheck", Dycheck, &[], 15),
        plain("import/dycheck", Dycheck, &[".json"], 15),
        plain("import/dycheck", Dycheck, &[".npy"], 15),
        plain("import/nvidia", Nvidia, &[], 15),
        plain("import/nvidia", Nvidia, &["poses_bounds"], 15),
        Case {
            source: "import/davis",
            files: &[],
            refused: 15,
            read: Box::new(|path| {
                let folder = path.join("JPEGImages/480p/ball");
                let clip = davis::read_clip(&folder, &VideoOptions::default(), &Silent);
                clip.map(|_| Vec::new()).map_err(|e| e.to_string())
            }),
        },
        plain("import/record3d/clip.r3d", Record3d, &[], 15),
        plain("record3d unpacked", Record3d, &["metadata", "jpg"], 15),
        plain("record3d unpacked", Record3d, &[".depth", ".conf"], 15),
        plain("record3d large", Record3d, &[".depth"], 15),
        side(&["depth_exr"], |o, file| o.depth = Some(file.into())),
        side(&["depth_pfm"], |o, file| o.depth = Some(file.into())),
        side(&["depth_png"], |o, file| o.depth = Some(file.into())),
        side(&["depth_npy"], |o, file| o.depth = Some(file.into())),
        side(&["depth.npz"], |o, file| o.depth = Some(file.into())),
        side(&["masks_palette", "masks_png"], |o, file| o.masks = Some(file.into())),
        side(&["masks.npz"], |o, file| o.masks = Some(file.into())),
        side(&["tapip3d.npz", "world.npz"], |o, file| o.tracks = Some(file.into())),
        side(&["cotracker.npz", "spatracker.npz"], |o, file| {
            o.tracks = Some(file.into())
        }),
        pictured("import/colmap_text", Colmap, &["sparse/0/cameras.txt"], 40),
        pictured("import/colmap_text", Colmap, &["sparse/0/images.txt"], 40),
        pictured("import/colmap_binary", Colmap, &["sparse/0/cameras.bin"], 40),
        pictured("import/colmap_binary", Colmap, &["sparse/0/images.bin"], 40),
        plain("import/colmap_opencv", Colmap, &["sparse/0/cameras.txt"], 40),
        plain("import/nerfstudio", Nerfstudio, &["transforms.json"], 40),
        plain("import/nerfstudio", Nerfstudio, &["depth/2.png"], 40),
        plain("import/nerfstudio", Nerfstudio, &["masks/2.png"], 40),
        Case {
            read: Box::new(|path| {
                let options = ImportOptions {
                    reach: Reach::Anywhere,
                    ..ImportOptions::default()
                };
                of(path, Nerfstudio, &options)
            }),
            ..plain("exr", Nerfstudio, &["depth_2.exr"], 20)
        },
        plain("import/vipe", Vipe, &["pose/dog.npz"], 40),
        plain("import/vipe", Vipe, &["intrinsics/dog.npz"], 40),
        plain("import/vipe", Vipe, &["intrinsics/dog_camera.txt"], 20),
        plain("import/vipe", Vipe, &["depth/dog.zip"], 40),
        plain("import/vipe", Vipe, &["mask/dog.zip"], 40),
        plain("import/vipe", Vipe, &["mask/dog.txt"], 20),
        plain("import/vipe", Vipe, &["rgb/dog.mp4"], 20),
        plain("megasam/outputs/dog_droid.npz", Megasam, &[], 40),
    ]
}
