//! The networks on a GPU, or on a software Vulkan driver (lavapipe), against the fixtures and
//! against the processor.
#![cfg(feature = "gpu")]
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use cubecl::device::{WgpuBackend, WgpuDevice, WgpuDeviceKind};
use cubecl::wgpu::{AutoGraphicsApi, RuntimeOptions, try_init_setup};
use m4_core::{Camera, DepthMap, Intrinsics, Plane, RgbImage, Silent};
use m4_nets::droid::{EdgeUpdate, MemoryOptions, Storage};
use m4_nets::sam2::{Direction, ObjectMask, VideoPredictor, VideoSize};
use m4_nets::{
    ClipError, Compute, DepthAnything, Device, DroidMemory, DroidNet, MoGe, MoGeOptions, MobileSam,
    PointPrompt, PointQuery, PosedClip, Prompt, Raft, Sam2, Tapip3d, Tapip3dOptions, UniDepth, cpu,
};
use m4_testkit::{Fixture, FormulaWeights, Need, assert_close, skip};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, LazyLock};
use tempfile::TempDir;

/// The GPU or the software driver, started once, and whether it is software.
static DEVICE: LazyLock<Result<(Device, bool), String>> = LazyLock::new(|| {
    let mut why = String::new();
    for kind in [
        WgpuDeviceKind::DiscreteGpu(0),
        WgpuDeviceKind::IntegratedGpu(0),
        WgpuDeviceKind::VirtualGpu(0),
        WgpuDeviceKind::Cpu,
    ] {
        let software = matches!(kind, WgpuDeviceKind::Cpu);
        let device = WgpuDevice::new(kind).on(WgpuBackend::Vulkan);
        match try_init_setup::<AutoGraphicsApi>(&device, RuntimeOptions::default()) {
            Ok(_) => return Ok((m4_nets::gpu(device), software)),
            Err(error) => why = error.to_string(),
        }
    }
    Err(why)
});

/// The GPU or the software driver; `None`, and said so, without one.
#[track_caller]
fn gpu() -> Option<Device> {
    match &*DEVICE {
        Ok((device, _)) => Some(device.clone()),
        Err(why) => {
            skip(Need::Vulkan, why);
            None
        }
    }
}

/// The GPU; `None`, and said so, with a software driver, on which the largest networks take three
/// to ten minutes each.
#[track_caller]
fn fast_gpu() -> Option<Device> {
    let device = gpu()?;
    if matches!(&*DEVICE, Ok((_, true))) {
        skip(Need::Gpu, "the only Vulkan device is a software driver");
        return None;
    }
    Some(device)
}

/// A checkpoint with weights by the formula; the folder goes with it.
fn checkpoint(weights: &FormulaWeights) -> (TempDir, PathBuf) {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("weights.safetensors");
    weights.write(&path);
    (folder, path)
}

/// The GPU in half precision, if it has that; else the test is listed as skipped in part.
#[track_caller]
fn half(gpu: Device) -> Option<Compute> {
    let compute = Compute::half(gpu);
    if compute.is_half() {
        return Some(compute);
    }
    skip(Need::HalfPrecision, "32 bits are tested");
    None
}

fn pattern(w: usize, h: usize, moved: f32) -> RgbImage {
    Plane::from_fn(w, h, |x, y| {
        let (x, y) = (x as f32 + moved, y as f32);
        let wave =
            |a: f32, b: f32| (127.0 + 60.0 * (a * x).sin() + 60.0 * (b * y + 0.03 * x).cos()) as u8;
        [wave(0.21, 0.13), wave(0.09, 0.31), wave(0.37, 0.05)]
    })
}

const RAFT: &str = include_str!("../../../fixtures/raft/keys.txt");

/// Against the fixture, in both precisions; one iteration reaches every kernel.
///
/// In half precision, single cells of the flow at an eighth of the size differ by 2.3 % of the
/// largest; the full flow, which averages nine of them, differs by less than 2 %.
#[test]
fn raft_agrees_with_the_module() {
    let Some(gpu) = gpu() else {
        return;
    };
    let (_folder, path) = checkpoint(&FormulaWeights::of_keys(RAFT));
    let file = Fixture::open("raft/flow.safetensors");
    let check = |on: Compute, [low, full]: [f64; 2]| {
        let net = Raft::load(&path, on).unwrap();
        let [a, b] = ["image1", "image2"].map(|name| net.encode(&file.image(name)).unwrap());
        let [forward, _] = net.flow_both(&a, &b, 1, None).unwrap();
        for (name, flow, limit) in [
            ("flow_low_1", &forward.low, low),
            ("flow_up_1", &forward.flow, full),
        ] {
            assert_close(
                name,
                &[&flow.u[..], &flow.v].concat(),
                &file.floats(name).0,
                limit,
            );
        }
    };
    check(gpu.clone().into(), [1e-4; 2]);
    if let Some(half) = half(gpu) {
        check(half, [4e-2, 2e-2]);
    }
}

