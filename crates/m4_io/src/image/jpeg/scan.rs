//! Follows the blocks of a scan.

use super::bits::{Bits, Codes};

/// A component of an image: a plane of blocks of 8 x 8 samples.
struct Component {
    id: u8,
    /// Blocks of an MCU in a row and a column.
    sampling: (usize, usize),
    /// Blocks in a row and a column: of the image, and with those that fill its last MCUs.
    blocks: (usize, usize),
    stride: usize,
    /// Of a progressive image which coefficients of each block are not 0; empty for others.
    nonzero: Vec<u64>,
    /// A scan had its first coefficients.
    begun: bool,
}

/// The size and the components of an image.
pub(super) struct Frame {
    progressive: bool,
    components: Vec<Component>,
    /// MCUs in a row and a column.
    mcus: (usize, usize),
}

impl Frame {
    /// Reads a frame header (B.2.2).
    pub(super) fn read(segment: &[u8], progressive: bool) -> Result<Self, String> {
        let damaged = || "its frame header is damaged".to_owned();
        let (&[_, h1, h0, w1, w0, n], rest) = segment.split_first_chunk().ok_or_else(damaged)?;
        let side = |high, low| usize::from(u16::from_be_bytes([high, low]));
        let (width, height) = (side(w1, w0), side(h1, h0));
        let all: Vec<&[u8; 3]> = rest.as_chunks().0.iter().take(usize::from(n)).collect();
        let sampling = |c: &[u8; 3]| (usize::from(c[1] >> 4), usize::from(c[1] & 15));
        let fits =
            |c: &&[u8; 3]| (1..=4).contains(&sampling(c).0) && (1..=4).contains(&sampling(c).1);
        if !(1..=4).contains(&n)
            || all.len() < usize::from(n)
            || !all.iter().all(fits)
            || width * height == 0
        {
            return Err(damaged());
        }
        let h_max = all.iter().map(|c| sampling(c).0).max().unwrap_or(1);
        let v_max = all.iter().map(|c| sampling(c).1).max().unwrap_or(1);
        let mcus = (width.div_ceil(8 * h_max), height.div_ceil(8 * v_max));
        let component = |c: &&[u8; 3]| {
            let (h, v) = sampling(c);
            let stride = mcus.0 * h;
            Component {
                id: c[0],
                sampling: (h, v),
                blocks: (
                    (width * h).div_ceil(h_max).div_ceil(8),
                    (height * v).div_ceil(v_max).div_ceil(8),
                ),
                stride,
                nonzero: if progressive {
                    vec![0; stride * mcus.1 * v]
                } else {
                    Vec::new()
                },
                begun: false,
            }
        };
        Ok(Self {
            progressive,
            components: all.iter().map(component).collect(),
            mcus,
        })
    }

    /// Whether every component had a scan.
    pub(super) fn has_all(&self) -> bool {
        self.components.iter().all(|c| c.begun)
    }
}

/// One component in a scan: its place in the frame and its tables.
struct ScanComponent<'a> {
    component: usize,
    dc: Option<&'a Codes>,
    ac: Option<&'a Codes>,
}

/// A scan header.
pub(super) struct Scan<'a> {
    parts: Vec<ScanComponent<'a>>,
    /// First and last coefficient.
    band: (u32, u32),
    /// It refines coefficients that an earlier scan had.
    refines: bool,
    /// MCUs between two restart markers; 0 for none.
    restart: usize,
}

const NO_TABLE: &str = "a Huffman table is missing";

impl<'a> Scan<'a> {
    /// Reads a scan header (B.2.3).
    pub(super) fn read(
        segment: &[u8],
        frame: &Frame,
        codes: &'a [[Option<Codes>; 4]; 2],
        restart: usize,
    ) -> Result<Self, String> {
        let damaged = || "a scan header is damaged".to_owned();
        let (&n, rest) = segment.split_first().ok_or_else(damaged)?;
        let (named, rest) = rest
            .split_at_checked(2 * usize::from(n))
            .ok_or_else(damaged)?;
        let &[start, end, bits] = rest.first_chunk().ok_or_else(damaged)?;
        let part = |&[id, tables]: &[u8; 2]| {
            let of = |class: usize, table: u8| {
                codes[class]
                    .get(usize::from(table))
                    .and_then(Option::as_ref)
            };
            let component = frame.components.iter().position(|c| c.id == id)?;
            Some(ScanComponent {
                component,
                dc: of(0, tables >> 4),
                ac: of(1, tables & 15),
            })
        };
        let parts: Option<Vec<ScanComponent<'_>>> = named.as_chunks().0.iter().map(part).collect();
        let parts = parts
            .filter(|parts| (1..=4).contains(&parts.len()))
            .ok_or_else(damaged)?;
        let band = if frame.progressive {
            (u32::from(start), u32::from(end))
        } else {
            (0, 63)
        };
        // of several components there are only the first coefficients
        let mixed = frame.progressive && (band.0 == 0 || parts.len() > 1) && band != (0, 0);
        if band.0 > band.1 || band.1 > 63 || mixed {
            return Err(damaged());
        }
        Ok(Self {
            parts,
            band,
            refines: frame.progressive && bits >> 4 > 0,
            restart,
        })
    }

