//! The instruction sets that vectorised code runs on.

use fearless_simd::{Level, Simd as _};

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
    /// Fails with [`SimdLevelError`] if the variable names a level that this machine does not have.
    pub fn detect() -> Result<Self, SimdLevelError> {
        match std::env::var(ENV) {
            Ok(name) if !name.is_empty() => Self::named(&name),
            _ => Ok(Self::best()),
        }
    }

    /// The best level of this machine, whatever the environment says.
    pub fn best() -> Self {
        Self(Level::new())
    }

    /// The level of that [`name`](Self::name). Fails with [`SimdLevelError`] if this machine does
    /// not have it.
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
    pub fn available() -> Vec<Self> {
        let best = Level::new();
        #[cfg(target_arch = "x86_64")]
        {
            let sse2 = best.as_sse2().map(|t| t.level());
            let avx2 = best.as_avx2().map(|t| t.level());
            let avx512 = best.as_avx512().map(|t| t.level());
            [sse2, avx2, avx512]
                .into_iter()
                .flatten()
                .map(Self)
                .collect()
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

    /// What [`dispatch!`](crate::dispatch) takes.
    #[must_use]
    pub fn level(self) -> Level {
        self.0
    }
}

/// `dispatch!(level, s => f(s, ..))` compiles the call for each level that has a name and runs that
/// of `level`. Unlike `fearless_simd`'s it has no version for SSE4.2: processors without AVX2 are
/// rare, and every version costs compile time.
#[cfg(target_arch = "x86_64")]
#[macro_export]
macro_rules! dispatch {
    ($level:expr, $s:ident => $call:expr) => {{
        use $crate::fearless_simd::Simd as _;
        let level: $crate::fearless_simd::Level = $level;
        if let Some($s) = level.as_avx512() {
            $s.vectorize(
                #[inline(always)]
                || $call,
            )
        } else if let Some($s) = level.as_avx2() {
            $s.vectorize(
                #[inline(always)]
                || $call,
            )
        } else if let Some($s) = level.as_sse2() {
            $s.vectorize(
                #[inline(always)]
                || $call,
            )
        } else {
            unreachable!("SSE2 is part of x86-64")
        }
    }};
}
/// `dispatch!(level, s => f(s, ..))` compiles the call for each level and runs that of `level`.
#[cfg(not(target_arch = "x86_64"))]
#[macro_export]
macro_rules! dispatch {
    ($level:expr, $s:ident => $call:expr) => {
        $crate::fearless_simd::dispatch!($level, $s => $call)
    };
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
