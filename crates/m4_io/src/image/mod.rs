//! Images, depth maps and masks, one file each.
//!
//! Reading takes 8- and 16-bit PNG and JPEG; an incomplete or damaged file is an error. Transparent
//! pixels are laid over black. Writing is atomic; the format follows the file name's extension.

mod jpeg;
mod read;
mod share;

pub use read::{
    Photo, decode_rgb, ids_of_bytes, read_depth, read_grey, read_ids, read_mask, read_photo,
    read_rgb, size,
};

use crate::{WriteError, atomic};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use m4_core::{CompactIds, DepthMap, Mask, Plane, RgbImage};
use std::path::Path;

/// Quality of JPEG files, 1 to 100: at 95 the coding error is under that of 8-bit video.
const JPEG_QUALITY: u8 = 95;

fn is_jpeg(path: &Path) -> Result<bool, WriteError> {
    let extension = path
        .extension()
        .and_then(|e| e.to_str())
        .map(str::to_ascii_lowercase);
    match extension.as_deref() {
        Some("png") => Ok(false),
        Some("jpg" | "jpeg") => Ok(true),
        _ => Err(WriteError::unsupported(
            path,
            "the name must end in .png, .jpg or .jpeg",
        )),
    }
}

fn save(
    path: &Path,
    bytes: &[u8],
    (width, height): (usize, usize),
    colour: ExtendedColorType,
) -> Result<(), WriteError> {
    let (Ok(w), Ok(h)) = (u32::try_from(width), u32::try_from(height)) else {
        return Err(WriteError::bad(
            path,
            format!("{width} x {height} pixels are too many"),
        ));
    };
    let mut file = Vec::new();
    if is_jpeg(path)? {
        JpegEncoder::new_with_quality(&mut file, JPEG_QUALITY).write_image(bytes, w, h, colour)
    } else {
        PngEncoder::new(&mut file).write_image(bytes, w, h, colour)
    }
    .map_err(|e| WriteError::bad(path, e.to_string()))?;
    atomic::write(path, &file).map_err(|e| WriteError::io(path, e))
}

/// Writes a colour image as PNG or JPEG (quality 95), by the extension.
pub fn write_rgb(path: &Path, image: &RgbImage) -> Result<(), WriteError> {
    save(
        path,
        image.data().as_flattened(),
        image.size(),
        ExtendedColorType::Rgb8,
    )
}

/// A depth map in steps of `unit`: `round(depth / unit)`.
///
/// 0 = unknown is kept, as is every other value that is not above 0; a known depth is 1 to 65535
/// steps, so depths outside of that range are moved to its ends.
pub(crate) fn depth_steps(depth: &DepthMap, unit: f64) -> Plane<u16> {
    depth.map(|&z| {
        if z > 0.0 {
            (f64::from(z) / unit).round().clamp(1.0, 65535.0) as u16
        } else {
            0
        }
    })
}

/// Writes a depth map as a 16-bit PNG of `round(depth / unit)`, 1 to 65535 where it is known. Fails
/// when the extension is not `.png` or the file system refuses.
pub fn write_depth(path: &Path, depth: &DepthMap, unit: f64) -> Result<(), WriteError> {
    if is_jpeg(path)? {
        return Err(WriteError::bad(
            path,
            "JPEG cannot store 16-bit depth; use .png",
        ));
    }
    save_steps(path, &depth_steps(depth, unit))
}

/// Writes a mask as an 8-bit PNG. Fails for other extensions and when the file system refuses.
pub fn write_mask(path: &Path, mask: &Mask) -> Result<(), WriteError> {
    write_grey(path, mask)
}

/// Writes object ids per pixel as a greyscale `.png`, of 8 bits if no id is above 255, else of 16.
pub fn write_ids(path: &Path, ids: &CompactIds) -> Result<(), WriteError> {
    if is_jpeg(path)? {
        return Err(WriteError::bad(path, "JPEG changes numbers; use .png"));
    }
    let plane = ids.to_plane();
    if ids.largest() <= u16::from(u8::MAX) {
        return write_grey(path, &plane.map(|&id| id as u8));
    }
    save_steps(path, &plane)
}

/// Writes numbers of 16 bits as a greyscale image.
fn save_steps(path: &Path, steps: &Plane<u16>) -> Result<(), WriteError> {
    let bytes: Vec<u8> = steps.data().iter().flat_map(|v| v.to_ne_bytes()).collect();
    save(path, &bytes, steps.size(), ExtendedColorType::L16)
}

/// Writes brightness as an 8-bit PNG. Fails for other extensions and when the file system refuses.
pub fn write_grey(path: &Path, grey: &Plane<u8>) -> Result<(), WriteError> {
    save(path, grey.data(), grey.size(), ExtendedColorType::L8)
}

#[cfg(test)]
mod tests {
    use super::{read_depth, read_ids, read_rgb, write_depth, write_ids, write_rgb};
    use m4_core::{CompactIds, Plane};

    #[test]
    fn unknown_depth_stays_distinct_from_near_depth() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("d.png");
        let depth = Plane::from_vec(3, 2, vec![0.0, 1e-9, 1.2344, 65.535, 1e9, f32::NAN]).unwrap();
        write_depth(&path, &depth, 0.001).unwrap();
        let got = read_depth(&path, 0.001).unwrap();
        assert_eq!(
            got.to_map().data(),
            [0.0, 0.001, 1.234, 65.535, 65.535, 0.0]
        );
    }

    #[test]
    fn instance_ids_round_trip_exactly() {
        let dir = tempfile::tempdir().unwrap();
        for (name, step) in [("small.png", 15u16), ("large.png", 4000)] {
            let path = dir.path().join(name);
            let ids = CompactIds::from(&Plane::from_fn(17, 9, |x, y| {
                (x as u16 / 4) * (y as u16 / 3) * step
            }));
            assert_eq!(ids.largest() > 255, step > 255);
            write_ids(&path, &ids).unwrap();
            assert_eq!(read_ids(&path).unwrap(), ids);
        }
        let colours = dir.path().join("c.png");
        write_rgb(&colours, &Plane::filled(4, 4, [1, 2, 3])).unwrap();
        assert!(
            read_ids(&colours)
                .unwrap_err()
                .to_string()
                .contains("greyscale PNG")
        );
        assert!(
            write_ids(
                &dir.path().join("i.jpg"),
                &CompactIds::from(&Plane::filled(2, 2, 1))
            )
            .is_err()
        );
    }

    #[test]
    fn jpeg_is_close_and_other_extensions_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let rgb = Plane::from_fn(64, 48, |x, y| [(x * 3) as u8, (y * 4) as u8, 90]);
        let path = dir.path().join("a.JPG");
        write_rgb(&path, &rgb).unwrap();
        let got = read_rgb(&path).unwrap();
        for (a, b) in got.data().iter().zip(rgb.data()) {
            assert!(
                a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) <= 8),
                "{a:?} {b:?}"
            );
        }
        let error = write_rgb(&dir.path().join("a.bmp"), &rgb).unwrap_err();
        assert!(error.to_string().contains(".png"), "{error}");
    }
}
