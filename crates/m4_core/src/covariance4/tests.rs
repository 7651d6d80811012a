use super::{Covariance4, Covariance4Error, Slice3, VelocityForm};
use crate::{
    CounterRng,
    nalgebra::{Matrix4, Vector3, Vector4},
};
use crate::{SplatLayout, Splats};

fn rotor(index: u64) -> Covariance4<f64> {
    let mut rng = CounterRng::new(1, 0, index);
    let mean = std::array::from_fn(|_| rng.normal());
    let log_scale = Vector4::from_fn(|_, _| -2.0 * rng.uniform());
    let left = Vector4::from_fn(|_, _| rng.normal());
    let right = Vector4::from_fn(|_, _| rng.normal());
    Covariance4::from_rotor(mean, &log_scale, &left, &right, rng.normal(), vec![[0.1, 0.2, 0.3]])
}

fn assert_slices(a: &Slice3<f64>, b: &Slice3<f64>) {
    assert!((a.mean - b.mean).norm() < 1e-12 * (1.0 + a.mean.norm()), "{a:?} {b:?}");
    assert!((a.covariance - b.covariance).norm() < 1e-12, "{a:?} {b:?}");
    assert!((a.marginal - b.marginal).abs() < 1e-12, "{a:?} {b:?}");
}

#[test]
fn both_forms_are_one_model() {
    for index in 0..500 {
        let form = rotor(index);
        let velocity = form.to_velocity().unwrap();
        let back = velocity.to_covariance4();
        assert!((back.matrix() - form.matrix()).norm() < 1e-12, "{form:?}");
        assert_eq!(
            (back.mean, back.opacity, &back.colour),
            (form.mean, form.opacity, &form.colour)
        );
        for t in [-2.0, -0.3, 0.0, 0.5, 1.7] {
            let t = form.mean[3] + t;
            assert_slices(&form.slice(t), &velocity.slice(t));
        }
    }
}

#[test]
fn a_slice_is_the_conditional_of_the_joint_density() {
    let form = rotor(7);
    let precision = form.matrix().try_inverse().unwrap();
    let seen = form.slice(form.mean[3] + 0.4);
    let x = seen.mean + Vector3::new(0.1, -0.05, 0.02);
    let d = Vector4::new(x.x - form.mean[0], x.y - form.mean[1], x.z - form.mean[2], 0.4);
    let joint = d.dot(&(precision * d));
    let inverse = seen.covariance.try_inverse().unwrap();
    let conditional = (x - seen.mean).dot(&(inverse * (x - seen.mean)));
    assert!((joint - conditional + 2.0 * seen.marginal.ln()).abs() < 1e-9 * joint);
}

#[test]
fn equal_rotors_have_zero_velocity() {
    let q = Vector4::new(0.3, -0.4, 0.5, 0.6);
    let log_scale = Vector4::<f64>::new(-1.0, -0.5, -2.0, 0.7);
    let form = Covariance4::from_rotor([0.0; 4], &log_scale, &q, &q, 0.0, Vec::new());
    let velocity = form.to_velocity().unwrap();
    assert!(velocity.velocity.norm() < 1e-14 && (velocity.log_time_sd - 0.7).abs() < 1e-14);
}

#[test]
fn splats_keep_the_form() {
    let layout = SplatLayout {
        isotropic: false,
        sh_degree: 0,
        time_degree: 0,
    };
    let mut splats = Splats::zeros(layout, 3, 2);
    let form = rotor(3).to_velocity().unwrap();
    form.write(&mut splats, 1).unwrap();
    let read = VelocityForm::<f64>::from_splats(&splats, 1).unwrap();
    let (a, b) = (read.to_covariance4().matrix(), form.to_covariance4().matrix());
    assert!((a - b).norm() < 1e-6 * b.norm());
    assert!(form.write(&mut splats, 2).is_err() && VelocityForm::<f64>::from_splats(&splats, 2).is_err());
    let mut isotropic = Splats::zeros(
        SplatLayout {
            isotropic: true,
            ..layout
        },
        0,
        1,
    );
    assert!(form.write(&mut isotropic, 0).is_err());
    assert_eq!(VelocityForm::<f64>::from_splats(&isotropic, 0).unwrap().quat.x, 1.0);
}

#[test]
fn covariances_that_are_not_positive_definite_are_errors() {
    let mut m = Matrix4::<f64>::identity();
    m[(3, 3)] = 0.0;
    let error = |m: &Matrix4<f64>| {
        Covariance4::from_matrix([0.0; 4], m, 0.0, Vec::new())
            .to_velocity()
            .unwrap_err()
    };
    assert!(matches!(error(&m), Covariance4Error::Time { .. }));
    m[(3, 3)] = f64::NAN;
    assert!(matches!(error(&m), Covariance4Error::Time { .. }));
    m[(3, 3)] = 1.0;
    m[(1, 1)] = -1.0;
    assert!(matches!(error(&m), Covariance4Error::Space { .. }));
    m[(1, 1)] = f64::NAN;
    assert!(matches!(error(&m), Covariance4Error::Space { .. }));
}