/// What an update says, on a device.
fn droid(path: &std::path::Path, on: impl Into<Compute>) -> (f64, Vec<Vec<f32>>) {
    let net = Arc::new(DroidNet::load(path, on).unwrap());
    let options = MemoryOptions {
        budget_bytes: 1 << 28,
        storage: Storage::F32,
        scratch: std::env::temp_dir(),
    };
    let mut memory = DroidMemory::new(
        net,
        options,
        Box::new(|frame| Ok(pattern(128, 128, 3.0 * frame as f32))),
    );
    let motion = memory.motion_px(0, 1).unwrap();
    let n = 16 * 16;
    let at: [Vec<f32>; 2] = [
        (0..n).map(|i| (i % 16) as f32 + 0.3).collect(),
        (0..n).map(|i| (i / 16) as f32 - 0.2).collect(),
    ];
    let mut out = Vec::new();
    for id in 0..2 {
        memory.enter(id, 0, 1 + id as usize);
    }
    for _ in 0..2 {
        let mut targets = [at.clone(), at.clone()];
        let mut weights: [[Vec<f32>; 2]; 2] =
            std::array::from_fn(|_| std::array::from_fn(|_| vec![0.0; n]));
        let mut still = [vec![0.0; n], vec![0.0; n]];
        let mut edges: Vec<EdgeUpdate<'_>> = Vec::new();
        for (id, ((target_px, weight), static_confidence)) in
            (0..).zip(targets.iter_mut().zip(&mut weights).zip(&mut still))
        {
            edges.push(EdgeUpdate {
                id,
                projected_px: [&at[0], &at[1]],
                target_px,
                weight,
                static_confidence,
            });
        }
        let eta = memory.revise_source(0, &mut edges).unwrap();
        out = [
            targets.concat(),
            weights.concat(),
            still.to_vec(),
            vec![eta],
        ]
        .concat();
    }
    (motion, out)
}

#[test]
fn tracking_network_matches_the_cpu() {
    let Some(gpu) = gpu() else {
        return;
    };
    let (_folder, path) = checkpoint(&FormulaWeights::of_keys(include_str!(
        "../../../fixtures/droid/keys.txt"
    )));
    let (on_gpu, on_cpu) = (droid(&path, &gpu), droid(&path, cpu()));
    assert!(
        (on_gpu.0 / on_cpu.0 - 1.0).abs() < 1e-4,
        "{} {}",
        on_gpu.0,
        on_cpu.0
    );
    for (k, (on_gpu, on_cpu)) in on_gpu.1.iter().zip(&on_cpu.1).enumerate() {
        assert_close(&format!("plane {k}"), on_gpu, on_cpu, 1e-4);
    }
    if let Some(compute) = half(gpu) {
        let half = droid(&path, compute);
        for (k, (half, on_cpu)) in half.1.iter().zip(&on_cpu.1).enumerate() {
            assert_close(&format!("plane {k} in half precision"), half, on_cpu, 2e-2);
        }
    }
}

