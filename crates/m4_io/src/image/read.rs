//! Reads PNG and JPEG files into planes.

use crate::error::AtPath;
use crate::{Fault, ReadError, files};
use exif::{In, Tag};
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};
use m4_core::{CompactDepth, CompactIds, CompactMask, Plane, RgbImage};
use std::io::{self, BufRead, BufReader, Cursor, Seek};
use std::path::Path;

/// Longest side that is read, pixels: 16 times 1080p, and far under what overflows an index.
const MAX_SIDE_PX: u32 = 32_768;
/// What deflate makes of a byte at most.
const MAX_RATIO: u64 = 1032;
/// Pixels that a byte of JPEG stands for at most: a block of 64 takes a bit or more.
const JPEG_PIXELS_A_BYTE: u64 = 512;
/// Pixels that a file of any length may claim.
const FREE_PIXELS: u64 = 1 << 20;

/// Opens an image and checks its format and size, from the header alone.
fn open(path: &Path) -> Result<impl ImageDecoder, Fault> {
    let file = files::open(path)?;
    let file_bytes = file.metadata()?.len();
    checked(BufReader::new(file), file_bytes, u64::MAX)
}

/// The decoder of an image of `file_bytes`, at most `most_pixels`, whose format and size are in order.
fn checked<'a, R: BufRead + Seek + 'a>(
    mut from: R,
    file_bytes: u64,
    most_pixels: u64,
) -> Result<impl ImageDecoder + 'a, Fault> {
    let bits = bits_a_pixel(from.fill_buf()?);
    let reader = ImageReader::new(from).with_guessed_format()?;
    if !matches!(reader.format(), Some(ImageFormat::Png | ImageFormat::Jpeg)) {
        return Err(Fault::unsupported("it is not a PNG or JPEG image", "convert it to one of these"));
    }
    let decoder = reader.into_decoder().map_err(damaged)?;
    let (width, height) = decoder.dimensions();
    let pixels = u64::from(width) * u64::from(height);
    if width > MAX_SIDE_PX || height > MAX_SIDE_PX || pixels > most_pixels {
        let limit = MAX_SIDE_PX.min(most_pixels.isqrt() as u32);
        let what = format!("it is {width} x {height} pixels, above the limit of {limit} pixels per side");
        return Err(Fault::bad(what, "resize it"));
    }
    // before there is memory for more pixels than the file can hold
    let most = match bits {
        Some(bits) => file_bytes.saturating_mul(8 * MAX_RATIO) / bits,
        None => file_bytes.saturating_mul(JPEG_PIXELS_A_BYTE),
    };
    if pixels > most.max(FREE_PIXELS) {
        return Err(bad(format!("{file_bytes} bytes cannot hold {width} x {height} pixels")));
    }
    Ok(decoder)
}

/// Bits that a pixel of a PNG takes before it is packed, by the start of the file (PNG specification, 11.2.2); `None` for JPEG.
fn bits_a_pixel(start: &[u8]) -> Option<u64> {
    let channels = match start.get(25) {
        _ if !start.starts_with(b"\x89PNG") => return None,
        Some(2) => 3,
        Some(4) => 2,
        Some(6) => 4,
        _ => 1,
    };
    Some(channels * u64::from(start.get(24).copied().unwrap_or(1).max(1)))
}

fn decode(path: &Path) -> Result<DynamicImage, Fault> {
    DynamicImage::from_decoder(open(path)?).map_err(damaged)
}

fn decode_bytes(bytes: &[u8], most_pixels: u64) -> Result<DynamicImage, Fault> {
    let decoder = checked(Cursor::new(bytes), bytes.len() as u64, most_pixels)?;
    DynamicImage::from_decoder(decoder).map_err(damaged)
}

fn bad(reason: String) -> Fault {
    Fault::bad(format!("the image is damaged ({reason})"), "export it again")
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

/// Decodes a colour image of an archive, at most `most_pixels`, as [`read_rgb`]; `name` is for messages.
pub fn decode_rgb(bytes: &[u8], name: &Path, most_pixels: u64) -> Result<RgbImage, ReadError> {
    decode_bytes(bytes, most_pixels).and_then(rgb).at(name)
}

/// Reads a colour image; grey becomes colour, 16 bits become 8, transparency becomes black.
pub fn read_rgb(path: &Path) -> Result<RgbImage, ReadError> {
    decode(path).and_then(rgb).at(path)
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
    let mut decoder = open(path).at(path)?;
    let (width, height) = decoder.dimensions();
    // A damaged EXIF block is none.
    let exif = decoder.exif_metadata().ok().flatten();
    let orientation = decoder.orientation().ok();
    let mut image = DynamicImage::from_decoder(decoder).map_err(damaged).at(path)?;
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
        rgba.pixels().map(|p| [over_black(p[0], p[3]), over_black(p[1], p[3]), over_black(p[2], p[3])]).collect()
    } else {
        image.into_rgb8().pixels().map(|p| p.0).collect()
    };
    plane(size, data)
}

