//! Fixtures, and weights by a formula.

use m4_nets::Flow;
use m4_scene::RgbImage;
use safetensors::{Dtype, SafeTensors, serialize_to_file, tensor::TensorView};
use std::path::{Path, PathBuf};

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

/// A picture, `[h, w, 3]` bytes.
pub fn picture(file: &[u8], name: &str) -> RgbImage {
    let tensors = SafeTensors::deserialize(file).unwrap();
    let tensor = tensors.tensor(name).unwrap();
    let [h, w, 3] = tensor.shape() else {
        panic!("{name} is no picture");
    };
    let pixels = tensor.data().as_chunks::<3>().0.to_vec();
    RgbImage::from_vec(*w, *h, pixels).unwrap()
}

/// A picture from a PNG file of the fixtures.
pub fn png(name: &str) -> RgbImage {
    let image = image::open(fixtures().join(name)).unwrap().to_rgb8();
    let (w, h) = (image.width() as usize, image.height() as usize);
    RgbImage::from_vec(w, h, image.pixels().map(|p| p.0).collect()).unwrap()
}

/// The real weights `name/file` in the folder `MINUTE4D_WEIGHTS` or the user's cache; `None`, and a word on it, without.
#[expect(clippy::print_stderr, reason = "a test that is skipped says so")]
pub fn real_weights(name: &str, file: &str) -> Option<PathBuf> {
    let cache = std::env::var_os("XDG_CACHE_HOME").map(PathBuf::from);
    let cache = cache.or_else(|| std::env::var_os("HOME").map(|home| Path::new(&home).join(".cache")));
    let folder = std::env::var_os("MINUTE4D_WEIGHTS").map(PathBuf::from);
    let folder = folder.or_else(|| cache.map(|c| c.join("minute4d/weights")))?;
    let path = folder.join(name).join(file);
    if path.is_file() {
        return Some(path);
    }
    eprintln!("not tested with real weights: `minute4d weights fetch {name}` gets them");
    None
}

/// The fill rule of the fixtures: numbers in [-1, 1) from the name of a tensor alone.
pub fn formula(name: &str, n: usize) -> impl Iterator<Item = f64> {
    let mut key = 0xCBF2_9CE4_8422_2325u64;
    for byte in name.bytes() {
        key = (key ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01B3);
    }
    (1..=n as u64).map(move |i| {
        let mut z = key.wrapping_add(i.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^= z >> 31;
        (z >> 11) as f64 * 2f64.powi(-52) - 1.0
    })
}

/// Writes a checkpoint of the tensors of `list` (lines of a name and a shape), filled by the rule.
pub fn write_formula_weights(list: &str, path: &Path) {
    let tensors: Vec<(String, Vec<usize>, Vec<u8>)> = list
        .lines()
        .map(|line| {
            let mut words = line.split_whitespace();
            let name = words.next().unwrap().to_owned();
            let shape: Vec<usize> = words.map(|w| w.parse().unwrap()).collect();
            let fan_in: usize = shape[1..].iter().product();
            let last = name.rsplit('.').next().unwrap();
            let value = |u: f64| match (last, shape.len()) {
                (l, _) if l.ends_with("bias") => 0.02 * u,
                (l, 1) if l.ends_with("weight") => 1.0 + 0.1 * u,
                (l, _) if l.ends_with("weight") => u * (3.0 / fan_in as f64).sqrt(),
                _ => panic!("no rule for {name}"),
            };
            let bytes = formula(&name, shape.iter().product())
                .flat_map(|u| (value(u) as f32).to_le_bytes())
                .collect();
            (name, shape, bytes)
        })
        .collect();
    let views = tensors
        .iter()
        .map(|(name, shape, bytes)| (name, TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap()));
    serialize_to_file(views, None, path).unwrap();
}

/// Distances between `flow` and `want` (`[2, h, w]`, every `step`-th row and column): mean, largest, and the standard
/// deviation of what is wanted.
pub fn end_point_errors(flow: &Flow, want: &[f32], step: usize) -> (f64, f64, f64) {
    let at: Vec<usize> = (0..flow.height)
        .step_by(step)
        .flat_map(|y| (0..flow.width).step_by(step).map(move |x| (x, y)))
        .map(|(x, y)| y * flow.width + x)
        .collect();
    assert_eq!(want.len(), 2 * at.len());
    let (u, v) = want.split_at(at.len());
    let error = |k: usize| f64::from(flow.u[at[k]] - u[k]).hypot(f64::from(flow.v[at[k]] - v[k]));
    let errors: Vec<f64> = (0..at.len()).map(error).collect();
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let want: Vec<f64> = want.iter().map(|&x| f64::from(x)).collect();
    let centre = mean(&want);
    let spread = mean(&want.iter().map(|x| (x - centre).powi(2)).collect::<Vec<_>>()).sqrt();
    assert!(errors.iter().all(|e| e.is_finite()), "flow that is no number");
    (mean(&errors), errors.iter().copied().fold(0.0, f64::max), spread)
}
