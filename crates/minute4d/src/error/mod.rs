//! The error type of the library, and the category of each failure.
//!
//! [`Error`] has a variant for what a caller may tell apart: the errors of other crates by
//! operation, outputs, settings, networks. Requests and inputs that cannot be used are
//! [`Refusal`]s, whose messages stand where they are refused. Each says its [`Category`].

mod data;
mod network;
#[cfg(feature = "nets")]
mod weights;

pub use data::{Category, OutputError, Refusal};
pub use network::{NetworkError, NetworkMethod};
#[cfg(feature = "nets")]
pub use weights::WeightsError;

use crate::settings::SettingsError;
use crate::time::TimeError;
use m4_core::advice::{CPU, RESUME, TIME_LIMIT};
use m4_geometry::classical::dense::DenseError;
use m4_geometry::classical::sparse::SparseError;
use m4_geometry::masks::InstanceError;
use m4_geometry::megasam::MegasamError;
use m4_geometry::tracks::TrackError;
use m4_io::{ErrorKind, ReadError, WriteError};
use m4_kernels::SimdLevelError;
use m4_train::TrainError;
use m4_train::init::InitError;
use m4_viewer::FramesError;
use m4_viewer::page::PageError;
use m4_viewer::server::ServeError;
use std::io;
use std::path::{Path, PathBuf};

