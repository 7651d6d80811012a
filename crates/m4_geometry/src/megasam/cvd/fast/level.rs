//! Which vector instructions the kernels are compiled for when they run.

use fearless_simd::Level;

/// A set of vector instructions that this machine has. Results differ between levels in the last bits.
#[derive(Debug, Clone, Copy)]
pub(in crate::megasam::cvd) struct SimdLevel(pub(super) Level);

impl SimdLevel {
    /// The best one.
    pub fn best() -> Self {
        Self(Level::new())
    }

    /// Every one.
    #[cfg(test)]
    pub fn available() -> Vec<Self> {
        let best = Level::new();
        #[cfg(target_arch = "x86_64")]
        {
            use fearless_simd::Simd as _;
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

    /// For messages.
    #[cfg(test)]
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
            "native"
        }
    }
}

/// `dispatch!(level, s => f(s, ..))` compiles the call for SSE2, AVX2 and AVX-512 and runs that of `level`.
#[cfg(target_arch = "x86_64")]
macro_rules! dispatch {
    ($level:expr, $s:ident => $call:expr) => {{
        use fearless_simd::Simd as _;
        let level: fearless_simd::Level = $level.0;
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
#[cfg(not(target_arch = "x86_64"))]
macro_rules! dispatch {
    ($level:expr, $s:ident => $call:expr) => {
        fearless_simd::dispatch!($level.0, $s => $call)
    };
}
pub(super) use dispatch;
