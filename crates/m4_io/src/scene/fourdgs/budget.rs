//! Computes the memory that a file requires before any is allocated.
//!
//! The decoder of the `fourdgs` crate stops at half a gigabyte, whatever the size of the file; streams
//! with one constant row let a kilobyte ask for that much. Here the counts are added up first.

use ::fourdgs::opcode;
use ::fourdgs::records::parse_chunk;
use ::fourdgs::serialization::{MAGIC, Records, STREAM_HEADER_SIZE};

/// Memory that any file may ask for, bytes.
const FREE: u64 = 48 << 20;
/// Memory that a byte of the file may ask for besides: splats take 8 to 15 bytes in a file and about 600
/// while they are decoded.
const PER_BYTE: u64 = 96;
/// A splat of a scene, of its chunk before, and of the columns after.
const PER_SPLAT: u64 = 2 * 76 + 100;
/// A symbol of a stream: eight bytes decoded, up to four raw.
const PER_SYMBOL: u64 = 12;

/// More than the file may ask for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct OverBudget {
    pub needed: u64,
    pub allowed: u64,
}

/// Adds up what the records claim. Whatever does not parse is left to the decoder, which refuses it at
/// that place without having allocated for what follows.
pub(super) fn check(bytes: &[u8]) -> Result<(), OverBudget> {
    let allowed = FREE + PER_BYTE * bytes.len() as u64;
    let (mut kept, mut largest) = (0u64, 0u64);
    let body = bytes.get(MAGIC.len()..).unwrap_or_default();
    for record in Records::new(body, 0) {
        let Ok(record) = record else { break };
        match record.opcode {
            opcode::CHUNK => {
                let Ok((head, streams)) = parse_chunk(record.content) else {
                    break;
                };
                kept = kept.saturating_add(u64::from(head.count) * PER_SPLAT);
                // A chunk that is compressed as a whole hides its streams; each symbol in it is a byte at least.
                let symbols = if head.compression.is_empty() {
                    stream_symbols(streams, u64::from(head.count))
                } else {
                    head.uncompressed_size
                        .saturating_add(u64::from(head.count).saturating_mul(26))
                };
                largest = largest.max(symbols.saturating_mul(PER_SYMBOL));
            }
            // Bands are kept, decoded, until the last chunk.
            opcode::SH_BAND_STREAM => {
                let symbols = stream_symbols(record.content.get(1..).unwrap_or_default(), u64::MAX);
                kept = kept.saturating_add(symbols.saturating_mul(PER_SYMBOL));
            }
            _ => {}
        }
        let needed = kept.saturating_add(largest);
        if needed > allowed {
            return Err(OverBudget { needed, allowed });
        }
    }
    Ok(())
}

/// Symbols of the streams that follow one another in `bytes`. A stream with another count than `expected`
/// is refused by the decoder before it allocates.
fn stream_symbols(mut bytes: &[u8], expected: u64) -> u64 {
    const CONSTANT: u8 = 2;
    let mut symbols = 0u64;
    while let Some((head, rest)) = bytes.split_at_checked(STREAM_HEADER_SIZE) {
        let (mode, channels) = (head[2], u64::from(head[4]));
        let count = u64::from(u32::from_le_bytes([head[5], head[6], head[7], head[8]]));
        let payload = u64::from_le_bytes([
            head[9], head[10], head[11], head[12], head[13], head[14], head[15], head[16],
        ]);
        let rows = if mode == CONSTANT { 1 } else { count.min(expected) };
        symbols = symbols.saturating_add(rows * channels);
        let Some(next) = usize::try_from(payload).ok().and_then(|n| rest.get(n..)) else {
            break;
        };
        bytes = next;
    }
    symbols
}
