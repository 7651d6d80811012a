//! Decodes one coded frame into one image with OpenH264.

use super::wire::Setup;
use openh264::OpenH264API;
use openh264::decoder::{DecodedYUV, Decoder, DecoderConfig, Flush};
use openh264::formats::YUVSource;

/// `dsOutOfMemory` of OpenH264's `DECODING_STATE`.
const OUT_OF_MEMORY: i64 = 0x4000;

/// The decoder of one stream, in this process.
pub struct H264 {
    decoder: Decoder,
    setup: Setup,
    /// The decoder has no parameter sets, or may have dropped them.
    fresh: bool,
    /// Parameter sets and a frame.
    joined: Vec<u8>,
}

/// What became of a coded frame.
pub enum Frame<'a> {
    /// It is damaged.
    Damaged,
    /// There is no memory for it.
    NoMemory,
    /// It is decoded.
    Whole(DecodedYUV<'a>),
}

impl H264 {
    /// `None` when the library cannot be set up.
    pub fn new(setup: Setup) -> Option<Self> {
        // Parameter sets were changed so that no image is held back (see `sps::undelayed`); flushing
        // would leak the decoder's images.
        let settings = DecoderConfig::new().flush_after_decode(Flush::NoFlush);
        let decoder = Decoder::with_api_config(OpenH264API::from_source(), settings).ok()?;
        Some(Self {
            decoder,
            setup,
            fresh: true,
            joined: Vec::new(),
        })
    }

    /// Decodes one frame (with start codes), behind the parameter sets when it is `fresh`.
    pub fn decode(&mut self, frame: &[u8], fresh: bool) -> Frame<'_> {
        let frame = if fresh || self.fresh {
            self.joined.clear();
            self.joined.extend_from_slice(&self.setup.headers);
            self.joined.extend_from_slice(frame);
            &self.joined
        } else {
            frame
        };
        // A decoder that met an error may have dropped its parameter sets.
        self.fresh = true;
        let size = self.setup.size;
        match self.decoder.decode(frame) {
            Ok(Some(yuv)) if yuv.dimensions() == size && holds(&yuv, size) => {
                self.fresh = false;
                Frame::Whole(yuv)
            }
            Err(e) if e.native_code() & OUT_OF_MEMORY != 0 => Frame::NoMemory,
            _ => Frame::Damaged,
        }
    }
}

/// Luma (0), blue (1) or red (2): its bytes, from a row to the next, and the size of what is seen.
fn plane<'a>(yuv: &'a DecodedYUV<'_>, which: usize, size: (usize, usize)) -> (&'a [u8], usize, (usize, usize)) {
    let (luma_stride, chroma_stride, _) = yuv.strides();
    let half = (size.0.div_ceil(2), size.1.div_ceil(2));
    match which {
        0 => (yuv.y(), luma_stride, size),
        1 => (yuv.u(), chroma_stride, half),
        _ => (yuv.v(), chroma_stride, half),
    }
}

/// True when the planes have all rows of an image of `size`.
fn holds(yuv: &DecodedYUV<'_>, size: (usize, usize)) -> bool {
    (0..3).all(|which| {
        let (bytes, stride, (width, height)) = plane(yuv, which, size);
        width <= stride && bytes.len() >= height.saturating_sub(1) * stride + width
    })
}

/// The rows of luma (0), blue (1) or red (2) of a [`Frame::Whole`], without what lies between them.
pub fn rows<'a>(yuv: &'a DecodedYUV<'_>, which: usize, size: (usize, usize)) -> impl Iterator<Item = &'a [u8]> {
    let (bytes, stride, (width, height)) = plane(yuv, which, size);
    bytes.chunks(stride.max(1)).take(height).map(move |row| &row[..width])
}
