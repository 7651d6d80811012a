//! Fixtures and real weights.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use m4_core::{Plane, RgbImage};
use m4_nets::LoadError;
use m4_testkit::{FormulaWeights, Need, repository, skip};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A smooth image of any size.
pub fn test_image(w: usize, h: usize) -> RgbImage {
    Plane::from_fn(w, h, |x, y| {
        let (x, y) = (x as f32 / w as f32, y as f32 / h as f32);
        [x, y, (9.0 * x).sin() * (7.0 * y).cos() * 0.5 + 0.5].map(|v| (v * 255.0) as u8)
    })
}

/// The network that `load` makes of a checkpoint of `weights`.
pub fn loaded<N>(weights: &FormulaWeights, load: impl Fn(&Path) -> Result<N, LoadError>) -> N {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("weights.safetensors");
    weights.write(&path);
    load(&path).unwrap()
}

/// An image from a PNG file of the fixtures.
pub fn png(name: &str) -> RgbImage {
    let image = image::open(repository().join("fixtures").join(name))
        .unwrap()
        .to_rgb8();
    let (w, h) = (image.width() as usize, image.height() as usize);
    RgbImage::from_vec(w, h, image.pixels().map(|p| p.0).collect()).unwrap()
}

/// The real weights `name/file` in the folder `MINUTE4D_WEIGHTS` or the user's cache; `None`, and a
/// word on it, without.
#[track_caller]
pub fn real_weights(name: &str, file: &str) -> Option<PathBuf> {
    let cache = std::env::var_os("XDG_CACHE_HOME").map(PathBuf::from);
    let cache =
        cache.or_else(|| std::env::var_os("HOME").map(|home| Path::new(&home).join(".cache")));
    let folder = std::env::var_os("MINUTE4D_WEIGHTS").map(PathBuf::from);
    let folder = folder.or_else(|| cache.map(|c| c.join("minute4d/weights")))?;
    let path = folder.join(name).join(file);
    if path.is_file() {
        return Some(path);
    }
    skip(
        Need::Weights,
        &format!("the published {name}/{file} is not here"),
    );
    None
}
