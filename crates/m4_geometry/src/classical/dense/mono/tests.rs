use super::{Mono, MonoDepth, MonoKind};
use crate::classical::dense::static_depth::Measured;
use m4_core::{CounterRng, Plane};

const W: usize = 40;
const H: usize = 30;

/// Ground that comes nearer downwards, and on its right half a thing twice as near that moves.
fn disparity(p: usize) -> f32 {
    let ground = 0.2 + 0.03 * (p / W) as f32;
    if moves(p) { 2.0 * ground } else { ground }
}

fn moves(p: usize) -> bool {
    (24..36).contains(&(p % W)) && (8..20).contains(&(p / W))
}

/// The true depth, in a disguise that differs from frame to frame; a column is unknown.
fn mono(kind: MonoKind) -> Mono {
    let map = |frame: usize| {
        let factor = 1.7 + frame as f32;
        Plane::from_fn(W, H, |x, y| {
            let d = disparity(y * W + x);
            match kind {
                _ if x == 3 => f32::NAN,
                MonoKind::UpToScale => factor / d,
                MonoKind::AffineDisparity => factor * (d - 0.15),
                MonoKind::Metric(unit) => unit / d,
            }
        })
    };
    read(kind, &[map(0), map(1)])
}

fn read(kind: MonoKind, maps: &[Plane<f32>]) -> Mono {
    let depth = MonoDepth { kind, maps };
    Mono {
        kind,
        frames: (0..maps.len()).map(|i| depth.at_size(i, (W, H))).collect(),
    }
}

fn dynamic() -> Vec<u8> {
    (0..W * H).map(|p| u8::from(moves(p))).collect()
}

/// Stereo that saw the upper two thirds, with 1 % of noise, and was wrong in a fifth of that.
fn measured() -> Measured {
    let mut rng = CounterRng::new(4, 0, 0);
    let is_visible = |p: usize| p / W < 20 && !moves(p);
    let disparity = (0..W * H).map(|p| {
        let wrong = if p % 5 == 0 { 1.6 } else { 1.0 };
        disparity(p) * wrong * (1.0 + 0.01 * rng.normal() as f32)
    });
    Measured {
        disparity: disparity.collect(),
        confidence: (0..W * H)
            .map(|p| if is_visible(p) { 1.0 } else { 0.0 })
            .collect(),
    }
}

#[test]
fn relative_depth_is_aligned_within_two_per_cent_whatever_its_kind() {
    for kind in [MonoKind::UpToScale, MonoKind::AffineDisparity] {
        let (mono, measured, dynamic) = (mono(kind), measured(), dynamic());
        for i in 0..2 {
            let aligned = mono
                .aligned(i, &measured.disparity, &measured.confidence, Some(&dynamic))
                .unwrap();
            for (p, d) in aligned.iter().enumerate() {
                assert_eq!(d.is_nan(), p % W == 3, "{kind:?} {p}");
                assert!(
                    d.is_nan() || (d / disparity(p) - 1.0).abs() < 0.02,
                    "{kind:?} {p}: {d}"
                );
            }
            // Below, where nothing was measured, it stands; above, measurements do.
            let with = mono.with_prior(i, &measured, Some(&dynamic));
            let (below, above) = (25 * W + 7, 10 * W + 7);
            assert!((with.disparity[below] / disparity(below) - 1.0).abs() < 0.02);
            assert!(with.confidence[below] > 0.0 && with.confidence[25 * W + 3] == 0.0);
            assert_eq!(with.disparity[above], measured.disparity[above]);
            // Dynamic regions get their own depth; the rest stays.
            let background = vec![0.3; W * H];
            let mut out = background.clone();
            mono.place_dynamic(
                i,
                &Measured {
                    confidence: vec![0.0; W * H],
                    ..measured.clone()
                },
                &background,
                &dynamic,
                &mut out,
            );
            assert_eq!(out, background, "nothing to align to");
            let background: Vec<f32> = (0..W * H)
                .map(|p| if moves(p) { 0.2 } else { disparity(p) })
                .collect();
            let mut out = background.clone();
            mono.place_dynamic(i, &measured, &background, &dynamic, &mut out);
            for (p, d) in out.iter().enumerate() {
                assert!((d / disparity(p) - 1.0).abs() < 0.02, "{kind:?} {p}: {d}");
            }
        }
    }
}

#[test]
fn metric_depth_is_taken_as_it_is() {
    let (mono, mut measured, dynamic) = (mono(MonoKind::Metric(3.0)), measured(), dynamic());
    mono.impose(1, &mut measured, Some(&dynamic));
    let mut out = vec![0.1; W * H];
    mono.overrule(1, &mut out);
    for p in 0..W * H {
        let has_depth = p % W != 3;
        assert_eq!(
            measured.confidence[p] == 1.0,
            !moves(p) && (has_depth || p / W < 20),
            "{p}"
        );
        assert!(
            !has_depth || moves(p) || (measured.disparity[p] / disparity(p) - 1.0).abs() < 1e-6
        );
        let want = if has_depth { disparity(p) } else { 0.1 };
        assert!((out[p] / want - 1.0).abs() < 1e-6, "{p}");
    }
    assert!(
        mono.aligned(1, &measured.disparity, &measured.confidence, None)
            .is_none()
    );
}

#[test]
fn without_parallax_relief_is_kept_at_distance_one() {
    let out = mono(MonoKind::UpToScale).without_parallax(1, vec![1.0; W * H]);
    let (a, b) = (5 * W + 7, 25 * W + 7);
    assert!((out[b] / out[a] / (disparity(b) / disparity(a)) - 1.0).abs() < 1e-5);
    let mut sorted = out.clone();
    sorted.sort_by(f32::total_cmp);
    assert!((sorted[W * H / 2] - 1.0).abs() < 0.05 && out[5 * W + 3] == 1.0);
    let nothing = Mono::default();
    assert_eq!(nothing.without_parallax(0, vec![1.5; 4]), [1.5; 4]);
    assert!(nothing.aligned(0, &[1.0; 4], &[1.0; 4], None).is_none());
}

#[test]
fn inverted_relief_is_not_used() {
    let measured = measured();
    let aligned = |slope: f32| {
        read(
            MonoKind::AffineDisparity,
            &[Plane::from_fn(W, H, |x, y| slope * disparity(y * W + x))],
        )
        .aligned(0, &measured.disparity, &measured.confidence, None)
    };
    assert!(aligned(-1.0).is_none());
    assert!(aligned(1.0).is_some());
}
