//! The focal length in a camera's EXIF block, the only value that geometry uses.

/// Diagonal of a frame of 35 mm film, millimetres: what "35 mm equivalent" focal lengths refer to (CIPA DCG-001).
const FILM_DIAGONAL_MM: f64 = 43.266_615;
/// Tag of the pointer to the EXIF part.
const EXIF_PART: u16 = 0x8769;
/// Tag `FocalLengthIn35mmFilm`, millimetres.
const FOCAL_35_MM: u16 = 0xa405;

/// Focal length in pixels of an image of `width` x `height` pixels, from its EXIF block (a TIFF
/// header and directories); `None` where the block does not say or is damaged.
pub fn focal_px(exif: &[u8], width: usize, height: usize) -> Option<f64> {
    let tiff = Tiff::new(exif)?;
    let part = tiff.find(tiff.u32(4)?, EXIF_PART)?;
    let entry = tiff.find_entry(tiff.u32(part)?, FOCAL_35_MM)?;
    let millimetres = match tiff.u16(entry + 2)? {
        3 => u32::from(tiff.u16(entry + 8)?),
        4 => tiff.u32(entry + 8)?,
        _ => return None,
    };
    let diagonal_px = (width as f64).hypot(height as f64);
    (millimetres > 0).then(|| f64::from(millimetres) / FILM_DIAGONAL_MM * diagonal_px)
}

struct Tiff<'a> {
    bytes: &'a [u8],
    little: bool,
}

impl<'a> Tiff<'a> {
    fn new(bytes: &'a [u8]) -> Option<Self> {
        let little = match bytes.get(..4)? {
            b"II*\0" => true,
            b"MM\0*" => false,
            _ => return None,
        };
        Some(Self { bytes, little })
    }

    fn u16(&self, at: usize) -> Option<u16> {
        let b = *self.bytes.get(at..)?.first_chunk()?;
        Some(if self.little { u16::from_le_bytes(b) } else { u16::from_be_bytes(b) })
    }

    fn u32(&self, at: usize) -> Option<u32> {
        let b = *self.bytes.get(at..)?.first_chunk()?;
        Some(if self.little { u32::from_le_bytes(b) } else { u32::from_be_bytes(b) })
    }

    /// Where the entry of `tag` is in the directory at `at`.
    fn find_entry(&self, at: u32, tag: u16) -> Option<usize> {
        let at = at as usize;
        let count = usize::from(self.u16(at)?);
        (0..count).map(|i| at + 2 + 12 * i).find(|&entry| self.u16(entry) == Some(tag))
    }

    /// Where the value of `tag` is in the directory at `at`, for values of up to four bytes.
    fn find(&self, at: u32, tag: u16) -> Option<usize> {
        Some(self.find_entry(at, tag)? + 8)
    }
}

#[cfg(test)]
mod tests {
    use super::focal_px;

    fn block() -> Vec<u8> {
        let mut tiff = b"II*\0\x08\0\0\0".to_vec();
        // One entry: the pointer to the part at byte 26.
        tiff.extend([1, 0, 0x69, 0x87, 4, 0, 1, 0, 0, 0, 26, 0, 0, 0, 0, 0, 0, 0]);
        // One entry: 26 mm as a short.
        tiff.extend([1, 0, 0x05, 0xa4, 3, 0, 1, 0, 0, 0, 26, 0, 0, 0, 0, 0, 0, 0]);
        tiff
    }

    #[test]
    fn truncated_exif_blocks_give_no_focal_length() {
        let whole = block();
        assert!(focal_px(&whole, 40, 30).is_some());
        for cut in 0..38 {
            assert_eq!(focal_px(&whole[..cut], 40, 30), None, "{cut}");
        }
        assert_eq!(focal_px(b"Exif\0\0", 40, 30), None);
    }
}
