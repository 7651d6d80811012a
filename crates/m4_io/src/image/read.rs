//! Reads PNG and JPEG files into planes.

use super::{ReadImageError, exif};
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};
use m4_core::{CompactDepth, CompactIds, CompactMask, Plane, RgbImage};
use std::fs::File;
use std::io::{BufRead as _, BufReader, Cursor};
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
fn open(path: &Path) -> Result<impl ImageDecoder, ReadImageError> {
    let io = |source| ReadImageError::Io {
        path: path.to_path_buf(),
        source,
    };
    let file = File::open(path).map_err(io)?;
    let facts = file.metadata().map_err(io)?;
    if facts.is_dir() {
        return Err(io(std::io::Error::from(std::io::ErrorKind::IsADirectory)));
    }
    let mut file = BufReader::new(file);
    let bits = bits_a_pixel(file.fill_buf().map_err(io)?);
    let reader = ImageReader::new(file).with_guessed_format().map_err(io)?;
    if !matches!(reader.format(), Some(ImageFormat::Png | ImageFormat::Jpeg)) {
        return Err(ReadImageError::UnknownFormat {
            path: path.to_path_buf(),
        });
    }
    let decoder = reader.into_decoder().map_err(|e| damaged(path, &e))?;
    check_size(path, decoder.dimensions())?;
    check_held(path, decoder.dimensions(), bits, facts.len())?;
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

/// Refuses a header with more pixels than its file can hold, before there is memory for them.
fn check_held(
    path: &Path,
    (width, height): (u32, u32),
    bits: Option<u64>,
    file_bytes: u64,
) -> Result<(), ReadImageError> {
    let pixels = u64::from(width) * u64::from(height);
    let most = match bits {
        Some(bits) => file_bytes.saturating_mul(8 * MAX_RATIO) / bits,
        None => file_bytes.saturating_mul(JPEG_PIXELS_A_BYTE),
    };
    if pixels <= most.max(FREE_PIXELS) {
        return Ok(());
    }
    Err(ReadImageError::Damaged {
        path: path.to_path_buf(),
        reason: format!("{file_bytes} bytes cannot hold {width} x {height} pixels"),
    })
}

fn check_size(path: &Path, (width, height): (u32, u32)) -> Result<(), ReadImageError> {
    if width > MAX_SIDE_PX || height > MAX_SIDE_PX {
        return Err(ReadImageError::TooLarge {
            path: path.to_path_buf(),
            width,
            height,
            limit: MAX_SIDE_PX,
        });
    }
    Ok(())
}

fn decode(path: &Path) -> Result<DynamicImage, ReadImageError> {
    DynamicImage::from_decoder(open(path)?).map_err(|e| damaged(path, &e))
}

fn damaged(path: &Path, error: &image::ImageError) -> ReadImageError {
    // A disk that fails says nothing about the image.
    if let image::ImageError::IoError(source) = error
        && let Some(code) = source.raw_os_error()
    {
        return ReadImageError::Io {
            path: path.to_path_buf(),
            source: std::io::Error::from_raw_os_error(code),
        };
    }
    ReadImageError::Damaged {
        path: path.to_path_buf(),
        reason: error.to_string(),
    }
}

fn plane<T>(path: &Path, width: u32, height: u32, data: Vec<T>) -> Result<Plane<T>, ReadImageError> {
    Plane::from_vec(width as usize, height as usize, data).map_err(|e| ReadImageError::Damaged {
        path: path.to_path_buf(),
        reason: e.to_string(),
    })
}

/// Width and height of an image in pixels, from its header.
///
/// # Errors
///
/// [`ReadImageError`] if there is no such file or it is not a PNG or JPEG image.
pub fn size(path: &Path) -> Result<(usize, usize), ReadImageError> {
    let (width, height) = open(path)?.dimensions();
    Ok((width as usize, height as usize))
}

/// Decodes a colour image that was read from an archive; as [`read_rgb`], at most `most_pixels`. `name` is for messages.
///
/// # Errors
///
/// [`ReadImageError`] if it is not a complete PNG or JPEG image, or is larger.
pub fn decode_rgb(bytes: &[u8], name: &Path, most_pixels: u64) -> Result<RgbImage, ReadImageError> {
    let reader = ImageReader::new(Cursor::new(bytes));
    let reader = reader.with_guessed_format().map_err(|source| ReadImageError::Io {
        path: name.to_path_buf(),
        source,
    })?;
    if !matches!(reader.format(), Some(ImageFormat::Png | ImageFormat::Jpeg)) {
        return Err(ReadImageError::UnknownFormat {
            path: name.to_path_buf(),
        });
    }
    let decoder = reader.into_decoder().map_err(|e| damaged(name, &e))?;
    let (width, height) = decoder.dimensions();
    if width > MAX_SIDE_PX || height > MAX_SIDE_PX || u64::from(width) * u64::from(height) > most_pixels {
        return Err(ReadImageError::TooLarge {
            path: name.to_path_buf(),
            width,
            height,
            limit: MAX_SIDE_PX.min(most_pixels.isqrt() as u32),
        });
    }
    check_held(name, (width, height), bits_a_pixel(bytes), bytes.len() as u64)?;
    rgb(
        name,
        DynamicImage::from_decoder(decoder).map_err(|e| damaged(name, &e))?,
    )
}

/// Reads a colour image; grey becomes colour, 16 bits become 8, transparency becomes black.
///
/// # Errors
///
/// [`ReadImageError`] if there is no such file or it is not a complete PNG or JPEG image.
pub fn read_rgb(path: &Path) -> Result<RgbImage, ReadImageError> {
    rgb(path, decode(path)?)
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
///
/// # Errors
///
/// [`ReadImageError`] if there is no such file or it is not a complete PNG or JPEG image.
pub fn read_photo(path: &Path) -> Result<Photo, ReadImageError> {
    let mut decoder = open(path)?;
    let (width, height) = decoder.dimensions();
    // A damaged EXIF block is none.
    let exif = decoder.exif_metadata().ok().flatten();
    let orientation = decoder.orientation().ok();
    let mut image = DynamicImage::from_decoder(decoder).map_err(|e| damaged(path, &e))?;
    if let Some(orientation) = orientation {
        image.apply_orientation(orientation);
    }
    Ok(Photo {
        rgb: rgb(path, image)?,
        focal_px: exif.and_then(|e| exif::focal_px(&e, width as usize, height as usize)),
    })
}

fn rgb(path: &Path, image: DynamicImage) -> Result<RgbImage, ReadImageError> {
    let (width, height) = (image.width(), image.height());
    let data: Vec<[u8; 3]> = if image.color().has_alpha() {
        let over_black = |c: u8, a: u8| ((u32::from(c) * u32::from(a) + 127) / 255) as u8;
        let rgba = image.into_rgba8();
        rgba.pixels()
            .map(|p| [over_black(p[0], p[3]), over_black(p[1], p[3]), over_black(p[2], p[3])])
            .collect()
    } else {
        image.into_rgb8().pixels().map(|p| p.0).collect()
    };
    plane(path, width, height, data)
}

/// Reads a depth map: a greyscale PNG of 16 bits, times `unit` (scene units per step); 0 stays 0 = unknown.
///
/// # Errors
///
/// [`ReadImageError`] if there is no such file or it is not a 16-bit greyscale PNG.
pub fn read_depth(path: &Path, unit: f64) -> Result<CompactDepth, ReadImageError> {
    match decode(path)? {
        DynamicImage::ImageLuma16(grey) => {
            let (width, height) = grey.dimensions();
            let steps = plane(path, width, height, grey.into_raw())?;
            Ok(CompactDepth::from_steps(steps, unit))
        }
        other => Err(ReadImageError::NotDepth {
            path: path.to_path_buf(),
            found: format!("an image of type {:?}", other.color()),
        }),
    }
}

/// Reads object ids per pixel: a greyscale PNG of 8 or 16 bits, whose values are the numbers.
///
/// # Errors
///
/// [`ReadImageError`] if there is no such file or it is not a greyscale PNG: JPEG changes numbers.
pub fn read_ids(path: &Path) -> Result<CompactIds, ReadImageError> {
    ids(path, decode(path)?, is_png(path)?)
}

/// As [`read_ids`], of a file in memory; `path` is for messages.
///
/// # Errors
///
/// [`ReadImageError`] if it is not a greyscale PNG.
pub fn ids_of_bytes(path: &Path, bytes: &[u8]) -> Result<CompactIds, ReadImageError> {
    let reader = ImageReader::with_format(Cursor::new(bytes), ImageFormat::Png);
    let decoder = reader.into_decoder().map_err(|e| damaged(path, &e))?;
    check_size(path, decoder.dimensions())?;
    check_held(path, decoder.dimensions(), bits_a_pixel(bytes), bytes.len() as u64)?;
    let image = DynamicImage::from_decoder(decoder).map_err(|e| damaged(path, &e))?;
    ids(path, image, true)
}

fn ids(path: &Path, image: DynamicImage, is_png: bool) -> Result<CompactIds, ReadImageError> {
    let wrong = |found: String| ReadImageError::NotIds {
        path: path.to_path_buf(),
        found,
    };
    let (width, height) = (image.width(), image.height());
    let numbers: Vec<u16> = match image {
        DynamicImage::ImageLuma8(grey) if is_png => grey.into_raw().into_iter().map(u16::from).collect(),
        DynamicImage::ImageLuma16(grey) => grey.into_raw(),
        DynamicImage::ImageLuma8(_) => return Err(wrong("a JPEG image".to_owned())),
        other => return Err(wrong(format!("an image of type {:?}", other.color()))),
    };
    Ok(CompactIds::from(&plane(path, width, height, numbers)?))
}

/// Whether the bytes, not the name, are those of a PNG file.
fn is_png(path: &Path) -> Result<bool, ReadImageError> {
    let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format);
    let reader = reader.map_err(|source| ReadImageError::Io {
        path: path.to_path_buf(),
        source,
    })?;
    Ok(reader.format() == Some(ImageFormat::Png))
}

/// Reads a mask: set where the image's brightness is at least 128.
///
/// # Errors
///
/// [`ReadImageError`] if there is no such file or it is not a complete PNG or JPEG image.
pub fn read_mask(path: &Path) -> Result<CompactMask, ReadImageError> {
    Ok(read_grey(path)?.into())
}

/// Reads the brightness of an image, 0 to 255.
///
/// # Errors
///
/// [`ReadImageError`] if there is no such file or it is not a complete PNG or JPEG image.
pub fn read_grey(path: &Path) -> Result<Plane<u8>, ReadImageError> {
    let grey = decode(path)?.into_luma8();
    let (width, height) = grey.dimensions();
    plane(path, width, height, grey.into_raw())
}

#[cfg(test)]
mod tests {
    use super::{ReadImageError, decode_rgb};
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
        assert!(matches!(
            decode(&bytes, 14),
            Err(ReadImageError::TooLarge { width: 5, .. })
        ));
        assert!(matches!(decode(&bytes[..40], 15), Err(ReadImageError::Damaged { .. })));
        assert!(matches!(
            decode(b"GIF89a", 15),
            Err(ReadImageError::UnknownFormat { .. })
        ));
    }
}
