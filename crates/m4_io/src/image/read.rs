//! Reads PNG and JPEG files into planes.

use super::jpeg;
use super::share::Share;
use crate::error::AtPath;
use crate::{Fault, ReadError, files};
use exif::{In, Tag};
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};
use m4_core::{CompactDepth, CompactIds, CompactMask, Plane, RgbImage};
use std::io::{self, BufRead, BufReader, Cursor, Seek};
use std::path::Path;

/// Longest side that is read, pixels: 16 times 1080p, and far under what overflows an index.
const MAX_SIDE_PX: u32 = 32_768;
/// Longest file, bytes.
const MAX_FILE_BYTES: u64 = 1 << 30;
/// Bytes per pixel beside what the decoder gives out: a copy in another type.
const CONVERTED: u64 = 4;
/// Bytes per pixel of the coefficients of a JPEG whose scans must all be read before there is a
/// pixel.
const COEFFICIENTS: u64 = 6;
/// The last chunk of a PNG file with its checksum; the decoder checks all others that hold pixels.
const PNG_END: &[u8] = b"\0\0\0\0IEND\xae\x42\x60\x82";
const JPEG: &[u8] = &[0xff, 0xd8, 0xff];
/// Opens an image and checks its format and size, from the header alone: for those that are not
/// decoded.
fn open(path: &Path) -> Result<impl ImageDecoder, Fault> {
    checked(BufReader::new(files::open(path)?), u64::MAX)
}

/// The decoder of an image, at most `most_pixels`, whose format and size are in order.
fn checked<'a, R: BufRead + Seek + 'a>(
    mut from: R,
    most_pixels: u64,
) -> Result<impl ImageDecoder + 'a, Fault> {
    let start = from.fill_buf()?;
    // as after a copy that was interrupted
    if start.iter().all(|byte| *byte == 0) {
        return Err(bad("it is empty or starts with zeros".to_owned()));
    }
    let reader = ImageReader::new(from).with_guessed_format()?;
    if !matches!(reader.format(), Some(ImageFormat::Png | ImageFormat::Jpeg)) {
        return Err(Fault::unsupported(
            "it is not a PNG or JPEG image",
            "convert it to one of these",
        ));
    }
    let decoder = reader.into_decoder().map_err(damaged)?;
    let (width, height) = decoder.dimensions();
    let pixels = u64::from(width) * u64::from(height);
    if width > MAX_SIDE_PX || height > MAX_SIDE_PX || pixels > most_pixels {
        let limit = MAX_SIDE_PX.min(most_pixels.isqrt() as u32);
        let what =
            format!("it is {width} x {height} pixels, above the limit of {limit} pixels per side");
        return Err(Fault::bad(what, "resize it"));
    }
    Ok(decoder)
}

/// The decoder of an image in memory that is whole, at most `most_pixels`, and the share of the
/// memory for decoding that it takes.
fn whole(bytes: &[u8], most_pixels: u64) -> Result<(impl ImageDecoder + '_, Share), Fault> {
    let decoder = checked(Cursor::new(bytes), most_pixels)?;
    let is_jpeg = bytes.starts_with(JPEG);
    let (width, height) = decoder.dimensions();
    let held = if is_jpeg && jpeg::keeps_coefficients(bytes) {
        COEFFICIENTS
    } else {
        0
    };
    let a_pixel = u64::from(decoder.color_type().bytes_per_pixel()) + CONVERTED + held;
    let (needed, file_bytes) = (
        a_pixel * u64::from(width) * u64::from(height),
        bytes.len() as u64,
    );
    files::within_memory(&format!("{width} x {height} pixels"), needed, file_bytes)?;
    if is_jpeg {
        jpeg::check(bytes).map_err(bad)?;
    } else if !bytes.windows(PNG_END.len()).rev().any(|end| end == PNG_END) {
        return Err(bad("it ends before its last chunk".to_owned()));
    }
    Ok((decoder, Share::take(files::beyond(needed, file_bytes))))
}

/// What `convert` makes of the image in a file.
fn decode<T>(
    path: &Path,
    convert: impl FnOnce(DynamicImage) -> Result<T, Fault>,
) -> Result<T, ReadError> {
    files::read(path, MAX_FILE_BYTES)
        .map_err(Fault::from)
        .and_then(|bytes| decode_bytes(&bytes, u64::MAX, convert))
        .at(path)
}

fn decode_bytes<T>(
    bytes: &[u8],
    most_pixels: u64,
    convert: impl FnOnce(DynamicImage) -> Result<T, Fault>,
) -> Result<T, Fault> {
    let (decoder, _share) = whole(bytes, most_pixels)?;
    convert(DynamicImage::from_decoder(decoder).map_err(damaged)?)
}

