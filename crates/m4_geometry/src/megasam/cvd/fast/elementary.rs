//! Logarithm and exponential without branches: loops over them become vector code, as loops over the standard library's do
//! not. Polynomials of the Cephes library (Moshier), 2e-7 relative.

/// The natural logarithm of a positive, normal number.
#[inline(always)]
pub(super) fn ln(x: f32) -> f32 {
    // the mantissa between sqrt(1/2) and sqrt(2)
    const ROOT: u32 = 0x3f35_04f3;
    let shifted = x.to_bits().wrapping_sub(ROOT);
    let e = ((shifted as i32) >> 23) as f32;
    let f = f32::from_bits((shifted & 0x007f_ffff) + ROOT) - 1.0;
    let mut p = 7.037_684e-2;
    p = p * f - 1.151_461e-1;
    p = p * f + 1.167_699_9e-1;
    p = p * f - 1.242_014_1e-1;
    p = p * f + 1.424_932_3e-1;
    p = p * f - 1.666_805_8e-1;
    p = p * f + 2.000_071_5e-1;
    p = p * f - 2.499_999_4e-1;
    p = p * f + 3.333_333e-1;
    let square = f * f;
    let low = p * square * f - 2.121_944_4e-4 * e - 0.5 * square;
    (f + low) + 0.693_359_4 * e
}

/// `e^x` for `x` of 0 or less; 1e-35 and the like become about that.
#[inline(always)]
pub(super) fn exp(x: f32) -> f32 {
    let x = if x > -80.0 { x } else { -80.0 };
    // adding 1.5 * 2^23 rounds, and leaves the whole number in the low bits
    let magic = 12_582_912.0;
    let shifted = x * std::f32::consts::LOG2_E + magic;
    let n = shifted - magic;
    let r = (x - n * 0.693_359_4) + n * 2.121_944_4e-4;
    let mut p = 1.987_569_1e-4;
    p = p * r + 1.398_199_9e-3;
    p = p * r + 8.333_452e-3;
    p = p * r + 4.166_579_6e-2;
    p = p * r + 1.666_666_5e-1;
    p = p * r + 5.0e-1;
    let y = p * r * r + r + 1.0;
    f32::from_bits(y.to_bits().wrapping_add(shifted.to_bits() << 23))
}

#[cfg(test)]
mod tests {
    use super::{exp, ln};

    #[test]
    fn elementary_functions_match_the_standard_library() {
        for k in 0..200_000 {
            let x = 1e-4 * 1.000_12f64.powi(k % 150_000) as f32;
            let want = f64::from(x).ln();
            assert!((f64::from(ln(x)) - want).abs() <= 2e-7 * want.abs().max(0.5), "ln {x}");
            let y = -60.0 * k as f32 / 200_000.0;
            let want = f64::from(y).exp();
            assert!((f64::from(exp(y)) - want).abs() <= 5e-7 * want, "exp {y}");
        }
        assert_eq!((ln(1.0), exp(0.0)), (0.0, 1.0));
        assert!(exp(-1e9) < 1e-30);
    }
}
