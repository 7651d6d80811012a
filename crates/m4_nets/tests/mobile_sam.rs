//! MobileSAM against its authors' module: with synthetic weights always, with the real ones where
//! they are.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::{loaded, png, real_weights};
use m4_core::{Plane, RgbImage};
use m4_nets::{MobileSam, PointPrompt, Prompt, cpu};
use m4_testkit::{Fixture, FormulaWeights, same_on_any_threads};

const KEYS: &str = include_str!("../../../fixtures/mobile_sam/keys.txt");
/// Rows and columns of the masks that the fixtures keep.
const STEP: usize = 4;

fn network() -> MobileSam {
    loaded(&FormulaWeights::of_keys(KEYS), |path| {
        MobileSam::load(path, cpu())
    })
}

/// The largest difference and the standard deviation of what is wanted.
fn distance(got: &[f32], want: &[f32]) -> (f64, f64) {
    assert_eq!(got.len(), want.len());
    let pairs = got.iter().zip(want);
    let worst = pairs.map(|(a, b)| f64::from((a - b).abs()));
    let worst = worst.fold(
        0.0,
        |a, b| if b.is_nan() { f64::INFINITY } else { a.max(b) },
    );
    let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / want.len() as f64;
    let centre = mean(&mut want.iter().map(|&x| f64::from(x)));
    let spread = mean(&mut want.iter().map(|&x| (f64::from(x) - centre).powi(2))).sqrt();
    (worst, spread)
}

fn every(plane: &Plane<f32>, step: usize) -> Vec<f32> {
    let rows = (0..plane.height()).step_by(step).map(|y| plane.row(y));
    rows.flat_map(|row| row.iter().copied().step_by(step))
        .collect()
}

/// How far is allowed: the masks relative to their standard deviation, the qualities as they are.
struct Limits {
    masks: f64,
    iou: f64,
}

