//! Scene files: `scene.safetensors` and those of other viewers, one folder per format.
//!
//! A writer takes a [`m4_core::Scene`], writes the file atomically, and returns what it wrote and
//! what the format could not hold ([`Written`]). A format with one instant, or one per frame, is
//! given splats without time by [`instant()`]. Splats that are bound to nodes are in
//! `scene.safetensors` alone; other writers refuse them, `minute4d export` turns them into others
//! before. A reader takes untrusted bytes: whatever they are, it returns a scene ([`Imported`]) or
//! an error that names the field, and allocates no more than a small multiple of the file.

pub mod fourdgs;
pub mod ftgs;
pub mod gltf;
pub mod ply;
pub mod safetensors;
mod splats;
pub mod splatv;
pub mod spz;
mod valid;

pub use splats::{at_peak, instant};

use crate::WriteError;
use crate::atomic::AtomicFile;
use m4_core::{Scene, SourceFrame, Splats};
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// The constant harmonic: a colour is `1/2 + C0` times the first coefficient
/// (docs/spec/optimiser.md 1.8).
pub(crate) const C0: f64 = 0.282_094_791_773_878_14;

/// What a file holds differently from the scene that it was written from, or a scene from the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Loss {
    /// Evaluated at fixed instants: what it was, and at which.
    Baked(String),
    /// Missing from the file.
    Dropped(String),
    /// Stored with fewer digits: what, and the step or the largest error.
    Quantised(String),
}

impl Loss {
    /// The Mip filter, for a format that has no place for it; `None` for a scene without one.
    pub(crate) fn of_mip(scene: &Scene) -> Option<Self> {
        let what = "the Mip filter: splats smaller than a pixel are rendered too thick";
        scene.mip.then(|| Self::Dropped(what.to_owned()))
    }
}

impl std::fmt::Display for Loss {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Baked(what) => write!(f, "baked: {what}"),
            Self::Dropped(what) => write!(f, "dropped: {what}"),
            Self::Quantised(what) => write!(f, "quantised: {what}"),
        }
    }
}

/// A file, or a folder of files, that was written and read back.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Written {
    /// The file; for a sequence the folder.
    pub path: PathBuf,
    /// Bytes of all files.
    pub bytes: u64,
    /// Splats in the file; for a sequence the sum over its files.
    pub splats: usize,
    /// What the format could not hold.
    pub losses: Vec<Loss>,
}

/// A scene from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// The scene. `source` is empty where the file has no cameras.
    pub scene: Scene,
    /// Unit vector that points up, where the file says so.
    pub up: Option<[f64; 3]>,
    /// What of the file a scene cannot hold.
    pub losses: Vec<Loss>,
}

/// `1 splat`, `2 splats`.
pub(crate) fn plural(n: usize, noun: &str) -> String {
    let s = if n == 1 { "" } else { "s" };
    format!("{n} {noun}{s}")
}

/// Frames per second where a scene or a file does not say.
pub const DEFAULT_FPS: f64 = 30.0;

/// How long a frame of a scene lasts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Clock {
    /// Seconds from one frame to the next.
    pub step_s: f64,
    /// True where that was made up: [`DEFAULT_FPS`].
    pub assumed: bool,
}

impl Clock {
    /// The clock of a scene.
    pub fn of(scene: &Scene) -> Self {
        let steps = scene.time_frames.saturating_sub(1) as f64;
        match scene.duration_s {
            Some(s) if s > 0.0 && steps > 0.0 => Self {
                step_s: s / steps,
                assumed: false,
            },
            _ => Self {
                step_s: 1.0 / DEFAULT_FPS,
                assumed: true,
            },
        }
    }
}

/// Longest side of an image, pixels, and farthest position, world units, of a valid camera.
const MAX_SIDE_PX: usize = 16_384;
const MAX_PLACE: f64 = 1e12;

