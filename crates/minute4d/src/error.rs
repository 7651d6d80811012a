//! The error type of the library, and the category of each failure.

use crate::enhance::EnhanceError;
use crate::evaluate::ProtocolError;
use crate::export::ExportError;
use crate::geometry::GivenError;
use crate::import::ImportError;
use crate::render::{PathError, TimeError};
use crate::reproduce::ReproduceError;
use crate::settings::SettingsError;
use m4_eval::geometry::{GeometryError, LlffError};
use m4_eval::image::ImageError;
use m4_init::InitError;
use m4_io::ErrorKind;
use m4_io::capture::{ReadCaptureError, WriteCaptureError};
use m4_io::image::{ReadImageError, WriteImageError};
use m4_io::scene_file::{ReadSceneError, WriteSceneError};
use m4_io::trajectory::ReadTrajectoryError;
use m4_io::video::{ReadVideoError, WriteVideoError};
use m4_kernels::SimdLevelError;
use m4_slam::cvd::CvdError;
use m4_slam::dense::DenseError;
use m4_slam::megasam::MegasamError;
use m4_slam::sparse::SparseError;
use m4_slam::tracks3d::TrackError;
use m4_train::TrainError;
use m4_viewer::FramesError;
use m4_viewer::page::PageError;
use m4_viewer::server::ServeError;
use std::io;
use std::path::PathBuf;

/// The command that builds the program with GPU support and networks, for messages about missing features.
pub const BUILD_FULL: &str = "cargo build --release -p minute4d_cli --features full";

/// The category of a failure, which determines the exit code of the program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Category {
    /// An invariant of the program is broken.
    Internal,
    /// An argument is invalid.
    Usage,
    /// An input is damaged, incomplete or inconsistent.
    BadInput,
    /// An input does not exist.
    NoInput,
    /// This machine cannot do the computation: a device, a program or weights are missing or fail, or memory is insufficient.
    NoDevice,
    /// An output cannot be written.
    CannotWrite,
    /// The machine failed while reading.
    Io,
    /// The same command may succeed later.
    TryAgain,
    /// A setting does not exist or has an invalid value.
    BadSettings,
    /// The caller asked to stop; what was finished is kept.
    Stopped,
}

impl Category {
    /// Returns the exit code of this category, after `sysexits.h`. That of [`Category::Stopped`] depends
    /// on the signal; 130 here.
    #[must_use]
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Internal => 1,
            Self::Usage => 2,
            Self::BadInput => 65,
            Self::NoInput => 66,
            Self::NoDevice => 69,
            Self::CannotWrite => 73,
            Self::Io => 74,
            Self::TryAgain => 75,
            Self::BadSettings => 78,
            Self::Stopped => 130,
        }
    }
}

