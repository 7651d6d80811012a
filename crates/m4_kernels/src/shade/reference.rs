//! The definition of the colour, forward and backward.

use super::{C0, C1, C2, C3};
use m4_core::{Real, nalgebra::Vector3};

/// Spatial harmonics of degree 3.
pub const MAX_TERMS: usize = 16;

/// What the colour of one splat depends on besides its coefficients.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sight<T: Real> {
    /// From the camera's centre to the shifted mean, world units, not 0.
    pub offset: Vector3<T>,
    /// `t - time_mean`, frames; 0 for static splats.
    pub dt: T,
    /// Period of the first temporal harmonic, frames.
    pub period: T,
    /// Spatial harmonics a temporal one: 1, 4, 9 or 16.
    pub sh_terms: usize,
}

/// The gradient of a loss with respect to the input of [`shade()`].
#[derive(Debug, Clone, PartialEq)]
pub struct ShadeGradient<T: Real> {
    /// With respect to the coefficients, same order.
    pub coefficients: Vec<[T; 3]>,
    /// With respect to [`Sight::offset`]; the camera's centre receives the opposite.
    pub offset: Vector3<T>,
    /// With respect to `time_mean` through the cosines alone; not through the offset.
    pub time_mean: T,
}

/// Real spherical harmonics up to degree 3 at a unit direction, and their gradients as polynomials.
pub fn harmonics<T: Real>(d: &Vector3<T>) -> ([T; MAX_TERMS], [Vector3<T>; MAX_TERMS]) {
    let (x, y, z) = (d.x, d.y, d.z);
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (zero, two, three, four, six, eight) = (
        T::zero(),
        T::of(2.0),
        T::of(3.0),
        T::of(4.0),
        T::of(6.0),
        T::of(8.0),
    );
    let c1 = T::of(C1);
    let c2 = C2.map(T::of);
    let c3 = C3.map(T::of);
    let value = [
        T::of(C0),
        -c1 * y,
        c1 * z,
        -c1 * x,
        c2[0] * x * y,
        c2[1] * y * z,
        c2[2] * (two * zz - xx - yy),
        c2[3] * x * z,
        c2[4] * (xx - yy),
        c3[0] * y * (three * xx - yy),
        c3[1] * x * y * z,
        c3[2] * y * (four * zz - xx - yy),
        c3[3] * z * (two * zz - three * xx - three * yy),
        c3[4] * x * (four * zz - xx - yy),
        c3[5] * z * (xx - yy),
        c3[6] * x * (xx - three * yy),
    ];
    let gradient = [
        Vector3::zeros(),
        Vector3::new(zero, -c1, zero),
        Vector3::new(zero, zero, c1),
        Vector3::new(-c1, zero, zero),
        Vector3::new(y, x, zero) * c2[0],
        Vector3::new(zero, z, y) * c2[1],
        Vector3::new(-two * x, -two * y, four * z) * c2[2],
        Vector3::new(z, zero, x) * c2[3],
        Vector3::new(two * x, -two * y, zero) * c2[4],
        Vector3::new(six * x * y, three * xx - three * yy, zero) * c3[0],
        Vector3::new(y * z, x * z, x * y) * c3[1],
        Vector3::new(-two * x * y, four * zz - xx - three * yy, eight * y * z) * c3[2],
        Vector3::new(
            -six * x * z,
            -six * y * z,
            six * zz - three * xx - three * yy,
        ) * c3[3],
        Vector3::new(four * zz - three * xx - yy, -two * x * y, eight * x * z) * c3[4],
        Vector3::new(two * x * z, -two * y * z, xx - yy) * c3[5],
        Vector3::new(three * xx - three * yy, -six * x * y, zero) * c3[6],
    ];
    (value, gradient)
}

/// Angular frequency of temporal harmonic `n`, radians per frame.
fn frequency<T: Real>(sight: &Sight<T>, n: usize) -> T {
    T::two_pi() * T::of(n as f64) / sight.period
}

/// The sum before the cut at 0.
fn raw<T: Real>(coefficients: &[[T; 3]], sight: &Sight<T>) -> [T; 3] {
    let (basis, _) = harmonics(&sight.offset.normalize());
    let mut sum = [T::of(0.5); 3];
    for (index, k) in coefficients.iter().enumerate() {
        let (n, l) = (index / sight.sh_terms, index % sight.sh_terms);
        let weight = (frequency(sight, n) * sight.dt).cos() * basis[l];
        for channel in 0..3 {
            sum[channel] += weight * k[channel];
        }
    }
    sum
}

/// Red, green and blue, at least 0 (Minute4D Eq. 2). `coefficients` hold a multiple of
/// [`Sight::sh_terms`] rows.
pub fn shade<T: Real>(coefficients: &[[T; 3]], sight: &Sight<T>) -> [T; 3] {
    raw(coefficients, sight).map(|c| if c > T::zero() { c } else { T::zero() })
}

/// Gradient with respect to coefficients, offset and `time_mean`, given that with respect to
/// [`shade()`].
pub fn shade_vjp<T: Real>(
    coefficients: &[[T; 3]],
    sight: &Sight<T>,
    g: &[T; 3],
) -> ShadeGradient<T> {
    let value = raw(coefficients, sight);
    let live: [T; 3] = std::array::from_fn(|c| {
        if value[c] > T::zero() {
            g[c]
        } else {
            T::zero()
        }
    });
    let distance = sight.offset.norm();
    let direction = sight.offset / distance;
    let (basis, slopes) = harmonics(&direction);
    let mut out = ShadeGradient {
        coefficients: vec![[T::zero(); 3]; coefficients.len()],
        offset: Vector3::zeros(),
        time_mean: T::zero(),
    };
    let mut d_direction = Vector3::zeros();
    for (index, k) in coefficients.iter().enumerate() {
        let (n, l) = (index / sight.sh_terms, index % sight.sh_terms);
        let omega = frequency(sight, n);
        let (cos, sin) = ((omega * sight.dt).cos(), (omega * sight.dt).sin());
        let pull = k[0] * live[0] + k[1] * live[1] + k[2] * live[2];
        out.coefficients[index] = live.map(|c| cos * basis[l] * c);
        d_direction += slopes[l] * (cos * pull);
        // d cos(omega (t - time_mean)) / d time_mean = + omega sin(omega dt)
        out.time_mean += omega * sin * basis[l] * pull;
    }
    out.offset = (d_direction - direction * direction.dot(&d_direction)) / distance;
    out
}
