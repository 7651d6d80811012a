//! Scenes and broken files for the tests of this crate.

use m4_core::{
    Camera, Column, CounterRng, Exposure, Intrinsics, Scene, Se3, SourceFrame, SplatLayout, Splats,
    nalgebra::{Matrix3, Vector3, Vector4, Vector6},
    quat,
};

/// One static and one moving splat, nothing symmetric, numbers that are easy by hand:
///
/// ```text
/// still   mean (1, 2, 6), ln scales -1 -2 -3, a quarter of a turn about y, opacity 0.8, c = (1, 0, -1)
/// moving  mean (-1, 0.5, 3) at frame 2, velocity (0.25, 0, -0.5), ln scales -4, no rotation,
///         opacity 0.5, sd in time 2 frames, c = (0, 2, 0.5)
/// ```
///
/// 9 frames in 2 seconds; the camera of frame i stands at (i, 0, 0) and looks along z.
pub fn asymmetric_scene(sh_degree: usize) -> Scene {
    let layout = SplatLayout {
        isotropic: false,
        sh_degree,
        time_degree: 0,
    };
    let mut splats = Splats::zeros(layout, 1, 1);
    let mut put = |column, offset, values: [f32; 2]| splats.column_mut(column, offset).copy_from_slice(&values);
    for (k, values) in [[1.0, -1.0], [2.0, 0.5], [6.0, 3.0]].into_iter().enumerate() {
        put(Column::Mean, k, values);
    }
    for (k, values) in [[-1.0, -4.0], [-2.0, -4.0], [-3.0, -4.0]].into_iter().enumerate() {
        put(Column::LogScale, k, values);
    }
    let h = std::f32::consts::FRAC_1_SQRT_2;
    // y a little more than w, so that which is the largest does not hang on rounding
    for (k, values) in [[h, 1.0], [0.0, 0.0], [h * 1.0001, 0.0], [0.0, 0.0]]
        .into_iter()
        .enumerate()
    {
        put(Column::Quat, k, values);
    }
    put(Column::Opacity, 0, [4f32.ln(), 0.0]);
    for (k, values) in [[1.0, 0.0], [0.0, 2.0], [-1.0, 0.5]].into_iter().enumerate() {
        put(Column::Colour, k, values);
    }
    splats.column_mut(Column::TimeMean, 0)[0] = 2.0;
    splats.column_mut(Column::LogTimeSd, 0)[0] = 2f32.ln();
    splats.column_mut(Column::Velocity, 0)[0] = 0.25;
    splats.column_mut(Column::Velocity, 2)[0] = -0.5;
    let source = (0..9)
        .map(|i| SourceFrame {
            camera: Camera {
                intrinsics: Intrinsics {
                    width: 64,
                    height: 48,
                    fx: 80.0,
                    fy: 75.0,
                    cx: 30.0,
                    cy: 25.0,
                },
                c2w: Se3 {
                    rotation: Matrix3::identity(),
                    translation: Vector3::new(f64::from(i), 0.0, 0.0),
                },
            },
            t: f64::from(i),
            exposure: Exposure::IDENTITY,
        })
        .collect();
    Scene {
        splats,
        background: [0.0; 3],
        time_frames: 9,
        duration_s: Some(2.0),
        mip: true,
        near: 0.25,
        source,
    }
}

/// Any numbers, the same on every run; 16 frames.
pub fn random_scene(sh_degree: usize, n_static: usize, n_dynamic: usize) -> Scene {
    let layout = SplatLayout {
        isotropic: false,
        sh_degree,
        time_degree: 0,
    };
    let mut splats = Splats::zeros(layout, n_static, n_dynamic);
    let mut rng = CounterRng::new(7, 3, (n_static + 1000 * n_dynamic) as u64);
    for (c, column) in splats.columns_mut().enumerate() {
        for v in column {
            let normal = rng.normal() as f32;
            *v = match c {
                c if layout.range(Column::LogScale).contains(&c) => normal - 4.0,
                c if layout.range(Column::Colour).contains(&c) => (0.4 * normal).clamp(-0.9, 0.9),
                c if layout.range(Column::TimeMean).contains(&c) => (8.0 + 4.0 * normal).clamp(0.0, 15.0),
                c if layout.range(Column::LogTimeSd).contains(&c) => 1.5 + 0.3 * normal,
                c if layout.range(Column::Velocity).contains(&c) => 0.05 * normal,
                _ => normal,
            };
        }
    }
    let source = (0..16)
        .map(|i| {
            let i = f64::from(i);
            SourceFrame {
                camera: Camera {
                    intrinsics: Intrinsics {
                        width: 64,
                        height: 48,
                        fx: 80.0,
                        fy: 75.0,
                        cx: 30.0,
                        cy: 25.0,
                    },
                    c2w: Se3::identity().retract(&Vector6::new(0.1 * i, -0.2, 0.05 * i, 0.02 * i, 0.3 - 0.01 * i, 0.1)),
                },
                t: i,
                exposure: Exposure::IDENTITY,
            }
        })
        .collect();
    Scene {
        splats,
        background: [0.2, 0.3, 0.4],
        time_frames: 16,
        duration_s: Some(0.5),
        mip: false,
        near: 0.05,
        source,
    }
}

/// Every value of a parameter within a tolerance.
pub fn assert_columns(got: &Splats, expected: &Splats, column: Column, tolerance: f32) {
    for c in 0..expected.layout().range(column).len() {
        for (i, (a, b)) in got.column(column, c).iter().zip(expected.column(column, c)).enumerate() {
            assert!((a - b).abs() <= tolerance, "{column:?} {c} of splat {i}: {a} and {b}");
        }
    }
}

/// Every rotation matrix within a tolerance: `q` and `-q` are one.
pub fn assert_rotations(got: &Splats, expected: &Splats, tolerance: f64) {
    let rotation = |s: &Splats, i: usize| {
        quat::rotation(&Vector4::from_fn(|k, _| f64::from(s.column(Column::Quat, k)[i])).normalize())
    };
    for i in 0..expected.n() {
        let off = (rotation(got, i) - rotation(expected, i)).amax();
        assert!(off <= tolerance, "rotation of splat {i} is off by {off}");
    }
}
