//! Checkpoints are read strictly: exactly the published tensors, of their shapes.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use m4_nets::{
    DepthAnything, DroidNet, LoadError, MoGe, MobileSam, Raft, Sam2, Tapip3d, UniDepth, cpu,
};
use m4_testkit::FormulaWeights;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

type Load = fn(&Path) -> Result<(), LoadError>;

/// A change of a list of tensors.
enum Change {
    /// Without the lines that contain this.
    Without(&'static str),
    /// With this line.
    With(&'static str),
    /// With something else in the place of the first.
    Replace(&'static str, &'static str),
    /// Nothing but this line.
    Only(&'static str),
}
use Change::{Only, Replace, With, Without};

impl Change {
    fn of(&self, keys: &str) -> String {
        let changed: String = match *self {
            Without(part) => keys
                .lines()
                .filter(|line| !line.contains(part))
                .map(|line| format!("{line}\n"))
                .collect(),
            With(line) => format!("{keys}{line}\n"),
            Replace(from, to) => keys.replace(from, to),
            Only(line) => format!("{line}\n"),
        };
        assert_ne!(changed, keys);
        changed
    }
}

/// Writes a checkpoint of the tensors `keys`, and loads it.
fn load_keys(load: Load, keys: &str) -> Result<(), LoadError> {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("weights.safetensors");
    let config = include_str!("../../../fixtures/tapip3d/config.json");
    FormulaWeights::of_keys(keys).write_with(Some(("config", config)), &path);
    load(&path)
}

/// `keys` are accepted, with each `prefix` too; each change is refused with a message that contains
/// what stands beside it.
#[track_caller]
fn check(
    load: Load,
    keys: &str,
    prefixes: &[&str],
    accepted: &[Change],
    refused: &[(Change, &str)],
) {
    load_keys(load, keys).unwrap();
    for prefix in prefixes {
        let prefixed: String = keys
            .lines()
            .map(|line| format!("{prefix}{line}\n"))
            .collect();
        load_keys(load, &prefixed).unwrap();
    }
    for change in accepted {
        load_keys(load, &change.of(keys)).unwrap();
    }
    for (change, message) in refused {
        let error = load_keys(load, &change.of(keys)).unwrap_err();
        assert!(matches!(error, LoadError::OtherNetwork { .. }), "{error}");
        assert!(
            error.to_string().contains(message),
            "{error}, not {message}"
        );
    }
    let folder = TempDir::new().unwrap();
    let text = folder.path().join("text.pth");
    fs::write(&text, "no checkpoint at all").unwrap();
    assert!(matches!(load(&text), Err(LoadError::Unreadable { .. })));
    assert!(matches!(
        load(&folder.path().join("none.pth")),
        Err(LoadError::Missing { .. })
    ));
}

#[test]
fn depth_anything_is_read_strictly() {
    check(
        |path| DepthAnything::load(path, cpu()).map(drop),
        include_str!("../../../fixtures/depth_anything_v1/vits.keys.txt"),
        &[],
        &[],
        &[
            (
                Without("blocks.11.norm2.bias"),
                "1 tensors are missing (pretrained.blocks.11.norm2.",
            ),
            (Without("cls_token"), "pretrained.cls_token"),
            (
                With("pretrained.register_tokens 1 4 384"),
                "pretrained.register_tokens",
            ),
            (Only("pretrained.cls_token 1 1 1536"), "1024 of ViT-L"),
            // the width of a larger backbone and the head of the small one
            (
                Replace("cls_token 1 1 384", "cls_token 1 1 768"),
                "do not fit",
            ),
        ],
    );
}

#[test]
fn the_tracking_network_is_read_strictly() {
    check(
        |path| DroidNet::load(path, cpu()).map(drop),
        include_str!("../../../fixtures/droid/keys.txt"),
        &["module."],
        &[Without("agg_motion.conv4"), Without("agg_motion.eta")],
        &[
            (
                Without("update.agg.conv1.weight"),
                "1 tensors are missing (update.agg.conv1.weight)",
            ),
            (
                Without("update.agg.upmask.0.bias"),
                "1 tensors are missing (update.agg.upmask.bias)",
            ),
            (With("update.head.weight 2 2"), "update.head.weight"),
            (
                Replace("update.delta.2.weight 2", "update.delta.2.weight 4"),
                "do not fit",
            ),
        ],
    );
}

#[test]
fn mobile_sam_is_read_strictly() {
    check(
        |path| MobileSam::load(path, cpu()).map(drop),
        include_str!("../../../fixtures/mobile_sam/keys.txt"),
        &[],
        &[],
        &[
            (
                Without("no_mask_embed.weight"),
                "1 tensors are missing (prompt_encoder.no_mask_embed.weight)",
            ),
            (With("image_encoder.head2.weight 2 2"), "head2.weight"),
            (
                Replace(
                    "mask_decoder.mask_tokens.weight 4",
                    "mask_decoder.mask_tokens.weight 5",
                ),
                "mask_decoder.mask_tokens.weight",
            ),
        ],
    );
}

#[test]
fn moge_is_read_strictly() {
    check(
        |path| MoGe::load(path, cpu()).map(drop),
        include_str!("../../../fixtures/moge2/vits_normal.keys.txt"),
        &["model."],
        &[Without("normal_head")],
        &[
            (
                Without("neck.res_blocks.2.1.layers.5.bias"),
                "1 tensors are missing (neck.res_blocks.2.1.conv2.bias)",
            ),
            (With("head.weight 2 2"), "head.weight"),
            (Without("points_head"), "points_head"),
            (
                Without("output_projections.3"),
                "[2, 5, 8, 11] are to be tapped by 3 projections",
            ),
            (
                Only("encoder.backbone.cls_token 1 1 384"),
                "output_projections",
            ),
            // the first version of the network has other tensors
            (
                Only("backbone.cls_token 1 1 1024"),
                "encoder.backbone.cls_token",
            ),
        ],
    );
}

#[test]
fn raft_is_read_strictly() {
    check(
        |path| Raft::load(path, cpu()).map(drop),
        include_str!("../../../fixtures/raft/keys.txt"),
        &["module."],
        &[],
        &[
            (
                Without("cnet.norm1.running_var"),
                "1 tensors are missing (cnet.norm1.running_var)",
            ),
            (
                Without("cnet.layer2.0.downsample.1.weight"),
                "1 tensors are missing (cnet.layer2.0.downsample.norm.",
            ),
            (
                Without("gru.convq2.bias"),
                "1 tensors are missing (update_block.gru.convq2.bias)",
            ),
            (With("head.weight 2 2"), "head.weight"),
            (
                Replace("mask.2.bias 576", "mask.2.bias 575"),
                "mask.weights.bias",
            ),
        ],
    );
}

#[test]
fn sam2_is_read_strictly() {
    check(
        |path| Sam2::load(path, cpu()).map(drop),
        include_str!("../../../fixtures/sam2/tiny.keys.txt"),
        &["model."],
        &[],
        &[
            (
                Without("obj_ptr_tpos_proj.bias"),
                "1 tensors are missing (obj_ptr_tpos_proj.bias)",
            ),
            (
                With("memory_encoder.head.weight 2 2"),
                "memory_encoder.head.weight",
            ),
            (Only("fnet.conv1.weight 32 3 7 7"), "tensors are missing"),
        ],
    );
}

#[test]
fn unidepth_is_read_strictly() {
    check(
        |path| UniDepth::load(path, cpu()).map(drop),
        include_str!("../../../fixtures/unidepth_v2/formula.keys.txt"),
        &["module."],
        // neither of use here
        &[
            Without("pixel_encoder.register_tokens"),
            Without("pixel_decoder.depth_layer.confidence_mlp."),
        ],
        &[
            (
                Without("pixel_decoder.level_embeds"),
                "1 tensors are missing (pixel_decoder.level_embeds)",
            ),
            (
                Without("pixel_encoder.cls_token"),
                "1 tensors are missing (pixel_encoder.cls_token)",
            ),
            (
                Without("pixel_encoder.blocks."),
                "1 tensors are missing (pixel_encoder.blocks.3.",
            ),
            (
                Without("ups.2.up.3.bias"),
                "1 tensors are missing (pixel_decoder.depth_layer.ups.2.up_conv.bias)",
            ),
            (
                Without("global_token_adapter.input_adapters.1.1."),
                "2 tensors are missing",
            ),
            (With("head.weight 2 2"), "head.weight"),
            (
                Replace("level_embeds 4 128", "level_embeds 4 100"),
                "1 tensors do not fit",
            ),
            (
                Replace("to_depth.bias 1\n", "to_depth.bias 2\n"),
                "1 tensors do not fit",
            ),
        ],
    );
}

#[test]
fn tapip3d_is_read_strictly() {
    check(
        |path| Tapip3d::load(path, cpu()).map(drop),
        include_str!("../../../fixtures/tapip3d/keys.txt"),
        &[],
        &[],
        &[
            (Without("encoder.backbone.conv3.bias"), "conv3.bias"),
            (Without("point_updater.flow_head.bias"), "flow_head.bias"),
            (Without("time_emb"), "time_emb"),
            (
                With("point_updater.more.weight 2 2"),
                "point_updater.more.weight",
            ),
        ],
    );
}
