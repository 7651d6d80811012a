//! Arrays of an npz archive, by any of several names.

use super::npy::{NpyFile, array_fault, array_of, open_npz, present};
use super::{lens, pose};
use crate::core::{FrameSource, ImportOptions, ReadSourceError, SourceFault, step};
use crate::side::depth;
use m4_io::npy::{ArrayFault, Npz, Number};
use m4_math::Se3;
use m4_scene::{CompactDepth, Intrinsics, Plane, Progress, RgbImage, Silent};
use std::path::{Path, PathBuf};

/// Bytes of an array of poses or lenses: a quarter of a million frames.
const MAX_SMALL_BYTES: u64 = 16 << 20;
/// Bytes a pixel of a decoded frame: colour and depth, and room for a mask.
const BYTES_A_PIXEL: u64 = 8;

/// An archive.
pub(crate) struct Arrays {
    pub path: PathBuf,
    npz: Npz,
    limit_bytes: u64,
}

impl Arrays {
    pub fn open(path: &Path, options: &ImportOptions) -> Result<Self, ReadSourceError> {
        Ok(Self {
            path: path.to_path_buf(),
            npz: open_npz(path).map_err(|fault| fault.at(path))?,
            limit_bytes: options.max_memory_bytes,
        })
    }

    /// Which of the names it has.
    pub fn find(&self, names: &[&'static str]) -> Option<&'static str> {
        present(&self.npz, names)
    }

    /// Which of the names it has; an error that lists what is there if none.
    pub fn need(&self, names: &[&'static str], remedy: &str) -> Result<&'static str, ReadSourceError> {
        self.find(names).ok_or_else(|| {
            let what = format!("the array {}", names.join(" or "));
            SourceFault::missing(what, format!("it has {}; {remedy}", self.npz.names())).at(&self.path)
        })
    }

    /// A fault of one array.
    pub fn at(&self, name: &str) -> impl Fn(SourceFault) -> ReadSourceError + use<> {
        let (path, name) = (self.path.clone(), format!("array `{name}`"));
        move |fault| fault.within(&path, name.clone())
    }

    /// A small array: its numbers and its shape without leading 1s beyond `rank`.
    pub fn numbers(&mut self, name: &'static str, rank: usize) -> Result<(Vec<usize>, Vec<f64>), ReadSourceError> {
        let at = self.at(name);
        let array = array_of(&mut self.npz, name, MAX_SMALL_BYTES).and_then(NpyFile::of_array);
        let array = array.map_err(at)?;
        Ok((unbatched(&array.shape, rank).to_vec(), array.values))
    }

    /// Rigid motions `[n][3][4]` or `[n][4][4]`, as they are stored.
    pub fn poses(&mut self, name: &'static str) -> Result<Vec<Se3<f64>>, ReadSourceError> {
        let at = self.at(name);
        let (shape, values) = self.numbers(name, 3)?;
        let rows = match *shape.as_slice() {
            [_, rows @ (3 | 4), 4] => rows,
            ref other => return Err(at(wrong_shape(other, "(frames, 3, 4) or (frames, 4, 4)"))),
        };
        let all = values.chunks_exact(4 * rows).enumerate();
        all.map(|(i, m)| pose::of_matrix(&format!("the matrix of frame {i}"), m).map_err(&at))
            .collect()
    }

    /// Matrices of intrinsics `[n][3][3]` of pictures of that size; one `[3][3]` serves for all `n`.
    pub fn lenses(
        &mut self,
        name: &'static str,
        n: usize,
        size: (usize, usize),
    ) -> Result<Vec<Intrinsics>, ReadSourceError> {
        let at = self.at(name);
        let (shape, values) = self.numbers(name, 3)?;
        match *shape.as_slice() {
            [m, 3, 3] if m == n => {}
            [3, 3] => {
                let one = lens::of_matrix(&values, size).map_err(&at)?;
                return Ok(vec![one; n]);
            }
            ref other => return Err(at(wrong_shape(other, &format!("({n} frames, 3, 3)")))),
        }
        let all = values.chunks_exact(9).enumerate();
        all.map(|(i, k)| {
            lens::of_matrix(k, size).map_err(|fault| fault.within(&self.path, format!("array `{name}`, frame {i}")))
        })
        .collect()
    }

    /// Frames, width and height of an array of maps `[n][h][w]` or `[n][h][w][1]`.
    pub fn map_shape(&mut self, name: &'static str) -> Result<(usize, usize, usize), ReadSourceError> {
        let (at, path) = (self.at(name), self.path.clone());
        let limit_bytes = self.limit_bytes;
        let array = array_of(&mut self.npz, name, limit_bytes).map_err(&at)?;
        let shape = match array.shape.as_slice() {
            [rest @ .., 1] if rest.len() >= 3 => unbatched(rest, 3),
            all => unbatched(all, 3),
        };
        match *shape {
            [h, w] if h * w > 0 => {
                fits(&path, (1, w, h), limit_bytes)?;
                Ok((1, w, h))
            }
            [n, h, w] if n * h * w > 0 => {
                fits(&path, (n, w, h), limit_bytes)?;
                Ok((n, w, h))
            }
            ref other => Err(at(wrong_shape(other, "(frames, height, width)"))),
        }
    }

    /// Depth maps of [`Arrays::map_shape`].
    pub fn maps(
        &mut self,
        name: &'static str,
        progress: &dyn Progress,
    ) -> Result<Vec<FrameSource<CompactDepth>>, ReadSourceError> {
        let (n, w, h) = self.map_shape(name)?;
        let at = self.at(name);
        let mut read = || -> Result<Vec<_>, SourceFault> {
            let mut array = array_of(&mut self.npz, name, self.limit_bytes)?;
            let mut maps = Vec::with_capacity(n);
            for i in 0..n {
                step("read depth", i, n, progress)?;
                let values = array.next_f64(w * h).map_err(bad)?;
                maps.push(FrameSource::held(depth::map(w, h, values, 1.0)?));
            }
            array.end().map_err(bad)?;
            Ok(maps)
        };
        read().map_err(at)
    }

    /// Pictures `[n][h][w][3]` or `[n][3][h][w]`, of bytes or of 0 to 1, with their size.
    pub fn pictures(&mut self, name: &'static str, progress: &dyn Progress) -> Result<Vec<RgbImage>, ReadSourceError> {
        let (at, path) = (self.at(name), self.path.clone());
        let limit_bytes = self.limit_bytes;
        let mut array = array_of(&mut self.npz, name, limit_bytes).map_err(&at)?;
        let shape = unbatched(&array.shape, 4);
        let (n, h, w, planar) = match *shape {
            [h, w, 3] => (1, h, w, false),
            [n, h, w, 3] => (n, h, w, false),
            [n, 3, h, w] => (n, h, w, true),
            ref other => {
                let expected = "(frames, height, width, 3) or (frames, 3, height, width)";
                return Err(at(wrong_shape(other, expected)));
            }
        };
        if n * h * w == 0 {
            return Err(at(wrong_shape(shape, "pictures of at least a pixel")));
        }
        fits(&path, (n, w, h), limit_bytes)?;
        let mut read = || -> Result<Vec<_>, SourceFault> {
            let mut all = Vec::with_capacity(n);
            for i in 0..n {
                step("read pictures", i, n, progress)?;
                let bytes = if array.number == Number::U8 {
                    array.next_u8(3 * w * h).map_err(bad)?
                } else {
                    let values = array.next_f64(3 * w * h).map_err(bad)?;
                    to_bytes(&values)?
                };
                let pixel = |k: usize| {
                    if planar {
                        [bytes[k], bytes[k + w * h], bytes[k + 2 * w * h]]
                    } else {
                        [bytes[3 * k], bytes[3 * k + 1], bytes[3 * k + 2]]
                    }
                };
                let pixels = (0..w * h).map(pixel).collect();
                let image = Plane::from_vec(w, h, pixels);
                all.push(image.map_err(|e| SourceFault::bad(e.to_string(), "save the pictures again"))?);
            }
            array.end().map_err(bad)?;
            Ok(all)
        };
        read().map_err(at)
    }

    /// The picture of an archive of one frame.
    pub fn only_picture(&mut self, name: &'static str) -> Result<RgbImage, ReadSourceError> {
        let at = self.at(name);
        let mut all = self.pictures(name, &Silent)?;
        match (all.pop(), all.is_empty()) {
            (Some(one), true) => Ok(one),
            _ => Err(at(SourceFault::bad("it has several pictures", "save one frame a file"))),
        }
    }

    /// The depth map of an archive of one frame.
    pub fn only_map(&mut self, name: &'static str) -> Result<CompactDepth, ReadSourceError> {
        let at = self.at(name);
        let mut all = self.maps(name, &Silent)?;
        match (all.pop(), all.is_empty()) {
            (Some(one), true) => one.get().map_err(at),
            _ => Err(at(SourceFault::bad("it has several maps", "save one frame a file"))),
        }
    }
}

/// The shape without leading 1s beyond `rank`: networks leave a dimension of batches.
fn unbatched(shape: &[usize], rank: usize) -> &[usize] {
    match shape {
        [1, rest @ ..] if shape.len() > rank => unbatched(rest, rank),
        all => all,
    }
}

fn wrong_shape(found: &[usize], expected: &str) -> SourceFault {
    SourceFault::bad(
        format!("it has shape {found:?}; {expected} was expected"),
        "save the arrays of one clip as the tool gives them",
    )
}

fn to_bytes(values: &[f64]) -> Result<Vec<u8>, SourceFault> {
    if let Some(value) = values.iter().find(|v| !(-0.01..=1.01).contains(*v)) {
        let what = format!("its pictures hold {value}; bytes, or numbers from 0 to 1, were expected");
        return Err(SourceFault::bad(what, "save them so"));
    }
    // a cast to u8 clips
    Ok(values.iter().map(|v| (v * 255.0).round() as u8).collect())
}

/// Whether the decoded frames fit into memory.
fn fits(path: &Path, (n, w, h): (usize, usize, usize), limit_bytes: u64) -> Result<(), ReadSourceError> {
    // no overflow: the array fits into a file
    let needed_bytes = ((n * w * h) as u64).saturating_mul(BYTES_A_PIXEL);
    if needed_bytes <= limit_bytes {
        return Ok(());
    }
    Err(SourceFault::TooLarge {
        what: format!("a clip of {n} frames of {w} x {h} pixels"),
        needed_bytes,
        limit_bytes,
    }
    .at(path))
}

/// What is wrong with the array that the place names.
fn bad(fault: ArrayFault) -> SourceFault {
    array_fault("the array", fault)
}

/// The fault with the file and the place in its words: frames name the source and themselves.
pub(crate) fn inner(error: ReadSourceError) -> SourceFault {
    let file = match &error.place {
        Some(place) => PathBuf::from(format!("{}, {place}", error.path.display())),
        None => error.path,
    };
    error.fault.of_file(&file)
}
