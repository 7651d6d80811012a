//! Shows scenes in a browser: `viewer.html` of a run, and the same page from a local server.
//!
//! [`stage`](self) writes the page as the last stage of a run. [`view()`] serves an existing scene and
//! shows every newer one; [`Broadcast`] does the same from within the training process.

mod broadcast;
mod config;
mod error;
mod file;
mod pack;
mod source;
mod view;

pub use broadcast::Broadcast;
pub use config::{LiveConfig, ViewerConfig};
pub use error::ViewerError;
pub(crate) use file::stage;
pub use file::title;
pub use view::{Viewing, view};

/// Name of the stage.
pub const STAGE: &str = "viewer";