    /// Follows the data behind the header, to the marker behind them; returns how many bytes they
    /// have.
    pub(super) fn follow(&self, frame: &mut Frame, data: &[u8]) -> Result<usize, String> {
        let (mut bits, mut run) = (Bits::new(data), 0);
        let (progressive, mcus) = (frame.progressive, frame.mcus);
        // the blocks of a single component come row by row, without those that fill MCUs
        let (columns, rows) = match self.parts[..] {
            [ref one] => frame.components[one.component].blocks,
            _ => mcus,
        };
        for mcu in 0..columns * rows {
            if self.restart > 0 && mcu > 0 && mcu % self.restart == 0 {
                bits.restart((mcu / self.restart - 1) % 8)?;
                run = 0;
            }
            let (x, y) = (mcu % columns, mcu / columns);
            for part in &self.parts {
                let component = &mut frame.components[part.component];
                let (h, v) = if self.parts.len() == 1 {
                    (1, 1)
                } else {
                    component.sampling
                };
                for k in 0..h * v {
                    if !progressive {
                        baseline(&mut bits, part)?;
                        continue;
                    }
                    let block = (y * v + k / h) * component.stride + x * h + k % h;
                    self.progressive(&mut bits, part, &mut component.nonzero[block], &mut run)?;
                }
            }
        }
        if run > 0 {
            return Err("its data end before its last block".to_owned());
        }
        for part in &self.parts {
            frame.components[part.component].begun |= self.band.0 == 0;
        }
        bits.end()
    }

    /// A block of a progressive scan (annex G); `nonzero` marks its coefficients not 0, `run`
    /// the blocks to come without new ones.
    fn progressive(
        &self,
        bits: &mut Bits<'_>,
        part: &ScanComponent<'_>,
        nonzero: &mut u64,
        run: &mut u32,
    ) -> Result<(), String> {
        let (first, last) = self.band;
        if first == 0 {
            if self.refines {
                return bits.skip(1);
            }
            let size = bits.symbol(part.dc.ok_or(NO_TABLE)?)?;
            return bits.skip(u32::from(size));
        }
        let codes = part.ac.ok_or(NO_TABLE)?;
        let mut k = first;
        while *run == 0 && k <= last {
            let symbol = bits.symbol(codes)?;
            let (mut zeros, size) = (u32::from(symbol >> 4), u32::from(symbol & 15));
            if size == 0 && zeros < 15 {
                *run = (1 << zeros) + bits.take(zeros)?;
                break;
            }
            bits.skip(size)?;
            if self.refines {
                // coefficients that are known have a bit each, and do not count
                while k <= last {
                    if *nonzero >> k & 1 == 1 {
                        bits.skip(1)?;
                    } else if zeros == 0 {
                        break;
                    } else {
                        zeros -= 1;
                    }
                    k += 1;
                }
            } else {
                k += zeros;
            }
            if size > 0 {
                if k > last {
                    return Err(TOO_MANY.to_owned());
                }
                *nonzero |= 1 << k;
            }
            k += 1;
        }
        if *run > 0 {
            *run -= 1;
            if self.refines && k <= last {
                let rest = (u64::MAX >> (63 - last)) & (u64::MAX << k);
                bits.skip((*nonzero & rest).count_ones())?;
            }
        }
        Ok(())
    }
}

const TOO_MANY: &str = "a block has more than 64 coefficients";

/// A block of a sequential scan (F.2.2).
fn baseline(bits: &mut Bits<'_>, part: &ScanComponent<'_>) -> Result<(), String> {
    let (dc, ac) = (part.dc.ok_or(NO_TABLE)?, part.ac.ok_or(NO_TABLE)?);
    let size = bits.symbol(dc)?;
    bits.skip(u32::from(size))?;
    let mut k = 1;
    while k < 64 {
        let symbol = bits.symbol(ac)?;
        let (zeros, size) = (u32::from(symbol >> 4), u32::from(symbol & 15));
        if size == 0 && zeros < 15 {
            break;
        }
        k += zeros + 1;
        if k > 64 {
            return Err(TOO_MANY.to_owned());
        }
        bits.skip(size)?;
    }
    Ok(())
}
