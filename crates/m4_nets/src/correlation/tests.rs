//! Both implementations against the definition, and against the published module.

use super::*;
use crate::cpu;
use crate::fixture::Fixture;
use crate::ops::tensor;
use m4_testkit::{formula_input, same_on_any_threads};

fn by_definition(
    f: &[f32],
    g: &[f32],
    [h, w, c]: [usize; 3],
    centres: &[f32],
    radius: usize,
    levels: usize,
) -> Vec<f64> {
    let mut maps = vec![(h, w, g.iter().map(|&x| f64::from(x)).collect::<Vec<f64>>())];
    for level in 1..levels {
        let (h, w, fine) = &maps[level - 1];
        let at = |y: usize, x: usize, k: usize| fine[(y * w + x) * c + k];
        let (h2, w2) = (h / 2, w / 2);
        let mut coarse = Vec::new();
        for y in 0..h2 {
            for x in 0..w2 {
                coarse.extend((0..c).map(|k| {
                    let (y, x) = (2 * y, 2 * x);
                    (at(y, x, k) + at(y, x + 1, k) + at(y + 1, x, k) + at(y + 1, x + 1, k)) / 4.0
                }));
            }
        }
        maps.push((h2, w2, coarse));
    }
    let r = radius as i64;
    let mut out = Vec::new();
    for p in 0..h * w {
        for (level, (h, w, g)) in maps.iter().enumerate() {
            let centre = [0, 1].map(|k| f64::from(centres[2 * p + k]) / f64::from(1 << level));
            for dx in -r..=r {
                for dy in -r..=r {
                    let (x, y) = (centre[0] + dx as f64, centre[1] + dy as f64);
                    let mut sum = 0.0;
                    for (x, wx) in [
                        (x.floor(), 1.0 - (x - x.floor())),
                        (x.floor() + 1.0, x - x.floor()),
                    ] {
                        for (y, wy) in [
                            (y.floor(), 1.0 - (y - y.floor())),
                            (y.floor() + 1.0, y - y.floor()),
                        ] {
                            if x < 0.0
                                || y < 0.0
                                || x >= *w as f64
                                || y >= *h as f64
                                || x.is_nan()
                                || y.is_nan()
                            {
                                continue;
                            }
                            let q = &g[(y as usize * w + x as usize) * c..][..c];
                            let f = &f[p * c..][..c];
                            let dot: f64 = f.iter().zip(q).map(|(a, b)| f64::from(*a) * b).sum();
                            sum += wx * wy * dot / 16.0;
                        }
                    }
                    out.push(sum);
                }
            }
        }
    }
    out
}

/// Both implementations, the fast one first.
fn both(
    f: &[f32],
    g: &[f32],
    size: [usize; 3],
    centres: &[f32],
    radius: usize,
    levels: usize,
) -> [Vec<f32>; 2] {
    let [h, w, _] = size;
    let device = cpu();
    let (f, g) = (
        tensor(f.to_vec(), size, &device),
        tensor(g.to_vec(), size, &device),
    );
    let centres = tensor(centres.to_vec(), [h, w, 2], &device);
    let fast = scores(
        &FeatureMap::new(f.clone()),
        &Pyramid::new(g.clone(), levels),
        centres.clone(),
        radius,
    );
    let target = Pyramid::of(FeatureMap::on_device(g), levels);
    let plain = lookup::scores(f.div_scalar(4.0), &target, centres, radius);
    [fast, plain].map(|scores| {
        assert_eq!(scores.dims(), [h, w, taps(levels, radius)]);
        scores.try_into_vec_as().unwrap()
    })
}

/// Largest difference relative to the largest number that is wanted.
fn error(got: &[f32], want: &[f64]) -> f64 {
    assert_eq!(got.len(), want.len());
    let largest = want.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    assert!(largest > 0.0, "nothing to compare with");
    let differences = got.iter().zip(want).map(|(&a, b)| (f64::from(a) - b).abs());
    differences.fold(
        0.0,
        |m: f64, x| if x.is_nan() { f64::NAN } else { m.max(x) },
    ) / largest
}

#[test]
fn agree_with_the_definition() {
    // odd sizes, a level of one row, a level without any; widths that are no multiple of the lanes
    for (size, radius, levels) in [
        ([17, 24, 128], 3, 4),
        ([18, 17, 256], 4, 4),
        ([9, 11, 20], 3, 4),
        ([5, 40, 16], 1, 4),
    ] {
        let [h, w, c] = size;
        let f = formula_input("f", 0.0, 1.0, h * w * c);
        let g = formula_input("g", 0.1, 1.0, h * w * c);
        let mut centres = formula_input("centres", 10.0, 40.0, h * w * 2);
        let wild = [
            0.0,
            1e30,
            f32::INFINITY,
            3.0,
            f32::NAN,
            2.0,
            -1e9,
            f32::NEG_INFINITY,
            -0.0,
            -1.0,
        ];
        centres[..10].copy_from_slice(&wild);
        // exactly on the last pixel, and a whole window beyond
        centres[10..14].copy_from_slice(&[
            (w - 1) as f32,
            (h - 1) as f32,
            (w + radius) as f32,
            -(radius as f32) - 1.0,
        ]);
        let want = by_definition(&f, &g, size, &centres, radius, levels);
        for (name, got) in ["window", "volume"]
            .iter()
            .zip(both(&f, &g, size, &centres, radius, levels))
        {
            let error = error(&got, &want);
            assert!(error < 2e-6, "{name} {size:?}: {error:.1e}");
        }
    }
}

/// `[c][n]` as `[n][c]`.
fn channels_last(values: &[f32], c: usize) -> Vec<f32> {
    let n = values.len() / c;
    (0..n * c).map(|i| values[(i % c) * n + i / c]).collect()
}

#[test]
fn agree_with_the_published_module() {
    let (encoders, lookup) = (
        Fixture::open("droid/encoders.safetensors"),
        Fixture::open("droid/corr_lookup.safetensors"),
    );
    let maps: Vec<Vec<f32>> = encoders
        .floats("fmap")
        .0
        .chunks(128 * 16 * 24)
        .map(|map| channels_last(map, 128))
        .collect();
    let (centres, want) = (lookup.floats("coords").0, lookup.floats("corr").0);
    let far = centres
        .chunks(2)
        .filter(|c| c[0] < -4.0 || c[0] > 27.0 || c[1] < -4.0 || c[1] > 19.0)
        .count();
    assert!(far > 0, "no point is far outside");
    for (edge, (i, j)) in lookup
        .indices("ii")
        .into_iter()
        .zip(lookup.indices("jj"))
        .enumerate()
    {
        let centres = &centres[edge * 16 * 24 * 2..][..16 * 24 * 2];
        let want = channels_last(&want[edge * 196 * 16 * 24..][..196 * 16 * 24], 196);
        let want: Vec<f64> = want.into_iter().map(f64::from).collect();
        for got in both(&maps[i], &maps[j], [16, 24, 128], centres, 3, 4) {
            let error = error(&got, &want);
            assert!(error < 2e-5, "edge {edge}: {error:.1e}");
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let size = [33, 21, 128];
    let [h, w, c] = size;
    let f = formula_input("f", 0.0, 1.0, h * w * c);
    let centres = formula_input("centres", 12.0, 15.0, h * w * 2);
    let one = same_on_any_threads(|| both(&f, &f, size, &centres, 3, 4));
    assert!(one[0].iter().any(|&x| x != 0.0));
}
