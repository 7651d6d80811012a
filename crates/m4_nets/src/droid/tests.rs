//! Parts of the network against the published module.

use super::*;
use crate::cpu;
use crate::ops::tensor;
use m4_core::RgbImage;
use m4_testkit::{formula_input, write_formula_weights};
use safetensors::SafeTensors;
use std::path::Path;
use std::sync::LazyLock;

const KEYS: &str = include_str!("../../../../fixtures/droid/keys.txt");
/// Grid of the fixtures.
const H: usize = 16;
const W: usize = 24;
const N: usize = H * W;

pub fn network() -> DroidNet {
    static FOLDER: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
        let folder = tempfile::TempDir::new().unwrap();
        write_formula_weights(KEYS, &folder.path().join("weights.safetensors"));
        folder
    });
    DroidNet::load(&FOLDER.path().join("weights.safetensors"), cpu()).unwrap()
}

/// A file of the fixtures.
pub struct Fixture(Vec<u8>);

impl Fixture {
    pub fn open(name: &str) -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/droid");
        Self(std::fs::read(folder.join(name)).unwrap())
    }

    fn bytes(&self, name: &str) -> Vec<u8> {
        let tensors = SafeTensors::deserialize(&self.0).unwrap();
        tensors.tensor(name).unwrap().data().to_vec()
    }

    pub fn floats(&self, name: &str) -> Vec<f32> {
        let bytes = self.bytes(name);
        bytes.as_chunks::<4>().0.iter().map(|&b| f32::from_le_bytes(b)).collect()
    }

    pub fn indices(&self, name: &str) -> Vec<usize> {
        let bytes = self.bytes(name);
        let words = bytes.as_chunks::<8>().0.iter();
        words.map(|&b| u64::from_le_bytes(b) as usize).collect()
    }

    /// Images of blue, green and red planes.
    pub fn images(&self) -> Vec<RgbImage> {
        let (w, h) = (8 * W, 8 * H);
        let image = |planes: &[u8]| {
            let pixel = |i: usize| [2, 1, 0].map(|c: usize| planes[c * w * h + i]);
            RgbImage::from_vec(w, h, (0..w * h).map(pixel).collect()).unwrap()
        };
        self.bytes("images_bgr_u8").chunks(3 * w * h).map(image).collect()
    }
}

pub fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.try_into_vec_as().unwrap()
}

#[track_caller]
pub fn agree(what: &str, got: &[f32], want: &[f32], limit: f32) {
    assert_eq!(got.len(), want.len(), "{what}");
    let largest = want.iter().fold(0.0_f32, |m, x| m.max(x.abs()));
    assert!(largest > 0.0, "{what}: nothing to compare with");
    let error = got.iter().zip(want).map(|(a, b)| (a - b).abs());
    let error = error.fold(0.0, |m: f32, x| if x.is_nan() { f32::NAN } else { m.max(x) }) / largest;
    println!("{what}: {error:.1e}");
    assert!(error < limit, "{what}: {error:.1e}");
}

/// `[n][c][h * w]` as `[n][h * w][c]`, as the fixtures have deltas and weights.
fn components_last(values: &[f32], c: usize) -> Vec<f32> {
    let edges = values.chunks(c * N);
    edges.flat_map(|edge| (0..c * N).map(move |i| edge[(i % c) * N + i / c])).collect()
}

#[test]
fn encoders_agree_with_the_module() {
    let (net, file) = (network(), Fixture::open("encoders.safetensors"));
    let (fmap, hidden, context) = (file.floats("fmap"), file.floats("hidden"), file.floats("context"));
    for (i, image) in file.images().iter().enumerate() {
        let part = |all: &[f32]| all[i * WIDTH * N..][..WIDTH * N].to_vec();
        agree("fmap", &values(net.features(image).unwrap()), &part(&fmap), 3e-5);
        let [h, c] = net.state(image).unwrap();
        agree("hidden", &values(h), &part(&hidden), 3e-5);
        agree("context", &values(c), &part(&context), 3e-5);
    }
}

