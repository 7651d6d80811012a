//! Sequence parameter sets (ITU-T H.264, 7.3.2.1.1 and E.1.1): size, sampling and colours.

use crate::video::colour::Colours;
use h264_reader::nal::sps::{FrameMbsFlags, SeqParameterSet, VuiParameters};
use h264_reader::nal::{NalHeader, WritableNal};
use h264_reader::rbsp::{BitReader, ByteReader};
use std::panic::catch_unwind;

/// What a decoder and a colour conversion must know.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sps {
    pub profile: u8,
    /// 0 = grey, 1 = 4:2:0, 2 = 4:2:2, 3 = 4:4:4.
    pub chroma_format: u32,
    pub bit_depth: u8,
    /// Every image is a whole frame.
    pub progressive: bool,
    /// Cropped, pixels.
    pub size: (usize, usize),
    /// Width of a pixel over its height.
    pub pixel_aspect: Option<f64>,
    pub colours: Colours,
}

/// Longest side of an image, pixels.
const MAX_SIDE_PX: usize = 16_384;
/// The highest level (6.2): files often state one that their images exceed, and every decoder shows
/// them.
const ANY_LEVEL: u8 = 62;
/// Where the level stands in a parameter set.
const LEVEL_AT: usize = 3;

/// A NAL unit of type 7, header byte included; `None` if it is cut short or impossible.
fn parsed(nal: &[u8]) -> Option<SeqParameterSet> {
    let mut nal = nal.to_vec();
    let level = std::mem::replace(nal.get_mut(LEVEL_AT)?, ANY_LEVEL);
    let parse = || {
        SeqParameterSet::from_bits(BitReader::new(ByteReader::skipping_h264_header(&nal[..]))).ok()
    };
    // A panic of the parser, which is not ours, is a fault of the file.
    let set = catch_unwind(parse).ok()??;
    Some(SeqParameterSet {
        level_idc: level,
        ..set
    })
}

impl Sps {
    /// Parses a NAL unit of type 7, header byte included; `None` if it is cut short or impossible.
    pub fn parse(nal: &[u8]) -> Option<Self> {
        let set = parsed(nal)?;
        let (width, height) = set.pixel_dimensions().ok()?;
        let size = (width as usize, height as usize);
        let chroma = &set.chroma_info;
        let vui = set.vui_parameters.as_ref();
        let aspect = vui.and_then(|v| v.aspect_ratio_info.as_ref()?.get());
        let aspect = aspect.map(|(w, h)| f64::from(w) / f64::from(h));
        [size.0, size.1]
            .iter()
            .all(|side| (1..=MAX_SIDE_PX).contains(side))
            .then(|| Self {
                profile: set.profile_idc.into(),
                chroma_format: chroma.chroma_format.to_u32(),
                bit_depth: chroma
                    .bit_depth_luma_minus8
                    .max(chroma.bit_depth_chroma_minus8)
                    + 8,
                progressive: set.frame_mbs_flags == FrameMbsFlags::Frames,
                size,
                pixel_aspect: aspect.filter(|a| (0.1..=10.0).contains(a)),
                colours: vui.map_or_else(Colours::default, colours),
            })
    }
}

fn colours(vui: &VuiParameters) -> Colours {
    let Some(signal) = &vui.video_signal_type else {
        return Colours::default();
    };
    let full_range = Some(signal.video_full_range_flag);
    match &signal.colour_description {
        Some(described) => Colours {
            transfer: described.transfer_characteristics.into(),
            matrix: described.matrix_coefficients.into(),
            full_range,
        },
        None => Colours {
            full_range,
            ..Colours::default()
        },
    }
}

/// Profile whose images the decoder gives out at once (Scalable Baseline, with the syntax of a High
/// parameter set).
const UNDELAYED_PROFILE: u8 = 83;

/// The parameter set (a NAL unit of type 7) with a profile for which OpenH264 does not hold images
/// back to put them in order of display. What is decoded does not change: for progressive 8-bit
/// 4:2:0 the profile decides about nothing else in that decoder. The order is ours to make, from
/// the times in the container; the decoder's own order would hide which image a damaged frame took
/// away.
pub fn undelayed(nal: &[u8]) -> Option<Vec<u8>> {
    if !matches!(nal.get(1)?, 77 | 100) {
        return Some(nal.to_vec());
    }
    let set = SeqParameterSet {
        profile_idc: UNDELAYED_PROFILE.into(),
        ..parsed(nal)?
    };
    Some(set.to_vec_with_header(NalHeader::new(nal[0]).ok()?))
}

#[cfg(test)]
mod tests {
    use super::{Colours, Sps, undelayed};

    #[test]
    fn parameter_sets_of_x264_are_parsed_and_rewritten() {
        // The example clip: High, 480 x 360 (368 coded rows, cropped by 8), BT.709, limited range,
        // square pixels.
        let high = [
            0x67, 0x64, 0x00, 0x1f, 0xac, 0x76, 0x11, 0x07, 0x82, 0xff, 0x97, 0x01, 0x6a, 0x02,
            0x02, 0x03, 0x4a, 0x00, 0x00, 0x03, 0x00, 0x02, 0x00, 0x00, 0x03, 0x00, 0x60, 0x1e,
            0x30, 0x63, 0x08, 0xc0,
        ];
        // The same at 240 x 180, Main.
        let main = [
            0x67, 0x4d, 0x40, 0x0c, 0xec, 0xa1, 0xe3, 0x3f, 0x3e, 0x02, 0xd4, 0x04, 0x04, 0x06,
            0x94, 0x00, 0x00, 0x03, 0x00, 0x04, 0x00, 0x00, 0x03, 0x00, 0xc0, 0x3c, 0x50, 0xa6,
            0x58,
        ];
        let colours = Colours {
            transfer: 1,
            matrix: 1,
            full_range: Some(false),
        };
        let want = Sps {
            profile: 100,
            chroma_format: 1,
            bit_depth: 8,
            progressive: true,
            size: (480, 360),
            pixel_aspect: Some(1.0),
            colours,
        };
        for (nal, want) in [
            (&high[..], want),
            (
                &main,
                Sps {
                    profile: 77,
                    size: (240, 180),
                    ..want
                },
            ),
        ] {
            assert_eq!(Sps::parse(nal), Some(want));
            let quick = undelayed(nal).unwrap();
            assert_eq!(
                Sps::parse(&quick),
                Some(Sps {
                    profile: 83,
                    ..want
                })
            );
            // The level, and nothing that reads like a start code.
            assert_eq!(quick[3], nal[3]);
            assert!(
                quick
                    .windows(3)
                    .all(|w| w != [0, 0, 0] && w != [0, 0, 1] && w != [0, 0, 2]),
                "{quick:x?}"
            );
            for cut in 0..nal.len() - 1 {
                assert!(Sps::parse(&nal[..cut]).is_none());
            }
        }
        // A level of 96 macroblocks at most.
        let mut low = high;
        low[3] = 10;
        assert_eq!(Sps::parse(&low), Some(want));
    }
}