impl From<ErrorKind> for Category {
    fn from(kind: ErrorKind) -> Self {
        match kind {
            ErrorKind::NotFound => Self::NoInput,
            ErrorKind::BadData | ErrorKind::Unsupported => Self::BadInput,
            ErrorKind::Unavailable => Self::NoDevice,
            ErrorKind::CannotWrite => Self::CannotWrite,
            ErrorKind::Io => Self::Io,
            ErrorKind::Cancelled => Self::Stopped,
            _ => Self::Internal,
        }
    }
}

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
    /// The time limit was reached before there was a scene.
    #[error(
        "the time limit of {seconds:.0} s was reached in the stage {stage}; finished work is kept: the same command with \
         --resume continues, and --time-limit changes the limit"
    )]
    TimeLimit {
        /// The stage.
        stage: &'static str,
        /// The limit.
        seconds: f64,
    },
    /// The requested GPU is missing, does not start, or failed.
    #[cfg(feature = "gpu")]
    #[error(transparent)]
    Gpu(#[from] m4_gpu::GpuError),
    /// A GPU was requested in a build without GPU support.
    #[error(
        "this program was built without GPU support, which --device gpu needs: `{BUILD_FULL}` builds it with them; --device cpu works without"
    )]
    NoGpuSupport,
    /// A file has the name of a folder to create.
    #[error("cannot create the folder {}: a file with that name exists; choose another name", path.display())]
    InTheWay {
        /// The file.
        path: PathBuf,
    },
    /// A folder with other files in it.
    #[error("the folder {} is not empty and not made by minute4d (it has no usable {missing}); choose another folder, or --force to write into it anyway", path.display())]
    Foreign {
        /// The folder.
        path: PathBuf,
        /// The record that it lacks.
        missing: &'static str,
    },
    /// A folder with earlier work.
    #[error("the folder {} contains {what}; --resume continues it, --force replaces it", path.display())]
    Exists {
        /// The folder.
        path: PathBuf,
        /// What is in it.
        what: &'static str,
    },
    /// A folder that another process uses.
    #[error("another minute4d is using {}; wait for it, or choose another folder", path.display())]
    Busy {
        /// The folder.
        path: PathBuf,
    },
    /// A file that would be replaced.
    #[error("{} already exists; --force replaces it", path.display())]
    WouldReplace {
        /// The file or folder.
        path: PathBuf,
    },
    /// An input that does not exist.
    #[error("there is no {what} at {}", path.display())]
    Missing {
        /// What was expected there.
        what: &'static str,
        /// Where.
        path: PathBuf,
    },
    /// A folder or file of an unknown kind.
    #[error("{} is neither a video, a folder of images, a capture, a scene nor a run", path.display())]
    Unknown {
        /// The given value.
        path: PathBuf,
    },
    /// A capture without held-out views.
    #[error("{} has no transforms_test.json, so there are no held-out views to compare with; give a capture that has some", path.display())]
    NoTestList {
        /// The capture.
        path: PathBuf,
    },
    /// A row of an ablation failed.
    #[error("the row {row} failed: {said}; its files are in {}", folder.display())]
    Row {
        /// Its name.
        row: &'static str,
        /// The folder of the row.
        folder: PathBuf,
        /// Its last messages.
        said: String,
    },
    /// The finished scene did not read back as it was written.
    #[error("{} was written but does not read back correctly: {what}; check the disk", path.display())]
    Verify {
        /// The file.
        path: PathBuf,
        /// The difference.
        what: String,
    },
    /// The caller asked to stop.
    #[error("stopped during {stage}{}", if *saved { "; run the same command with --resume to continue" } else { "" })]
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
    /// A time along a camera path.
    #[error(transparent)]
    Time(#[from] TimeError),
    /// A camera path.
    #[error(transparent)]
    Path(#[from] PathError),
    /// The instruction set that was asked for.
    #[error(transparent)]
    Simd(#[from] SimdLevelError),
    /// Exporting a scene.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// Importing a file.
    #[error(transparent)]
    Import(#[from] ImportError),
    /// Reading a clip.
    #[error(transparent)]
    ReadVideo(#[from] ReadVideoError),
    /// Writing a clip.
    #[error(transparent)]
    WriteVideo(#[from] WriteVideoError),
    /// Reading an image.
    #[error(transparent)]
    ReadImage(#[from] ReadImageError),
    /// Writing an image.
    #[error(transparent)]
    WriteImage(#[from] WriteImageError),
    /// Reading a capture.
    #[error(transparent)]
    ReadCapture(#[from] ReadCaptureError),
    /// Writing a capture.
    #[error(transparent)]
    WriteCapture(#[from] WriteCaptureError),
    /// Reading a scene.
    #[error(transparent)]
    ReadScene(#[from] ReadSceneError),
    /// Writing a scene.
    #[error(transparent)]
    WriteScene(#[from] WriteSceneError),
    /// Reading cameras.
    #[error(transparent)]
    ReadTrajectory(#[from] ReadTrajectoryError),
    /// Cameras and tracks from a video.
    #[error(transparent)]
    Sparse(#[from] SparseError),
    /// Depth and masks from a video.
    #[error(transparent)]
    Dense(#[from] DenseError),
    /// The first splats.
    #[error(transparent)]
    Init(#[from] InitError),
    /// Training.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// The page of a scene.
    #[error(transparent)]
    Page(#[from] PageError),
    /// The frames in it.
    #[error(transparent)]
    Frames(#[from] FramesError),
    /// The server of the page.
    #[error(transparent)]
    Serve(#[from] ServeError),
    /// A front end that needs a network, in a build that has none.
    #[error(
        "this program was built without networks, which the front end {frontend} needs: `{BUILD_FULL}` builds it with them; \
         --frontend classical works without"
    )]
    NoNetworks {
        /// The front end.
        frontend: &'static str,
    },
    /// A front end whose weights are missing.
    #[cfg(feature = "nets")]
    #[error("the front end {frontend} cannot be used: {source}; --frontend classical works without")]
    FrontEndWeights {
        /// The front end.
        frontend: &'static str,
        /// What is missing, and how to get it.
        source: crate::weights::WeightsError,
    },
    /// A front end whose weights are invalid.
    #[cfg(feature = "nets")]
    #[error("the front end {frontend} cannot be used: {source}; --frontend classical works without")]
    FrontEndLoad {
        /// The front end.
        frontend: &'static str,
        /// The fault.
        source: Box<m4_nets::LoadError>,
    },
    /// A depth network that failed.
    #[cfg(feature = "nets")]
    #[error("{source_name} estimated no depth of frame {frame}: {reason}")]
    MonoDepth {
        /// Its name.
        source_name: String,
        /// The frame.
        frame: usize,
        /// What went wrong.
        reason: Box<dyn std::error::Error + Send + Sync>,
    },
    /// MegaSaM's reconstruction failed.
    #[error(transparent)]
    Megasam(#[from] MegasamError),
    /// A segmenter that needs a network, in a build that has none.
    #[error(
        "this program was built without networks, which the segmenter {segmenter} needs: `{BUILD_FULL}` builds it with them; \
         --segmenter none works without"
    )]
    NoSegmenter {
        /// The segmenter.
        segmenter: &'static str,
    },
    /// A segmenter whose weights are missing.
    #[cfg(feature = "nets")]
    #[error("the segmenter {segmenter} cannot be used: {source}; --segmenter none works without")]
    SegmenterWeights {
        /// The segmenter.
        segmenter: &'static str,
        /// What is missing, and how to get it.
        source: crate::weights::WeightsError,
    },
    /// A segmenter whose weights are invalid.
    #[cfg(feature = "nets")]
    #[error("the segmenter {segmenter} cannot be used: {source}; --segmenter none works without")]
    SegmenterLoad {
        /// The segmenter.
        segmenter: &'static str,
        /// The fault.
        source: Box<m4_nets::LoadError>,
    },
    /// A tracker that needs a network, in a build that has none.
    #[error(
        "this program was built without networks, which the tracker {tracker} needs: `{BUILD_FULL}` builds it with them; \
         --tracker flow works without"
    )]
    NoTracker {
        /// The tracker.
        tracker: &'static str,
    },
    /// A tracker whose weights are missing.
    #[cfg(feature = "nets")]
    #[error("the tracker {tracker} cannot be used: {source}; --tracker flow works without")]
    TrackerWeights {
        /// The tracker.
        tracker: &'static str,
        /// What is missing, and how to get it.
        source: crate::weights::WeightsError,
    },
    /// A tracker whose weights are invalid.
    #[cfg(feature = "nets")]
    #[error("the tracker {tracker} cannot be used: {source}; --tracker flow works without")]
    TrackerLoad {
        /// The tracker.
        tracker: &'static str,
        /// The fault.
        source: Box<m4_nets::LoadError>,
    },
    /// No method was selected, or none is available.
    #[error("there is nothing to do: --segmenter none and --tracker none leave a capture unchanged; omit one of them")]
    NothingToEnhance,
    /// Refining masks or tracking points.
    #[error(transparent)]
    Enhance(#[from] EnhanceError),
    /// Geometry that the user provided.
    #[error(transparent)]
    Given(#[from] GivenError),
    /// Pretrained weights.
    #[cfg(feature = "nets")]
    #[error(transparent)]
    Weights(#[from] crate::weights::WeightsError),
    /// A protocol of evaluation.
    #[error(transparent)]
    Protocol(#[from] ProtocolError),
    /// The table of a data set.
    #[error(transparent)]
    Reproduce(#[from] ReproduceError),
    /// Scoring images.
    #[error(transparent)]
    Score(#[from] ImageError),
    /// Scoring geometry.
    #[error(transparent)]
    ScoreGeometry(#[from] GeometryError),
    /// Ground-truth cameras in the LLFF layout.
    #[error("{}: {source}", path.display())]
    Llff {
        /// The file.
        path: PathBuf,
        /// The fault.
        source: LlffError,
    },
}

impl Error {
    /// Returns the category of the failure.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::Read { source, .. } => ErrorKind::of_read(source).into(),
            Self::Write { .. }
            | Self::InTheWay { .. }
            | Self::Foreign { .. }
            | Self::Exists { .. }
            | Self::WouldReplace { .. }
            | Self::Verify { .. } => Category::CannotWrite,
            Self::Busy { .. } | Self::Serve(_) | Self::TimeLimit { .. } => Category::TryAgain,
            Self::Missing { .. } => Category::NoInput,
            Self::Unknown { .. }
            | Self::NoTestList { .. }
            | Self::Row { .. }
            | Self::Score(_)
            | Self::ScoreGeometry(_)
            | Self::Llff { .. } => Category::BadInput,
            Self::Stopped { .. } => Category::Stopped,
            Self::Internal { .. } | Self::Frames(_) => Category::Internal,
            Self::Page(_) => Category::BadInput,
            Self::Settings(SettingsError::Read { source, .. }) => ErrorKind::of_read(source).into(),
            Self::Settings(SettingsError::Internal { .. }) => Category::Internal,
            Self::Settings(_) => Category::BadSettings,
            Self::Path(PathError::NoSource { .. }) => Category::BadInput,
            Self::Time(_) | Self::Path(_) => Category::Usage,
            Self::Simd(_) | Self::NoGpuSupport => Category::NoDevice,
            #[cfg(feature = "gpu")]
            Self::Gpu(_) => Category::NoDevice,
            #[cfg(feature = "nets")]
            Self::Weights(e)
            | Self::FrontEndWeights { source: e, .. }
            | Self::SegmenterWeights { source: e, .. }
            | Self::TrackerWeights { source: e, .. } => e.category(),
            #[cfg(feature = "nets")]
            Self::FrontEndLoad { .. } | Self::SegmenterLoad { .. } | Self::TrackerLoad { .. } => Category::NoDevice,
            Self::NoNetworks { .. } | Self::NoSegmenter { .. } | Self::NoTracker { .. } => Category::NoDevice,
            Self::NothingToEnhance => Category::Usage,
            Self::Given(GivenError::Missing { .. }) => Category::NoInput,
            Self::Given(GivenError::Read { source, .. }) => ErrorKind::of_read(source).into(),
            Self::Given(_) => Category::BadInput,
            Self::Enhance(e) => e.category(),
            Self::Protocol(e) => e.category(),
            Self::Reproduce(e) => e.category(),
            Self::Export(e) => e.category(),
            Self::Import(e) => e.category(),
            Self::ReadVideo(ReadVideoError::BadOption { .. }) => Category::BadSettings,
            Self::ReadVideo(e) => e.kind().into(),
            Self::WriteVideo(e) => e.kind().into(),
            Self::ReadImage(e) => e.kind().into(),
            Self::WriteImage(e) => e.kind().into(),
            Self::ReadCapture(e) => e.kind().into(),
            Self::WriteCapture(e) => e.kind().into(),
            Self::ReadScene(e) => e.kind().into(),
            Self::WriteScene(e) => e.kind().into(),
            Self::ReadTrajectory(e) => e.kind().into(),
            Self::Sparse(SparseError::Setting { .. })
            | Self::Dense(DenseError::Setting { .. })
            | Self::Init(InitError::BadSetting { .. })
            | Self::Train(TrainError::BadSetting { .. }) => Category::BadSettings,
            Self::Train(TrainError::Device { .. }) => Category::NoDevice,
            Self::Sparse(SparseError::Cancelled)
            | Self::Dense(
                DenseError::Cancelled { .. }
                | DenseError::Consistent(CvdError::Cancelled { .. })
                | DenseError::Tracks(TrackError::Cancelled { .. }),
            )
            | Self::Init(InitError::Stopped) => Category::Stopped,
            Self::Megasam(e) if e.is_stop() => Category::Stopped,
            Self::Sparse(_) | Self::Dense(_) | Self::Megasam(_) | Self::Init(_) | Self::Train(_) => Category::BadInput,
            #[cfg(feature = "nets")]
            Self::MonoDepth { .. } => Category::NoDevice,
        }
    }

    /// Returns true if the same work may succeed later or on another machine, so that finished work is worth keeping.
    #[must_use]
    pub fn may_pass(&self) -> bool {
        matches!(
            self.category(),
            Category::CannotWrite | Category::Io | Category::TryAgain | Category::NoDevice
        )
    }

    /// True when the caller asked to stop.
    #[must_use]
    pub fn is_stop(&self) -> bool {
        self.category() == Category::Stopped
    }
}

#[cfg(test)]
mod tests {
    use super::{Category, Error};
    use m4_slam::cvd::CvdError;
    use m4_slam::dense::DenseError;
    use m4_slam::tracks3d::TrackError;

    #[test]
    fn a_stop_is_no_fault_of_the_input_however_deep_it_was_noticed() {
        let phase = "at work";
        let stops = [
            DenseError::Cancelled { phase },
            DenseError::Consistent(CvdError::Cancelled { stage: 2, step: 39 }),
            DenseError::Tracks(TrackError::Cancelled { phase }),
        ];
        for stop in stops {
            assert_eq!(Error::from(stop).category(), Category::Stopped);
        }
    }
}
