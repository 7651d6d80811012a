//! The fast path against the reference, on problems that no fixture has.

use super::adjust::adjust_on;
use super::*;
use fearless_simd::Level;
use m4_core::{CounterRng, Se3, SimdLevel, nalgebra::Vector6};

/// Seven frames of 21 x 17 pixels: two and a half blocks, so that the last one is padded.
fn geometry() -> Geometry<f64> {
    let mut rng = CounterRng::new(3, 1, 0);
    let grid = Grid {
        width: 21,
        height: 17,
    };
    let plane = |rng: &mut CounterRng| {
        (0..grid.len())
            .map(|_| 0.2 + 0.6 * rng.uniform())
            .collect::<Vec<f64>>()
    };
    Geometry {
        grid,
        lens: Pinhole {
            fx: 19.0,
            fy: 18.2,
            cx: 10.3,
            cy: 8.1,
        },
        poses: (0..7)
            .map(|k| {
                let wobble = Vector6::from_fn(|_, _| 0.03 * rng.normal());
                let step = Vector6::new(0.12, 0.02, 0.03, 0.0, 0.02, 0.0) * f64::from(k);
                Se3::exp(&(step + wobble))
            })
            .collect(),
        disparity: (0..7).map(|_| plane(&mut rng)).collect(),
        sensor: (0..7)
            .map(|_| {
                plane(&mut rng)
                    .into_iter()
                    .map(|d| if d < 0.4 { 0.0 } else { d })
                    .collect()
            })
            .collect(),
    }
}

/// Edges over up to three frames, one pair twice; targets a few pixels off, a tenth of them far
/// off.
fn factors(geometry: &Geometry<f64>) -> Vec<Factor<f64>> {
    let mut rng = CounterRng::new(3, 2, 0);
    let mut pairs: Vec<(usize, usize)> = (0..7_usize)
        .flat_map(|i| (0..7).map(move |j| (i, j)))
        .filter(|&(i, j)| i != j && i.abs_diff(j) < 4)
        .collect();
    pairs.push((2, 3));
    pairs
        .into_iter()
        .map(|(source, target)| {
            let g = geometry.relative(source, target);
            let mut out = Factor {
                source,
                target,
                target_px: Default::default(),
                weight: Default::default(),
            };
            for (n, &d) in geometry.disparity[source].iter().enumerate() {
                let (u, v) = ((n % 21) as f64, (n / 21) as f64);
                let p = project(&g, &geometry.lens, 1.0, u, v, d).pixel;
                let far = if rng.uniform() < 0.1 { 20.0 } else { 1.0 };
                for k in 0..2 {
                    out.target_px[k].push(p[k] + 0.4 * far * rng.normal());
                    out.weight[k].push(20.0 * rng.uniform());
                }
            }
            out
        })
        .collect()
}

pub(crate) fn narrow(planes: &[Vec<f64>]) -> Vec<Vec<f32>> {
    planes
        .iter()
        .map(|p| p.iter().map(|&x| x as f32).collect())
        .collect()
}

pub(crate) fn narrow_geometry(g: &Geometry<f64>) -> Geometry<f32> {
    Geometry {
        grid: g.grid,
        lens: g.lens,
        poses: g.poses.clone(),
        disparity: narrow(&g.disparity),
        sensor: narrow(&g.sensor),
    }
}

pub(crate) fn narrow_factors(factors: &[Factor<f64>]) -> Vec<Factor<f32>> {
    let pair = |p: &[Vec<f64>; 2]| p.clone().map(|p| p.into_iter().map(|x| x as f32).collect());
    factors
        .iter()
        .map(|f| Factor {
            source: f.source,
            target: f.target,
            target_px: pair(&f.target_px),
            weight: pair(&f.weight),
        })
        .collect()
}

fn options() -> Vec<DbaOptions> {
    let one = DbaOptions {
        iterations: 1,
        ..DbaOptions::default()
    };
    let focal = DbaOptions {
        free: Free::PosesDepthAndFocal,
        ..one
    };
    vec![
        one,
        focal,
        DbaOptions {
            free: Free::Poses,
            cauchy_px: Some(0.7),
            ..one
        },
        DbaOptions {
            cauchy_px: Some(1.0),
            prior_alpha: None,
            ..focal
        },
        DbaOptions {
            iterations: 2,
            python_twin: true,
            ..focal
        },
    ]
}

/// The fast path on `level`, with the edges and damping of this file.
fn fast(level: Level, window: std::ops::Range<usize>, options: &DbaOptions) -> Geometry<f32> {
    let start = geometry();
    let factors = narrow_factors(&factors(&start));
    let edges: Vec<&Factor<f32>> = factors.iter().collect();
    let problem = Problem {
        edges: &edges,
        eta: &vec![vec![0.01; start.grid.len()]; 7],
    };
    let mut got = narrow_geometry(&start);
    let report = adjust_on(level, &mut got, &problem, window, options).expect("a sound problem");
    assert_eq!(report.failed, 0);
    assert!(report.rms_px > 0.1, "{report:?}");
    got
}

