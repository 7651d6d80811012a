//! Cleans the frames of one shot: bars, overlays and flicker; everything that is done is a warning
//! and a line of the record.

use super::words;
use super::{Exposure, Overlays, Rectangle, Shot, Shown, Timeline, bars, cut_out, small};
use m4_core::{Plane, Progress, RgbImage, VideoFrame, evenly};
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

/// Frames on which bars are looked for.
const BAR_FRAMES: usize = 32;

impl Footage {
    /// Takes the shot with the index `used` of a clip whose inspected frames are at `times_s`,
    /// counts the frames that are left out, and reports both.
    #[must_use]
    pub fn of(timeline: &Timeline, used: usize, times_s: &[f64], progress: &dyn Progress) -> Self {
        let mut footage = Self {
            shots: timeline.shots.iter().map(Shot::span_s).collect(),
            shot: used + 1,
            frozen_s: timeline.shots[used].frozen_s.clone(),
            ..Self::default()
        };
        footage.tell_frames(timeline, used, times_s, progress);
        footage
    }

    /// Returns whether there is more to say than that the clip is one continuous take.
    #[must_use]
    pub fn is_worth_a_word(&self) -> bool {
        let ordinary = Self {
            shots: self.shots.clone(),
            shot: 1,
            ..Self::default()
        };
        self.shots.len() > 1 || *self != ordinary
    }

    /// Cuts bars off; returns where the frames lie in what they were.
    pub fn crop(&mut self, frames: &mut [VideoFrame], progress: &dyn Progress) -> Rectangle {
        let size = frames.first().map_or((0, 0), |f| f.rgb.size());
        let luma: Vec<Plane<f32>> = evenly(frames.len(), Some(BAR_FRAMES))
            .par_iter()
            .map(|&i| small(&frames[i].rgb, usize::MAX))
            .collect();
        let area = bars(&luma.iter().collect::<Vec<_>>());
        if area == Rectangle::whole(size) {
            return area;
        }
        frames.par_iter_mut().for_each(|frame| {
            frame.rgb = cut_out(&frame.rgb, area);
        });
        self.crop = Some([area.x, area.y, area.width, area.height]);
        progress.warn(&words::bars(size, area));
        area
    }

    /// Removes overlays and flicker from frames of which `shown` was measured, one each.
    pub fn clean(&mut self, frames: &mut [VideoFrame], shown: &[Shown], progress: &dyn Progress) {
        let overlays = {
            let images: Vec<&RgbImage> = frames.iter().map(|f| &f.rgb).collect();
            Overlays::of(&images, shown)
        };
        if let Some(extent) = overlays.extent() {
            self.overlay_frames = overlays.frames();
            progress.warn(&words::overlays(overlays.frames(), shown.len(), extent));
            let frames = frames.par_iter_mut().enumerate();
            frames.for_each(|(i, frame)| overlays.remove(i, &mut frame.rgb));
        }
        let exposure = Exposure::of(shown);
        let percent = |log: f32| 100.0 * f64::from(log).exp_m1();
        if let Some(flicker) = exposure.flickers().map(percent) {
            self.flicker_percent = Some(flicker);
            progress.warn(&words::flicker(flicker));
            let frames = frames.par_iter_mut().zip(&exposure.flicker);
            frames.for_each(|(frame, &log)| scale(&mut frame.rgb, (-log).exp()));
        }
        if let Some(drift) = exposure.drifts().map(percent) {
            self.exposure_percent = Some(drift);
            progress.warn(&words::exposure(drift));
        }
    }
}

/// Returns what was measured of the inspected frames at `times_s`, for each of `frames`.
#[must_use]
pub fn nearest(frames: &[VideoFrame], times_s: &[f64], shown: &[Shown]) -> Vec<Shown> {
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

/// Multiplies all values.
fn scale(image: &mut RgbImage, factor: f32) {
    let table: Vec<u8> = (0..=255_u8)
        .map(|v| (f32::from(v) * factor).round().clamp(0.0, 255.0) as u8)
        .collect();
    for rgb in image.data_mut() {
        *rgb = rgb.map(|v| table[usize::from(v)]);
    }
}
