//! LPIPS against the networks stated again in PyTorch: with synthetic weights always, with the
//! published ones where they are.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::{png, real_weights};
use m4_core::{Mask, Plane};
use m4_nets::{LoadError, Lpips, LpipsImage, LpipsNet, cpu};
use m4_testkit::{Fixture, formula, same_on_any_threads};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use tempfile::TempDir;

const NETS: [(LpipsNet, &str); 2] = [(LpipsNet::Alex, "alex"), (LpipsNet::Vgg, "vgg")];
/// Rows and columns of the maps that the fixture of the published weights keeps.
const STEP: usize = 4;

/// An array of a synthetic checkpoint: its name, its sides (of a kernel `[h][w][in][out]`), its
/// numbers row by row.
#[derive(Clone)]
struct Array {
    name: String,
    sides: Vec<usize>,
    values: Vec<f32>,
}

/// The arrays of `net` with the numbers of `oracles/lpips.py`.
fn arrays_by_formula(net: LpipsNet) -> Vec<Array> {
    // side of the kernel, channels; whether the layer is compared
    let (module, layers): (_, Vec<(usize, usize, bool)>) = match net {
        LpipsNet::Alex => (
            "AlexNet_0",
            vec![
                (11, 64, true),
                (5, 192, true),
                (3, 384, true),
                (3, 256, true),
                (3, 256, true),
            ],
        ),
        LpipsNet::Vgg => {
            let widths = [
                64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512,
            ];
            let compared = [1, 3, 6, 9, 12];
            let layer = |(i, width)| (3, width, compared.contains(&i));
            (
                "VGG16_0",
                widths.into_iter().enumerate().map(layer).collect(),
            )
        }
    };
    let (mut arrays, mut lins, mut from) = (Vec::new(), Vec::new(), 3);
    for (i, (side, to, compared)) in layers.into_iter().enumerate() {
        let (name, fan_in) = (format!("{module}/Conv_{i}/kernel"), from * side * side);
        let scale = (6.0 / fan_in as f64).sqrt();
        let first: Vec<f32> = formula(&name, to * fan_in)
            .map(|u| (u * scale) as f32)
            .collect();
        let taps = side * side;
        let mut values = Vec::with_capacity(first.len());
        for tap in 0..taps {
            for c in 0..from {
                values.extend((0..to).map(|o| first[(o * from + c) * taps + tap]));
            }
        }
        let sides = vec![side, side, from, to];
        arrays.push(Array {
            name,
            sides,
            values,
        });
        let name = format!("{module}/Conv_{i}/bias");
        let values = formula(&name, to).map(|u| (0.02 * u) as f32).collect();
        let sides = vec![to];
        arrays.push(Array {
            name,
            sides,
            values,
        });
        if compared {
            let name = format!("NetLinLayer_{}/Conv_0/kernel", lins.len());
            let values = formula(&name, to).map(|u| u.abs() as f32).collect();
            let sides = vec![1, 1, to, 1];
            lins.push(Array {
                name,
                sides,
                values,
            });
        }
        from = to;
    }
    arrays.append(&mut lins);
    arrays
}