/// The inputs of the update fixture: hidden, context, correlation, motion.
fn inputs(edges: usize) -> [Tensor<4>; 4] {
    [("hidden", 0.0, 0.9, WIDTH), ("context", 0.5, 0.5, WIDTH), ("corr", 0.0, 4.0, 196), ("motion", 0.0, 6.0, 4)].map(
        |(name, offset, scale, c)| {
            let values = formula_input(&format!("input/droid/{name}"), offset, scale, edges * c * N);
            tensor(values, [edges, c, H, W], &cpu())
        },
    )
}

#[test]
fn an_update_agrees_with_the_module() {
    let (net, file) = (network(), Fixture::open("update_step.safetensors"));
    let sources = file.indices("ii");
    let [hidden, context, corr, motion] = inputs(sources.len());
    let context = net.gru.context(context);
    let update = &net.net.update;
    let advanced = |motion| update.advance(&net.gru, hidden.clone(), context.clone(), corr.clone(), motion);
    let after = advanced(Some(motion));
    let weights = update.weight(after.clone());
    let (delta, weight) = (values(update.delta(after.clone())), values(weights.clone()));
    agree("delta", &components_last(&delta, 2), &file.floats("delta"), 3e-5);
    agree("weight", &components_last(&weight, 2), &file.floats("weight"), 3e-5);
    let first = values(after.clone().narrow(0, 0, 2));
    agree("hidden", &first, &file.floats("hidden_out"), 3e-5);

    let mut groups = sources.clone();
    groups.sort_unstable();
    groups.dedup();
    let mut still = vec![0.0; sources.len() * N];
    let (mut eta, mut upmask) = (Vec::new(), Vec::new());
    for group in groups {
        let at: Vec<usize> = (0..sources.len()).filter(|&e| sources[e] == group).collect();
        let of = |all: &Tensor<4>| {
            let parts = at.iter().map(|&e| all.clone().narrow(0, e, 1));
            Tensor::cat(parts.collect(), 0)
        };
        let (hidden, weight) = (of(&after), of(&weights));
        let n = at.len() as f32;
        let shared = net.net.update.agg.of_mean(update.agg.sum_of(hidden.clone()) / n);
        eta.extend(values(update.agg.eta(shared.clone())));
        let mask = values(update.agg.upmask(shared));
        upmask.extend(mask.chunks(N).step_by(7).flatten().copied());
        let head = &update.agg_motion;
        let edges = head.edges(hidden, weight);
        let together = head.together(edges.clone().sum_dim(0) / n);
        let m = values(head.still(edges, together));
        for (k, &e) in at.iter().enumerate() {
            still[e * N..][..N].copy_from_slice(&m[k * N..][..N]);
        }
    }
    agree("eta", &eta, &file.floats("eta"), 3e-5);
    agree("upmask", &upmask, &file.floats("upmask_strided"), 3e-5);
    agree("m", &still, &file.floats("m"), 3e-5);
    let weight = components_last(&weight, 2);
    let weighted: Vec<f32> = weight.iter().zip(0..).map(|(w, i)| w * still[i / 2]).collect();
    agree("m * weight", &weighted, &file.floats("weighted"), 3e-5);

    // as the motion filter does it
    let after = advanced(None);
    let c: Vec<f32> =
        values(after.clone()).chunks(WIDTH * N).flat_map(|edge| edge.chunks(N).step_by(9).flatten()).copied().collect();
    agree("alone, hidden", &c, &file.floats("nograph_hidden_out_strided"), 3e-5);
    let last = |x| components_last(&values(x), 2);
    agree("alone, delta", &last(update.delta(after.clone())), &file.floats("nograph_delta"), 3e-5);
    agree("alone, weight", &last(update.weight(after)), &file.floats("nograph_weight"), 3e-5);
}