fn bad(reason: String) -> Fault {
    Fault::bad(
        format!("the image is damaged ({reason})"),
        "export it again",
    )
}

fn damaged(error: image::ImageError) -> Fault {
    // A disk that fails says nothing about the image.
    if let image::ImageError::IoError(source) = &error
        && let Some(code) = source.raw_os_error()
    {
        return io::Error::from_raw_os_error(code).into();
    }
    bad(error.to_string())
}

fn plane<T>((width, height): (u32, u32), data: Vec<T>) -> Result<Plane<T>, Fault> {
    Plane::from_vec(width as usize, height as usize, data).map_err(|e| bad(e.to_string()))
}

/// Width and height of a PNG or JPEG image in pixels, from its header.
pub fn size(path: &Path) -> Result<(usize, usize), ReadError> {
    let (width, height) = open(path).at(path)?.dimensions();
    Ok((width as usize, height as usize))
}

/// Decodes a colour image of an archive, at most `most_pixels`, as [`read_rgb`]; `name` is for
/// messages.
pub fn decode_rgb(bytes: &[u8], name: &Path, most_pixels: u64) -> Result<RgbImage, ReadError> {
    decode_bytes(bytes, most_pixels, rgb).at(name)
}

/// Reads a colour image; grey becomes colour, 16 bits become 8, transparency becomes black.
pub fn read_rgb(path: &Path) -> Result<RgbImage, ReadError> {
    decode(path, rgb)
}

/// An image as a camera took it.
#[derive(Debug, Clone)]
pub struct Photo {
    /// Upright: turned as its EXIF block says.
    pub rgb: RgbImage,
    /// Focal length of `rgb` in pixels, where the EXIF block gives its equivalent on 35 mm film.
    pub focal_px: Option<f64>,
}

/// Reads a colour image with what its EXIF block says about the camera.
pub fn read_photo(path: &Path) -> Result<Photo, ReadError> {
    let bytes = files::read(path, MAX_FILE_BYTES).at(path)?;
    let (mut decoder, _share) = whole(&bytes, u64::MAX).at(path)?;
    let (width, height) = decoder.dimensions();
    // A damaged EXIF block is none.
    let exif = decoder.exif_metadata().ok().flatten();
    let orientation = decoder.orientation().ok();
    let mut image = DynamicImage::from_decoder(decoder)
        .map_err(damaged)
        .at(path)?;
    if let Some(orientation) = orientation {
        image.apply_orientation(orientation);
    }
    Ok(Photo {
        rgb: rgb(image).at(path)?,
        focal_px: exif.and_then(|e| focal_px_of(e, width as usize, height as usize)),
    })
}

fn rgb(image: DynamicImage) -> Result<RgbImage, Fault> {
    let size = (image.width(), image.height());
    let data: Vec<[u8; 3]> = if image.color().has_alpha() {
        let over_black = |c: u8, a: u8| ((u32::from(c) * u32::from(a) + 127) / 255) as u8;
        let rgba = image.into_rgba8();
        rgba.pixels()
            .map(|p| {
                [
                    over_black(p[0], p[3]),
                    over_black(p[1], p[3]),
                    over_black(p[2], p[3]),
                ]
            })
            .collect()
    } else {
        image.into_rgb8().pixels().map(|p| p.0).collect()
    };
    plane(size, data)
}

/// Reads a depth map: a greyscale PNG of 16 bits, times `unit` (scene units per step); 0 stays 0 =
/// unknown.
pub fn read_depth(path: &Path, unit: f64) -> Result<CompactDepth, ReadError> {
    decode(path, |image| match image {
        DynamicImage::ImageLuma16(grey) => {
            let steps = plane(grey.dimensions(), grey.into_raw())?;
            Ok(CompactDepth::from_steps(steps, unit))
        }
        other => {
            let what = format!("the depth map is an image of type {:?}", other.color());
            Err(Fault::bad(
                what,
                "it must be a greyscale PNG with 16 bits per pixel",
            ))
        }
    })
}

/// Reads object ids per pixel: a greyscale PNG of 8 or 16 bits (JPEG changes numbers).
pub fn read_ids(path: &Path) -> Result<CompactIds, ReadError> {
    let is_png = files::first_bytes::<4>(path) == b"\x89PNG";
    decode(path, |image| ids(image, is_png))
}

