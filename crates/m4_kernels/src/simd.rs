//! Which vector instructions the kernels run on, and the helpers that every `cpu.rs` shares.

use fearless_simd::{Level, Simd, f32x16, prelude::*, u32x16};
use fearless_simd_macros::simd;

/// The environment variable that picks a level for a whole process: `sse2`, `avx2`, `avx512` (or
/// `neon` and so on, the names that [`SimdLevel::available`] gives).
pub const ENV: &str = "MINUTE4D_SIMD";

/// A level that was asked for cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("SIMD level {asked:?} cannot be used on this machine; choose one of: {}", available.join(", "))]
pub struct SimdLevelError {
    /// As it was written.
    pub asked: String,
    /// The names that would have worked.
    pub available: Vec<&'static str>,
}

/// A set of vector instructions that this machine has: holding one is the proof.
///
/// Results differ between levels in the last bits (fused or separate multiplication and addition),
/// and are the same on any number of threads and any machine with the same level.
#[derive(Debug, Clone, Copy)]
pub struct SimdLevel(Level);

impl SimdLevel {
    /// The level that [`ENV`] names, or else the best one.
    ///
    /// # Errors
    ///
    /// [`SimdLevelError`] if the variable names a level that this machine does not have.
    pub fn detect() -> Result<Self, SimdLevelError> {
        match std::env::var(ENV) {
            Ok(name) if !name.is_empty() => Self::named(&name),
            _ => Ok(Self::best()),
        }
    }

    /// The best level of this machine, whatever the environment says.
    #[must_use]
    pub fn best() -> Self {
        Self(Level::new())
    }

    /// The level of that [`name`](Self::name).
    ///
    /// # Errors
    ///
    /// [`SimdLevelError`] if this machine does not have it.
    pub fn named(name: &str) -> Result<Self, SimdLevelError> {
        let all = Self::available();
        all.iter()
            .find(|l| l.name().eq_ignore_ascii_case(name))
            .copied()
            .ok_or_else(|| SimdLevelError {
                asked: name.to_owned(),
                available: all.iter().map(|l| l.name()).collect(),
            })
    }

    /// Every level that this machine has, the baseline of its architecture first.
    #[must_use]
    pub fn available() -> Vec<Self> {
        let best = Level::new();
        #[cfg(target_arch = "x86_64")]
        {
            let sse2 = best.as_sse2().map(|t| t.level());
            let avx2 = best.as_avx2().map(|t| t.level());
            let avx512 = best.as_avx512().map(|t| t.level());
            [sse2, avx2, avx512].into_iter().flatten().map(Self).collect()
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            vec![Self(best)]
        }
    }

    /// `sse2`, `avx2`, `avx512`; on other architectures `neon`, `wasm128` or `portable`.
    #[must_use]
    pub fn name(self) -> &'static str {
        #[cfg(target_arch = "x86_64")]
        {
            if self.0.as_avx512().is_some() {
                "avx512"
            } else if self.0.as_avx2().is_some() {
                "avx2"
            } else {
                "sse2"
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            if cfg!(target_arch = "aarch64") {
                "neon"
            } else if cfg!(target_arch = "wasm32") {
                "wasm128"
            } else {
                "portable"
            }
        }
    }

    /// What `dispatch!` takes.
    pub(crate) fn level(self) -> Level {
        self.0
    }
}

impl PartialEq for SimdLevel {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

impl Eq for SimdLevel {}

impl std::fmt::Display for SimdLevel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// Splats or pixels handled together, whatever the width of the machine's vectors.
pub(crate) const LANES: usize = 16;

/// One value in every lane.
#[inline(always)]
pub(crate) fn all<S: Simd>(s: S, value: f32) -> f32x16<S> {
    f32x16::splat(s, value)
}

/// `column[at..at + LANES]`; past the end of the column the last lanes hold `fill`.
#[inline(always)]
pub(crate) fn load<S: Simd>(s: S, column: &[f32], at: usize, fill: f32) -> f32x16<S> {
    if let Some(whole) = column.get(at..at + LANES) {
        return f32x16::from_slice(s, whole);
    }
    let mut lanes = [fill; LANES];
    let rest = &column[at.min(column.len())..];
    lanes[..rest.len()].copy_from_slice(rest);
    f32x16::from_slice(s, &lanes)
}

/// Writes the lanes that fall into `column`.
#[inline(always)]
pub(crate) fn store<S: Simd>(value: f32x16<S>, column: &mut [f32], at: usize) {
    if let Some(whole) = column.get_mut(at..at + LANES) {
        value.store_slice(whole);
        return;
    }
    let mut lanes = [0.0; LANES];
    value.store_slice(&mut lanes);
    let at = at.min(column.len());
    let rest = &mut column[at..];
    let len = rest.len();
    rest.copy_from_slice(&lanes[..len]);
}

/// `2^x` for `x` in `-126..=127`, within 2e-7 of itself; `x` outside must be clamped by the caller.
#[simd]
pub(crate) fn exp2<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
    // adding 1.5 * 2^23 leaves round(x) in the low bits of the mantissa
    let magic = all(s, 12_582_912.0);
    let shifted = x + magic;
    let f = x - (shifted - magic);
    // least squares on [-1/2, 1/2] weighted for relative error, exact at 0
    let p = all(s, 0.001_327_646)
        .mul_add(f, all(s, 0.009_675_541))
        .mul_add(f, all(s, 0.055_507_133))
        .mul_add(f, all(s, 0.240_221_197))
        .mul_add(f, all(s, 0.693_146_967))
        .mul_add(f, all(s, 1.0));
    let exponent: u32x16<S> = shifted.to_bits();
    f32x16::from_bits(p.to_bits() + (exponent << 23u32))
}