/// Reads a depth map: a greyscale PNG of 16 bits, times `unit` (scene units per step); 0 stays 0 = unknown.
pub fn read_depth(path: &Path, unit: f64) -> Result<CompactDepth, ReadError> {
    match decode(path).at(path)? {
        DynamicImage::ImageLuma16(grey) => {
            let steps = plane(grey.dimensions(), grey.into_raw()).at(path)?;
            Ok(CompactDepth::from_steps(steps, unit))
        }
        other => {
            let what = format!("the depth map is an image of type {:?}", other.color());
            Err(Fault::bad(what, "it must be a greyscale PNG with 16 bits per pixel").at(path))
        }
    }
}

/// Reads object ids per pixel: a greyscale PNG of 8 or 16 bits (JPEG changes numbers).
pub fn read_ids(path: &Path) -> Result<CompactIds, ReadError> {
    let is_png = files::first_bytes::<4>(path) == b"\x89PNG";
    decode(path).and_then(|image| ids(image, is_png)).at(path)
}

/// As [`read_ids`], of a file in memory; `path` is for messages. Fails if it is not a greyscale PNG.
pub fn ids_of_bytes(path: &Path, bytes: &[u8]) -> Result<CompactIds, ReadError> {
    let is_png = bytes.starts_with(b"\x89PNG");
    decode_bytes(bytes, u64::MAX).and_then(|image| ids(image, is_png)).at(path)
}

fn ids(image: DynamicImage, is_png: bool) -> Result<CompactIds, Fault> {
    let size = (image.width(), image.height());
    let numbers: Vec<u16> = match image {
        DynamicImage::ImageLuma8(grey) if is_png => grey.into_raw().into_iter().map(u16::from).collect(),
        DynamicImage::ImageLuma16(grey) => grey.into_raw(),
        other => {
            let kind = if is_png { "a PNG" } else { "a JPEG" };
            let what = format!("the instance map is {kind} image of type {:?}", other.color());
            let hint = "it must be a greyscale PNG with 8 or 16 bits per pixel, 0 where there is none";
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
    let grey = decode(path).at(path)?.into_luma8();
    plane(grey.dimensions(), grey.into_raw()).at(path)
}

/// Diagonal of a frame of 35 mm film, millimetres: what "35 mm equivalent" focal lengths refer to (CIPA DCG-001).
const FILM_DIAGONAL_MM: f64 = 43.266_615;

/// Focal length in pixels by an EXIF block; `None` where it is missing or damaged.
fn focal_px_of(block: Vec<u8>, width: usize, height: usize) -> Option<f64> {
    let mut reader = exif::Reader::new();
    // What is damaged elsewhere in the block does not matter.
    let fields = reader.continue_on_error(true).read_raw(block).or_else(|e| e.distill_partial_result(|_| {})).ok()?;
    let millimetres = fields.get_field(Tag::FocalLengthIn35mmFilm, In::PRIMARY)?.value.get_uint(0)?;
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
        image.write_to(&mut Cursor::new(&mut bytes), ImageFormat::Png).unwrap();
        let decode = |bytes: &[u8], most| decode_rgb(bytes, Path::new("a.png"), most);
        let read = decode(&bytes, 15).unwrap();
        assert_eq!((read.size(), read[(4, 2)]), ((5, 3), [4, 2, 77]));
        for (bytes, most, kind, says) in [
            (&bytes[..], 14, ErrorKind::BadData, "5 x 3 pixels"),
            (&bytes[..40], 15, ErrorKind::BadData, "damaged"),
            (b"GIF89a", 15, ErrorKind::Unsupported, "not a PNG"),
        ] {
            let error = decode(bytes, most).unwrap_err();
            assert!(error.kind() == kind && error.to_string().contains(says), "{error}");
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