#[test]
fn the_fast_path_agrees_with_the_reference_on_every_level() {
    let start = geometry();
    let factors = factors(&start);
    let edges: Vec<&Factor<f64>> = factors.iter().collect();
    let eta = vec![vec![0.01; start.grid.len()]; 7];
    let problem = Problem {
        edges: &edges,
        eta: &eta,
    };
    for (case, options) in options().into_iter().enumerate() {
        for window in [1..7, 2..5] {
            let mut want = start.clone();
            let failed = adjust_reference(&mut want, &problem, window.clone(), &options)
                .expect("a sound problem");
            assert_eq!(failed, 0);
            m4_testkit::on_every_level(
                &SimdLevel::available(),
                SimdLevel::name,
                &["sse2", "avx2", "avx512"],
                |level| {
                    let got = fast(level.level(), window.clone(), &options);
                    let what = format!("case {case}, window {window:?}, {}", level.name());
                    for k in 0..7 {
                        let moved = (want.poses[k].matrix() - start.poses[k].matrix()).amax();
                        let off = (got.poses[k].matrix() - want.poses[k].matrix()).amax();
                        assert!(off < 2e-5, "{what}: pose {k} is off by {off:e}");
                        assert_eq!(
                            moved > 1e-3,
                            window.contains(&k),
                            "{what}: pose {k} moved by {moved:e}"
                        );
                    }
                    if options.free.depth() {
                        let got: Vec<f64> =
                            got.disparity.concat().into_iter().map(f64::from).collect();
                        let (before, after) = (start.disparity.concat(), want.disparity.concat());
                        let step = |after: &[f64]| -> Vec<f64> {
                            after.iter().zip(&before).map(|(a, b)| a - b).collect()
                        };
                        m4_testkit::assert_gradient(&what, &step(&got), &step(&after), 1e-4);
                    }
                    if options.free.focal() {
                        let (got, want) =
                            (got.lens.fx - start.lens.fx, want.lens.fx - start.lens.fx);
                        assert!(want.abs() > 1e-3, "{what}: the focal length stayed");
                        let off = (got / want - 1.0).abs();
                        assert!(
                            off < 1e-3,
                            "{what}: focal length moved by {got}, not {want}"
                        );
                    }
                },
            );
        }
    }
}

#[test]
fn the_number_of_threads_does_not_change_a_bit() {
    let options = options()[1];
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        pool.install(|| fast(Level::new(), 1..7, &options))
    };
    let one = run(1);
    for threads in [2, 5] {
        assert_eq!(run(threads), one, "{threads} threads");
    }
}

#[test]
fn jacobians_match_central_differences() {
    let g = Se3::exp(&Vector6::new(0.4, -0.2, 0.1, 0.2, -0.3, 0.1));
    let source = Se3::exp(&Vector6::new(-0.3, 0.1, 0.6, -0.1, 0.2, 0.4));
    let lens = geometry().lens;
    let rate = lens.fy / lens.fx;
    let (u, v, d) = (3.0, 11.0, 0.7);
    // Source twist, target twist, disparity, focal parameter.
    let at = |x: &[f64]| {
        let i = Se3::exp(&Vector6::from_column_slice(&x[..6])).compose(&source);
        let j = Se3::exp(&Vector6::from_column_slice(&x[6..12])).compose(&g.compose(&source));
        let moved = lens.with_focal_step(x[13]);
        project(&j.compose(&i.inverse()), &moved, rate, u, v, d + x[12]).pixel
    };
    let p = project(&g, &lens, rate, u, v, d);
    for k in 0..2 {
        let mut got: Vec<f64> = p.by_source.row(k).iter().copied().collect();
        got.extend(p.by_target.row(k).iter());
        got.extend([p.by_disparity[k], p.by_focal[k]]);
        let want = m4_testkit::central_differences(&[0.0; 14], 1e-6, |x| at(x)[k]);
        m4_testkit::assert_gradient("projection", &got, &want.gradient, 1e-7);
    }
}

#[test]
fn indefinite_system_changes_nothing_and_is_reported() {
    let start = narrow_geometry(&geometry());
    let factors = narrow_factors(&factors(&geometry()));
    let edges: Vec<&Factor<f32>> = factors.iter().collect();
    let problem = Problem {
        edges: &edges,
        eta: &vec![vec![0.01; start.grid.len()]; 7],
    };
    let options = DbaOptions {
        ep: -1e9,
        ..DbaOptions::default()
    };
    let mut got = start.clone();
    let report = adjust(&mut got, &problem, 1..7, &options).expect("a sound problem");
    assert_eq!((report.failed, report.iterations), (2, 2));
    assert_eq!(got, start);
}

#[test]
fn mismatched_input_is_rejected() {
    let mut start = narrow_geometry(&geometry());
    let mut factors = narrow_factors(&factors(&geometry()));
    let eta = vec![vec![0.01; start.grid.len()]; 7];
    factors[3].target = 7;
    let edges: Vec<&Factor<f32>> = factors.iter().collect();
    let problem = Problem {
        edges: &edges,
        eta: &eta,
    };
    let refused = |start: &mut Geometry<f32>, problem: &Problem<'_, f32>, window| {
        let error = adjust(start, problem, window, &DbaOptions::default())
            .expect_err("input that does not fit");
        error.to_string()
    };
    assert!(refused(&mut start, &problem, 1..7).contains("edge 3"));
    let edges = &edges[..3];
    let problem = Problem { edges, eta: &eta };
    assert!(refused(&mut start, &problem, 1..8).contains("window 1..8"));
    start.disparity[2].pop();
    assert!(refused(&mut start, &problem, 1..7).contains("disparity of frame 2 has"));
}

#[test]
fn the_lower_of_two_middle_values_counts() {
    assert_eq!(lower_median(&mut [4.0_f64, 1.0, 3.0, 2.0]), 2.0);
    assert_eq!(lower_median::<f64>(&mut []), 0.0);
}

#[test]
fn a_turning_camera_keeps_its_prior_and_its_focal_length() {
    let turning = Observability {
        depth: 0.0,
        focal: 49.0,
    };
    assert_eq!(
        (turning.focal_is_seen(), turning.prior_alpha(1e-5)),
        (false, Some(1e-5))
    );
    let walking = Observability {
        depth: 25.0,
        focal: 50.0,
    };
    assert_eq!(
        (walking.focal_is_seen(), walking.prior_alpha(1e-5)),
        (true, None)
    );
}
