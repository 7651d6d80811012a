//! The parts against upstream's modules with weights by the formula, and what a caller does not see
//! of clips.

use super::memory::{Memories, Rotations};
use super::*;
use crate::cpu;
use crate::fixture::{Fixture, assert_close, assert_near, assert_same_tensors, every};
use crate::sam::{PointPrompt, Prompt};
use m4_testkit::{FormulaWeights, formula_input};
use std::sync::LazyLock;
use tempfile::TempDir;

pub const TINY: &str = include_str!("../../../../fixtures/sam2/tiny.keys.txt");
pub const LIMIT: f64 = 1e-4;

pub fn loaded(weights: &FormulaWeights, side: usize) -> Sam2 {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("weights.safetensors");
    weights.write(&path);
    Sam2::load(&path, cpu()).unwrap().with_side(side).unwrap()
}

/// The tiny size for images of 256 by 256 pixels.
fn tiny() -> &'static Sam2 {
    static NET: LazyLock<Sam2> = LazyLock::new(|| loaded(&FormulaWeights::of_keys(TINY), 256));
    &NET
}

fn input<const D: usize>(key: &str, scale: f64, shape: [usize; D]) -> Tensor<D> {
    let values = formula_input(
        &format!("input/sam2/{key}"),
        0.0,
        scale,
        shape.iter().product(),
    );
    tensor(values, shape, &cpu())
}

/// Some channels, rows and columns of a map `[h, w, c]`, as many as the fixture has: `[c, h, w]`.
#[track_caller]
pub fn assert_map(map: Tensor<3>, fixture: &Fixture, name: &str, limit: f64) {
    let (want, shape) = fixture.floats(name);
    let shape = &shape[shape.len() - 3..];
    let [h, w, c] = map.dims();
    let steps = [c / shape[0], h / shape[1], w / shape[2]];
    let values: Vec<f32> = map.try_into_vec_as().unwrap();
    let at = |i: usize| {
        let (k, y, x) = (
            i / (shape[1] * shape[2]),
            i / shape[2] % shape[1],
            i % shape[2],
        );
        values[(y * steps[1] * w + x * steps[2]) * c + k * steps[0]]
    };
    let got: Vec<f32> = (0..want.len()).map(at).collect();
    assert_close(name, &got, &want, limit);
}

#[track_caller]
pub fn assert_numbers(got: &[f32], fixture: &Fixture, name: &str) {
    assert_close(name, got, &fixture.floats(name).0, LIMIT);
}

/// Upstream counts pixels from 0.
pub fn point(at: &[f32], on_object: bool) -> PointPrompt {
    PointPrompt {
        at_px: [at[0] + 0.5, at[1] + 0.5],
        on_object,
    }
}

#[test]
fn all_sizes_have_the_published_tensors() {
    let keys = [
        (TINY, Sam2Size::Tiny, 471),
        (
            include_str!("../../../../fixtures/sam2/small.keys.txt"),
            Sam2Size::Small,
            519,
        ),
        (
            include_str!("../../../../fixtures/sam2/base_plus.keys.txt"),
            Sam2Size::BasePlus,
            615,
        ),
        (
            include_str!("../../../../fixtures/sam2/large.keys.txt"),
            Sam2Size::Large,
            903,
        ),
    ];
    for (keys, size, count) in keys {
        assert_eq!(keys.lines().count(), count);
        assert_same_tensors(
            &Net::new(&size.config(), &cpu()),
            keys,
            &renames(),
            unneeded,
        );
        let shapes = crate::fixture::renamed(keys, &renames());
        assert_eq!(Sam2Size::of(&shapes), Some(size));
    }
}

#[test]
fn blocks_agree_with_the_module() {
    let fixture = Fixture::open("sam2/unit_hiera_blocks.safetensors");
    let trunk = &tiny().net.image_encoder.trunk;
    for (i, kind, shape) in [
        (0, "window8", [1, 20, 12, 96]),
        (3, "pool", [1, 18, 22, 192]),
        (4, "window14", [1, 16, 18, 384]),
        (5, "global", [1, 8, 10, 384]),
        (10, "pool14", [1, 16, 20, 384]),
    ] {
        let name = format!("block{i}_{kind}");
        let out = trunk.blocks[i].forward(input(&name, 1.0, shape));
        let [_, h, w, c] = out.dims();
        let out = every(out.reshape([h * w, c]), 4).reshape([1, h, w, c / 4]);
        assert_near(out, &fixture, &format!("{name}_out_strided"), LIMIT);
    }
    for [h, w] in [[64, 64], [32, 48]] {
        let positions = trunk.positions([h, w]).reshape([h * w, 96]);
        let positions = every(positions, 16).reshape([1, h, w, 6]);
        assert_near(
            positions,
            &fixture,
            &format!("pos_embed_{h}x{w}_strided"),
            LIMIT,
        );
    }
}

