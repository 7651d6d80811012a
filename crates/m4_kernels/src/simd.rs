//! The helpers shared by every `cpu.rs`.

use fearless_simd::{Simd, f32x16, prelude::*, u32x16};
pub(crate) use m4_core::dispatch;

/// Splats or pixels handled together, whatever the width of the machine's vectors.
pub(crate) const LANES: usize = 16;

/// One value in every lane.
#[inline(always)]
pub(crate) fn all<S: Simd>(s: S, value: f32) -> f32x16<S> {
    f32x16::splat(s, value)
}

/// `each!(3, k => f(k))` is `[f(0), f(1), f(2)]`. As `std::array::from_fn`, but certain to be
/// compiled for the vector instructions of the function it stands in: a closure need not be.
macro_rules! each {
    (@at $i:ident, $value:expr; $($k:literal)*) => {
        [$({
            let $i = $k;
            $value
        }),*]
    };
    (2, $i:ident => $value:expr) => { each!(@at $i, $value; 0 1) };
    (3, $i:ident => $value:expr) => { each!(@at $i, $value; 0 1 2) };
    (4, $i:ident => $value:expr) => { each!(@at $i, $value; 0 1 2 3) };
    ($n:expr, $i:ident => $value:expr) => {{
        let mut out = [{
            let $i = 0;
            $value
        }; $n];
        for at in 1..$n {
            out[at] = {
                let $i = at;
                $value
            };
        }
        out
    }};
}
pub(crate) use each;

/// One value in every lane, three times.
#[inline(always)]
pub(crate) fn all3<S: Simd>(s: S, values: &[f32; 3]) -> [f32x16<S>; 3] {
    [all(s, values[0]), all(s, values[1]), all(s, values[2])]
}

/// `column[at..at + LANES]`; past the end of the column the last lanes hold `fill`.
#[inline(always)]
pub(crate) fn load<S: Simd>(s: S, column: &[f32], at: usize, fill: f32) -> f32x16<S> {
    match column.get(at..at + LANES) {
        Some(whole) => f32x16::from_slice(s, whole),
        None => f32x16::from_slice(s, &end_of(column, at, fill)),
    }
}

/// Rows that are fetched together, see [`touch`].
pub(crate) const FETCH_ROWS: usize = 8 * LANES;

/// Reads one value of each cache line of `column[at..at + FETCH_ROWS]`. More columns than the
/// processor follows on its own come into the cache much faster in such bunches of independent
/// reads than line by line when they are needed.
#[inline(always)]
pub(crate) fn touch(column: &[f32], at: usize) {
    let rows = &column[at.min(column.len())..column.len().min(at + FETCH_ROWS)];
    for value in rows.iter().step_by(LANES) {
        // one after the other: of a sum the compiler makes gathers, which are slower
        std::hint::black_box(*value);
    }
}

/// Writes the lanes that fall into `column`.
#[inline(always)]
pub(crate) fn store<S: Simd>(value: f32x16<S>, column: &mut [f32], at: usize) {
    match column.get_mut(at..at + LANES) {
        Some(whole) => value.store_slice(whole),
        None => store_end(column, at, &value.to_array()),
    }
}

// Cold, so that the compiler saves registers for these calls on this path alone.
#[cold]
#[inline(never)]
fn end_of(column: &[f32], at: usize, fill: f32) -> [f32; LANES] {
    let mut lanes = [fill; LANES];
    let rest = &column[at.min(column.len())..];
    lanes[..rest.len()].copy_from_slice(rest);
    lanes
}

#[cold]
#[inline(never)]
fn store_end(column: &mut [f32], at: usize, lanes: &[f32; LANES]) {
    let at = at.min(column.len());
    let rest = &mut column[at..];
    let len = rest.len();
    rest.copy_from_slice(&lanes[..len]);
}

/// Rows to columns: lane `k` of `out[i]` is lane `i` of `rows[k]`.
#[inline(always)]
pub(crate) fn turn<S: Simd>(rows: &[f32x16<S>; LANES]) -> [f32x16<S>; LANES] {
    // a perfect shuffle rotates the eight bits of (row, lane) by one place
    let mut turned = *rows;
    for _ in 0..4 {
        let old = turned;
        for k in 0..LANES / 2 {
            turned[2 * k] = old[k].zip_low(old[k + LANES / 2]);
            turned[2 * k + 1] = old[k].zip_high(old[k + LANES / 2]);
        }
    }
    turned
}

