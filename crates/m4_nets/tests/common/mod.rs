//! Fixtures and real weights.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use m4_core::{Plane, RgbImage};
use m4_nets::LoadError;
use m4_testkit::{FormulaWeights, Need, skip};
use safetensors::{Dtype, SafeTensors};
use std::fmt::Debug;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// The folder of fixtures.
pub fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures")
}

/// A tensor of 32-bit numbers.
pub fn floats(file: &[u8], name: &str) -> Vec<f32> {
    let tensors = SafeTensors::deserialize(file).unwrap();
    let tensor = tensors.tensor(name).unwrap();
    assert_eq!(tensor.dtype(), Dtype::F32, "{name}");
    let bytes = tensor.data().chunks_exact(4);
    bytes.map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect()
}

/// An image, `[h, w, 3]` or `[3, h, w]` bytes.
pub fn read_image(file: &[u8], name: &str) -> RgbImage {
    let tensors = SafeTensors::deserialize(file).unwrap();
    let tensor = tensors.tensor(name).unwrap();
    let bytes = tensor.data();
    let (w, h, pixels) = match *tensor.shape() {
        [h, w, 3] => (w, h, bytes.as_chunks::<3>().0.to_vec()),
        [3, h, w] => {
            let pixel = |i| [0, 1, 2].map(|c| bytes[c * h * w + i]);
            (w, h, (0..h * w).map(pixel).collect())
        }
        _ => panic!("{name} is not an image"),
    };
    RgbImage::from_vec(w, h, pixels).unwrap()
}

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

/// What `make` gives, which is the same for any number of threads.
#[track_caller]
pub fn same_on_any_threads<T: PartialEq + Debug + Send>(make: impl Fn() -> T + Sync) -> T {
    let [one, two, five] = [1, 2, 5].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(&make)
    });
    assert_eq!(one, two);
    assert_eq!(one, five);
    one
}

/// Fails unless the largest difference, relative to the largest of `want`, is below `limit`.
#[expect(clippy::print_stdout, reason = "figures for docs/networks.md")]
#[track_caller]
pub fn assert_near(what: &str, got: &[f32], want: &[f32], limit: f32) {
    assert_eq!(got.len(), want.len(), "{what}");
    let largest = want.iter().fold(0.0_f32, |m, x| m.max(x.abs()));
    assert!(largest > 0.0, "{what}: nothing but zeros is wanted");
    let off = got.iter().zip(want).map(|(a, b)| (a - b).abs());
    let error = off.fold(0.0_f32, |m, x| if x.is_nan() { f32::INFINITY } else { m.max(x) }) / largest;
    println!("{what}: {error:.1e} of {largest}");
    assert!(error < limit, "{what}: {error:.1e} of {largest}");
}

/// An image from a PNG file of the fixtures.
pub fn png(name: &str) -> RgbImage {
    let image = image::open(fixtures().join(name)).unwrap().to_rgb8();
    let (w, h) = (image.width() as usize, image.height() as usize);
    RgbImage::from_vec(w, h, image.pixels().map(|p| p.0).collect()).unwrap()
}

/// The real weights `name/file` in the folder `MINUTE4D_WEIGHTS` or the user's cache; `None`, and a word on it, without.
#[track_caller]
pub fn real_weights(name: &str, file: &str) -> Option<PathBuf> {
    let cache = std::env::var_os("XDG_CACHE_HOME").map(PathBuf::from);
    let cache = cache.or_else(|| std::env::var_os("HOME").map(|home| Path::new(&home).join(".cache")));
    let folder = std::env::var_os("MINUTE4D_WEIGHTS").map(PathBuf::from);
    let folder = folder.or_else(|| cache.map(|c| c.join("minute4d/weights")))?;
    let path = folder.join(name).join(file);
    if path.is_file() {
        return Some(path);
    }
    skip(Need::Weights, &format!("the published {name}/{file} is not here"));
    None
}