/// The tokens of points, `[2, n, 256]`, after which one is that is no place.
fn sparse(fixture: &Fixture, labels: &str) -> Tensor<3> {
    let encoder = &tiny().net.prompt_encoder;
    let (points, _) = fixture.floats("points");
    let labels = fixture.whole(labels);
    let token = |i: usize| match labels[i] {
        -1 => encoder.nowhere(),
        kind => encoder.place(
            [0, 1].map(|k| (points[2 * i + k] + 0.5) / 256.0),
            kind as usize,
        ),
    };
    let of_one = |k: usize| {
        let mut tokens: Vec<Tensor<2>> = (3 * k..3 * k + 3).map(token).collect();
        tokens.push(encoder.nowhere());
        Tensor::cat(tokens, 0)
    };
    Tensor::stack(vec![of_one(0), of_one(1)], 0)
}

#[test]
fn prompts_agree_with_the_module() {
    let fixture = Fixture::open("sam2/unit_prompt_encoder.safetensors");
    let encoder = &tiny().net.prompt_encoder;
    assert_near(sparse(&fixture, "labels"), &fixture, "sparse", LIMIT);
    assert_near(
        sparse(&fixture, "labels_box"),
        &fixture,
        "sparse_box",
        LIMIT,
    );
    let strided = |x: Tensor<4>| {
        x.reshape([2, 32, 8, 16, 16])
            .narrow(2, 0, 1)
            .squeeze_dim::<4>(2)
    };
    let dense = encoder.mask(Some(input("pe_mask", 8.0, [2, 1, 64, 64])));
    assert_near(strided(dense), &fixture, "dense_mask_strided", LIMIT);
    let dense = encoder.mask(None).expand([2, 256, 16, 16]);
    assert_near(strided(dense), &fixture, "dense_nomask_strided", LIMIT);
    let places = tiny().tables.places.clone().reshape([16, 16, 256]);
    assert_map(places, &fixture, "image_pe_strided", LIMIT);
}

