//! Why points could not be followed.

use crate::classical::dense::FlowError;

/// Why there are no tracks.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrackError {
    /// The clip could not be read.
    #[error("points cannot be tracked in frame {frame}: {reason}")]
    Frame {
        /// Which frame.
        frame: usize,
        /// What is wrong with it.
        reason: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The source of flow failed.
    #[error("no flow between frames {frame} and {}", frame + 1)]
    Flow {
        /// The first of the two frames.
        frame: usize,
        /// What went wrong.
        source: FlowError,
    },
    /// A query that asks about no place of the clip.
    #[error(
        "query {query} asks about frame {frame} of {frames} at {xyz:?}; it needs a frame of the clip and a finite position"
    )]
    Query {
        /// Which query.
        query: usize,
        /// Its frame.
        frame: usize,
        /// Frames of the clip.
        frames: usize,
        /// Its place.
        xyz: [f32; 3],
    },
    /// The tracker failed.
    #[error("{tracker} could not track points: {reason}")]
    Source {
        /// Its name.
        tracker: String,
        /// What went wrong.
        reason: Box<dyn std::error::Error + Send + Sync>,
    },
    /// Another number of values than of frames times queries.
    #[error("{found} values for {frames} frames and {queries} queries")]
    Count {
        /// Values.
        found: usize,
        /// Frames of the clip.
        frames: usize,
        /// Queries.
        queries: usize,
    },
    /// A setting out of range.
    #[error("setting {name} is {value}; it must be {expected}")]
    Setting {
        /// Which setting.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        expected: &'static str,
    },
    /// The user asked to stop.
    #[error("stopped on request while {phase}")]
    Cancelled {
        /// What was going on.
        phase: &'static str,
    },
}