/// True for a camera that an image can be made with, at a moment that is a number.
pub(crate) fn usable(frame: &SourceFrame) -> bool {
    let k = &frame.camera.intrinsics;
    let side = |px: usize| (1..=MAX_SIDE_PX).contains(&px);
    let focal = |px: f64| px.is_finite() && (1e-3..=1e9).contains(&px);
    let centre = |px: f64| px.is_finite() && px.abs() < 1e9;
    let rotation = &frame.camera.c2w.rotation;
    let turned = rotation * rotation.transpose();
    let orthonormal = turned
        .iter()
        .enumerate()
        .all(|(i, &v)| (v - f64::from(u8::from(i % 4 == 0))).abs() < 1e-3);
    side(k.width)
        && side(k.height)
        && focal(k.fx)
        && focal(k.fy)
        && centre(k.cx)
        && centre(k.cy)
        && frame.t.is_finite()
        && frame
            .camera
            .c2w
            .translation
            .iter()
            .all(|v| v.abs() < MAX_PLACE)
        && orthonormal
        && rotation.determinant() > 0.0
}

/// Refuses a scene that would not render.
pub(crate) fn check_finite(path: &Path, scene: &Scene) -> Result<(), WriteError> {
    if scene.splats.is_finite() {
        return Ok(());
    }
    Err(WriteError::bad(
        path,
        "a parameter of a splat is not a finite number",
    ))
}

/// Refuses bound splats, for formats that have no nodes.
pub(crate) fn check_unbound(path: &Path, splats: &Splats) -> Result<(), WriteError> {
    let n = splats.bindings().len();
    if n == 0 {
        return Ok(());
    }
    let how = "turn them into splats of an instant or on straight lines first (m4_kernels::pose::at, pieces)";
    Err(WriteError::bad(
        path,
        format!(
            "{} bound to nodes, which this format does not have; {how}",
            plural(n, "splat")
        ),
    ))
}

/// Writes `bytes` to `path`, atomically, and reads them back first.
pub(crate) fn publish(path: &Path, bytes: &[u8]) -> Result<(), WriteError> {
    let mut file = VerifiedFile::create(path).map_err(|e| WriteError::io(path, e))?;
    file.write_all(bytes).map_err(|e| WriteError::io(path, e))?;
    file.publish(path).map(|_| ())
}

/// An [`AtomicFile`] that keeps a hash of what was written.
pub(crate) struct VerifiedFile {
    file: AtomicFile,
    hash: blake3::Hasher,
    bytes: u64,
}

impl VerifiedFile {
    pub fn create(path: &Path) -> io::Result<Self> {
        Ok(Self {
            file: AtomicFile::create(path)?,
            hash: blake3::Hasher::new(),
            bytes: 0,
        })
    }

    /// Puts everything on the disk and compares it with what was written.
    fn verify(&mut self) -> io::Result<()> {
        self.file.sync()?;
        let mut read = blake3::Hasher::new();
        let mut from = File::open(self.file.temporary_path())?;
        let mut block = vec![0; 1 << 16];
        loop {
            match from.read(&mut block)? {
                0 => break,
                n => read.update(&block[..n]),
            };
        }
        if read.finalize() != self.hash.finalize() {
            return Err(io::Error::other(
                "the bytes on the disk are not those that were written",
            ));
        }
        Ok(())
    }

    /// Verifies the file and publishes it; its size, bytes.
    pub fn publish(mut self, path: &Path) -> Result<u64, WriteError> {
        self.verify().map_err(|e| WriteError::verify(path, e))?;
        self.file.commit().map_err(|e| WriteError::io(path, e))?;
        Ok(self.bytes)
    }
}

impl Write for VerifiedFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let n = self.file.write(bytes)?;
        self.hash.update(&bytes[..n]);
        self.bytes += n as u64;
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::VerifiedFile;
    use std::io::Write;

    #[test]
    fn a_file_that_changed_on_the_disk_is_not_published() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.bin");
        let mut file = VerifiedFile::create(&path).unwrap();
        file.write_all(b"abc").unwrap();
        file.verify().unwrap();
        let temporary = file.file.temporary_path().to_path_buf();
        std::fs::write(&temporary, b"abd").unwrap();
        assert!(file.verify().is_err());
        std::fs::write(&temporary, b"abc").unwrap();
        assert_eq!(file.publish(&path).unwrap(), 3);
        assert_eq!(std::fs::read(&path).unwrap(), b"abc");
    }
}