/// Rows to columns: `out[i][k]` is lane `i` of `rows[k]`.
#[inline(always)]
pub(crate) fn transpose<S: Simd>(rows: &[f32x16<S>; LANES]) -> [[f32; LANES]; LANES] {
    let turned = turn(rows);
    each!(LANES, k => turned[k].to_array())
}

/// `2^x` for `x` in `-125..=127`, within 2e-7 of itself; the caller clamps.
#[inline(always)]
pub(crate) fn exp2<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
    // adding 1.5 * 2^23 leaves round(x) in the low bits of the mantissa
    let magic = all(s, 12_582_912.0);
    let shifted = x + magic;
    let f = x - (shifted - magic);
    let p = all(s, 0.001_327_646)
        .mul_add(f, all(s, 0.009_675_541))
        .mul_add(f, all(s, 0.055_507_133))
        .mul_add(f, all(s, 0.240_221_2))
        .mul_add(f, all(s, 0.693_146_95))
        .mul_add(f, all(s, 1.0));
    let exponent: u32x16<S> = shifted.to_bits();
    f32x16::from_bits(p.to_bits() + (exponent << 23u32))
}

/// `e^x`, within 1e-6 of itself for `|x| < 20`; saturates near 2^-125 and 2^127. NaN stays NaN, so
/// that a broken parameter leaves its splat out instead of passing for a number.
#[inline(always)]
pub(crate) fn exp<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
    let y = x * all(s, std::f32::consts::LOG2_E);
    let power = exp2(s, y.max(all(s, -125.0)).min(all(s, 127.0)));
    x.simd_eq(x).select(power, x)
}

/// `e^x - 1` for `x <= 0`, within 2e-7 of itself.
#[inline(always)]
pub(crate) fn exp_m1<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
    let x = x.max(all(s, -80.0));
    let k = (x * all(s, std::f32::consts::LOG2_E)).round_ties_even();
    // ln 2 in two parts, so that nothing is lost where the result is small
    let f = k.mul_add(all(s, -1.428_606_8e-6), k.mul_add(all(s, -0.693_145_75), x));
    let p = all(s, 1.0 / 5040.0)
        .mul_add(f, all(s, 1.0 / 720.0))
        .mul_add(f, all(s, 1.0 / 120.0))
        .mul_add(f, all(s, 1.0 / 24.0))
        .mul_add(f, all(s, 1.0 / 6.0))
        .mul_add(f, all(s, 0.5))
        .mul_add(f, all(s, 1.0))
        * f;
    let power = exp2(s, k);
    power.mul_add(p, power - all(s, 1.0))
}

/// `log2(x)` for normal `x` above 0, within 1e-7 of `1 + |log2 x|`.
#[inline(always)]
pub(crate) fn log2<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
    // x = 2^k m with m in [sqrt(1/2), sqrt(2)), then log m = 2 atanh((m - 1) / (m + 1))
    let bits: u32x16<S> = x.to_bits();
    let half = u32x16::splat(s, 0x3f35_04f3);
    let k = (bits - half) >> 23u32;
    let m: f32x16<S> = f32x16::from_bits(bits - (k << 23u32));
    let k: fearless_simd::i32x16<S> = ((k << 24u32).bitcast::<fearless_simd::i32x16<S>>()) >> 24u32;
    let one = all(s, 1.0);
    let z = (m - one) / (m + one);
    let zz = z * z;
    let scale = 2.0 * std::f32::consts::LOG2_E;
    let p = all(s, scale / 9.0)
        .mul_add(zz, all(s, scale / 7.0))
        .mul_add(zz, all(s, scale / 5.0))
        .mul_add(zz, all(s, scale / 3.0))
        .mul_add(zz, all(s, scale));
    z.mul_add(p, k.to_float::<f32x16<S>>())
}

