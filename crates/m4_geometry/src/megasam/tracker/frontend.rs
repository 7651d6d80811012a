//! The front end: frames come one by one, keyframes are chosen, a window of them is adjusted.

use super::BETA;
use super::TrackerSettings;
use super::correspondence::{Correspondence, TrackerError, check_count};
use super::keyframes::{FrameInput, Keyframes, Update};
use crate::dba::{DbaOptions, Free, Grid, Pinhole};
use crate::megasam::graph::{FactorGraph, ProximitySettings, frame_distance, neighbourhood};
use m4_core::Se3;

/// Keyframes before the first adjustment: 8.
const WARMUP: usize = 8;
/// Share of the full motion in the distance of frames in the first choice of edges: 0.25.
const INITIAL_BETA: f64 = 0.25;
/// Keyframes a new one may be joined with: 25.
const WINDOW: usize = 25;
/// Sources of new edges: the last 5 keyframes.
const NEW_SOURCES: usize = 5;
/// The choice of edges of the front end; sources, targets and the greatest number of edges are set
/// where it is made.
const PROXIMITY: ProximitySettings = ProximitySettings {
    first_source: 0,
    first_target: 0,
    radius: 2,
    suppression: 1,
    threshold_px: 12.0,
    beta: BETA,
    max_factors: 0,
};
/// Suppression of the first choice, steps of frames: 2.
const INITIAL_SUPPRESSION: usize = 2;
/// Updates after which an edge retires: 25.
const MAX_AGE: u32 = 25;

/// What became of a submitted frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Submitted {
    /// Too little motion since the last keyframe.
    Skipped,
    /// Kept until there are enough for the first adjustment.
    Waiting,
    /// The first adjustment has been done.
    Initialised,
    /// Adjusted; `distance_px` is that of the two keyframes before it, and `dropped` is the number
    /// in the clip of the keyframe that turned out to be needless.
    Tracked {
        /// Pixels of the grid.
        distance_px: f64,
        /// Number in the clip.
        dropped: Option<usize>,
    },
}

/// State of the front end.
#[derive(Debug)]
pub struct Frontend {
    settings: TrackerSettings,
    /// The keyframes so far.
    pub keyframes: Keyframes,
    /// Their edges.
    pub graph: FactorGraph,
    initialised: bool,
    last_accepted: Option<usize>,
}

impl Frontend {
    /// Without frames. `lens` is a first guess.
    #[must_use]
    pub fn new(grid: Grid, lens: Pinhole<f64>, settings: TrackerSettings) -> Self {
        let graph = FactorGraph::new(settings.max_factors);
        #[cfg(test)]
        let graph = graph.with_permuted_ranks(settings.python_twin);
        Self {
            settings,
            keyframes: Keyframes::new(grid, lens),
            graph,
            initialised: false,
            last_accepted: None,
        }
    }

    /// True after the first adjustment.
    #[must_use]
    pub fn is_initialised(&self) -> bool {
        self.initialised
    }

    /// Takes the next frame; `forced` ones become keyframes however little moved.
    ///
    /// # Errors
    ///
    /// [`TrackerError`] when correspondences fail or the state becomes useless.
    pub fn submit(
        &mut self,
        input: &FrameInput,
        forced: bool,
        source: &mut dyn Correspondence,
    ) -> Result<Submitted, TrackerError> {
        let expected = self.keyframes.geometry.grid.len();
        if input.sensor.len() != expected {
            return Err(TrackerError::Input(format!(
                "the sensor disparity of frame {} has {} values while the grid has {expected} pixels",
                input.frame,
                input.sensor.len()
            )));
        }
        if let (Some(last), false) = (self.last_accepted, forced)
            && source.motion_px(last, input.frame)? <= self.settings.motion_filter_px
        {
            return Ok(Submitted::Skipped);
        }
        self.last_accepted = Some(input.frame);
        let last = self.keyframes.len().checked_sub(1);
        let pose = last.map_or_else(Se3::identity, |k| self.keyframes.geometry.poses[k]);
        self.keyframes.push(input, pose, last);
        if self.initialised {
            return self.track(source);
        }
        if self.keyframes.len() < WARMUP {
            return Ok(Submitted::Waiting);
        }
        self.initialise(source)?;
        Ok(Submitted::Initialised)
    }

