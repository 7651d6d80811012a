//! The parts common to all formats: list of frames, camera models, loading, errors.

mod error;
mod lens;
mod listing;
mod load;
mod options;
mod undistort;

pub use error::{ReadSourceError, SourceFault};
pub use lens::{Distortion, Lens};
pub use listing::{FrameSource, Imported, ListedFrame, Listing};
pub use load::load;
pub(crate) use load::step;
pub use options::ImportOptions;