/// Writes `arrays`, whose names have up to three parts, as Python pickles nested dictionaries of
/// numpy's arrays.
fn write(arrays: &[Array], path: &Path) {
    let mut out = b"\x80\x03}".to_vec();
    let text = |out: &mut Vec<u8>, text: &str| {
        out.push(b'X');
        out.extend((text.len() as u32).to_le_bytes());
        out.extend(text.bytes());
    };
    let mut open: Vec<&str> = Vec::new();
    for array in arrays {
        let parts: Vec<&str> = array.name.split('/').collect();
        let (last, folders) = parts.split_last().unwrap();
        let common = open.iter().zip(folders).take_while(|(a, b)| a == b).count();
        out.extend(b"s".repeat(open.len() - common));
        open.truncate(common);
        for folder in &folders[common..] {
            text(&mut out, folder);
            out.push(b'}');
            open.push(folder);
        }
        text(&mut out, last);
        out.extend(
            b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\0\x85C\x01b\x87R(K\x01(",
        );
        for &side in &array.sides {
            out.push(b'M');
            out.extend((side as u16).to_le_bytes());
        }
        out.extend(b"tcnumpy\ndtype\nX\x02\0\0\0f4\x89\x88\x87R(K\x03X\x01\0\0\0<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\0tb\x89B");
        out.extend((4 * array.values.len() as u32).to_le_bytes());
        out.extend(array.values.iter().flat_map(|v| v.to_le_bytes()));
        out.extend(b"tbs");
    }
    out.extend(b"s".repeat(open.len()));
    out.push(b'.');
    fs::write(path, out).unwrap();
}

/// Checkpoints by the formula, written once.
fn formula_weights(net: LpipsNet) -> PathBuf {
    static FOLDER: LazyLock<TempDir> = LazyLock::new(|| {
        let folder = TempDir::new().unwrap();
        for (net, name) in NETS {
            write(&arrays_by_formula(net), &folder.path().join(name));
        }
        folder
    });
    let name = NETS.iter().find(|(n, _)| *n == net).unwrap().1;
    FOLDER.path().join(name)
}

fn network(net: LpipsNet) -> Lpips {
    Lpips::load(net, &formula_weights(net), cpu()).unwrap()
}

struct Case {
    file: Fixture,
    image: LpipsImage,
    reference: LpipsImage,
    mask: Mask,
}

fn case() -> Case {
    let file = Fixture::open("lpips/formula.safetensors");
    let [image, reference] = ["image", "reference"].map(|name| LpipsImage::from(&file.image(name)));
    let (w, h) = image.size();
    let mask = Mask::from_vec(w, h, file.bytes("mask")).unwrap();
    Case {
        file,
        image,
        reference,
        mask,
    }
}

#[expect(clippy::print_stdout, reason = "figures for docs/networks.md")]
fn close(what: &str, got: f64, want: f64, limit: f64) {
    println!("{what}: {got:.7} where {want:.7} is wanted");
    assert!(want > 0.05, "{what}: {want} says little");
    assert!(
        (got - want).abs() < limit,
        "{what}: {got} where {want} is wanted"
    );
}

#[expect(clippy::print_stdout, reason = "figures for docs/networks.md")]
fn close_map(what: &str, got: &Plane<f32>, step: usize, want: &[f32], limit: f32) {
    let rows = (0..got.height()).step_by(step).map(|y| got.row(y));
    let got: Vec<f32> = rows
        .flat_map(|row| row.iter().copied().step_by(step))
        .collect();
    assert_eq!(got.len(), want.len(), "{what}");
    let worst = got
        .iter()
        .zip(want)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max);
    let ends = |values: &[f32]| {
        values
            .iter()
            .fold((f32::MAX, 0f32), |(a, b), &v| (a.min(v), b.max(v)))
    };
    let (least, most) = ends(want);
    println!("{what}: worst {worst:.2e} of {least:.3} to {most:.3}");
    assert!(
        most > 1.5 * least && most > 0.1,
        "{what} hardly differs from a constant"
    );
    assert!(
        worst < limit && got.iter().all(|v| v.is_finite()),
        "{what}: {worst}"
    );
}

/// LPIPS stated anew in `PyTorch` (`oracles/lpips.py`), which `oracles/check_programs.py` compares
/// with the authors' package.
#[test]
fn agrees_with_lpips_restated_in_pytorch_by_formula() {
    let case = case();
    for (net, name) in NETS {
        let lpips = network(net);
        let want = |what: &str| case.file.doubles(&format!("{name}/{what}"))[0];
        let score = lpips.compare(&case.image, &case.reference).unwrap();
        close(
            &format!("{name} distance"),
            score.distance,
            want("distance"),
            2e-6,
        );
        let map = case.file.floats(&format!("{name}/map")).0;
        close_map(&format!("{name} map"), &score.map, 1, &map, 2e-5);
        let inside = lpips.compare_inside(&case.image, &case.reference, &case.mask);
        close(
            &format!("{name} masked"),
            inside.unwrap().unwrap(),
            want("masked"),
            2e-6,
        );
        let all = score.mean_inside(&case.mask.map(|_| 1)).unwrap().unwrap();
        let mean = map.iter().map(|&v| f64::from(v)).sum::<f64>() / map.len() as f64;
        close(&format!("{name} mean of the map"), all, mean, 2e-6);
        // the other way round is the same, and nothing differs from itself
        let back = lpips.compare(&case.reference, &case.image).unwrap();
        assert!((back.distance - score.distance).abs() < 1e-9, "{back:?}");
        let same = lpips.compare(&case.image, &case.image).unwrap();
        assert!(same.distance == 0.0 && same.map.data().iter().all(|&v| v == 0.0));
    }
}

/// The distances that the LPIPS project prints for its own images, and the maps of the same weights
/// in PyTorch.
#[test]
fn agrees_with_the_published_distances() {
    let file = Fixture::open("lpips/published.safetensors");
    let read = |name: &str| LpipsImage::from(&png(&format!("lpips/ex_{name}.png")));
    let reference = read("ref");
    let case = case();
    let published = [
        ("lpips-alex", "alexnet.ckpt", [0.7219, 0.1376]),
        ("lpips-vgg", "vgg16.ckpt", [0.5686, 0.4217]),
    ];
    for ((net, name), (entry, weights, distances)) in NETS.into_iter().zip(published) {
        let Some(path) = real_weights(entry, weights) else {
            continue;
        };
        let lpips = Lpips::load(net, &path, cpu()).unwrap();
        for (other, printed) in ["p0", "p1"].into_iter().zip(distances) {
            let what = format!("{name}/{other}");
            let score = lpips.compare(&read(other), &reference).unwrap();
            close(&what, score.distance, printed, 1e-3);
            close(
                &what,
                score.distance,
                file.doubles(&format!("{what}/distance"))[0],
                5e-6,
            );
            let map = file.floats(&format!("{what}/map")).0;
            close_map(&what, &score.map, STEP, &map, 1e-4);
        }
        let want = |what: &str| file.doubles(&format!("{name}/made_up/{what}"))[0];
        let score = lpips.compare(&case.image, &case.reference).unwrap();
        close("made up", score.distance, want("distance"), 5e-6);
        let map = file.floats(&format!("{name}/made_up/map")).0;
        close_map("made up", &score.map, STEP, &map, 1e-4);
        let inside = lpips.compare_inside(&case.image, &case.reference, &case.mask);
        close(
            "made up, masked",
            inside.unwrap().unwrap(),
            want("masked"),
            5e-6,
        );
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let case = case();
    for (net, _) in NETS {
        let lpips = network(net);
        let one = same_on_any_threads(|| lpips.compare(&case.image, &case.reference).unwrap());
        assert!(one.distance > 0.1);
    }
}

#[test]
fn images_of_different_or_too_small_size_are_refused() {
    let flat =
        |w, h, v| LpipsImage::from_planes(w, h, [&vec![v; w * h]; 3].map(|p| &p[..])).unwrap();
    for (net, _) in NETS {
        let lpips = network(net);
        let least = net.min_side_px();
        let compare = |a: &LpipsImage, b: &LpipsImage| lpips.compare(a, b).map(drop);
        let within = |w| {
            lpips.compare_inside(
                &flat(64, 64, 0.5),
                &flat(64, 64, 0.4),
                &Plane::filled(w, 64, 0),
            )
        };
        for (result, message) in [
            (
                compare(&flat(least - 1, 64, 0.5), &flat(least - 1, 64, 0.4)),
                "pixels per side at least",
            ),
            (
                compare(&flat(0, 0, 0.5), &flat(0, 0, 0.4)),
                "pixels per side at least",
            ),
            (
                compare(&flat(64, 64, 0.5), &flat(64, 65, 0.4)),
                "the image has 64 x 64 pixels but the reference 64 x 65",
            ),
            (within(63).map(drop), "the mask has 63 x 64"),
        ] {
            let error = result.unwrap_err();
            assert!(error.to_string().contains(message), "{error}");
        }
        let score = lpips
            .compare(&flat(least, least, 0.5), &flat(least, least, 0.4))
            .unwrap();
        assert!(score.distance.is_finite() && score.map.size() == (least, least));
        assert_eq!(within(64).unwrap(), None);
    }
    let (good, short, bad) = (
        [0.5f32; 6],
        [0.5f32; 5],
        [0.1, 0.2, f32::NAN, 0.0, 0.0, 0.0],
    );
    for (planes, message) in [
        (
            [&good[..], &short, &good],
            "planes of 6 values; channel 1 has 5",
        ),
        ([&good[..], &good, &bad], "pixel (2, 0) of channel 2 is NaN"),
    ] {
        let error = LpipsImage::from_planes(3, 2, planes).unwrap_err();
        assert!(error.to_string().contains(message), "{error}");
    }
}

#[test]
fn a_checkpoint_is_read_strictly() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("alexnet.ckpt");
    let load = |arrays: &[Array]| {
        write(arrays, &path);
        Lpips::load(LpipsNet::Alex, &path, cpu()).err()
    };
    let all = arrays_by_formula(LpipsNet::Alex);
    assert!(load(&all).is_none());
    let Some(LoadError::OtherNetwork {
        missing,
        unused,
        wrong,
        ..
    }) = load(&all[1..])
    else {
        panic!("an array is missing");
    };
    assert_eq!(
        (missing, unused, wrong),
        (vec!["convs.0.weight".to_owned()], vec![], vec![])
    );
    let mut more = all.clone();
    more.push(Array {
        name: "NetLinLayer_5/Conv_0/kernel".to_owned(),
        ..all[all.len() - 1].clone()
    });
    let error = load(&more).unwrap().to_string();
    assert!(error.contains("lins.5.weight"), "{error}");
    for name in [
        "AlexNet_0/Conv_00/kernel",
        "AlexNet_0/Conv_0/scale",
        "VGG16_0/Conv_0/kernel",
    ] {
        let mut other = all.clone();
        other[0].name = name.to_owned();
        let Some(LoadError::OtherNetwork {
            missing, unused, ..
        }) = load(&other)
        else {
            panic!("{name} is taken for another");
        };
        assert_eq!((missing.len(), unused), (1, vec![name.to_owned()]));
    }
    let mut turned = all.clone();
    turned[2].sides.reverse();
    let error = load(&turned).unwrap().to_string();
    assert!(error.contains("convs.1.weight"), "{error}");
    let other = Lpips::load(LpipsNet::Alex, &formula_weights(LpipsNet::Vgg), cpu()).unwrap_err();
    assert!(matches!(other, LoadError::OtherNetwork { .. }), "{other}");
    fs::write(&path, b"\x80\x03cos\nsystem\n.").unwrap();
    let error = Lpips::load(LpipsNet::Alex, &path, cpu()).unwrap_err();
    assert!(matches!(error, LoadError::Unreadable { .. }), "{error}");
    let none = Lpips::load(LpipsNet::Alex, &folder.path().join("none"), cpu()).unwrap_err();
    assert!(matches!(none, LoadError::Missing { .. }));
}
