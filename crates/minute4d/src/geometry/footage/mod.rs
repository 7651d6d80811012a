//! Chooses the frames of a clip that are worth using, and cleans them: one shot, without blank and
//! repeated frames, bars, overlays and flicker. Everything that is done is a warning and a line of
//! the record; a clip without any of it stays as it was read, bit by bit.

mod words;

use super::Context;
use crate::{Error, Refusal};
use m4_core::{Plane, Progress, RgbImage, Video, VideoFrame};
use m4_geometry::inspect::{Exposure, Overlays, Reason, Rectangle, Shot, Shown, Timeline, bars};
use m4_io::ReadError;
use m4_io::video::{VideoOptions, evenly};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// What a clip has besides one continuous take, and what was done about it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Footage {
    /// First and last time of each shot, seconds.
    pub shots: Vec<[f64; 2]>,
    /// The shot that was used, from 1.
    pub shot: usize,
    /// Frames that were left out because they show nothing: black, one colour, a covered lens.
    pub blank_frames: usize,
    /// ... because they show another image than those around.
    pub odd_frames: usize,
    /// ... because they repeat the one before.
    pub repeated_frames: usize,
    /// ... because they mix two shots.
    pub dissolved_frames: usize,
    /// ... because their shot is too short.
    pub short_frames: usize,
    /// Stretches of one frozen image within the shot, seconds; they were kept.
    pub frozen_s: Vec<[f64; 2]>,
    /// The part of the frames within bars: first column and row, width and height, pixels.
    pub crop: Option<[usize; 4]>,
    /// Frames from which an overlay was removed.
    pub overlay_frames: usize,
    /// Flicker of the brightness that was evened out, per cent.
    pub flicker_percent: Option<f64>,
    /// Change of the exposure from the darkest to the brightest part, per cent; it was kept.
    pub exposure_percent: Option<f64>,
}

/// Frames of a clip that are inspected at most, evenly spaced: a minute at 60 frames per second.
const MOST_INSPECTED: usize = 3600;
/// Longest side of frames that are read for inspection alone, pixels.
const INSPECTED_PX: usize = 160;
/// Frames on which bars are looked for.
const BAR_FRAMES: usize = 32;

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
    let used = chosen_shot(&timeline, context.settings().geometry.shot)?;
    let shot = &timeline.shots[used];
    let mut footage = Footage {
        shots: timeline.shots.iter().map(Shot::span_s).collect(),
        shot: used + 1,
        frozen_s: shot.frozen_s.clone(),
        ..Footage::default()
    };
    let first = |shot: &Shot| shot.frames.first().map_or(0, |f| f.index);
    let end = timeline.shots.get(used + 1).map_or(times_s.len(), first);
    let within = |i: usize| (first(shot)..end).contains(&i);
    let of = |reason: Reason| -> Vec<f64> {
        let here = timeline
            .left_out
            .iter()
            .filter(|left| left.reason == reason);
        // Repeats and odd frames of other shots are no concern.
        let anywhere = !matches!(reason, Reason::Repeated | Reason::Odd);
        here.filter(|left| anywhere || within(left.index))
            .map(|left| times_s[left.index])
            .collect()
    };
    footage.tell_frames(&of, shot, observer);
    let (mut video, shown) = if shot.frames.len() == inspected.frames.len() {
        let shown = nearest(&video.frames, &times_s, &shot.frames);
        (video, shown)
    } else {
        let again = overview.is_some().then_some((options, read));
        frames_of(video, again, (shot, &times_s))?
    };
    let area = footage.crop(&mut video, observer);
    footage.clean(&mut video, &shown, observer);
    let footage = Some(footage).filter(Footage::is_worth_a_word);
    Ok(Chosen {
        video,
        area,
        footage,
    })
}