/// Sine and cosine of `turns` full turns, within 2e-7 for `|turns|` up to some thousands.
#[inline(always)]
pub(crate) fn sin_cos_turns<S: Simd>(s: S, turns: f32x16<S>) -> (f32x16<S>, f32x16<S>) {
    // half the angle lies in [-pi/2, pi/2], where the series converge fast; then double it
    let a = (turns - turns.round_ties_even()) * all(s, std::f32::consts::PI);
    let b = a * a;
    let k = |v: f64| all(s, v as f32);
    let sin = k(-1.0 / 39_916_800.0)
        .mul_add(b, k(1.0 / 362_880.0))
        .mul_add(b, k(-1.0 / 5_040.0))
        .mul_add(b, k(1.0 / 120.0))
        .mul_add(b, k(-1.0 / 6.0))
        .mul_add(b, k(1.0))
        * a;
    let cos = k(1.0 / 479_001_600.0)
        .mul_add(b, k(-1.0 / 3_628_800.0))
        .mul_add(b, k(1.0 / 40_320.0))
        .mul_add(b, k(-1.0 / 720.0))
        .mul_add(b, k(1.0 / 24.0))
        .mul_add(b, k(-0.5))
        .mul_add(b, k(1.0));
    let twice = sin + sin;
    (twice * cos, k(1.0) - twice * sin)
}

/// `1 / (1 + e^-x)`.
#[inline(always)]
pub(crate) fn sigmoid<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
    let one = all(s, 1.0);
    one / (one + exp(s, -x))
}

/// `a . b` of two 3-vectors.
#[inline(always)]
pub(crate) fn dot<S: Simd>(a: &[f32x16<S>; 3], b: &[f32x16<S>; 3]) -> f32x16<S> {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

/// The lanes of a mask that are set, as bits.
#[inline(always)]
pub(crate) fn bits<S: Simd>(mask: fearless_simd::mask32x16<S>) -> u16 {
    mask.to_bitmask() as u16
}

/// The lanes of a set of bits, in order.
pub(crate) fn lanes(mut set: u16) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = set.trailing_zeros() as usize;
        set &= set.wrapping_sub(1);
        (lane < LANES).then_some(lane)
    })
}

#[cfg(test)]
mod tests {
    use super::{LANES, all, dispatch, exp, exp_m1, log2, sigmoid, sin_cos_turns};
    use fearless_simd::{Simd, f32x16, prelude::*};
    use m4_core::SimdLevel;

    #[inline(always)]
    fn each<S: Simd>(s: S, x: f32) -> [f32; 6] {
        let v = all(s, x);
        let first = |v: f32x16<S>| v[LANES - 1];
        let (sin, cos) = sin_cos_turns(s, v);
        [
            first(exp(s, v)),
            first(log2(s, v.max(all(s, 1e-30)))),
            first(sin),
            first(cos),
            first(sigmoid(s, v)),
            first(exp_m1(s, v.min(-v))),
        ]
    }

    #[test]
    fn functions_match_those_of_f64() {
        for level in SimdLevel::available() {
            for k in -4000..=4000 {
                let x = k as f32 * 0.00497;
                let got = dispatch!(level.level(), s => each(s, x));
                let d = f64::from(x);
                let turn = d * std::f64::consts::TAU;
                let want = [
                    d.exp(),
                    d.max(1e-30).log2(),
                    turn.sin(),
                    turn.cos(),
                    1.0 / (1.0 + (-d).exp()),
                    (-d.abs()).exp_m1(),
                ];
                let scale = [
                    want[0],
                    1.0 + want[1].abs(),
                    1.0 + d.abs(),
                    1.0 + d.abs(),
                    want[4],
                    want[5].abs().max(1e-30),
                ];
                for i in 0..6 {
                    let error = (f64::from(got[i]) - want[i]).abs() / scale[i];
                    assert!(
                        error < 2e-6,
                        "{level}: function {i} of {x}: {} where {} was expected",
                        got[i],
                        want[i]
                    );
                }
            }
        }
    }

    #[test]
    fn a_level_that_does_not_exist_is_an_error_that_names_those_that_do() {
        let error = SimdLevel::named("avx1024").unwrap_err();
        assert!(
            error.to_string().contains(SimdLevel::available()[0].name()),
            "{error}"
        );
        for level in SimdLevel::available() {
            assert_eq!(SimdLevel::named(level.name()), Ok(level));
        }
    }
}
