use super::{HEADER_BYTES, PayloadError, bytes_per_splat, decode, encode};
use super::{Linear, Sinh, rotation_code, rotation_value};
use m4_core::{Column, CounterRng, Exposure, Intrinsics, Scene, SourceFrame, SplatLayout, Splats};
use m4_testkit::{SceneSpec, camera_looking_at, random_splats};

const FRAMES: usize = 10;

fn scene(layout: SplatLayout, n_static: usize, n_dynamic: usize) -> Scene {
    let camera = camera_looking_at(
        Intrinsics::centred(160, 120, 140.0),
        [0.3, 0.1, -0.5],
        [0.0, 0.0, 4.0],
    );
    let spec = SceneSpec {
        layout,
        n_static,
        n_dynamic,
        time_frames: FRAMES,
        ..SceneSpec::default()
    };
    let source = (0..FRAMES).map(|i| SourceFrame {
        camera,
        t: i as f64,
        exposure: Exposure::IDENTITY,
        distance_sigma: None,
    });
    Scene {
        splats: random_splats(5, &camera, &spec),
        background: [0.1, 0.2, 0.3],
        time_frames: FRAMES,
        duration_s: Some(1.5),
        mip: true,
        near: 0.05,
        source: source.collect(),
    }
}

fn layouts() -> impl Iterator<Item = SplatLayout> {
    let degrees = [(0, 0), (1, 0), (3, 2), (0, 1)];
    degrees.into_iter().flat_map(|(sh_degree, time_degree)| {
        [false, true].map(|isotropic| SplatLayout {
            isotropic,
            sh_degree,
            time_degree,
        })
    })
}

/// Largest difference of a column, after a map of both.
fn farthest(a: &Splats, b: &Splats, column: Column, map: impl Fn(f64) -> f64) -> f64 {
    let mut most = 0.0f64;
    for k in 0..a.layout().range(column).len() {
        for (x, y) in a.column(column, k).iter().zip(b.column(column, k)) {
            most = most.max((map(f64::from(*x)) - map(f64::from(*y))).abs());
        }
    }
    most
}

#[test]
fn every_layout_comes_back_within_half_a_step() {
    for layout in layouts() {
        let scene = scene(layout, 70, 50);
        let payload = encode(&scene, 4.0);
        assert_eq!((payload.n_static, payload.n_dynamic), (70, 50));
        let (a, b) = bytes_per_splat(layout);
        assert_eq!(payload.bytes.len(), HEADER_BYTES + 70 * a + 50 * b);
        let back = decode(&payload.bytes).unwrap();
        let splats = &scene.splats;
        assert_eq!(back.layout(), layout);
        let same = |v| v;
        // 6 units away one pixel in 140 is 0.043 units; a 64th of that is half a step
        assert!(farthest(splats, &back, Column::Mean, same) < 0.043 / 60.0);
        assert!(farthest(splats, &back, Column::LogScale, same) < 0.0276);
        assert!(farthest(splats, &back, Column::Colour, |v| 0.282_095 * v) < 0.00197);
        let sigmoid = |v: f64| 1.0 / (1.0 + (-v).exp());
        assert!(farthest(splats, &back, Column::Opacity, sigmoid) < 0.00197);
        assert!(farthest(splats, &back, Column::TimeMean, same) < 1e-3);
        assert!(farthest(splats, &back, Column::LogTimeSd, same) < 0.01);
        // in the ten frames of the clip no splat is off by more than a 64th of a pixel or of its
        // way
        for k in 0..3 {
            let columns = splats
                .column(Column::Velocity, k)
                .iter()
                .zip(back.column(Column::Velocity, k));
            for (v, w) in columns {
                assert!(
                    10.0 * (v - w).abs() < (4.0 / 140.0 + 10.0 * v.abs()) / 60.0,
                    "{v} {w}"
                );
            }
        }
    }
}

