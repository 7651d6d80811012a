//! The frames of the stage and what the user provides of them.
//!
//! Geometry also uses frames between those that `max_frames` keeps; the capture does not. Flow,
//! masks and tracks need small steps from frame to frame: where a clip is thinned, an object moves
//! too far from one kept frame to the next, so geometry runs on up to [`MOST_PER_STEP`] frames per
//! kept one. Of a long clip more frames than these are used for the cameras alone: tracks need
//! smaller steps still, and cost little.

use super::Context;
use super::footage::{self, Chosen};
use super::frontend::Plan;
use super::given::Given;
use crate::{Error, Refusal, Settings};
use m4_core::advice::FRAMES;
use m4_core::{
    Camera, Capture, CaptureFrame, CompactDepth, CompactMask, Plane, Progress, RgbImage, Tracks,
    Video, evenly,
};
use m4_geometry::FrameRate;
use m4_geometry::classical::dense::{DynamicObject, distance_sigma};
use m4_geometry::classical::sparse::SparseConfig;
use m4_geometry::inspect::Footage;
use m4_io::video::VideoOptions;
use std::path::Path;

/// A clip and what is known of it.
pub(super) struct Clip {
    pub video: Video,
    pub given: Given,
    /// Settings of the reconstruction, with what the file and the user say of the lens.
    pub sparse: SparseConfig,
    /// The focal length in pixels of the frames that settings or the file state.
    pub focal_px: Option<f64>,
    /// What was done about cuts, bars and the like.
    pub footage: Option<Footage>,
    /// How many of its frames are used for what.
    pub between: Between,
}

/// What geometry finds of a frame.
pub(super) struct FrameGeometry {
    pub camera: Camera,
    pub depth: CompactDepth,
    pub mask: CompactMask,
    pub motion: Option<Plane<u8>>,
}

impl Clip {
    /// Reads the clip and the files that the user provides, and leaves out what is not worth using;
    /// fails where a file is missing, damaged, or does not fit the clip.
    ///
    /// Poses, masks and depth belong to the frames as they are read: with them all frames stay, as
    /// they are.
    pub fn read(input: &Path, between: Between, context: &Context<'_>) -> Result<Self, Error> {
        let (settings, observer) = (context.settings(), context.observer());
        let frames = |options: &VideoOptions| m4_io::video::read(input, options, observer);
        let mut between = between;
        let mut options = between.to_read(&settings.video);
        let mut video = frames(&options)?;
        if between.track_more(&video, settings.video.max_memory_bytes) {
            drop(video);
            options = between.to_read(&settings.video);
            video = frames(&options)?;
        }
        let read = video.in_range;
        for warning in &video.warnings {
            observer.warn(warning);
        }
        let mut sparse = settings.sparse.clone();
        if sparse.fov_deg.is_none() && sparse.focal_px.is_none() {
            sparse.focal_px = video.focal_px;
        }
        let mut given = Given::read(input, &video, settings)?;
        let Chosen {
            video,
            area,
            footage,
        } = if settings.geometry.per_frame_given() {
            if settings.geometry.shot.is_some() {
                return Err(Refusal::usage(SHOT_WITH_FRAMES).into());
            }
            Chosen::all(video)
        } else {
            footage::choose(video, &options, &frames, context)?
        };
        let width = area.width;
        let from_fov = |fov: f64| 0.5 * width as f64 / (0.5 * fov.to_radians()).tan();
        let focal_px = sparse.focal_px.or(sparse.fov_deg.map(from_fov));
        if let Some(lens) = &mut given.lens {
            let k = &mut lens.intrinsics;
            (k.cx, k.cy) = (k.cx - area.x as f64, k.cy - area.y as f64);
            (k.width, k.height) = (area.width, area.height);
            sparse.intrinsics = Some([k.fx, k.fy, k.cx, k.cy]);
        }
        let lens = given.lens;
        let mut clip = Self {
            video,
            given,
            sparse,
            focal_px,
            footage,
            between,
        };
        clip.tell_frames(read, observer);
        if let Some(lens) = &lens {
            clip.straighten(lens)?;
        }
        Ok(clip)
    }

    /// The frames that get depth, of all.
    pub fn for_depth(&self) -> Vec<usize> {
        self.between.for_depth(self.video.frames.len())
    }

    /// Drops all frames but [`for_depth`](Self::for_depth), and returns these.
    pub fn keep_for_depth(&mut self) -> Vec<usize> {
        let chosen = self.for_depth();
        let frames = &mut self.video.frames;
        for (to, &from) in chosen.iter().enumerate() {
            frames.swap(to, from);
        }
        frames.truncate(chosen.len());
        chosen
    }

