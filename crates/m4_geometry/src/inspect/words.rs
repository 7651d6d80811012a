//! Warnings about a clip.

use super::{Footage, Reason, Rectangle, Shot, Timeline};
use m4_core::{Progress, advice};

/// Shots, or stretches of time, that a message lists at most.
const MOST_LISTED: usize = 12;

/// The times of shots in words.
pub(super) fn shots(spans_s: &[[f64; 2]]) -> String {
    let one = |(i, s): (usize, &[f64; 2])| format!("{}: {:.2} s to {:.2} s", i + 1, s[0], s[1]);
    list(spans_s.iter().enumerate().map(one).collect())
}

fn list(items: Vec<String>) -> String {
    let more = items.len().saturating_sub(MOST_LISTED);
    let text = items[..items.len() - more].join(", ");
    if more > 0 {
        format!("{text} and {more} more")
    } else {
        text
    }
}

/// Stretches of frames at these times, which follow each other more closely than `gap_s`.
fn stretches(times_s: &[f64], gap_s: f64) -> String {
    let mut runs: Vec<[f64; 2]> = Vec::new();
    for &time_s in times_s {
        match runs.last_mut() {
            Some(run) if time_s - run[1] <= gap_s => run[1] = time_s,
            _ => runs.push([time_s; 2]),
        }
    }
    let one = |[from, to]: &[f64; 2]| {
        if to - from < 0.005 {
            format!("{from:.2} s")
        } else {
            format!("{from:.2} s to {to:.2} s")
        }
    };
    list(runs.iter().map(one).collect())
}

/// Gap between frames that are named as one stretch, seconds.
const GAP_S: f64 = 0.15;

fn frames(n: usize) -> String {
    if n == 1 {
        "1 frame".to_owned()
    } else {
        format!("{n} frames")
    }
}

pub(super) fn bars((width, height): (usize, usize), area: Rectangle) -> String {
    let (right, bottom) = (width - area.x - area.width, height - area.y - area.height);
    format!(
        "bars at the borders are cut off (left {}, right {right}, top {}, bottom {bottom} pixels): frames of {width} x {height} \
         become {} x {}, with the principal point in the middle unless it is given",
        area.x, area.y, area.width, area.height
    )
}

pub(super) fn overlays(n: usize, of: usize, [left, top, right, bottom]: [f64; 4]) -> String {
    let percent = |v: f64| 100.0 * v;
    format!(
        "a logo, subtitles or other marks lie over the image in {n} of {of} frames (within {:.0} % to {:.0} % of the width and \
         {:.0} % to {:.0} % of the height): they are removed, and what is behind them is filled in smoothly from around, so \
         it may look blurred",
        percent(left),
        percent(right),
        percent(top),
        percent(bottom)
    )
}

pub(super) fn flicker(percent: f64) -> String {
    format!("the brightness flickers from frame to frame (by {percent:.0} %): it is evened out")
}

pub(super) fn exposure(percent: f64) -> String {
    format!(
        "the exposure changes by {percent:.0} % in the clip, so one surface has several colours: fit the exposure of every frame \
         in training (train.refine.exposure), or film with locked exposure"
    )
}

impl Footage {
    /// Counts and reports the frames that are left out beside the shot with the index `used`.
    pub(super) fn tell_frames(
        &mut self,
        timeline: &Timeline,
        used: usize,
        times_s: &[f64],
        progress: &dyn Progress,
    ) {
        let shot = &timeline.shots[used];
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
        if self.shots.len() > 1 {
            let n = self.shots.len();
            progress.warn(&format!(
                "the clip has {n} shots ({}): shot {} is used, or {}",
                shots(&self.shots),
                self.shot,
                advice::SHOT
            ));
        }
        let say = |reason: Reason, what: &str| -> usize {
            let times_s = of(reason);
            if !times_s.is_empty() {
                let n = frames(times_s.len());
                progress.warn(&format!(
                    "{n} at {} {what}: left out",
                    stretches(&times_s, GAP_S)
                ));
            }
            times_s.len()
        };
        self.blank_frames = say(
            Reason::Blank,
            "show nothing (black, one colour, a covered lens, or a fade)",
        );
        self.odd_frames = say(
            Reason::Odd,
            "show another image than those around (a flash or damage)",
        );
        self.dissolved_frames = say(Reason::Dissolve, "mix two shots (a dissolve)");
        self.short_frames = say(
            Reason::Short,
            "are cut off from the rest, in shots of less than half a second",
        );
        let repeated = of(Reason::Repeated).len();
        self.repeated_frames = repeated;
        if repeated > 0 {
            let all = repeated + shot.frames.len();
            let [from, to] = shot.span_s();
            let rate = (shot.frames.len() - 1) as f64 / (to - from).max(1e-6);
            progress.warn(&format!(
                "{repeated} of {all} frames repeat the one before ({rate:.1} different frames per second): left out"
            ));
        }
        for [from, to] in &self.frozen_s {
            progress.warn(&format!(
                "the image is frozen from {from:.2} s to {to:.2} s: these frames are kept, as a time in which nothing moves"
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{shots, stretches};

    #[test]
    fn times_are_listed_in_order() {
        assert_eq!(
            shots(&[[0.0, 1.25], [1.5, 4.0]]),
            "1: 0.00 s to 1.25 s, 2: 1.50 s to 4.00 s"
        );
        assert!(shots(&[[0.0, 1.0]; 15]).ends_with("12: 0.00 s to 1.00 s and 3 more"));
        assert_eq!(
            stretches(&[0.0, 0.1, 0.2, 1.0], 0.15),
            "0.00 s to 0.20 s, 1.00 s"
        );
    }
}
