//! One coded frame in, one picture out.

use super::config::Config;
use crate::video::colour::{Range, YuvMatrix};
use m4_scene::RgbImage;
use openh264::OpenH264API;
use openh264::decoder::{Decoder, DecoderConfig, Flush};
use openh264::formats::YUVSource;

/// The decoder of one stream.
pub struct H264 {
    decoder: Decoder,
    matrix: YuvMatrix,
    size: (usize, usize),
}

impl H264 {
    /// `None` when the library cannot be set up.
    pub fn new(config: &Config, matrix_code: u16, full_range: bool) -> Option<Self> {
        // Parameter sets were changed so that no picture is held back (see `sps::undelayed`); flushing
        // would leak the decoder's pictures.
        let settings = DecoderConfig::new().flush_after_decode(Flush::NoFlush);
        let decoder = Decoder::with_api_config(OpenH264API::from_source(), settings).ok()?;
        let range = if full_range { Range::Full } else { Range::Limited };
        Some(Self {
            decoder,
            matrix: YuvMatrix::from_code(matrix_code, config.sps.height, range)?,
            size: (config.sps.width, config.sps.height),
        })
    }

    /// Decodes one frame (with start codes); `None` when it is damaged. The picture is converted only
    /// when it is wanted.
    pub fn decode(&mut self, frame: &[u8], wanted: bool) -> Option<Option<RgbImage>> {
        match self.decoder.decode(frame) {
            Ok(Some(yuv)) if yuv.dimensions() == self.size => {
                let (y, u, _) = yuv.strides();
                let planes = [yuv.y(), yuv.u(), yuv.v()];
                if wanted {
                    self.matrix.picture_420(self.size, planes, [y, u]).map(Some)
                } else {
                    Some(None)
                }
            }
            _ => None,
        }
    }
}