#[test]
fn rotations_come_back_with_either_sign_and_any_length() {
    let mut rng = CounterRng::new(9, 1, 0);
    for _ in 0..2000 {
        let quat: [f32; 4] = std::array::from_fn(|_| (3.0 * rng.normal()) as f32);
        let back = rotation_value(rotation_code(quat));
        let length = quat.iter().map(|v| v * v).sum::<f32>().sqrt();
        let dot: f32 = quat.iter().zip(back).map(|(a, b)| a / length * b).sum();
        // half of the angle, radians: three halves of a step (sqrt(2) / 1023), and as much as all
        // of them together on the component that is left out, where all four are alike
        assert!(dot.abs().min(1.0).acos() < 0.0025, "{quat:?} {back:?}");
        assert!((back.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5);
    }
    assert_eq!(
        rotation_value(rotation_code([0.0; 4]))[0],
        rotation_value(rotation_code([5.0, 0.0, 0.0, 0.0]))[0]
    );
}

#[test]
fn codes_stay_in_their_bytes() {
    let sinh = Sinh::mean(1.0, 0.1, 1e-5);
    for value in [f32::MAX, f32::MIN, 0.0, 1.0, 1e-30] {
        assert!(sinh.code(value) < 1 << 24);
    }
    assert_eq!(sinh.value(sinh.code(1.0)), 1.0);
    let linear = Linear::over([3.0, -1000.0, 2.0].into_iter(), 255.0, 0.05);
    assert_eq!(linear.code(3.0), 255);
    assert_eq!(linear.code(-1000.0), 0, "what is too small is raised");
    assert!((linear.value(linear.code(2.0)) - 2.0).abs() <= 0.025);
    let one = Linear::over([4.0, 4.0].into_iter(), 255.0, 0.05);
    assert_eq!(one.value(one.code(4.0)), 4.0);
}

#[test]
fn invisible_splats_are_left_out_of_the_payload() {
    let layout = SplatLayout {
        isotropic: true,
        sh_degree: 0,
        time_degree: 0,
    };
    let mut scene = scene(layout, 4, 5);
    let splats = &mut scene.splats;
    splats.column_mut(Column::Opacity, 0)[1] = -5.6; // 0.0037 < 1/255
    splats.column_mut(Column::Mean, 2)[2] = f32::NAN;
    let (time, sd) = ([-6.0, -0.5, 30.0, 4.0, 9.3], [2.0f32, 0.3, 4.0, 1.0, 0.3]);
    for (i, (time, sd)) in time.into_iter().zip(sd).enumerate() {
        splats.column_mut(Column::TimeMean, 0)[i] = time;
        splats.column_mut(Column::LogTimeSd, 0)[i] = sd.ln();
    }
    // the first lives until -6 + 2.448 x 2 < 0, the third from 20.2 on; the last row is too faint
    splats.column_mut(Column::Opacity, 0)[7] = -6.0;
    let payload = encode(&scene, 4.0);
    assert_eq!((payload.n_static, payload.n_dynamic), (2, 2));
    let back = decode(&payload.bytes).unwrap();
    let times = back.column(Column::TimeMean, 0);
    assert!(
        (times[0] + 0.5).abs() < 1e-3 && (times[1] - 9.3).abs() < 1e-3,
        "{times:?}"
    );
}

#[test]
fn an_empty_scene_round_trips() {
    let layout = SplatLayout {
        isotropic: false,
        sh_degree: 0,
        time_degree: 0,
    };
    let mut scene = scene(layout, 0, 0);
    scene.source.clear();
    let payload = encode(&scene, f64::NAN);
    assert_eq!(payload.bytes.len(), HEADER_BYTES);
    assert_eq!(decode(&payload.bytes).unwrap().n(), 0);
}

#[test]
fn other_bytes_are_errors() {
    let layout = layouts().next().unwrap();
    let good = encode(&scene(layout, 3, 2), 4.0).bytes;
    let with = |at: usize, byte: u8| {
        let mut bytes = good.clone();
        bytes[at] = byte;
        decode(&bytes).unwrap_err()
    };
    assert!(matches!(with(0, b'X'), PayloadError::Header(_)));
    assert!(matches!(with(4, 3), PayloadError::Version(3)));
    assert!(matches!(with(16, 4), PayloadError::Degree { .. }));
    assert!(matches!(with(8, 200), PayloadError::Length { .. }));
    assert!(
        matches!(with(15, 255), PayloadError::Length { .. }),
        "no overflow, no allocation"
    );
    assert!(matches!(
        decode(&good[..good.len() - 1]),
        Err(PayloadError::Length { .. })
    ));
    assert!(matches!(
        decode(&good[..100]),
        Err(PayloadError::Header(100))
    ));
    let mut infinite = good.clone();
    infinite[24..32].copy_from_slice(&f64::INFINITY.to_le_bytes());
    assert!(matches!(
        decode(&infinite),
        Err(PayloadError::Number { index: 0, .. })
    ));
}