/// As [`read_ids`], of a file in memory; `path` is for messages. Fails if it is not a greyscale
/// PNG.
pub fn ids_of_bytes(path: &Path, bytes: &[u8]) -> Result<CompactIds, ReadError> {
    let is_png = bytes.starts_with(b"\x89PNG");
    decode_bytes(bytes, u64::MAX, |image| ids(image, is_png)).at(path)
}

fn ids(image: DynamicImage, is_png: bool) -> Result<CompactIds, Fault> {
    let size = (image.width(), image.height());
    let numbers: Vec<u16> = match image {
        DynamicImage::ImageLuma8(grey) if is_png => {
            grey.into_raw().into_iter().map(u16::from).collect()
        }
        DynamicImage::ImageLuma16(grey) => grey.into_raw(),
        other => {
            let kind = if is_png { "a PNG" } else { "a JPEG" };
            let what = format!(
                "the instance map is {kind} image of type {:?}",
                other.color()
            );
            let hint =
                "it must be a greyscale PNG with 8 or 16 bits per pixel, 0 where there is none";
            return Err(Fault::bad(what, hint));
        }
    };
    Ok(CompactIds::from(&plane(size, numbers)?))
}

/// Reads a mask: set where the image's brightness is at least 128.
pub fn read_mask(path: &Path) -> Result<CompactMask, ReadError> {
    Ok(read_grey(path)?.into())
}

/// Reads the brightness of an image, 0 to 255.
pub fn read_grey(path: &Path) -> Result<Plane<u8>, ReadError> {
    decode(path, |image| {
        let grey = image.into_luma8();
        plane(grey.dimensions(), grey.into_raw())
    })
}

/// Diagonal of a frame of 35 mm film, millimetres: what "35 mm equivalent" focal lengths refer to
/// (CIPA DCG-001).
const FILM_DIAGONAL_MM: f64 = 43.266_615;

/// Focal length in pixels by an EXIF block; `None` where it is missing or damaged.
fn focal_px_of(block: Vec<u8>, width: usize, height: usize) -> Option<f64> {
    let mut reader = exif::Reader::new();
    // What is damaged elsewhere in the block does not matter.
    let fields = reader
        .continue_on_error(true)
        .read_raw(block)
        .or_else(|e| e.distill_partial_result(|_| {}))
        .ok()?;
    let millimetres = fields
        .get_field(Tag::FocalLengthIn35mmFilm, In::PRIMARY)?
        .value
        .get_uint(0)?;
    let diagonal_px = (width as f64).hypot(height as f64);
    (millimetres > 0).then(|| f64::from(millimetres) / FILM_DIAGONAL_MM * diagonal_px)
}

#[cfg(test)]
mod tests {
    use super::{decode_rgb, focal_px_of};
    use crate::ErrorKind;
    use image::{ImageFormat, RgbImage};
    use std::io::Cursor;
    use std::path::Path;

    #[test]
    fn decode_rgb_enforces_pixel_limit() {
        let mut bytes = Vec::new();
        let image = RgbImage::from_fn(5, 3, |x, y| image::Rgb([x as u8, y as u8, 77]));
        image
            .write_to(&mut Cursor::new(&mut bytes), ImageFormat::Png)
            .unwrap();
        let decode = |bytes: &[u8], most| decode_rgb(bytes, Path::new("a.png"), most);
        let read = decode(&bytes, 15).unwrap();
        assert_eq!((read.size(), read[(4, 2)]), ((5, 3), [4, 2, 77]));
        for (bytes, most, kind, says) in [
            (&bytes[..], 14, ErrorKind::BadData, "5 x 3 pixels"),
            (&bytes[..40], 15, ErrorKind::BadData, "damaged"),
            (b"GIF89a", 15, ErrorKind::Unsupported, "not a PNG"),
        ] {
            let error = decode(bytes, most).unwrap_err();
            assert!(
                error.kind() == kind && error.to_string().contains(says),
                "{error}"
            );
        }
    }

    #[test]
    fn truncated_exif_blocks_give_no_focal_length() {
        let mut tiff = b"II*\0\x08\0\0\0".to_vec();
        // One entry: the pointer to the part at byte 26.
        tiff.extend([1, 0, 0x69, 0x87, 4, 0, 1, 0, 0, 0, 26, 0, 0, 0, 0, 0, 0, 0]);
        // One entry: 26 mm as a short.
        tiff.extend([1, 0, 0x05, 0xa4, 3, 0, 1, 0, 0, 0, 26, 0, 0, 0, 0, 0, 0, 0]);
        assert!(focal_px_of(tiff.clone(), 40, 30).is_some());
        for cut in 0..38 {
            assert_eq!(focal_px_of(tiff[..cut].to_vec(), 40, 30), None, "{cut}");
        }
    }
}
