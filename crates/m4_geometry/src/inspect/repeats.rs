//! Frames that repeat the one before, and stretches of a frozen image.

use super::quantile;
use super::timeline::Shown;
use std::ops::Range;

/// From one frame to the next.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    pub seconds: f64,
    /// No frame was left out between them.
    pub neighbours: bool,
    /// Mean absolute difference, grey levels.
    pub difference: f32,
}

/// What the steps of a shot come to.
#[derive(Debug, Default)]
pub(super) struct Repeats {
    /// Of each step: its second frame repeats the first.
    pub repeated: Vec<bool>,
    /// They repeat in a pattern, as 24 frames shown at 60 do.
    pub pattern: bool,
    /// Steps without any change, of long stretches.
    pub frozen: Vec<Range<usize>>,
}

/// Repeats are measured against the motion this long before and after, seconds.
const AROUND_S: f64 = 0.4;
/// The motion around is what this share of the steps stays below: with 15 frames shown at 60 three
/// of four steps are repeats.
const MOTION_SHARE: f64 = 0.9;
/// A repeat differs by less than this share of the motion around; a step of less than the second
/// share is neither a repeat nor motion.
const REPEAT: f32 = 0.2;
const UNCLEAR: f32 = 0.4;
/// Most unclear steps for each repeat.
const MOST_UNCLEAR: f64 = 0.35;
/// An image that stays longer is a pause, seconds: 10 frames per second are the fewest that are
/// shown at a higher rate.
const MOST_STILL_S: f64 = 0.11;
/// Least share of repeats among the steps that are a pattern: 25 frames shown at 30 have a sixth.
const PATTERN_SHARE: f64 = 0.12;
const MIN_PATTERN: usize = 3;
/// Motion that is less is noise, grey levels.
const MIN_MOTION: f32 = 0.3;
/// A frozen image differs by less, grey levels and share of the motion of the shot, and lasts
/// longer, seconds.
const FROZEN: f32 = 0.1;
const FROZEN_SHARE: f32 = 0.05;
const MIN_FROZEN_S: f64 = 0.5;

/// Which steps are repeats.
///
/// A camera that pauses makes a long run of small steps and a tripod makes all steps alike: only
/// short runs between steps of motion are repeats, and only where the two sorts are clearly apart
/// and repeats are frequent, or where not one pixel differs.
pub(super) fn of(steps: &[Step]) -> Repeats {
    let n = steps.len();
    let differences: Vec<f32> = steps.iter().map(|step| step.difference).collect();
    let ratios = relative(steps, &differences);
    let mut short = vec![false; n];
    let mut at_end = vec![false; n];
    let mut in_pause = vec![false; n];
    for run in runs(n, |i| ratios[i] < REPEAT && steps[i].neighbours) {
        let seconds: f64 = steps[run.clone()].iter().map(|step| step.seconds).sum();
        // What a run at an end continues is not known, so it says nothing of a pattern.
        let inside = run.start > 0 && run.end < n;
        let brief = seconds <= MOST_STILL_S;
        let flags = if brief && inside {
            &mut short
        } else {
            at_end[run.clone()].fill(brief);
            &mut in_pause
        };
        flags[run].fill(true);
    }
    let repeats = short.iter().filter(|&&s| s).count();
    let moving = (0..n).filter(|&i| !in_pause[i]).count();
    let unclear = (0..n)
        .filter(|&i| !in_pause[i] && (REPEAT..UNCLEAR).contains(&ratios[i]))
        .count();
    let pattern = repeats >= MIN_PATTERN
        && repeats as f64 >= PATTERN_SHARE * moving as f64
        && unclear as f64 <= MOST_UNCLEAR * repeats as f64;
    let repeated = (0..n)
        .map(|i| short[i] && (pattern || differences[i] == 0.0) || at_end[i] && pattern)
        .collect();
    Repeats {
        repeated,
        pattern,
        frozen: frozen(steps, &differences),
    }
}

/// Differences over the motion around them.
fn relative(steps: &[Step], differences: &[f32]) -> Vec<f32> {
    let mut ends = Vec::with_capacity(steps.len());
    let mut time_s = 0.0;
    for step in steps {
        time_s += step.seconds;
        ends.push(time_s);
    }
    let (mut from, mut to) = (0, 0);
    let mut ratios = Vec::with_capacity(steps.len());
    for (i, end_s) in ends.iter().enumerate() {
        while end_s - ends[from] > AROUND_S {
            from += 1;
        }
        while to < ends.len() && ends[to] - end_s <= AROUND_S {
            to += 1;
        }
        let motion = quantile(&differences[from..to], MOTION_SHARE);
        ratios.push(if motion < MIN_MOTION {
            1.0
        } else {
            differences[i] / motion
        });
    }
    ratios
}

/// Runs of indices below `n` for which `holds`.
fn runs(n: usize, holds: impl Fn(usize) -> bool) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for i in (0..n).filter(|&i| holds(i)) {
        match runs.last_mut() {
            Some(run) if run.end == i => run.end += 1,
            _ => runs.push(i..i + 1),
        }
    }
    runs
}

fn frozen(steps: &[Step], differences: &[f32]) -> Vec<Range<usize>> {
    let motion = quantile(differences, 0.75);
    let still = |i: usize| differences[i] < FROZEN.min(FROZEN_SHARE * motion);
    let mut runs = runs(steps.len(), still);
    runs.retain(|run| {
        let seconds: f64 = steps[run.clone()].iter().map(|step| step.seconds).sum();
        seconds >= MIN_FROZEN_S
    });
    runs
}

/// Frames that were repeated in a pattern were taken evenly in time and are shown at the next tick
/// of a faster clock: puts them back, where one rate fits all of them within a tick.
pub(super) fn even_out(frames: &mut [Shown], ticks_s: &[f64]) {
    let n = frames.len();
    let (Some(first), Some(last)) = (frames.first(), frames.last()) else {
        return;
    };
    let tick_s =
        (ticks_s[last.index] - ticks_s[first.index]) / (last.index - first.index).max(1) as f64;
    let mean_k = 0.5 * (n - 1) as f64;
    let mean_s = frames.iter().map(|f| f.time_s).sum::<f64>() / n as f64;
    let (mut up, mut down) = (0.0, 0.0);
    for (k, frame) in frames.iter().enumerate() {
        let k = k as f64 - mean_k;
        up += k * (frame.time_s - mean_s);
        down += k * k;
    }
    if down <= 0.0 {
        return;
    }
    let even_s = |k: usize| mean_s + up / down * (k as f64 - mean_k);
    // Times stay within what was shown: the first frame is not before the clip.
    let early_s = (frames[0].time_s - even_s(0)).max(0.0);
    let fits = |(k, frame): (usize, &Shown)| (frame.time_s - even_s(k)).abs() <= 0.75 * tick_s;
    if !frames.iter().enumerate().all(fits) {
        return;
    }
    for (k, frame) in frames.iter_mut().enumerate() {
        frame.time_s = even_s(k) + early_s;
    }
}