    /// Says which frames of a long clip of `count` frames are used for what.
    fn tell_frames(&self, count: usize, observer: &dyn Progress) {
        let (tracked, chosen) = (self.video.frames.len(), self.for_depth().len());
        if chosen < tracked {
            observer.warn(&format!(
                "the clip is long: of its {count} frames {tracked} are used for the cameras, and {chosen}, evenly spread, for depth \
                 and training; for more detail or less time {FRAMES}"
            ));
        }
    }

    /// The images.
    pub fn images(&self) -> Vec<&RgbImage> {
        self.video.frames.iter().map(|f| &f.rgb).collect()
    }

    /// The rate of the frames.
    pub fn rate(&self) -> FrameRate {
        let times_s: Vec<f64> = self.video.frames.iter().map(|f| f.time_s).collect();
        FrameRate::of_times(&times_s).unwrap_or(FrameRate::FILM)
    }

    /// The capture of these frames; lengths are metres if `metric`.
    pub fn capture(
        self,
        geometries: impl Iterator<Item = FrameGeometry>,
        metric: bool,
        tracks: Option<Tracks>,
    ) -> Capture {
        let time_frames = self.video.frames.len();
        let (moments, duration_s) = moments(&self.video);
        let frames = self
            .video
            .frames
            .into_iter()
            .zip(geometries)
            .zip(moments)
            .enumerate();
        let frames = frames.map(|(i, ((frame, geometry), t))| CaptureFrame {
            name: format!("{i:05}"),
            camera: geometry.camera,
            t,
            rgb: frame.rgb,
            depth: Some(geometry.depth),
            mask: Some(geometry.mask),
            motion: geometry.motion,
            instances: None,
            camera_index: None,
            distance_sigma: None,
        });
        Capture {
            frames: frames.collect(),
            time_frames,
            duration_s,
            metric,
            tracks,
        }
    }
}

/// The times of the frames in frames of the video, 0 to the number of frames less one, and the
/// duration, seconds.
fn moments(video: &Video) -> (Vec<f64>, Option<f64>) {
    let times_s: Vec<f64> = video.frames.iter().map(|f| f.time_s).collect();
    let (first_s, last_s) = (times_s.first().copied(), times_s.last().copied());
    let duration_s = last_s.unwrap_or(0.0) - first_s.unwrap_or(0.0);
    let last = times_s.len().saturating_sub(1) as f64;
    let moment = |(i, time_s): (usize, &f64)| {
        if duration_s > 0.0 {
            ((time_s - first_s.unwrap_or(0.0)) / duration_s * last).clamp(0.0, last)
        } else {
            i as f64
        }
    };
    let moments = times_s.iter().enumerate().map(moment).collect();
    (moments, (duration_s > 0.0).then_some(duration_s))
}

/// Why a shot cannot be chosen.
const SHOT_WITH_FRAMES: &str = "a shot cannot be chosen where poses, masks or depth are given for every frame; give a clip of \
                                the shot alone, with their files for its frames";

/// Steps of geometry per step from one kept frame to the next, at most.
const MOST_PER_STEP: usize = 4;
/// Frames that geometry may use in total, unless more are kept: what the default memory of the
/// dense stage holds at 480x360.
const MOST_FRAMES: usize = 240;

/// Frames that get depth where the user sets no number: at 360p their planes fit the default memory
/// of the dense stage with little shrinking, and they are a fifth of a second apart in a minute.
const MOST_WITH_DEPTH: usize = 300;
/// Frames that are read for the cameras: a minute and a half at 30 frames per second. At 640 pixels
/// they take 2 to 3 GB, less than what the depth of the others takes afterwards.
const MOST_TRACKED: usize = 2700;

/// How many frames are kept, how many get depth, and how many are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Between {
    n_kept: Option<usize>,
    n_depth: Option<usize>,
    n_read: Option<usize>,
    /// Whether cameras may use more frames than depth does.
    tracks_more: bool,
}

impl Between {
    /// Reads no more than is kept where the user gives data per frame, and where networks run,
    /// which follow longer steps and cost more per frame than all the rest.
    pub fn of(settings: &Settings, plan: &Plan) -> Self {
        let n_kept = settings.video.max_frames;
        let tracks_more = !plan.is_megasam() && !settings.geometry.per_frame_given();
        let small_steps =
            !plan.is_megasam() && plan.used.is_empty() && !settings.geometry.any_given();
        let n_read = n_kept.map(|n_kept| if small_steps { to_read(n_kept) } else { n_kept });
        let all = tracks_more.then_some(MOST_TRACKED);
        Self {
            n_kept,
            n_depth: n_read.or(tracks_more.then_some(MOST_WITH_DEPTH)),
            n_read: n_read.or(all),
            tracks_more,
        }
    }