#[test]
fn networks_of_depth_say_the_same_as_on_the_processor() {
    let Some(gpu) = fast_gpu() else {
        return;
    };
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("weights.safetensors");

    // the longer side becomes 768 pixels: a strip has fewer of them
    let image = pattern(56, 4, 0.0);
    let keys = include_str!("../../../fixtures/depth_anything_v1/vits.keys.txt");
    let weights =
        FormulaWeights::of_keys(keys).with("depth_head.scratch.output_conv2.2.bias", &[2.5]);
    weights.write(&path);
    let disparity = |on: &Device| {
        DepthAnything::load(&path, on)
            .unwrap()
            .disparity(&image)
            .unwrap()
    };
    let (on_gpu, on_cpu) = (disparity(&gpu), disparity(&cpu()));
    assert_close("Depth-Anything", on_gpu.data(), on_cpu.data(), 1e-4);

    let image = pattern(56, 42, 0.0);
    let keys = include_str!("../../../fixtures/moge2/vits_normal.keys.txt");
    let weights = FormulaWeights::of_keys(keys)
        .with("mask_head.output_blocks.4.bias", &[0.3])
        .scaled("points_head.output_blocks.4.weight", 0.3);
    weights.write(&path);
    let options = MoGeOptions {
        tokens: Some(24),
        known_focal_px: Some(70.0),
    };
    let map = |on: &Device| {
        MoGe::load(&path, on)
            .unwrap()
            .infer(&image, &options)
            .unwrap()
    };
    let (on_gpu, on_cpu) = (map(&gpu), map(&cpu()));
    let differ = on_gpu
        .mask
        .data()
        .iter()
        .zip(on_cpu.mask.data())
        .filter(|(a, b)| a != b)
        .count();
    assert!(
        differ * 500 < on_gpu.mask.data().len(),
        "{differ} pixels of the mask"
    );
    let common_depths = |z: &Plane<f32>| -> Vec<f32> {
        let both = on_gpu.mask.data().iter().zip(on_cpu.mask.data());
        z.data()
            .iter()
            .zip(both)
            .filter(|(_, (a, b))| **a && **b)
            .map(|(z, _)| *z)
            .collect()
    };
    assert_close(
        "MoGe-2",
        &common_depths(&on_gpu.depth_m),
        &common_depths(&on_cpu.depth_m),
        1e-3,
    );
}

#[test]
fn unidepth_matches_the_cpu() {
    let Some(gpu) = gpu() else {
        return;
    };
    let (_folder, path) = checkpoint(&FormulaWeights::of_keys(include_str!(
        "../../../fixtures/unidepth_v2/formula.keys.txt"
    )));
    let image = pattern(84, 56, 0.0);
    let map = |on: &Device| {
        UniDepth::load(&path, on)
            .unwrap()
            .depth_by_patches(&image, 48)
            .unwrap()
    };
    let (on_gpu, on_cpu) = (map(&gpu), map(&cpu()));
    assert_close(
        "UniDepth",
        on_gpu.depth_m.data(),
        on_cpu.depth_m.data(),
        1e-4,
    );
    assert!((on_gpu.camera.fx / on_cpu.camera.fx - 1.0).abs() < 1e-4);
}

#[test]
fn mobile_sam_matches_the_cpu() {
    let Some(gpu) = fast_gpu() else {
        return;
    };
    let (_folder, path) = checkpoint(&FormulaWeights::of_keys(include_str!(
        "../../../fixtures/mobile_sam/keys.txt"
    )));
    let image = pattern(96, 64, 0.0);
    let prompt = Prompt {
        points: vec![PointPrompt {
            at_px: [40.0, 30.0],
            on_object: true,
        }],
        box_px: None,
        mask_logits: None,
    };
    let logits = |on: &Device| {
        let net = MobileSam::load(&path, on).unwrap();
        let embedding = net.encode(&image).unwrap();
        let masks = net.masks(&embedding, &prompt).unwrap();
        masks[0].logits_at((96, 64)).data().to_vec()
    };
    assert_close("MobileSAM", &logits(&gpu), &logits(&cpu()), 1e-3);
}

/// The masks of an object that two points show, in two frames, as logits.
fn sam2(path: &std::path::Path, on: impl Into<Compute>) -> Vec<Vec<f32>> {
    let net = Arc::new(Sam2::load(path, on).unwrap().with_side(64).unwrap());
    let point = |at_px: [f32; 2], on_object| PointPrompt { at_px, on_object };
    let points = vec![point([40.0, 30.0], true), point([20.0, 70.0], false)];
    let clip = VideoSize {
        frames: 2,
        width: 128,
        height: 96,
    };
    let images = Box::new(|i: usize| Ok(pattern(128, 96, 2.0 * i as f32)));
    let mut predictor = VideoPredictor::new(net, clip, images, 0).unwrap();
    predictor
        .show(
            0,
            1,
            &Prompt {
                points,
                ..Prompt::default()
            },
        )
        .unwrap();
    let mut frames = Vec::new();
    let keep = |_, masks: &BTreeMap<u32, ObjectMask>| {
        frames.push(
            masks
                .values()
                .flat_map(|mask| mask.logits.data().to_vec())
                .collect(),
        );
    };
    predictor
        .follow(0..=1, Direction::Forward, &Silent, keep)
        .unwrap();
    frames
}

