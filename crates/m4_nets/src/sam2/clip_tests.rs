//! Clips against upstream's video predictor with weights by the formula, and what a caller does not
//! see of them.

use super::tests::{LIMIT, TINY, assert_map, assert_numbers, loaded, point};
use super::*;
use crate::cpu;
use crate::fixture::Fixture;
use crate::sam::Prompt;
use m4_core::Silent;
use m4_testkit::FormulaWeights;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A frame of a clip: 64 by 64 pixels, each four times per side.
fn frame(fixture: &Fixture, i: usize) -> RgbImage {
    let bytes = fixture.bytes("frames_u8_64");
    RgbImage::from_fn(256, 256, |x, y| {
        let at = ((i * 64 + y / 4) * 64 + x / 4) * 3;
        [bytes[at], bytes[at + 1], bytes[at + 2]]
    })
}

#[track_caller]
fn assert_entry(
    predictor: &VideoPredictor<'_>,
    fixture: &Fixture,
    what: &str,
    [i, at]: [usize; 2],
) {
    let entry = predictor.objects[&(i as u32 + 1)].at(at).unwrap();
    let name = format!("{what}_obj{i}_f{at}");
    assert_numbers(entry.mask.logits.data(), fixture, &format!("{name}_mask"));
    assert_numbers(
        &numbers(entry.pointer.clone()).unwrap(),
        fixture,
        &format!("{name}_ptr"),
    );
    assert_numbers(&[entry.mask.score], fixture, &format!("{name}_score"));
    if what == "A" {
        let memory = entry.memory.clone().unwrap().reshape([16, 16, 64]);
        assert_map(memory, fixture, &format!("{name}_mem_strided"), LIMIT);
    }
}

#[track_caller]
fn assert_call(predictor: &VideoPredictor<'_>, fixture: &Fixture, name: &str, id: u32, at: usize) {
    let entry = predictor.objects[&id].at(at).unwrap();
    assert_numbers(&entry.mask.candidates, fixture, &format!("{name}_iou"));
    assert_numbers(&[entry.mask.score], fixture, &format!("{name}_score"));
}

/// Every `step`-th row and column of the masks of a frame in the clip's size.
fn sampled(masks: &BTreeMap<u32, ObjectMask>, step: usize) -> Vec<f32> {
    let of_one = |mask: &ObjectMask| {
        let plane = mask.logits_at((320, 192));
        let rows = (0..192).step_by(step).map(|y| plane.row(y).to_vec());
        rows.flat_map(|row| row.into_iter().step_by(step))
            .collect::<Vec<f32>>()
    };
    masks.values().flat_map(of_one).collect()
}

/// Shows two objects in the first frame, and follows them: passage A of the fixtures.
fn passage_a(fixture: &Arc<Fixture>, bias: f32) -> VideoPredictor<'static> {
    let weights = FormulaWeights::of_keys(TINY).with(
        "sam_mask_decoder.pred_obj_score_head.layers.2.bias",
        &[bias],
    );
    let net = Arc::new(loaded(&weights, 256));
    let clip = VideoSize {
        frames: 6,
        width: 320,
        height: 192,
    };
    let frames = Arc::clone(fixture);
    let images = Box::new(move |i: usize| Ok(frame(&frames, i)));
    let mut predictor = VideoPredictor::new(Arc::clone(&net), clip, images, 0).unwrap();

    let features = predictor.features(0).unwrap();
    let stages = net.net.image_encoder.trunk.forward(
        prompts::squared(&frame(fixture, 0), 256, &cpu()).unwrap(),
        net.tables.trunk.clone(),
    );
    for (i, stage) in stages.into_iter().enumerate() {
        assert_map(
            stage.squeeze_dim(0),
            fixture,
            &format!("trunk_stage{i}_strided"),
            LIMIT,
        );
    }
    let [s1, s0] = features.fine.clone().map(|map| map.squeeze_dim::<3>(0));
    assert_map(s0, fixture, "fpn_s0_strided", LIMIT);
    assert_map(s1, fixture, "fpn_s1_strided", LIMIT);
    assert_map(
        features.map.clone().reshape([16, 16, 256]),
        fixture,
        "fpn_s2_strided",
        LIMIT,
    );
    assert_map(
        net.tables.sine.clone().reshape([16, 16, 256]),
        fixture,
        "pos_s2_strided",
        LIMIT,
    );

    let (one, _) = fixture.floats("prompt_obj1");
    let (three, _) = fixture.floats("prompt_obj2");
    let prompt = |points| Prompt {
        points,
        ..Prompt::default()
    };
    let mask = predictor
        .show(0, 1, &prompt(vec![point(&one, true)]))
        .unwrap();
    let alone = BTreeMap::from([(1, mask)]);
    assert_numbers(&sampled(&alone, 8), fixture, "prompt1_video_mask_strided");
    let points = (0..3).map(|i| point(&three[2 * i..], i < 2)).collect();
    predictor.show(0, 2, &prompt(points)).unwrap();
    for (i, id) in [(0, 1), (1, 2)] {
        assert_call(&predictor, fixture, &format!("A_prompt_call{i}"), id, 0);
        let map = features.map.clone() + net.net.no_mem_embed.val();
        let name = format!("A_prompt_call{i}_pix_strided");
        assert_map(map.reshape([16, 16, 256]), fixture, &name, LIMIT);
    }

    let mut samples = Vec::new();
    let mut call = 0;
    for at in 0..6 {
        let keep = |_, masks: &_| samples.extend(sampled(masks, 16));
        predictor
            .follow(at..=at, Direction::Forward, &Silent, keep)
            .unwrap();
        for id in [1, 2] {
            if at > 0 {
                assert_call(&predictor, fixture, &format!("A_call{call}"), id, at);
                if call < 6 {
                    let recall = predictor.objects[&id].recall(at, Direction::Forward, 6);
                    let features = predictor.features(at).unwrap();
                    let map = net.recalled(net.begun(&features), &[recall], 6);
                    let name = format!("A_call{call}_pix_strided");
                    assert_map(map.reshape([16, 16, 256]), fixture, &name, LIMIT);
                }
                call += 1;
            }
            assert_entry(&predictor, fixture, "A", [id as usize - 1, at]);
        }
    }
    assert_numbers(&samples, fixture, "A_video_masks_strided");
    predictor
}