    /// The options with which the clip is read.
    pub fn to_read(self, video: &VideoOptions) -> VideoOptions {
        VideoOptions {
            max_frames: self.n_read,
            ..video.clone()
        }
    }

    /// Reads more frames from now on than get depth, as many as `memory_bytes` hold, if the clip is
    /// long and `video` shows it thinned: tracks would break. True if that changes what is read.
    fn track_more(&mut self, video: &Video, memory_bytes: u64) -> bool {
        let frame = video.frames.first().map_or(0, |f| f.rgb.data().len());
        let frame_bytes = (size_of::<[u8; 3]>() * frame.max(1)) as u64;
        let most = (memory_bytes / frame_bytes).min(MOST_TRACKED as u64) as usize;
        let more = self.tracks_more
            && video.in_range > MOST_WITH_DEPTH
            && video.frames.len() < video.in_range.min(most);
        if more {
            self.n_read = Some(most);
        }
        more
    }

    /// Of `count` frames that were read those that get depth.
    fn for_depth(self, count: usize) -> Vec<usize> {
        evenly(count, self.n_depth)
    }

    /// Keeps the frames that were asked for, with their times; tracks lose the others, and objects
    /// count those that are kept.
    pub fn keep(
        self,
        capture: Capture,
        objects: &mut Vec<DynamicObject>,
        observer: &dyn Progress,
    ) -> Result<Capture, Error> {
        let all = capture.frames.len();
        let chosen = evenly(all, self.n_kept);
        if chosen.len() == all {
            return Ok(capture);
        }
        let tracks = capture
            .tracks
            .as_ref()
            .map(|tracks| tracks.in_order(&chosen));
        let unfit = |e| Error::internal(format!("tracks do not fit their frames: {e}"));
        let tracks = tracks.transpose().map_err(unfit)?;
        objects.retain_mut(|object| {
            let kept_before = |frame: usize| chosen.partition_point(|&i| i < frame);
            let end = kept_before(object.first_frame + object.frames);
            object.first_frame = kept_before(object.first_frame);
            object.frames = end - object.first_frame;
            object.frames > 0
        });
        let mut frames: Vec<_> = capture.frames.into_iter().map(Some).collect();
        let frames: Vec<_> = chosen.iter().filter_map(|&i| frames[i].take()).collect();
        observer.warn(&format!(
            "geometry used {all} frames to follow motion; {} of them are kept for training (max_frames)",
            frames.len()
        ));
        Ok(Capture {
            frames,
            tracks,
            ..capture
        })
    }
}

/// Gives each frame of `capture` the deviation of its `objects`.
pub(super) fn with_sigmas(mut capture: Capture, objects: &[DynamicObject]) -> Capture {
    for (i, frame) in capture.frames.iter_mut().enumerate() {
        frame.distance_sigma = distance_sigma(objects, i);
    }
    capture
}

/// Frames to read so that every step between two of `n_kept` frames has up to [`MOST_PER_STEP`]
/// parts.
fn to_read(n_kept: usize) -> usize {
    let per_step = (MOST_FRAMES / n_kept.max(1)).clamp(1, MOST_PER_STEP);
    // At least one frame must be kept: the reader refuses 0.
    n_kept
        .saturating_sub(1)
        .saturating_mul(per_step)
        .saturating_add(n_kept.min(1))
}

#[cfg(test)]
mod tests {
    use super::{Between, MOST_FRAMES, MOST_TRACKED, MOST_WITH_DEPTH, to_read, with_sigmas};
    use crate::Silent;
    use m4_core::evenly;
    use m4_core::{Capture, Plane, Tracks, Video, VideoFrame};
    use m4_geometry::classical::dense::{DistanceCue, DynamicObject};
    use m4_testkit::clips::plain_clip;

