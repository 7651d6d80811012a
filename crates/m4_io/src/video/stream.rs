//! Encodes images as coded frames without a container, so that single frames can be decoded.

use super::colour::{Range, YuvMatrix};
use super::encode::{Pieces, Refused};
use m4_core::RgbImage;

/// Frames of H.264 in BT.709, in the byte stream format (ITU-T H.264, Annex B). Sides that are odd
/// grow by one column or row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CodedFrames {
    /// Profile and level, as players are asked for them: `avc1.64001E` (RFC 6381).
    pub codec: String,
    /// One per image, in their order.
    pub frames: Vec<Vec<u8>>,
}

/// How images are encoded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CodedOptions {
    /// Images a second, 0.1 to 1000.
    pub fps: f64,
    /// Quantisation, 0 to 51: coding begins to be visible at 26; 6 more halve the bytes.
    pub qp: u8,
    /// Frames from one at which decoding can begin to the next, at least 1.
    pub key_every: usize,
}

/// Encodes images of one size, 16 pixels or more a side; the same bytes for any number of threads.
/// Fails with the reason where an option is out of its range or the encoder fails.
pub fn encode_frames(
    images: impl IntoIterator<Item = RgbImage>,
    options: &CodedOptions,
) -> Result<CodedFrames, String> {
    let CodedOptions { fps, qp, key_every } = *options;
    if !(0.1..=1000.0).contains(&fps) || qp > 51 || key_every == 0 {
        return Err(format!("{options:?} is out of range"));
    }
    let mut images = images.into_iter().peekable();
    let Some(size) = images.peek().map(RgbImage::size) else {
        return Err("there are no images".to_owned());
    };
    let matrix = YuvMatrix::from_code(1, size.1, Range::Limited).ok_or("BT.709 is not known")?;
    let reason = |refused| match refused {
        Refused::Encoder(error) => format!("{error}"),
        Refused::Other(reason) => reason,
    };
    let mut pieces = Pieces::new(size, fps, matrix, (qp, qp), key_every);
    let mut coded = Vec::new();
    for image in images {
        if image.size() != size {
            return Err(format!(
                "an image has {:?} pixels, not {size:?}",
                image.size()
            ));
        }
        coded.extend(pieces.push(image).map_err(reason)?);
    }
    coded.extend(pieces.finish().map_err(reason)?);
    let keys = coded.iter().enumerate().filter(|(_, c)| c.key);
    if !keys.map(|(i, _)| i).eq((0..coded.len()).step_by(key_every)) {
        return Err("the encoder moved the frames at which decoding can begin".to_owned());
    }
    let frames: Vec<_> = coded.into_iter().map(|c| c.bytes).collect();
    let codec = codec(&frames[0]).ok_or("the encoder left out its parameters")?;
    Ok(CodedFrames { codec, frames })
}

/// The name of profile and level, from the sequence parameters of a frame.
fn codec(frame: &[u8]) -> Option<String> {
    // a unit begins after 0, 0, 1; its type is in the lower five bits, 7 for these parameters
    let unit = frame
        .windows(7)
        .find(|bytes| bytes[..3] == [0, 0, 1] && bytes[3] & 31 == 7)?;
    let [_, _, _, _, profile, constraints, level] = unit.try_into().ok()?;
    Some(format!("avc1.{profile:02X}{constraints:02X}{level:02X}"))
}

#[cfg(test)]
mod tests {
    use super::{CodedOptions, encode_frames};
    use m4_core::{Plane, RgbImage};
    use openh264::decoder::Decoder;
    use openh264::formats::YUVSource;

    const OPTIONS: CodedOptions = CodedOptions {
        fps: 24.0,
        qp: 24,
        key_every: 4,
    };

    fn images(n: usize) -> Vec<RgbImage> {
        (0..n)
            .map(|i| Plane::from_fn(50, 34, |x, _| [(20 * i + x) as u8; 3]))
            .collect()
    }

    #[test]
    fn decoding_begins_at_every_key_frame() {
        let images = images(10);
        let coded = encode_frames(images.clone(), &OPTIONS).unwrap();
        assert!(coded.codec.starts_with("avc1.64"), "{}", coded.codec);
        assert_eq!(coded.frames.len(), 10);
        for start in [0, 4, 8] {
            let mut decoder = Decoder::new().unwrap();
            for i in start..(start + 4).min(10) {
                let image = decoder.decode(&coded.frames[i]).unwrap().expect("an image");
                assert_eq!(image.dimensions(), (50, 34));
                let mut rgb = vec![0; 50 * 34 * 3];
                image.write_rgb8(&mut rgb);
                let middle = &rgb[3 * (17 * 50 + 25)..][..3];
                let expected = images[i][(25, 17)];
                assert!(
                    middle.iter().zip(expected).all(|(a, b)| a.abs_diff(b) < 8),
                    "frame {i}: {middle:?}, not {expected:?}"
                );
            }
        }
    }

    #[test]
    fn images_that_cannot_be_encoded_are_refused() {
        assert!(encode_frames([], &OPTIONS).is_err());
        let never = CodedOptions {
            key_every: 0,
            ..OPTIONS
        };
        assert!(encode_frames(images(2), &never).is_err());
        let unknown = CodedOptions {
            fps: f64::NAN,
            ..OPTIONS
        };
        assert!(encode_frames(images(2), &unknown).is_err());
        let mut other = images(2);
        other.push(Plane::filled(16, 16, [0; 3]));
        let reason = encode_frames(other, &OPTIONS).unwrap_err();
        assert!(reason.contains("(16, 16)"), "{reason}");
    }
}
