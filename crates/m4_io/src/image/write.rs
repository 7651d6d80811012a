//! Writes planes as PNG and JPEG files.

use super::WriteImageError;
use crate::atomic;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use m4_core::{CompactIds, DepthMap, Mask, Plane, RgbImage};
use std::path::Path;

/// Quality of JPEG files, 1 to 100: at 95 the coding error is under that of 8-bit video.
const JPEG_QUALITY: u8 = 95;

fn is_jpeg(path: &Path) -> Result<bool, WriteImageError> {
    let extension = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    match extension.as_deref() {
        Some("png") => Ok(false),
        Some("jpg" | "jpeg") => Ok(true),
        _ => Err(WriteImageError::UnknownFormat {
            path: path.to_path_buf(),
        }),
    }
}

fn save(
    path: &Path,
    bytes: &[u8],
    (width, height): (usize, usize),
    colour: ExtendedColorType,
) -> Result<(), WriteImageError> {
    let encode = |reason: String| WriteImageError::Encode {
        path: path.to_path_buf(),
        reason,
    };
    let (Ok(w), Ok(h)) = (u32::try_from(width), u32::try_from(height)) else {
        return Err(encode(format!("{width} x {height} pixels are too many")));
    };
    let mut file = Vec::new();
    if is_jpeg(path)? {
        JpegEncoder::new_with_quality(&mut file, JPEG_QUALITY).write_image(bytes, w, h, colour)
    } else {
        PngEncoder::new(&mut file).write_image(bytes, w, h, colour)
    }
    .map_err(|e| encode(e.to_string()))?;
    atomic::write(path, &file).map_err(|source| WriteImageError::Io {
        path: path.to_path_buf(),
        source,
    })
}

/// Writes a colour image as PNG or JPEG (quality 95), by the extension.
///
/// # Errors
///
/// [`WriteImageError`] for other extensions and when the file system refuses.
pub fn write_rgb(path: &Path, image: &RgbImage) -> Result<(), WriteImageError> {
    save(path, image.data().as_flattened(), image.size(), ExtendedColorType::Rgb8)
}

/// Writes a depth map as a 16-bit PNG of `round(depth / unit)`.
///
/// 0 = unknown is kept, as is every other value that is not above 0; a known depth is stored as 1
/// to 65535 steps, so depths outside of that range are moved to its ends.
///
/// # Errors
///
/// [`WriteImageError`] when the extension is not `.png` or the file system refuses.
pub fn write_depth(path: &Path, depth: &DepthMap, unit: f64) -> Result<(), WriteImageError> {
    if is_jpeg(path)? {
        return Err(WriteImageError::Encode {
            path: path.to_path_buf(),
            reason: "JPEG cannot store 16-bit depth; use .png".into(),
        });
    }
    let steps = |z: f32| {
        if z > 0.0 {
            (f64::from(z) / unit).round().clamp(1.0, 65535.0) as u16
        } else {
            0
        }
    };
    let bytes: Vec<u8> = depth.data().iter().flat_map(|&z| steps(z).to_ne_bytes()).collect();
    save(path, &bytes, depth.size(), ExtendedColorType::L16)
}

/// Writes a mask as an 8-bit PNG.
///
/// # Errors
///
/// [`WriteImageError`] for other extensions and when the file system refuses.
pub fn write_mask(path: &Path, mask: &Mask) -> Result<(), WriteImageError> {
    write_grey(path, mask)
}

/// Writes object ids per pixel as a greyscale PNG, of 8 bits if no id is above 255, else of 16.
///
/// # Errors
///
/// [`WriteImageError`] when the extension is not `.png` or the file system refuses.
pub fn write_ids(path: &Path, ids: &CompactIds) -> Result<(), WriteImageError> {
    if is_jpeg(path)? {
        return Err(WriteImageError::Encode {
            path: path.to_path_buf(),
            reason: "JPEG changes numbers; use .png".into(),
        });
    }
    let plane = ids.to_plane();
    if ids.largest() <= u16::from(u8::MAX) {
        return write_grey(path, &plane.map(|&id| id as u8));
    }
    let bytes: Vec<u8> = plane.data().iter().flat_map(|id| id.to_ne_bytes()).collect();
    save(path, &bytes, plane.size(), ExtendedColorType::L16)
}

/// Writes brightness as an 8-bit PNG.
///
/// # Errors
///
/// [`WriteImageError`] for other extensions and when the file system refuses.
pub fn write_grey(path: &Path, grey: &Plane<u8>) -> Result<(), WriteImageError> {
    save(path, grey.data(), grey.size(), ExtendedColorType::L8)
}

#[cfg(test)]
mod tests {
    use super::{write_depth, write_ids, write_mask, write_rgb};
    use crate::image::{read_depth, read_ids, read_mask, read_rgb, size};
    use m4_core::{CompactIds, Plane};

    #[test]
    fn png_images_round_trip() {
        let dir = tempfile::tempdir().unwrap();
        let rgb = Plane::from_fn(37, 23, |x, y| [(x * 7) as u8, (y * 11) as u8, (x * y) as u8]);
        let path = dir.path().join("a.png");
        write_rgb(&path, &rgb).unwrap();
        assert_eq!(read_rgb(&path).unwrap(), rgb);
        assert_eq!(size(&path).unwrap(), (37, 23));

        let mask = Plane::from_fn(5, 4, |x, y| if (x + y) % 2 == 0 { 255 } else { 0 });
        let path = dir.path().join("m.png");
        write_mask(&path, &mask).unwrap();
        assert_eq!(read_mask(&path).unwrap().to_mask(), mask);
    }

    #[test]
    fn unknown_depth_stays_distinct_from_near_depth() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("d.png");
        let depth = Plane::from_vec(3, 2, vec![0.0, 1e-9, 1.2344, 65.535, 1e9, f32::NAN]).unwrap();
        write_depth(&path, &depth, 0.001).unwrap();
        let got = read_depth(&path, 0.001).unwrap();
        assert_eq!(got.to_map().data(), [0.0, 0.001, 1.234, 65.535, 65.535, 0.0]);
    }

    #[test]
    fn instance_ids_round_trip_exactly() {
        let dir = tempfile::tempdir().unwrap();
        for (name, step) in [("small.png", 15u16), ("large.png", 4000)] {
            let path = dir.path().join(name);
            let ids = CompactIds::from(&Plane::from_fn(17, 9, |x, y| (x as u16 / 4) * (y as u16 / 3) * step));
            assert_eq!(ids.largest() > 255, step > 255);
            write_ids(&path, &ids).unwrap();
            assert_eq!(read_ids(&path).unwrap(), ids);
        }
        let colours = dir.path().join("c.png");
        write_rgb(&colours, &Plane::filled(4, 4, [1, 2, 3])).unwrap();
        assert!(read_ids(&colours).unwrap_err().to_string().contains("greyscale PNG"));
        assert!(write_ids(&dir.path().join("i.jpg"), &CompactIds::from(&Plane::filled(2, 2, 1))).is_err());
    }

    #[test]
    fn jpeg_is_close_and_other_extensions_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let rgb = Plane::from_fn(64, 48, |x, y| [(x * 3) as u8, (y * 4) as u8, 90]);
        let path = dir.path().join("a.JPG");
        write_rgb(&path, &rgb).unwrap();
        let got = read_rgb(&path).unwrap();
        for (a, b) in got.data().iter().zip(rgb.data()) {
            assert!(a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) <= 8), "{a:?} {b:?}");
        }
        let error = write_rgb(&dir.path().join("a.bmp"), &rgb).unwrap_err();
        assert!(error.to_string().contains(".png"), "{error}");
    }
}