    #[test]
    fn steps_have_four_parts_while_memory_allows() {
        assert_eq!([0, 1, 2, 24].map(to_read), [0, 1, 5, 93]);
        assert_eq!([100, 200, 241, 1000].map(to_read), [199, 200, 241, 1000]);
        for n_kept in 2..MOST_FRAMES {
            let read = to_read(n_kept);
            assert!((n_kept..=MOST_FRAMES).contains(&read), "{n_kept}: {read}");
            // The frames of a long clip that are kept are the same with and without those between.
            let clip = 10 * (read - 1) + 1;
            let all = evenly(clip, Some(read));
            let direct = evenly(clip, Some(n_kept));
            let indices: Vec<usize> = evenly(all.len(), Some(n_kept))
                .iter()
                .map(|&i| all[i])
                .collect();
            assert_eq!(indices, direct);
        }
    }

    #[test]
    fn kept_frames_keep_their_times_and_tracks() {
        let places = (0..9).map(|i| [i as f32, 0.0, 1.0]).collect();
        let tracks = Some(Tracks::new(9, 1, places, vec![true; 9]).unwrap());
        let capture = Capture {
            tracks,
            ..plain_clip(9, (2, 1))
        };
        let between = |n_kept: usize, n_read: usize| Between {
            n_kept: Some(n_kept),
            n_depth: Some(n_read),
            n_read: Some(n_read),
            tracks_more: true,
        };
        let object = |first_frame: usize, frames: usize| DynamicObject {
            first_frame,
            frames,
            share: 0.1,
            cue: DistanceCue::Contact,
            sigma_percent: 6.0,
        };
        let mut objects = vec![object(2, 7), object(3, 6), object(5, 3)];
        objects[0].sigma_percent = 8.0;
        let thin = between(3, 9)
            .keep(capture.clone(), &mut objects, &Silent)
            .unwrap();
        let spans: Vec<_> = objects.iter().map(|o| (o.first_frame, o.frames)).collect();
        assert_eq!(spans, [(1, 2), (1, 2)]);
        let thin = with_sigmas(thin, &objects);
        let sigmas: Vec<Option<f32>> = thin.frames.iter().map(|f| f.distance_sigma).collect();
        let both = 0.005f64.sqrt() as f32;
        assert_eq!(sigmas, [None, Some(both), Some(both)]);
        let times: Vec<f64> = thin.frames.iter().map(|f| f.t).collect();
        assert_eq!((times, thin.time_frames), (vec![0.0, 4.0, 8.0], 9));
        let tracks = thin.tracks.unwrap();
        assert_eq!(
            (tracks.frames(), tracks.place(1, 0)),
            (3, Some([4.0, 0.0, 1.0]))
        );
        let all = between(20, 77)
            .keep(capture, &mut objects, &Silent)
            .unwrap();
        assert_eq!((all.frames.len(), objects.len()), (9, 2));
    }

    /// A clip of `in_range` frames of which `count` were read.
    fn video(count: usize, in_range: usize) -> Video {
        let frame = |i: usize| VideoFrame {
            rgb: Plane::filled(2, 2, [0; 3]),
            time_s: i as f64,
        };
        Video {
            frames: (0..count).map(frame).collect(),
            in_range,
            warnings: Vec::new(),
            focal_px: None,
        }
    }

    #[test]
    fn long_clips_have_more_frames_for_cameras_than_for_depth() {
        let mut all = Between {
            n_kept: None,
            n_depth: Some(MOST_WITH_DEPTH),
            n_read: Some(MOST_TRACKED),
            tracks_more: true,
        };
        let memory = u64::MAX;
        assert!(!all.track_more(&video(300, 300), memory));
        assert_eq!(all.for_depth(300), (0..300).collect::<Vec<_>>());
        assert!(!all.track_more(&video(1500, 1500), memory));
        let chosen = all.for_depth(1500);
        assert_eq!((chosen.len(), chosen[0], chosen[299]), (300, 0, 1499));
        assert!(chosen.windows(2).all(|w| (5..=6).contains(&(w[1] - w[0]))));
        // 24 are kept: depth has 93, cameras as many as memory holds
        let mut few = Between {
            n_kept: Some(24),
            n_depth: Some(93),
            n_read: Some(93),
            tracks_more: true,
        };
        assert!(!few.track_more(&video(93, 250), memory));
        assert_eq!(few.n_read, Some(93));
        assert!(few.track_more(&video(93, 9000), memory));
        assert_eq!(few.n_read, Some(MOST_TRACKED));
        assert_eq!(few.for_depth(MOST_TRACKED).len(), 93);
        let mut few = Between {
            n_read: Some(93),
            ..few
        };
        assert!(few.track_more(&video(93, 9000), 12 * 500) && few.n_read == Some(500));
        let mut given = Between {
            tracks_more: false,
            n_read: Some(93),
            ..few
        };
        assert!(!given.track_more(&video(93, 9000), memory));
    }
}
