//! Errors of the page of a scene, and of its server.

use crate::Category;
use m4_viewer::FramesError;
use m4_viewer::page::PageError;
use m4_viewer::server::ServeError;

/// Why a scene cannot be shown in a browser.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ViewerError {
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

impl ViewerError {
    /// Returns the category of the failure.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::Page(_) => Category::BadInput,
            Self::Frames(_) => Category::Internal,
            Self::Serve(_) => Category::TryAgain,
        }
    }
}