/// Why a stage failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The path.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A file or folder could not be written.
    #[error("cannot write {}: {source}; check the permissions and the free space, or choose another folder", path.display())]
    Write {
        /// The path.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// An input that does not exist.
    #[error("there is no {what} at {}{}", path.display(), of_link(path))]
    Missing {
        /// What was expected there.
        what: &'static str,
        /// Where.
        path: PathBuf,
    },
    /// An output folder or file that cannot be used.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// A file or folder whose contents cannot be used.
    #[error(transparent)]
    ReadData(#[from] ReadError),
    /// A file or folder whose contents cannot be written.
    #[error(transparent)]
    WriteData(#[from] WriteError),
    /// The time limit was reached before there was a scene.
    #[error(
        "the time limit of {seconds:.0} s was reached in the stage {stage}; finished work is kept: {}, and \
         {}",
        RESUME,
        TIME_LIMIT
    )]
    TimeLimit {
        /// The stage.
        stage: &'static str,
        /// The limit.
        seconds: f64,
    },
    /// The caller asked to stop.
    #[error("stopped during {stage}{}{}", if *saved { "; finished work is kept: " } else { "" }, if *saved { RESUME } else { "" })]
    Stopped {
        /// The stage that was running.
        stage: &'static str,
        /// True when there is something to resume from.
        saved: bool,
    },
    /// A bug.
    #[error("internal error: {what}; this is a bug in minute4d, please report it")]
    Internal {
        /// The observation.
        what: String,
    },
    /// Settings.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The instruction set that was asked for.
    #[error(transparent)]
    Simd(#[from] SimdLevelError),
    /// The requested GPU is missing, does not start, or failed.
    #[cfg(feature = "gpu")]
    #[error(transparent)]
    Gpu(#[from] m4_kernels::gpu::GpuError),
    /// A GPU was requested in a build without GPU support.
    #[error(
        "this program was built without GPU support (the feature gpu); {}",
        CPU
    )]
    NoGpuSupport,
    /// A method that needs a pretrained network.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// Pretrained weights.
    #[cfg(feature = "nets")]
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// A request or an input that cannot be used.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// Cameras and tracks from a video.
    #[error(transparent)]
    Sparse(#[from] SparseError),
    /// Depth and masks from a video.
    #[error(transparent)]
    Dense(#[from] DenseError),
    /// MegaSaM's reconstruction of a video.
    #[error(transparent)]
    Megasam(#[from] MegasamError),
    /// Refining masks.
    #[error(transparent)]
    Instances(#[from] InstanceError),
    /// Tracking points.
    #[error(transparent)]
    Tracks(#[from] TrackError),
    /// The first splats.
    #[error(transparent)]
    Init(#[from] InitError),
    /// Training.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// A time along a camera path.
    #[error(transparent)]
    Time(#[from] TimeError),
    /// The page of a scene.
    #[error(transparent)]
    Page(#[from] PageError),
    /// The frames in it.
    #[error(transparent)]
    Frames(#[from] FramesError),
    /// The server of the page.
    #[error(transparent)]
    Serve(#[from] ServeError),
}

/// What a path is that exists without leading anywhere.
fn of_link(path: &Path) -> &'static str {
    let is_link = path
        .symlink_metadata()
        .is_ok_and(|facts| facts.is_symlink());
    if is_link {
        ", which is a link that leads nowhere, or in a circle"
    } else {
        ""
    }
}

impl Error {
    /// For `map_err` after a read.
    pub fn read(path: &Path) -> impl Fn(io::Error) -> Self + Copy {
        |source| Self::Read {
            path: path.to_path_buf(),
            source,
        }
    }

    /// For `map_err` after a write.
    pub fn write(path: &Path) -> impl Fn(io::Error) -> Self + Copy {
        |source| Self::Write {
            path: path.to_path_buf(),
            source,
        }
    }

    /// Says what broke an invariant of the program; for `map_err` too.
    pub fn internal(what: impl ToString) -> Self {
        Self::Internal {
            what: what.to_string(),
        }
    }

    /// Says that nothing is at `path`, where `what` was expected.
    pub fn missing(what: &'static str, path: &Path) -> Self {
        Self::Missing {
            what,
            path: path.to_path_buf(),
        }
    }

    /// Fails with [`Error::Missing`] where nothing is at `path`.
    pub fn unless_exists(what: &'static str, path: &Path) -> Result<(), Self> {
        match path.exists() {
            true => Ok(()),
            false => Err(Self::missing(what, path)),
        }
    }

    /// Returns the category of the failure.
    pub fn category(&self) -> Category {
        match self {
            Self::Read { source, .. } => ErrorKind::of_read(source).into(),
            Self::Write { .. } => Category::CannotWrite,
            Self::Missing { .. } => Category::NoInput,
            Self::Output(_) => Category::CannotWrite,
            Self::ReadData(e) => e.kind().into(),
            Self::WriteData(e) => e.kind().into(),
            Self::TimeLimit { .. } => Category::TryAgain,
            Self::Stopped { .. } => Category::Stopped,
            Self::Internal { .. } => Category::Internal,
            Self::Settings(SettingsError::Read { source, .. }) => ErrorKind::of_read(source).into(),
            Self::Settings(SettingsError::Internal { .. }) => Category::Internal,
            Self::Settings(_) => Category::BadSettings,
            Self::Simd(_) | Self::NoGpuSupport => Category::NoDevice,
            #[cfg(feature = "gpu")]
            Self::Gpu(_) => Category::NoDevice,
            Self::Network(e) => e.category(),
            #[cfg(feature = "nets")]
            Self::Weights(e) => e.category(),
            Self::Refused(e) => e.category,
            Self::Sparse(SparseError::Setting { .. })
            | Self::Dense(DenseError::Setting { .. })
            | Self::Instances(InstanceError::Setting { .. })
            | Self::Tracks(TrackError::Setting { .. })
            | Self::Init(InitError::BadSetting { .. })
            | Self::Train(TrainError::BadSetting { .. }) => Category::BadSettings,
            Self::Sparse(SparseError::Cancelled)
            | Self::Dense(
                DenseError::Cancelled { .. } | DenseError::Tracks(TrackError::Cancelled { .. }),
            )
            | Self::Instances(InstanceError::Cancelled { .. })
            | Self::Tracks(TrackError::Cancelled { .. })
            | Self::Init(InitError::Stopped) => Category::Stopped,
            Self::Megasam(e) if e.is_stop() => Category::Stopped,
            Self::Train(TrainError::Device { .. }) => Category::NoDevice,
            Self::Sparse(_)
            | Self::Dense(_)
            | Self::Megasam(_)
            | Self::Instances(_)
            | Self::Tracks(_)
            | Self::Init(_)
            | Self::Train(_) => Category::BadInput,
            Self::Time(_) => Category::Usage,
            Self::Frames(_) => Category::Internal,
            Self::Serve(_) => Category::TryAgain,
            Self::Page(_) => Category::BadInput,
        }
    }

    /// Returns true if the same work may succeed later or on another machine, so that finished work
    /// is worth keeping.
    pub fn may_pass(&self) -> bool {
        matches!(
            self.category(),
            Category::CannotWrite | Category::Io | Category::TryAgain | Category::NoDevice
        )
    }

    /// True when the caller asked to stop.
    pub fn is_stop(&self) -> bool {
        self.category() == Category::Stopped
    }
}

#[cfg(test)]
mod tests {
    use super::{Category, Error, ServeError};
    use m4_geometry::classical::dense::DenseError;
    use m4_geometry::tracks::TrackError;
    use m4_io::Fault;
    use std::error::Error as _;
    use std::io;
    use std::path::Path;

    #[test]
    fn a_stop_is_no_fault_of_the_input_however_deep_it_was_noticed() {
        let phase = "at work";
        let stops = [
            DenseError::Cancelled { phase },
            DenseError::Tracks(TrackError::Cancelled { phase }),
        ];
        for stop in stops {
            assert_eq!(Error::from(stop).category(), Category::Stopped);
        }
    }

    #[test]
    fn the_type_of_an_operation_adds_nothing_to_the_message_nor_to_the_causes() {
        let refused = || io::Error::from(io::ErrorKind::PermissionDenied);
        let video = || Fault::Io(refused()).at(Path::new("clip.mp4"));
        let server = || ServeError::Listen {
            port: 80,
            source: refused(),
        };
        let expected = [
            (
                video().to_string(),
                Error::from(video()),
                Category::from(video().kind()),
                None,
            ),
            (
                server().to_string(),
                Error::from(server()),
                Category::TryAgain,
                Some(refused().to_string()),
            ),
        ];
        for (message, error, category, expected_cause) in expected {
            assert_eq!((error.to_string(), error.category()), (message, category));
            let cause = error.source().map(ToString::to_string);
            assert_eq!(cause, expected_cause);
            assert!(error.source().and_then(|cause| cause.source()).is_none());
        }
    }
}