/// The prompts of `oracles/mobile_sam.py` on an image of this size; pixels are counted from 0
/// there.
fn prompts(width: usize, height: usize) -> [(&'static str, Prompt); 4] {
    let at = |x: f64, y: f64| {
        let pixel = |part: f64, side: usize| (part * side as f64).round_ties_even() as f32 + 0.5;
        [pixel(x, width), pixel(y, height)]
    };
    let point = |x, y, on_object| PointPrompt {
        at_px: at(x, y),
        on_object,
    };
    let [[x0, y0], [x1, y1]] = [at(0.1, 0.2), at(0.55, 0.9)];
    let box_px = Some([x0, y0, x1, y1]);
    let prompt = |points, box_px| Prompt {
        points,
        box_px,
        mask_logits: None,
    };
    let on = point(0.3, 0.55, true);
    [
        ("point", prompt(vec![on], None)),
        ("box", prompt(vec![], box_px)),
        ("again", prompt(vec![on, point(0.8, 0.2, false)], box_px)),
        ("mask", prompt(vec![point(0.35, 0.4, true)], None)),
    ]
}

#[expect(clippy::print_stdout, reason = "figures for docs/networks.md")]
fn compare(net: &MobileSam, image: &RgbImage, file: &Fixture, limits: &Limits) {
    let close = |name: &str, got: &[f32], limit: f64| {
        let (worst, spread) = distance(got, &file.floats(name).0);
        println!("{name}: worst {worst:.2e} at a standard deviation of {spread:.2e}");
        assert!(
            spread > 1e-2,
            "{name} hardly differs from a constant: {spread}"
        );
        let scale = if name.ends_with("iou") { 1.0 } else { spread };
        assert!(
            worst < limit * scale,
            "{name}: {worst} at a standard deviation of {spread}"
        );
    };
    let embedding = net.encode(image).unwrap();
    let mut earlier = None;
    for (name, mut prompt) in prompts(image.width(), image.height()) {
        if ["again", "mask"].contains(&name) {
            prompt.mask_logits.clone_from(&earlier);
        }
        let masks = net.masks(&embedding, &prompt).unwrap();
        let logits: Vec<f32> = masks
            .iter()
            .flat_map(|mask| every(&mask.logits, STEP))
            .collect();
        close(&format!("{name}/logits"), &logits, limits.masks);
        let whole = masks[1].logits_at(image.size());
        assert_eq!(whole.size(), image.size());
        close(
            &format!("{name}/picture_logits"),
            &every(&whole, STEP),
            limits.masks,
        );
        let iou: Vec<f32> = masks.iter().map(|mask| mask.iou).collect();
        close(&format!("{name}/iou"), &iou, limits.iou);
        if name == "point" {
            earlier = Some(masks[1].logits.clone());
        }
    }
}

fn synthetic_image() -> (Fixture, RgbImage) {
    let file = Fixture::open("mobile_sam/formula.safetensors");
    let image = file.image("image");
    (file, image)
}

/// The module in f32 is within 2e-5 of itself in f64, and here as close.
#[test]
fn agrees_with_the_module_by_formula() {
    let net = network();
    let (file, image) = synthetic_image();
    let limits = Limits {
        masks: 2e-4,
        iou: 1e-5,
    };
    compare(&net, &image, &file, &limits);
}

#[test]
fn agrees_with_the_module_on_real_weights() {
    let Some(path) = real_weights("mobile-sam", "mobile_sam.pt") else {
        return;
    };
    let net = MobileSam::load(&path, cpu()).unwrap();
    let file = Fixture::open("mobile_sam/tennis.safetensors");
    let limits = Limits {
        masks: 1e-3,
        iou: 1e-4,
    };
    compare(&net, &png("tennis/tennis_0.png"), &file, &limits);
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let net = network();
    let (_, image) = synthetic_image();
    let [(_, point), ..] = prompts(image.width(), image.height());
    same_on_any_threads(|| net.masks(&net.encode(&image).unwrap(), &point).unwrap());
}

#[test]
fn invalid_images_and_prompts_are_refused() {
    let net = network();
    for (width, height) in [(0, 4), (1, 2049)] {
        let error = net
            .encode(&Plane::filled(width, height, [9, 9, 9]))
            .unwrap_err();
        assert!(
            error
                .to_string()
                .contains(&format!("not {width} x {height}")),
            "{error}"
        );
    }
    let embedding = net.encode(&Plane::filled(1, 2048, [9, 9, 9])).unwrap();
    let ask = |prompt: &Prompt| net.masks(&embedding, prompt);
    let at = |x| Prompt {
        points: vec![PointPrompt {
            at_px: [x, 0.5],
            on_object: true,
        }],
        ..Prompt::default()
    };
    let boxed = |y0, y1| Prompt {
        box_px: Some([0.5, y0, 0.5, y1]),
        ..Prompt::default()
    };
    let with_mask = |mask| Prompt {
        mask_logits: Some(mask),
        ..at(0.5)
    };
    let outside = "of an image of 1 x 2048 pixels";
    for (prompt, message) in [
        (Prompt::default(), "a point, a box or a mask"),
        (at(-0.1), outside),
        (at(1.1), outside),
        (at(f32::NAN), outside),
        (at(f32::INFINITY), outside),
        (boxed(9.5, 2048.5), outside),
        (boxed(9.5, 8.5), "first column and row, then last"),
        (with_mask(Plane::filled(256, 255, 0.0)), "not 256 x 255"),
        (
            with_mask(Plane::filled(256, 256, f32::INFINITY)),
            "NaN or infinite",
        ),
    ] {
        let error = ask(&prompt).unwrap_err();
        assert!(error.to_string().contains(message), "{error}");
    }
    assert_eq!(ask(&boxed(8.5, 9.5)).unwrap().len(), 4);
    let masks = ask(&at(0.5)).unwrap();
    assert_eq!(masks.len(), 4);
    assert_eq!(masks[0].logits_at((1, 2048)).size(), (1, 2048));
}
