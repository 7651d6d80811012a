//! Errors of the tracking network.

use std::error::Error;

/// Why the tracking network has no answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DroidError {
    /// An image is too small, or its sides are no multiples of 8.
    #[error(
        "the tracking network takes images whose sides are multiples of 8 and at least 128 px, this has {width} x {height}; \
         resize and crop it"
    )]
    Size {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A frame has another size than the first.
    #[error(
        "frame {frame} has {} x {} px where the frames before have {} x {}; a clip has one size",
        got.0, got.1, expected.0, expected.1
    )]
    OtherSize {
        /// The frame.
        frame: usize,
        /// Its columns and rows.
        got: (usize, usize),
        /// Those of the clip.
        expected: (usize, usize),
    },
    /// A source is revised without edges.
    #[error("frame {source_frame} is to be revised without an edge; its damping is a mean over its edges")]
    NoEdges {
        /// The frame.
        source_frame: usize,
    },
    /// An edge is asked for that did not enter.
    #[error("edge {id} is not known to the tracking network; let it enter first")]
    UnknownEdge {
        /// The edge.
        id: u64,
    },
    /// An edge starts at another frame than the one whose edges are revised, or is there twice.
    #[error(
        "edge {id} does not belong here: it starts at frame {source_frame}, and each edge of a source is revised once a time"
    )]
    WrongEdge {
        /// The edge.
        id: u64,
        /// Where it starts.
        source_frame: usize,
    },
    /// A plane has not the size of the grid.
    #[error("edge {id} has a plane of {got} numbers where the grid has {expected} pixels")]
    Plane {
        /// The edge.
        id: u64,
        /// Numbers of the plane.
        got: usize,
        /// Pixels of the grid.
        expected: usize,
    },
    /// A disparity has not the size of the grid.
    #[error("a disparity of {got} numbers is to be enlarged where the grid has {expected} pixels")]
    Disparity {
        /// Numbers of the disparity.
        got: usize,
        /// Pixels of the grid.
        expected: usize,
    },
    /// An image could not be had again.
    #[error("the image of frame {frame} is not available: {reason}")]
    Image {
        /// The frame.
        frame: usize,
        /// What its source says.
        reason: Box<dyn Error + Send + Sync>,
    },
    /// The file that states are moved to failed.
    #[error("the network's state cannot be stored in a file in {}: {reason}; is the disk full?", folder.display())]
    Scratch {
        /// Where the file is.
        folder: std::path::PathBuf,
        /// What the system says.
        reason: std::io::Error,
    },
    /// The device failed, for one for lack of memory.
    #[error("the device that tracks failed: {0}")]
    Device(String),
}
