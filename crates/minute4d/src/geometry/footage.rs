//! Chooses the frames of a clip that are worth using, and cleans them: one shot, without blank and
//! repeated frames, bars, overlays and flicker. Everything that is done is a warning and a line of
//! the record; a clip without any of it stays as it was read, bit by bit.

use super::Context;
use crate::{Error, Refusal};
use m4_core::{RgbImage, Video, VideoFrame, evenly};
use m4_geometry::inspect::{Footage, Rectangle, Shot, Shown, Timeline, nearest};
use m4_io::ReadError;
use m4_io::video::VideoOptions;

/// Frames of a clip that are inspected at most, evenly spaced: a minute at 60 frames per second.
const MOST_INSPECTED: usize = 3600;
/// Longest side of frames that are read for inspection alone, pixels.
const INSPECTED_PX: usize = 160;
/// Reads frames of the clip.
pub(super) type ReadFrames<'a> = dyn Fn(&VideoOptions) -> Result<Video, ReadError> + 'a;

/// Frames, and what was done to them.
pub(super) struct Chosen {
    pub video: Video,
    /// Where they lie in the frames as read.
    pub area: Rectangle,
    /// `None` where nothing was done.
    pub footage: Option<Footage>,
}

impl Chosen {
    /// All frames, as they are.
    pub fn all(video: Video) -> Self {
        let size = video.frames.first().map_or((0, 0), |f| f.rgb.size());
        Self {
            video,
            area: Rectangle::whole(size),
            footage: None,
        }
    }
}

/// Chooses and cleans the frames of `video`, which were read with `options`. Fails where there is
/// no shot of the number that was asked for.
pub(super) fn choose(
    video: Video,
    options: &VideoOptions,
    read: &ReadFrames<'_>,
    context: &Context<'_>,
) -> Result<Chosen, Error> {
    let observer = context.observer();
    let thinned = options.max_frames.is_some_and(|n| n < video.in_range);
    let overview = if thinned {
        let small = VideoOptions {
            max_frames: Some(MOST_INSPECTED),
            size: Some(INSPECTED_PX),
            ..options.clone()
        };
        Some(read(&small)?)
    } else {
        None
    };
    let inspected = overview.as_ref().unwrap_or(&video);
    observer.update("inspect clip", 0, 1, "");
    let images: Vec<&RgbImage> = inspected.frames.iter().map(|f| &f.rgb).collect();
    let times_s: Vec<f64> = inspected.frames.iter().map(|f| f.time_s).collect();
    let timeline = Timeline::new(&images, &times_s);
    observer.update("inspect clip", 1, 1, "");
    let used = timeline
        .chosen(context.settings().geometry.shot)
        .map_err(|fault| Refusal::bad_input(fault.to_string()))?;
    let shot = &timeline.shots[used];
    let mut footage = Footage::of(&timeline, used, &times_s, observer);
    let (mut video, shown) = if shot.frames.len() == inspected.frames.len() {
        let shown = nearest(&video.frames, &times_s, &shot.frames);
        (video, shown)
    } else {
        let again = overview.is_some().then_some((options, read));
        frames_of(video, again, (shot, &times_s))?
    };
    let area = footage.crop(&mut video.frames, observer);
    footage.clean(&mut video.frames, &shown, observer);
    let footage = Some(footage).filter(Footage::is_worth_a_word);
    Ok(Chosen {
        video,
        area,
        footage,
    })
}

/// The frames of a shot: those of `video`, or, if it was thinned, read again.
fn frames_of(
    video: Video,
    again: Option<(&VideoOptions, &ReadFrames<'_>)>,
    (shot, times_s): (&Shot, &[f64]),
) -> Result<(Video, Vec<Shown>), Error> {
    let mut video = if let Some((options, read)) = again {
        let shown = evenly(shot.frames.len(), options.max_frames);
        let time_s = |&i: &usize| times_s[shot.frames[i].index];
        let of_shot = VideoOptions {
            times_s: Some(shown.iter().map(time_s).collect()),
            ..options.clone()
        };
        read(&of_shot)?
    } else {
        let mut frames: Vec<Option<VideoFrame>> = video.frames.into_iter().map(Some).collect();
        let kept = shot.frames.iter().filter_map(|f| frames[f.index].take());
        Video {
            frames: kept.collect(),
            ..video
        }
    };
    let shown = nearest(&video.frames, times_s, &shot.frames);
    for (frame, shown) in video.frames.iter_mut().zip(&shown) {
        frame.time_s = shown.time_s;
    }
    Ok((video, shown))
}