#[test]
fn sam2_matches_the_cpu() {
    let Some(gpu) = gpu() else {
        return;
    };
    // objects are there beyond doubt
    let weights = FormulaWeights::of_keys(include_str!("../../../fixtures/sam2/tiny.keys.txt"))
        .with("sam_mask_decoder.pred_obj_score_head.layers.2.bias", &[5.0]);
    let (_folder, path) = checkpoint(&weights);
    let (on_gpu, on_cpu) = (sam2(&path, &gpu), sam2(&path, cpu()));
    for (k, (on_gpu, on_cpu)) in on_gpu.iter().zip(&on_cpu).enumerate() {
        assert_close(&format!("frame {k}"), on_gpu, on_cpu, [1e-4, 3e-4][k]);
    }
    if let Some(compute) = half(gpu) {
        let half = sam2(&path, compute);
        assert_close("frame 0 in half precision", &half[0], &on_cpu[0], 2e-2);
        // which of three readings is taken may be a close race from then on
        assert!(half[1].iter().all(|x| x.is_finite() && x.abs() < 100.0));
    }
}

/// A wavy wall, before a static camera.
struct Wall;

impl PosedClip for Wall {
    fn frames(&self) -> usize {
        3
    }

    fn image(&self, frame: usize) -> Result<RgbImage, ClipError> {
        Ok(pattern(256, 128, 2.0 * frame as f32))
    }

    fn depth(&self, frame: usize) -> Result<DepthMap, ClipError> {
        let z = |x: usize, y: usize| {
            3.0 + 0.3 * (0.05 * x as f32 + 0.1 * frame as f32).sin() + 0.004 * y as f32
        };
        Ok(Plane::from_fn(256, 128, z))
    }

    fn camera(&self, _frame: usize) -> Result<Camera, ClipError> {
        Ok(Camera {
            intrinsics: Intrinsics::centred(256, 128, 240.0),
            c2w: m4_core::Se3::identity(),
        })
    }
}

#[test]
fn points_are_followed_as_on_the_processor() {
    let Some(gpu) = fast_gpu() else {
        return;
    };
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("weights.safetensors");
    let config = include_str!("../../../fixtures/tapip3d/config.json");
    // a random network makes much of the highest frequencies of offsets: they are damped, as in its
    // fixture
    let damped = |s: usize| 0.5f32.powi(s.saturating_sub(4) as i32);
    let mut weights = FormulaWeights::of_keys(include_str!("../../../fixtures/tapip3d/keys.txt"))
        .scaled("point_updater.flow_head.weight", 0.005)
        .scaled_by("point_updater.input_transform.weight", |i| {
            (i % 711)
                .checked_sub(513 + 6)
                .map_or(1.0, |j| damped(j % 96 / 6))
        });
    for level in 0..4 {
        let name = format!("corr_processor.posenc_mlps.{level}.0.weight");
        weights = weights.scaled_by(&name, |j| {
            j.checked_sub(3).map_or(1.0, |j| damped(j % 48 / 3))
        });
    }
    weights.write_with(Some(("config", config)), &path);
    let queries: Vec<PointQuery> = (0..3)
        .map(|i| PointQuery {
            frame: i,
            world: [0.5 * i as f64 - 0.6, 0.1 * i as f64 - 0.2, 3.1],
        })
        .collect();
    let options = Tapip3dOptions {
        iterations: 1,
        support_grid: 1,
        ..Tapip3dOptions::at((256, 128))
    };
    let steps = |on: Compute| -> [Vec<f32>; 2] {
        let net = Tapip3d::load(&path, on).unwrap();
        let tracks = net.track(&Wall, &queries, &options, &Silent).unwrap();
        let at = tracks.world.chunks_exact(3).zip(&queries);
        let steps = at.flat_map(|(at, q)| {
            at.iter()
                .map(move |p| [0, 1, 2].map(|i| p[i] - q.world[i] as f32))
        });
        [steps.flatten().collect(), tracks.visibility]
    };
    let on_cpu = steps(cpu().into());
    let on_gpu = steps(gpu.clone().into());
    assert_close("steps", &on_gpu[0], &on_cpu[0], 2e-3);
    assert_close("visibility", &on_gpu[1], &on_cpu[1], 1e-3);
    if let Some(compute) = half(gpu) {
        let half = steps(compute);
        // 1.7e-2 was measured on lavapipe (docs/networks.md)
        assert_close("steps in half precision", &half[0], &on_cpu[0], 4e-2);
        assert_close("visibility in half precision", &half[1], &on_cpu[1], 2e-2);
    }
}