#[test]
fn a_clip_agrees_with_the_video_predictor() {
    let fixture = Arc::new(Fixture::open("sam2/video_256.safetensors"));
    let mut predictor = passage_a(&fixture, 1.0);

    let (place, _) = fixture.floats("prompt_obj3_point");
    let (corners, _) = fixture.floats("prompt_box3");
    let prompt = Prompt {
        points: vec![point(&place, true)],
        box_px: Some([0, 1, 2, 3].map(|i| corners[i] + 0.5)),
        mask_logits: None,
    };
    predictor.show(3, 3, &prompt).unwrap();
    assert_call(&predictor, &fixture, "B_prompt_call0", 3, 3);
    for (what, direction, frames) in [
        ("B", Direction::Forward, vec![3, 4, 5]),
        ("C", Direction::Backward, vec![3, 2, 1, 0]),
    ] {
        let (mut samples, mut call) = (Vec::new(), 0);
        for at in frames {
            let keep = |_, masks: &_| samples.extend(sampled(masks, 16));
            predictor.follow(at..=at, direction, &Silent, keep).unwrap();
            for id in [1, 2, 3] {
                if predictor.objects[&id].shown(at).is_none() {
                    assert_call(&predictor, &fixture, &format!("{what}_call{call}"), id, at);
                    call += 1;
                }
            }
        }
        assert_eq!(call, if what == "B" { 8 } else { 9 });
        assert_numbers(&samples, &fixture, &format!("{what}_video_masks_strided"));
    }
    for (i, at) in [0, 2]
        .into_iter()
        .flat_map(|i| [0, 2, 3, 5].map(|at| (i, at)))
    {
        assert_entry(&predictor, &fixture, "C", [i, at]);
    }

    let (place, _) = fixture.floats("prompt_correction");
    let prompt = Prompt {
        points: vec![point(&place, false)],
        ..Prompt::default()
    };
    let mask = predictor.show(2, 1, &prompt).unwrap();
    assert_call(&predictor, &fixture, "D_call0", 1, 2);
    assert_numbers(mask.logits.data(), &fixture, "D_correction_mask");
    let pointer = predictor.objects[&1].at(2).unwrap().pointer.clone();
    assert_numbers(&numbers(pointer).unwrap(), &fixture, "D_correction_ptr");
    // it stays what it was corrected to
    predictor
        .follow(1..=2, Direction::Backward, &Silent, |at, masks| {
            assert!(at != 2 || masks[&1] == mask);
        })
        .unwrap();
}

#[test]
fn a_clip_without_its_objects_agrees_with_the_video_predictor() {
    let fixture = Arc::new(Fixture::open("sam2/video_256_absent.safetensors"));
    let predictor = passage_a(&fixture, -0.1);
    let absent = |entry: &bank::Entry| !entry.mask.is_there();
    assert!(predictor.objects.values().any(
        |object| object.others.values().any(absent) || object.conditioning.values().any(absent)
    ));
}

/// Frames that are far from the last and from the prompted ones are forgotten.
#[test]
fn memory_does_not_grow_with_the_clip() {
    let net = Arc::new(loaded(&FormulaWeights::of_keys(TINY), 64));
    let clip = VideoSize {
        frames: 60,
        width: 64,
        height: 64,
    };
    let images = Box::new(|i: usize| {
        Ok(RgbImage::from_fn(64, 64, |x, y| {
            [(x + i) as u8, (4 * y) as u8, 90]
        }))
    });
    let mut predictor = VideoPredictor::new(net, clip, images, 0).unwrap();
    let prompt = Prompt {
        points: vec![point(&[12.0, 25.0], true)],
        ..Prompt::default()
    };
    predictor.show(0, 7, &prompt).unwrap();
    predictor
        .follow(0..=59, Direction::Forward, &Silent, |_, _| ())
        .unwrap();
    let object = &predictor.objects[&7];
    for frame in 0..60 {
        let near = |reach: usize| frame <= reach || 59 - frame <= reach;
        assert_eq!(object.at(frame).is_some(), near(15), "frame {frame}");
        assert_eq!(
            object.at(frame).is_some_and(|entry| entry.memory.is_some()),
            near(6),
            "frame {frame}"
        );
    } // a frame that was forgotten can be corrected
    predictor.show(30, 7, &prompt).unwrap();
    predictor
        .follow(25..=30, Direction::Backward, &Silent, |_, _| ())
        .unwrap();
}
