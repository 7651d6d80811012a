//! Parts of the network against the published module.

use super::*;
use crate::cpu;
use crate::fixture::{Fixture, assert_close as agree};
use crate::ops::tensor;
use m4_core::{Plane, RgbImage};
use m4_testkit::{formula_input, write_formula_weights};
use std::sync::LazyLock;

const KEYS: &str = include_str!("../../../../fixtures/droid/keys.txt");
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

/// The images of the fixtures, of blue, green and red planes.
pub fn images() -> Vec<RgbImage> {
    let (w, h) = (8 * W, 8 * H);
    let image =
        |planes: &[u8]| Plane::from_fn(w, h, |x, y| [2, 1, 0].map(|c| planes[(c * h + y) * w + x]));
    Fixture::open("droid/encoders.safetensors")
        .bytes("images_bgr_u8")
        .chunks(3 * w * h)
        .map(image)
        .collect()
}

pub fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.try_into_vec_as().unwrap()
}

/// `[n][c][h * w]` as `[n][h * w][c]`, as the fixtures have deltas and weights.
fn components_last(values: &[f32], c: usize) -> Vec<f32> {
    let edges = values.chunks(c * N);
    edges
        .flat_map(|edge| (0..c * N).map(move |i| edge[(i % c) * N + i / c]))
        .collect()
}

#[test]
fn encoders_agree_with_the_module() {
    let (net, file) = (network(), Fixture::open("droid/encoders.safetensors"));
    let (fmap, hidden, context) = (
        file.floats("fmap").0,
        file.floats("hidden").0,
        file.floats("context").0,
    );
    for (i, image) in images().iter().enumerate() {
        let part = |all: &[f32]| all[i * WIDTH * N..][..WIDTH * N].to_vec();
        agree(
            "fmap",
            &values(net.features(image).unwrap()),
            &part(&fmap),
            3e-5,
        );
        let [h, c] = net.state(image).unwrap();
        agree("hidden", &values(h), &part(&hidden), 3e-5);
        agree("context", &values(c), &part(&context), 3e-5);
    }
}

/// The inputs of the update fixture: hidden, context, correlation, motion.
fn inputs(edges: usize) -> [Tensor<4>; 4] {
    [
        ("hidden", 0.0, 0.9, WIDTH),
        ("context", 0.5, 0.5, WIDTH),
        ("corr", 0.0, 4.0, 196),
        ("motion", 0.0, 6.0, 4),
    ]
    .map(|(name, offset, scale, c)| {
        let values = formula_input(&format!("input/droid/{name}"), offset, scale, edges * c * N);
        tensor(values, [edges, c, H, W], &cpu())
    })
}

#[test]
fn an_update_agrees_with_the_module() {
    let (net, file) = (network(), Fixture::open("droid/update_step.safetensors"));
    let sources = file.indices("ii");
    let [hidden, context, corr, motion] = inputs(sources.len());
    let context = net.gru.context(context);
    let update = &net.net.update;
    let advanced = |motion| {
        update.advance(
            &net.gru,
            hidden.clone(),
            context.clone(),
            corr.clone(),
            motion,
        )
    };
    let after = advanced(Some(motion));
    let weights = update.weight(after.clone());
    let (delta, weight) = (values(update.delta(after.clone())), values(weights.clone()));
    agree(
        "delta",
        &components_last(&delta, 2),
        &file.floats("delta").0,
        3e-5,
    );
    agree(
        "weight",
        &components_last(&weight, 2),
        &file.floats("weight").0,
        3e-5,
    );
    let first = values(after.clone().narrow(0, 0, 2));
    agree("hidden", &first, &file.floats("hidden_out").0, 3e-5);

    let mut groups = sources.clone();
    groups.sort_unstable();
    groups.dedup();
    let mut still = vec![0.0; sources.len() * N];
    let mut eta = Vec::new();
    for group in groups {
        let at: Vec<usize> = (0..sources.len())
            .filter(|&e| sources[e] == group)
            .collect();
        let of = |all: &Tensor<4>| {
            let parts = at.iter().map(|&e| all.clone().narrow(0, e, 1));
            Tensor::cat(parts.collect(), 0)
        };
        let (hidden, weight) = (of(&after), of(&weights));
        let n = at.len() as f32;
        let shared = net
            .net
            .update
            .agg
            .of_mean(update.agg.sum_of(hidden.clone()) / n);
        eta.extend(values(update.agg.eta(shared)));
        let head = &update.agg_motion;
        let edges = head.edges(hidden, weight);
        let together = head.together(edges.clone().sum_dim(0) / n);
        let m = values(head.still(edges, together));
        for (k, &e) in at.iter().enumerate() {
            still[e * N..][..N].copy_from_slice(&m[k * N..][..N]);
        }
    }
    agree("eta", &eta, &file.floats("eta").0, 3e-5);
    agree("m", &still, &file.floats("m").0, 3e-5);
    let weight = components_last(&weight, 2);
    let weighted: Vec<f32> = weight
        .iter()
        .zip(0..)
        .map(|(w, i)| w * still[i / 2])
        .collect();
    agree("m * weight", &weighted, &file.floats("weighted").0, 3e-5);

    // as the motion filter does it
    let after = advanced(None);
    let c: Vec<f32> = values(after.clone())
        .chunks(WIDTH * N)
        .flat_map(|edge| edge.chunks(N).step_by(9).flatten())
        .copied()
        .collect();
    agree(
        "alone, hidden",
        &c,
        &file.floats("nograph_hidden_out_strided").0,
        3e-5,
    );
    let last = |x| components_last(&values(x), 2);
    agree(
        "alone, delta",
        &last(update.delta(after.clone())),
        &file.floats("nograph_delta").0,
        3e-5,
    );
    agree(
        "alone, weight",
        &last(update.weight(after)),
        &file.floats("nograph_weight").0,
        3e-5,
    );
}
