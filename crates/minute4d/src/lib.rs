//! The pipeline of minute4d: turns a casual video into a dynamic 3D scene.
//!
//! ```text
//! video --geometry--> capture --train--> scene.safetensors --render, preview, viewer, evaluate-->
//! ```
//!
//! [`run`] does everything; [`geometry::make`], [`train::make`], [`render::make`] and the functions of
//! [`evaluate`] each run one stage on the output of the previous one. A stage is a function of its input, its
//! [`Settings`] and the seed: results are stored with a hash of those ([`record`]) and reused if
//! nothing changed.
//!
//! ```no_run
//! use minute4d::{Existing, Job, Settings, Silent};
//! # fn main() -> Result<(), minute4d::Error> {
//! let job = Job {
//!     settings: Settings::fast(),
//!     device: Default::default(),
//!     existing: Existing::Resume,
//!     observer: &Silent,
//! };
//! let record = minute4d::run("clip.mp4".as_ref(), "out".as_ref(), &job)?;
//! println!("{:?} splats in {:.0} s", record.splats, record.seconds);
//! # Ok(())
//! # }
//! ```
#![forbid(unsafe_code)]

pub mod ablate;
pub mod batch;
pub mod bench;
pub mod cache;
pub mod device;
pub mod enhance;
pub mod evaluate;
pub mod export;
pub mod geometry;
pub mod layout;
pub mod networks;
pub mod page;
pub mod render;
pub mod reproduce;
pub mod run;
pub mod settings;
pub mod train;
pub mod view;
#[cfg(feature = "nets")]
pub mod weights;

mod environment;
mod error;
mod hash;
mod json;
mod observer;
mod time;

pub use error::{BUILD_FULL, Category, DataError, Error, NetworkError, NetworkMethod, OutputError, Refusal};
pub use json::plain_json;
pub use layout::Existing;
pub use observer::{Observer, RecordingObserver, StageEvent};
pub use run::{Job, run, threads, with_threads};
pub use settings::Settings;

pub use m4_core::{self, Progress, Silent};
#[cfg(feature = "nets")]
pub use m4_nets;
pub use {m4_eval, m4_geometry, m4_io, m4_kernels, m4_train, m4_viewer};

#[cfg(test)]
mod test_clips {
    use m4_core::{Camera, Capture, CaptureFrame, Intrinsics, Plane, RgbImage, Se3};

    /// A clip of `n` frames of a static camera: frame `i` shows `rgb(i)` at time `i`.
    pub fn clip(n: usize, rgb: impl Fn(usize) -> RgbImage) -> Capture {
        let frame = |i: usize| {
            let rgb = rgb(i);
            let intrinsics = Intrinsics::centred(rgb.width(), rgb.height(), 0.5 * rgb.width() as f64);
            CaptureFrame {
                name: format!("{i:05}"),
                camera: Camera { intrinsics, c2w: Se3::identity() },
                t: i as f64,
                rgb,
                depth: None,
                mask: None,
                motion: None,
                instances: None,
                camera_index: None,
            }
        };
        Capture { frames: (0..n).map(frame).collect(), time_frames: n, duration_s: None, metric: false, tracks: None }
    }

    /// The same with frames in which every value is `i`.
    pub fn plain_clip(n: usize, (width, height): (usize, usize)) -> Capture {
        clip(n, |i| Plane::filled(width, height, [i as u8; 3]))
    }
}