    /// Ends the front end: the source of correspondences may forget its edges.
    ///
    /// # Errors
    ///
    /// [`TrackerError::Correspondence`] when it fails at that.
    pub fn finish(mut self, source: &mut dyn Correspondence) -> Result<Keyframes, TrackerError> {
        self.graph.clear();
        source.change(&self.graph.take_changes())?;
        Ok(self.keyframes)
    }

    /// The first adjustment, of all keyframes there are; called by [`submit`](Self::submit) when
    /// there are enough, and by the caller at the end of a clip in which there never were.
    ///
    /// # Errors
    ///
    /// [`TrackerError`] when correspondences fail or the state becomes useless.
    pub fn initialise(&mut self, source: &mut dyn Correspondence) -> Result<(), TrackerError> {
        let s = self.settings;
        let count = self.keyframes.len();
        check_count(count)?;
        let frames = self.keyframes.frame.clone();
        self.graph.add(
            &neighbourhood(0, count, 3),
            &self.keyframes.geometry,
            &frames,
            false,
        );
        for _ in 0..s.initial_updates {
            self.update(1, Free::Poses, source)?;
        }
        let proximity = ProximitySettings {
            suppression: INITIAL_SUPPRESSION,
            beta: INITIAL_BETA,
            max_factors: s.max_factors,
            ..PROXIMITY
        };
        self.graph
            .add_proximity(&proximity, &self.keyframes.geometry, &frames, false);
        for free in [Free::Poses, Free::PosesAndDepth] {
            for _ in 0..s.initial_updates {
                self.update(1, free, source)?;
            }
        }
        let oldest = WARMUP.min(count).saturating_sub(4);
        self.graph.retire(|e| e.factor.source < oldest);
        self.initialised = true;
        Ok(())
    }

    fn track(&mut self, source: &mut dyn Correspondence) -> Result<Submitted, TrackerError> {
        let s = self.settings;
        let count = self.keyframes.len();
        self.graph.retire(|e| e.age > MAX_AGE);
        let proximity = ProximitySettings {
            first_source: count.saturating_sub(NEW_SOURCES),
            first_target: count.saturating_sub(WINDOW),
            max_factors: s.max_factors,
            ..PROXIMITY
        };
        let frames = self.keyframes.frame.clone();
        self.graph
            .add_proximity(&proximity, &self.keyframes.geometry, &frames, true);
        self.keyframes.reset_to_sensor(count - 1);
        for _ in 0..s.first_updates {
            self.update_window(source)?;
        }
        if count < 3 {
            return Ok(Submitted::Tracked {
                distance_px: f64::INFINITY,
                dropped: None,
            });
        }
        let (a, b) = (count - 3, count - 2);
        let g = &self.keyframes.geometry;
        let distance_px = 0.5 * (frame_distance(g, a, b, BETA) + frame_distance(g, b, a, BETA));
        let dropped = (distance_px < s.keyframe_px).then(|| self.keyframes.frame[b]);
        if dropped.is_some() {
            self.graph.remove_frame(b);
            self.keyframes.remove(b);
        } else {
            for _ in 0..s.second_updates {
                self.update_window(source)?;
            }
        }
        Ok(Submitted::Tracked {
            distance_px,
            dropped,
        })
    }

    /// One update of the poses from the second source of an active edge on.
    fn update_window(&mut self, source: &mut dyn Correspondence) -> Result<(), TrackerError> {
        let first = self
            .graph
            .active
            .iter()
            .map(|e| e.factor.source)
            .min()
            .unwrap_or(0);
        self.update(first + 1, Free::PosesAndDepth, source)
    }

    fn update(
        &mut self,
        first: usize,
        free: Free,
        source: &mut dyn Correspondence,
    ) -> Result<(), TrackerError> {
        let s = &self.settings;
        let update = Update {
            options: DbaOptions {
                free,
                ..s.adjustment()
            },
            window: first.max(1).min(self.keyframes.len())..self.keyframes.len(),
            inactive_from: Some(first.saturating_sub(3)),
            batch: None,
        };
        update
            .run(&mut self.keyframes, &mut self.graph, source)
            .map(drop)
    }
}
