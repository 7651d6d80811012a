//! The random numbers of [`m4_core::CounterRng`] on the device, whose integers have 32 bits.

#![expect(
    missing_docs,
    reason = "`cube` generates items beside those that it is written at"
)]

use cubecl::prelude::*;

/// A number of 64 bits.
#[derive(CubeType, Clone, Copy)]
pub struct Wide {
    pub high: u32,
    pub low: u32,
}

/// `2^32 high + low`.
#[cube]
pub fn wide(high: u32, low: u32) -> Wide {
    Wide { high, low }
}

/// `a + b`, modulo `2^64` as all that follows.
#[cube]
fn sum(a: &Wide, b: &Wide) -> Wide {
    let low = a.low + b.low;
    let mut carry = 0u32;
    if low < a.low {
        carry = 1u32;
    }
    wide(a.high + b.high + carry, low)
}

/// `a (2^32 high + low)`.
#[cube]
fn product(a: &Wide, high: u32, low: u32) -> Wide {
    wide(a.low.mul_hi(low) + a.low * high + a.high * low, a.low * low)
}

/// `a ^ (a >> shift)`, for shifts of less than 32 bits.
#[cube]
fn folded(a: &Wide, #[comptime] shift: u32) -> Wide {
    let rest = comptime!(32 - shift);
    wide(
        a.high ^ (a.high >> shift),
        a.low ^ ((a.low >> shift) | (a.high << rest)),
    )
}

/// The mixing function of `SplitMix64`.
#[cube]
fn mix(z: &Wide) -> Wide {
    let once = product(&folded(z, 30u32), 0xbf58_476du32, 0x1ce4_e5b9u32);
    let twice = product(&folded(&once, 27u32), 0x94d0_49bbu32, 0x1331_11ebu32);
    folded(&twice, 31u32)
}

/// The key of the stream of `index`; `base` is [`m4_core::CounterRng::base`].
#[cube]
pub fn key(base: &Wide, index: u32) -> Wide {
    sum(base, &mix(&wide(0x517c_c1b7u32, index ^ 0x2722_0a95u32)))
}

/// Number `counter` of a stream, from 1.
#[cube]
fn word(key: &Wide, counter: u32) -> Wide {
    let zero = 0u32;
    mix(&sum(
        key,
        &product(&wide(zero, counter), 0x9e37_79b9u32, 0x7f4a_7c15u32),
    ))
}

/// Standard normal number `k` of a stream that gives nothing else, from 0 (Box-Muller).
#[cube]
pub fn normal(key: &Wide, k: u32) -> f32 {
    let (first, second) = (word(key, 2u32 * k + 1u32), word(key, 2u32 * k + 2u32));
    // one minus a uniform number of 53 bits, from its complement: small ones keep their digits
    let (high, low) = (
        first.high ^ 0xffff_ffffu32,
        ((first.low ^ 0xffff_ffffu32) >> 11u32) + 1u32,
    );
    let rest = f32::cast_from(high) * 2.328_306_4e-10f32 + f32::cast_from(low) * 1.110_223e-16f32;
    let radius = (-2.0f32 * rest.min(1.0f32).ln()).sqrt();
    // half a turn less, which the sign makes up for: devices are exact within one turn around 0
    let turn = f32::cast_from(second.high) * 2.328_306_4e-10f32 - 0.5f32;
    -radius * (std::f32::consts::TAU * turn).cos()
}

#[cfg(test)]
mod tests {
    use super::{key, normal, wide};
    use crate::gpu::buffer::{Buffer, cubes, units};
    use crate::gpu::device::tests::gpu;
    use crate::launch;
    use cubecl::prelude::*;
    use m4_core::CounterRng;

    #[cube(launch)]
    fn draw(out: &mut [f32], count: u32, high: u32, low: u32) {
        let i = ABSOLUTE_POS as u32;
        if i < count {
            let key = key(&wide(high, low), i);
            for k in 0u32..4u32 {
                out[(4u32 * i + k) as usize] = normal(&key, k);
            }
        }
    }

    #[test]
    fn normal_numbers_are_those_of_the_host() {
        let Some(gpu) = gpu("normal_numbers_are_those_of_the_host") else {
            return;
        };
        let (seed, purpose, n) = (77, 5 | 0x1234_5678 << 32, 20_000usize);
        let base = CounterRng::base(seed, purpose);
        let out = Buffer::empty(&gpu.client, 4 * n);
        launch!(
            &gpu.client,
            draw::launch,
            (cubes(n, 256), units()),
            [out],
            [n as u32, (base >> 32) as u32, base as u32]
        );
        let got = out.read_floats(&gpu.client, "drawing").unwrap();
        for (i, numbers) in got.chunks(4).enumerate() {
            let mut rng = CounterRng::new(seed, purpose, i as u64);
            for &number in numbers {
                let want = rng.normal() as f32;
                assert!(
                    (number - want).abs() < 1e-4,
                    "stream {i}: {number} for {want}"
                );
            }
        }
    }
}