#[test]
fn the_decoder_agrees_with_the_module() {
    let fixture = Fixture::open("sam2/unit_mask_decoder.safetensors");
    let net = tiny();
    let last = |x: Tensor<4>| x.permute([0, 2, 3, 1]);
    let map = last(input("md_emb", 1.0, [2, 256, 16, 16])).reshape([2, 256, 256]);
    let fine = [
        last(input("md_s1", 1.0, [2, 64, 32, 32])),
        last(input("md_s0", 1.0, [2, 32, 64, 64])),
    ];
    let prompts = sparse(
        &Fixture::open("sam2/unit_prompt_encoder.safetensors"),
        "labels",
    );
    assert_near(prompts.clone(), &fixture, "sparse", LIMIT);
    let mask_embedding = net.net.prompt_encoder.mask(None).reshape([1, 1, 256]);
    let decoder = &net.net.mask_decoder;
    let (tokens, pixels) = decoder.transformed(
        map.clone() + mask_embedding,
        &net.tables.places,
        prompts.clone(),
    );
    assert_near(tokens, &fixture, "transformer_tokens", LIMIT);
    let pixels = every(pixels.reshape([512, 256]), 8).reshape([2, 256, 32]);
    assert_near(pixels, &fixture, "transformer_image_strided", LIMIT);

    let features = Features {
        map: map.clone(),
        fine,
    };
    let decoded = net.decoded(map, &features, prompts, None);
    let steps = |x: Tensor<4>, step: usize| {
        let [b, n, h, w] = x.dims();
        let rows = x.reshape([b, n, h / step, step, w]).narrow(3, 0, 1);
        let both = rows
            .reshape([b, n, h / step, w / step, step])
            .narrow(4, 0, 1);
        both.reshape([b, n, h / step, w / step])
    };
    assert_near(
        steps(decoded.masks.clone(), 4),
        &fixture,
        "all4_masks_strided",
        LIMIT,
    );
    assert_near(decoded.iou.clone(), &fixture, "all4_iou", LIMIT);
    let three = decoded.masks.clone().narrow(1, 1, 3);
    assert_near(steps(three, 2), &fixture, "multi_masks", LIMIT);
    assert_near(
        decoded.iou.clone().narrow(1, 1, 3),
        &fixture,
        "multi_iou",
        LIMIT,
    );
    assert_near(
        decoded.tokens.clone().narrow(1, 1, 3),
        &fixture,
        "multi_tokens",
        LIMIT,
    );
    assert_near(
        decoded.tokens.clone().narrow(1, 0, 1),
        &fixture,
        "single_tokens",
        LIMIT,
    );
    for name in ["multi_object_score", "single_object_score"] {
        assert_near(decoded.score.clone(), &fixture, name, LIMIT);
    }
    let stability = numbers(recall::stability(&decoded.masks)).unwrap();
    assert_numbers(&stability, &fixture, "stability_single");
    let iou = numbers(decoded.iou).unwrap();
    let chosen: Vec<usize> = (0..2)
        .map(|i| recall::chosen(&iou[4 * i..][..4], false, stability[i]))
        .collect();
    let one = |i: usize| {
        decoded
            .masks
            .clone()
            .narrow(0, i, 1)
            .narrow(1, chosen[i], 1)
    };
    assert_near(
        Tensor::cat(vec![one(0), one(1)], 0),
        &fixture,
        "single_masks",
        LIMIT,
    );
    let single: Vec<f32> = (0..2).map(|i| iou[4 * i + chosen[i]]).collect();
    assert_numbers(&single, &fixture, "single_iou");
}

/// Neighbouring channels as pairs, after what they are here: all first ones, then all second ones;
/// or back.
fn paired(x: Tensor<2>, back: bool) -> Tensor<2> {
    let [n, c] = x.dims();
    let [a, b] = if back { [2, c / 2] } else { [c / 2, 2] };
    x.reshape([n, a, b]).swap_dims(1, 2).reshape([n, c])
}

#[test]
fn memory_attention_agrees_with_the_module() {
    let fixture = Fixture::open("sam2/unit_memory_attention.safetensors");
    let net = tiny();
    let rotations = Rotations::new(16, &cpu(), DType::F32);
    let q = paired(input("rope_q", 1.0, [256, 256]), false).unsqueeze_dim(0);
    let turned = paired(rotations.turn(q).squeeze_dim(0), true);
    let turned = turned
        .reshape([32, 8, 256])
        .narrow(1, 0, 1)
        .squeeze_dim::<2>(1);
    assert_near(turned, &fixture, "rope_rotated_q_strided", LIMIT);

    let curr: Tensor<3> = input("ma_curr", 1.0, [1, 256, 256]);
    let places = input("ma_cpos", 1.0, [1, 256, 256]);
    let values: Tensor<3> = input("ma_mem", 1.0, [1, 776, 64]);
    let memories = Memories {
        keys: values.clone() + input("ma_mpos", 1.0, [1, 776, 64]),
        values,
        placed: 768,
    };
    let attention = &net.net.memory_attention;
    let layer = &attention.layers[0];
    let alone: Tensor<3> = input("rope_q", 1.0, [1, 256, 256]);
    let others: Tensor<3> = input("rope_k", 1.0, [1, 516, 64]);
    let others = Memories {
        values: others.clone(),
        keys: others,
        placed: 512,
    };
    let among = layer.self_attn.among(alone.clone(), &rotations);
    assert_near(
        every(among.squeeze_dim(0), 8),
        &fixture,
        "self_attn_strided",
        LIMIT,
    );
    let to = layer.cross_attn_image.to(alone, &others, &rotations);
    assert_near(
        every(to.squeeze_dim(0), 8),
        &fixture,
        "cross_attn_strided",
        LIMIT,
    );
    let begun = attention.begun(curr, &places, &rotations);
    let out = attention.forward(begun, &memories, &rotations);
    assert_near(every(out.squeeze_dim(0), 4), &fixture, "out_strided", LIMIT);
}

