//! GMFlow against its authors' module: with weights by a formula always, with the real ones where they are.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::{fixtures, floats, picture, png, real_weights};
use m4_nets::{Flow, FlowError, GmFlow, LoadError, cpu};
use m4_scene::{Plane, RgbImage};
use m4_testkit::write_formula_weights;
use std::fs;
use std::path::Path;
use std::sync::LazyLock;
use tempfile::TempDir;

const KEYS: &str = include_str!("../../../fixtures/gmflow/keys.txt");

/// Distances between `flow` and `want` (`[2, h, w]`, every `step`-th row and column): mean, largest, and the standard
/// deviation of what is wanted.
fn end_point_errors(flow: &Flow, want: &[f32], step: usize) -> (f64, f64, f64) {
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

/// A checkpoint with weights by the formula, made once.
fn formula_weights() -> &'static Path {
    static FOLDER: LazyLock<TempDir> = LazyLock::new(|| {
        let folder = TempDir::new().unwrap();
        write_formula_weights(KEYS, &folder.path().join("weights.safetensors"));
        folder
    });
    static PATH: LazyLock<std::path::PathBuf> = LazyLock::new(|| FOLDER.path().join("weights.safetensors"));
    &PATH
}

fn network() -> GmFlow {
    GmFlow::load(formula_weights(), cpu()).unwrap()
}

fn pair() -> (Vec<u8>, RgbImage, RgbImage) {
    let file = fs::read(fixtures().join("gmflow/formula.safetensors")).unwrap();
    let (a, b) = (picture(&file, "image0"), picture(&file, "image1"));
    (file, a, b)
}

/// 96 x 64 pixels; the module in f32 is at most 0.011 px from itself in f64, at a standard deviation of 10 px.
#[test]
fn agrees_with_the_module_by_formula() {
    let net = network();
    assert_eq!(net.parameters(), 4_716_720);
    let (file, a, b) = pair();
    let (a, b) = (net.encode(&a).unwrap(), net.encode(&b).unwrap());
    let (forward, back) = net.flow_both(&a, &b).unwrap();
    for (flow, name) in [(&forward, "flow01"), (&back, "flow10")] {
        let (mean, worst, spread) = end_point_errors(flow, &floats(&file, name), 1);
        println!("{name}: mean {mean:.2e} px, worst {worst:.2e} px");
        assert!(mean < 1e-2 && worst < 0.1, "{name}: {mean} px, worst {worst} px");
        assert!(spread > 5.0, "{name} hardly differs from a constant: {spread} px");
    }
    let one = net.flow_between(&a, &b).unwrap();
    assert_eq!(one, forward, "one direction alone is the same");
}

#[test]
fn agrees_with_the_module_on_real_weights() {
    let Some(path) = real_weights("gmflow", "flownet.pkl") else {
        return;
    };
    let net = GmFlow::load(&path, cpu()).unwrap();
    assert_eq!(net.parameters(), 4_716_720);
    let flow = net
        .flow(&png("gmflow/tennis_0.png"), &png("gmflow/tennis_1.png"))
        .unwrap();
    let file = fs::read(fixtures().join("gmflow/tennis.safetensors")).unwrap();
    let (mean, worst, spread) = end_point_errors(&flow, &floats(&file, "flow_every_4"), 4);
    println!("mean {mean:.2e} px, worst {worst:.2e} px, spread {spread:.2} px");
    assert!(mean < 5e-3 && worst < 0.2, "{mean} px, worst {worst} px");
    assert!(spread > 1.0, "{spread} px");
}

/// A picture with an edge repeated by hand gets the flow of the one that is padded inside.
#[test]
fn odd_sizes_are_padded_and_cropped() {
    let net = network();
    let (_, a, b) = pair();
    let (w, h) = (91, 63);
    let crop = |image: &RgbImage| Plane::from_fn(w, h, |x, y| image.row(y)[x]);
    let (a, b) = (crop(&a), crop(&b));
    let flow = net.flow(&a, &b).unwrap();
    assert_eq!(
        (flow.width, flow.height, flow.u.len(), flow.v.len()),
        (w, h, w * h, w * h)
    );
    let pad = |image: &RgbImage| {
        Plane::from_fn(96, 64, |x: usize, y: usize| {
            image.row(y.min(h - 1))[x.saturating_sub(2).min(w - 1)]
        })
    };
    let padded = net.flow(&pad(&a), &pad(&b)).unwrap();
    for y in 0..h {
        for x in 0..w {
            assert_eq!(flow.u[y * w + x], padded.u[y * 96 + x + 2], "column {x}, row {y}");
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let net = network();
    let (_, a, b) = pair();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| net.flow(&a, &b).unwrap())
    };
    let one = with(1);
    assert_eq!(one, with(2));
    assert_eq!(one, with(5));
}

#[test]
fn refuses_pictures_that_do_not_fit() {
    let net = network();
    let small: RgbImage = Plane::filled(1, 1, [9, 9, 9]);
    let flow = net.flow(&small, &small).unwrap();
    assert!(flow.u[0].is_finite() && flow.u.len() == 1);
    let other: RgbImage = Plane::filled(2, 1, [9, 9, 9]);
    let error = net.flow(&small, &other).unwrap_err();
    assert!(matches!(error, FlowError::Sizes { a: (1, 1), b: (2, 1) }), "{error}");
    let none: RgbImage = Plane::filled(0, 4, [9, 9, 9]);
    assert!(matches!(net.flow(&none, &none), Err(FlowError::Empty)));
}

#[test]
fn a_checkpoint_is_read_strictly() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("weights.safetensors");
    let load = |list: &str| {
        write_formula_weights(list, &path);
        GmFlow::load(&path, cpu()).map(|_| ())
    };
    let without: String = KEYS.lines().skip(1).map(|l| format!("{l}\n")).collect();
    let Err(LoadError::OtherNetwork {
        missing, unused, wrong, ..
    }) = load(&without)
    else {
        panic!("a tensor is missing");
    };
    assert_eq!(
        (missing, unused, wrong),
        (vec!["backbone.conv1.weight".to_owned()], vec![], vec![])
    );
    let Err(error) = load(&format!("{KEYS}head.weight 2 2\n")) else {
        panic!("a tensor is left over");
    };
    assert!(error.to_string().contains("head.weight"), "{error}");
    let Err(error) = load(&KEYS.replace("upsampler.0.bias 256", "upsampler.0.bias 255")) else {
        panic!("a tensor has another shape");
    };
    assert!(error.to_string().contains("upsampler.hidden.bias"), "{error}");
    let text = folder.path().join("text.pkl");
    fs::write(&text, "no checkpoint at all").unwrap();
    assert!(matches!(GmFlow::load(&text, cpu()), Err(LoadError::Unreadable { .. })));
    let nothing = folder.path().join("nothing.pkl");
    assert!(matches!(GmFlow::load(&nothing, cpu()), Err(LoadError::Missing { .. })));
}