/// The index of the shot of number `asked`, else of the longest.
fn chosen_shot(timeline: &Timeline, asked: Option<usize>) -> Result<usize, Error> {
    let Some(asked) = asked else {
        return Ok(timeline.longest());
    };
    let n = timeline.shots.len();
    if (1..=n).contains(&asked) {
        return Ok(asked - 1);
    }
    let spans: Vec<[f64; 2]> = timeline.shots.iter().map(Shot::span_s).collect();
    let message = match n {
        1 => format!("shot {asked} was asked for, and the clip is one shot without a cut"),
        _ => format!(
            "shot {asked} was asked for, and the clip has {n}: {}",
            words::shots(&spans)
        ),
    };
    Err(Refusal::bad_input(message).into())
}

/// What was measured of the inspected frames at `times_s`, for each of `frames`.
fn nearest(frames: &[VideoFrame], times_s: &[f64], shown: &[Shown]) -> Vec<Shown> {
    let distance = |i: usize, time_s: f64| (times_s[shown[i].index] - time_s).abs();
    let of = |frame: &VideoFrame| {
        let time_s = frame.time_s;
        let after = shown.partition_point(|s| times_s[s.index] < time_s);
        let near = [after.saturating_sub(1), after.min(shown.len() - 1)];
        let best = usize::from(distance(near[1], time_s) < distance(near[0], time_s));
        shown[near[best]]
    };
    frames.iter().map(of).collect()
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

impl Footage {
    fn is_worth_a_word(&self) -> bool {
        let ordinary = Self {
            shots: self.shots.clone(),
            shot: 1,
            ..Self::default()
        };
        self.shots.len() > 1 || *self != ordinary
    }

    /// Cuts bars off.
    fn crop(&mut self, video: &mut Video, observer: &dyn Progress) -> Rectangle {
        let frames = &mut video.frames;
        let size = frames.first().map_or((0, 0), |f| f.rgb.size());
        let luma: Vec<Plane<f32>> = evenly(frames.len(), Some(BAR_FRAMES))
            .par_iter()
            .map(|&i| frames[i].rgb.map(luma))
            .collect();
        let area = bars(&luma.iter().collect::<Vec<_>>());
        if area == Rectangle::whole(size) {
            return area;
        }
        frames.par_iter_mut().for_each(|frame| {
            let image = &frame.rgb;
            frame.rgb = Plane::from_fn(area.width, area.height, |x, y| {
                image[(area.x + x, area.y + y)]
            });
        });
        self.crop = Some([area.x, area.y, area.width, area.height]);
        observer.warn(&words::bars(size, area));
        area
    }

    /// Removes overlays and flicker.
    fn clean(&mut self, video: &mut Video, shown: &[Shown], observer: &dyn Progress) {
        let overlays = {
            let images: Vec<&RgbImage> = video.frames.iter().map(|f| &f.rgb).collect();
            Overlays::of(&images, shown)
        };
        if let Some(extent) = overlays.extent() {
            self.overlay_frames = overlays.frames();
            observer.warn(&words::overlays(overlays.frames(), shown.len(), extent));
            let frames = video.frames.par_iter_mut().enumerate();
            frames.for_each(|(i, frame)| overlays.remove(i, &mut frame.rgb));
        }
        let exposure = Exposure::of(shown);
        let percent = |log: f32| 100.0 * f64::from(log).exp_m1();
        if let Some(flicker) = exposure.flickers().map(percent) {
            self.flicker_percent = Some(flicker);
            observer.warn(&words::flicker(flicker));
            let frames = video.frames.par_iter_mut().zip(&exposure.flicker);
            frames.for_each(|(frame, &log)| scale(&mut frame.rgb, (-log).exp()));
        }
        if let Some(drift) = exposure.drifts().map(percent) {
            self.exposure_percent = Some(drift);
            observer.warn(&words::exposure(drift));
        }
    }
}

/// Luma of ITU-R BT.601.
fn luma(rgb: &[u8; 3]) -> f32 {
    let [r, g, b] = rgb.map(f32::from);
    0.299 * r + 0.587 * g + 0.114 * b
}

/// Multiplies all values.
fn scale(image: &mut RgbImage, factor: f32) {
    let table: Vec<u8> = (0..=255_u8)
        .map(|v| (f32::from(v) * factor).round().clamp(0.0, 255.0) as u8)
        .collect();
    for rgb in image.data_mut() {
        *rgb = rgb.map(|v| table[usize::from(v)]);
    }
}
