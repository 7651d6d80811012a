//! The arrays of an archive of tracks, by name and shape.

use crate::dataset::SourceErrorCause;
use crate::dataset::files::npy::{array_error, array_of, present};
use crate::dataset::files::pose;
use crate::npy::Npz;
use m4_core::Se3;

const HINT: &str = "give the tracks of this clip, one frame for each training frame";

/// Numbers `[frames][second][third]`.
pub(super) struct Numbers {
    pub second: usize,
    pub third: usize,
    pub values: Vec<f64>,
}

/// An archive and what its arrays must fit.
pub(super) struct Read {
    npz: Npz,
    frames: usize,
    limit_bytes: u64,
}

impl Read {
    pub(super) fn new(npz: Npz, frames: usize, limit_bytes: u64) -> Self {
        Self {
            npz,
            frames,
            // in memory numbers take 8 bytes, in the file 1 at least
            limit_bytes: limit_bytes / 8,
        }
    }

    /// What the archive holds, for messages.
    pub(super) fn names(&self) -> String {
        self.npz.names()
    }

    /// The first of `keys` that is there, `[frames][..][..]` or with a dimension of 1 before; two dimensions stand for a last one of 1.
    pub(super) fn one_of<'k>(&mut self, keys: &[&'k str]) -> Result<Option<(&'k str, Numbers)>, SourceErrorCause> {
        let Some(key) = present(&self.npz, keys) else {
            return Ok(None);
        };
        Ok(Some((key, self.numbers(key)?)))
    }

    fn numbers(&mut self, key: &str) -> Result<Numbers, SourceErrorCause> {
        let mut array = array_of(&mut self.npz, key, self.limit_bytes)?;
        let frames = self.frames;
        let (second, third) = match array.shape[..] {
            [n, k, c] | [1, n, k, c] if n == frames => (k, c),
            [n, k] if n == frames => (k, 1),
            [1, n, k] if n == frames => (k, 1),
            _ => {
                let what = format!("{key} has shape {:?} where {frames} frames were expected", array.shape);
                return Err(SourceErrorCause::bad(what, HINT));
            }
        };
        let n = array.shape.iter().product();
        let values = array.next_f64(n).map_err(|e| array_error(key, e))?;
        array.end().map_err(|e| array_error(key, e))?;
        Ok(Numbers { second, third, values })
    }

    /// One pose per frame.
    pub(super) fn cameras(&mut self, key: &str) -> Result<Option<Vec<Se3<f64>>>, SourceErrorCause> {
        if !self.npz.has(key) {
            return Ok(None);
        }
        let Numbers { second, third, values } = self.numbers(key)?;
        if !(3..=4).contains(&second) || third != 4 {
            let what = format!("{key} are matrices of {second} x {third}; 4 x 4 were expected");
            return Err(SourceErrorCause::bad(what, HINT));
        }
        let pose = |(i, m): (usize, &[f64])| {
            // of 4x4 matrices the last row is ignored
            pose::of_matrix(&format!("{key} of frame {i}"), &m[..12])
        };
        let poses: Result<Vec<_>, _> = values.chunks_exact(4 * second).enumerate().map(pose).collect();
        poses.map(Some)
    }

    /// Width and height of the images that were followed, by the shape of `video`.
    pub(super) fn video_size(&mut self) -> Result<Option<(usize, usize)>, SourceErrorCause> {
        let array = self.npz.array("video", u64::MAX).map_err(|e| array_error("video", e))?;
        let Some(array) = array else { return Ok(None) };
        match array.shape[..] {
            [_, h, w, 3] | [_, 3, h, w] | [1, _, h, w, 3] | [1, _, 3, h, w] if w > 0 && h > 0 => Ok(Some((w, h))),
            _ => {
                let what = format!(
                    "video has shape {:?}; [frames, height, width, 3] was expected",
                    array.shape
                );
                Err(SourceErrorCause::bad(what, HINT))
            }
        }
    }

    /// A colour per track.
    pub(super) fn colours(&mut self, tracks: usize) -> Result<Option<Vec<[u8; 3]>>, SourceErrorCause> {
        let array = self
            .npz
            .array("colors", self.limit_bytes)
            .map_err(|e| array_error("colors", e))?;
        let Some(mut array) = array else { return Ok(None) };
        if array.shape != [tracks, 3] || array.number != crate::npy::Number::U8 {
            let what = format!(
                "colors has shape {:?}; {tracks} colours of 8 bits were expected",
                array.shape
            );
            return Err(SourceErrorCause::bad(what, HINT));
        }
        let bytes = array.next_u8(3 * tracks).map_err(|e| array_error("colors", e))?;
        array.end().map_err(|e| array_error("colors", e))?;
        Ok(Some(bytes.as_chunks::<3>().0.to_vec()))
    }
}
