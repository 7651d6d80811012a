//! Numbers that sort as floats do.

#![expect(
    missing_docs,
    reason = "`cube` generates items beside those that it is written at"
)]

use cubecl::prelude::*;

/// A number that sorts as `value` does.
#[cube]
pub fn key_of(value: f32) -> u32 {
    let bits = u32::reinterpret(value);
    let mut key = bits | 0x8000_0000u32;
    if (bits >> 31u32) == 1u32 {
        key = !bits;
    }
    key
}

/// The float that became `key`.
#[cube]
pub fn float_of(key: u32) -> f32 {
    let mut bits = key & 0x7fff_ffffu32;
    if (key >> 31u32) == 0u32 {
        bits = !key;
    }
    f32::reinterpret(bits)
}