#[test]
fn objects_in_one_batch_equal_single_objects() {
    let net = tiny();
    let rotations = &net.tables.rotations;
    let attention = &net.net.memory_attention;
    let begun = attention.begun(
        input("ma_curr", 1.0, [1, 256, 256]),
        &net.tables.sine,
        rotations,
    );
    let both = Memories {
        values: input("ma_mem", 1.0, [2, 776, 64]),
        keys: input("ma_mpos", 1.0, [2, 776, 64]),
        placed: 768,
    };
    let together = attention.forward(begun.clone(), &both, rotations);
    for i in 0..2 {
        let one = Memories {
            values: both.values.clone().narrow(0, i, 1),
            keys: both.keys.clone().narrow(0, i, 1),
            placed: 768,
        };
        let alone = numbers(attention.forward(begun.clone(), &one, rotations)).unwrap();
        let got = numbers(together.clone().narrow(0, i, 1)).unwrap();
        assert_close("one of two", &got, &alone, 1e-5);
    }
}

#[test]
fn the_memory_encoder_agrees_with_the_module() {
    let fixture = Fixture::open("sam2/unit_memory_encoder.safetensors");
    let net = tiny();
    let mask: Tensor<4> = input("me_mask", 10.0, [1, 1, 256, 256]);
    let map: Tensor<4> = input("me_feat", 1.0, [1, 256, 16, 16]);
    let encoder = &net.net.memory_encoder;
    let smaller = encoder
        .mask_downsampler
        .forward(mask.clone())
        .squeeze_dim(0);
    assert_map(smaller, &fixture, "mask_downsampled_strided", LIMIT);
    let memory = encoder.forward(map.permute([0, 2, 3, 1]), mask);
    assert_map(memory.squeeze_dim(0), &fixture, "features", LIMIT);
    let places = net.tables.memory_sine.clone().reshape([16, 16, 64]);
    assert_map(places, &fixture, "pos", LIMIT);
}

#[test]
fn an_image_of_the_published_side_agrees_with_the_module() {
    let fixture = Fixture::open("sam2/image_1024_tiny.safetensors");
    let net = loaded(&FormulaWeights::of_keys(TINY), 1024);
    let bytes = fixture.bytes("image_u8_128");
    let image = RgbImage::from_fn(1024, 1024, |x, y| {
        let at = ((y / 8) * 128 + x / 8) * 3;
        [bytes[at], bytes[at + 1], bytes[at + 2]]
    });
    let features = net.encode(&image).unwrap();
    assert_map(
        net.unremembered(&features).reshape([64, 64, 256]),
        &fixture,
        "image_embed_strided",
        1e-3,
    );
    let [s1, s0] = features.fine.clone().map(|map| map.squeeze_dim::<3>(0));
    assert_map(s0, &fixture, "feat_s0_strided", 1e-3);
    assert_map(s1, &fixture, "feat_s1_strided", 1e-3);
    let at = fixture.doubles("point");
    let prompt = Prompt {
        points: vec![point(&[at[0] as f32, at[1] as f32], true)],
        ..Prompt::default()
    };
    let tokens =
        prompts::tokens(&net.net.prompt_encoder, &prompt, (1024, 1024), net.side).unsqueeze_dim(0);
    let decoded = net.decoded(net.unremembered(&features), &features, tokens, None);
    let strided = |i: usize| -> Vec<f32> {
        let values = numbers(decoded.masks.clone().narrow(1, i, 1)).unwrap();
        (0..32 * 32)
            .map(|k| values[k / 32 * 8 * 256 + k % 32 * 8])
            .collect()
    };
    let near = |got: &[f32], name: &str| assert_close(name, got, &fixture.floats(name).0, 1e-3);
    let iou = numbers(decoded.iou.clone()).unwrap();
    let three: Vec<f32> = (1..4).flat_map(strided).collect();
    near(&three, "multi_low_strided");
    near(&iou[1..], "multi_iou");
    let stability = numbers(recall::stability(&decoded.masks)).unwrap()[0];
    let chosen = recall::chosen(&iou, false, stability);
    near(&strided(chosen), "single_low_strided");
    near(&[iou[chosen]], "single_iou");
}
