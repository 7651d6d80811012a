//! Shots of a clip, and the frames of each that are worth using.

use super::dissolve::without_dissolves;
use super::link::{Link, SIDE_PX, coarse, detail, likeness};
use super::repeats::{self, Step};
use super::words::shots;
use super::{bars, cut_out, quantile, small};
use m4_core::{Plane, RgbImage};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A frame of a shot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shown {
    /// Index among the frames that were inspected.
    pub index: usize,
    /// When it was taken, seconds: as given, or evened out where frames were repeated in a pattern.
    pub time_s: f64,
    /// Logarithm of its brightness over that of the first frame of the shot, at the same points of
    /// the scene.
    pub log_gain: f32,
    /// How far the points of each quadrant moved since the first frame, image widths; across frames
    /// that were left out they count as still.
    pub place: [[f32; 2]; 4],
}

/// Frames without a break between them, in order of time.
#[derive(Debug, Clone, PartialEq)]
pub struct Shot {
    /// At least one.
    pub frames: Vec<Shown>,
    /// Stretches of one frozen image, seconds: kept.
    pub frozen_s: Vec<[f64; 2]>,
}

impl Shot {
    /// From the first to the last frame, seconds.
    #[must_use]
    pub fn span_s(&self) -> [f64; 2] {
        let at = |frame: Option<&Shown>| frame.map_or(0.0, |f| f.time_s);
        [at(self.frames.first()), at(self.frames.last())]
    }

    fn seconds(&self) -> f64 {
        self.span_s()[1] - self.span_s()[0]
    }
}

/// Why a frame is left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reason {
    /// It shows (almost) nothing: black, one colour, a covered lens; or fades to that.
    Blank,
    /// It shows another image than the frames around it: a flash, a damaged frame.
    Odd,
    /// It repeats the frame before.
    Repeated,
    /// It mixes two shots.
    Dissolve,
    /// Its shot is too short.
    Short,
}

/// Frames that are left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LeftOut {
    /// Index among the frames that were inspected.
    pub index: usize,
    /// Why.
    pub reason: Reason,
}

/// The shots of a clip.
#[derive(Debug, Clone, PartialEq)]
pub struct Timeline {
    /// Those that are long enough, in order of time; the longest where none is. At least one.
    pub shots: Vec<Shot>,
    /// Frames that belong to no shot, or are not worth using within one, in order.
    pub left_out: Vec<LeftOut>,
}

/// The shot that was asked for is not there.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("shot {asked} was asked for, and the clip {}", match spans_s.len() {
    1 => "is one shot without a cut".to_owned(),
    n => format!("has {n}: {}", shots(spans_s)),
})]
pub struct ShotError {
    /// Its number, from 1.
    pub asked: usize,
    /// First and last time of each shot, seconds.
    pub spans_s: Vec<[f64; 2]>,
}

/// Shots that are shorter are not offered, seconds.
const MIN_SHOT_S: f64 = 0.5;
/// A blank frame has less than this share of the detail of the clip.
const BLANK_DETAIL: f32 = 0.15;
/// A clip whose detail is less, grey levels per pixel, is not judged.
const MIN_DETAIL: f32 = 0.5;
/// A frame beside blank ones belongs to their fade while it has less than this share of the detail
/// further on, for at most as long.
const FADED_DETAIL: f32 = 0.8;
const MOST_FADE_S: f64 = 1.0;
/// Frames hang together if this share of points is found again, or this share of what neighbours
/// have in common in this clip, if that is less.
const MIN_LINK: f32 = 0.25;
const MIN_LINK_OF_MEDIAN: f32 = 0.4;
/// ... or if their rough images correlate that much at some shift.
const MIN_LIKENESS: f32 = 0.5;
/// Odd frames last no longer, seconds.
const MOST_ODD_S: f64 = 0.2;

impl Timeline {
    /// Inspects the frames of a clip, all of one size, with their rising times in seconds.
    ///
    /// # Panics
    ///
    /// If there are not as many times as frames.
    #[must_use]
    pub fn new(frames: &[&RgbImage], times_s: &[f64]) -> Self {
        assert_eq!(frames.len(), times_s.len(), "a time per frame");
        Inspection::new(frames, times_s).timeline()
    }

    /// Returns the index of the shot of the number `asked`, from 1, else of the longest.
    ///
    /// # Errors
    ///
    /// [`ShotError`] where there is no such shot.
    pub fn chosen(&self, asked: Option<usize>) -> Result<usize, ShotError> {
        let Some(asked) = asked else {
            return Ok(self.longest());
        };
        let index = asked.wrapping_sub(1);
        if index < self.shots.len() {
            return Ok(index);
        }
        let spans_s = self.shots.iter().map(Shot::span_s).collect();
        Err(ShotError { asked, spans_s })
    }

    /// The shot that lasts longest, the first of them.
    #[must_use]
    pub fn longest(&self) -> usize {
        let mut best = 0;
        for (i, shot) in self.shots.iter().enumerate() {
            if shot.seconds() > self.shots[best].seconds() + 1e-9 {
                best = i;
            }
        }
        best
    }
}

pub(super) struct Inspection<'a> {
    pub times_s: &'a [f64],
    /// Small luma within the bars.
    pub images: Vec<Plane<f32>>,
    /// Of each image.
    pub detail: Vec<f32>,
    /// From each image to the next.
    links: Vec<Link>,
    /// Least share of a link that holds.
    min_link: f32,
}

impl<'a> Inspection<'a> {
    fn new(frames: &[&RgbImage], times_s: &'a [f64]) -> Self {
        let whole: Vec<Plane<f32>> = frames.par_iter().map(|f| small(f, SIDE_PX)).collect();
        let full = whole.iter().map(detail).collect::<Vec<f32>>();
        let reference = quantile(&full, 0.5);
        let shown: Vec<&Plane<f32>> = whole
            .iter()
            .zip(&full)
            .filter(|(_, d)| **d >= BLANK_DETAIL * reference)
            .map(|(image, _)| image)
            .collect();
        let area = bars(&shown);
        let images: Vec<Plane<f32>> = whole.par_iter().map(|p| cut_out(p, area)).collect();
        let detail = images.par_iter().map(detail).collect();
        let links: Vec<Link> = images
            .par_windows(2)
            .map(|pair| Link::new(&pair[0], &pair[1]))
            .collect();
        let shares: Vec<f32> = links.iter().map(|link| link.share).collect();
        Self {
            times_s,
            images,
            detail,
            links,
            min_link: MIN_LINK.min(MIN_LINK_OF_MEDIAN * quantile(&shares, 0.5)),
        }
    }

    /// What frame `b`, after `a`, has in common with it.
    pub fn link(&self, a: usize, b: usize) -> Link {
        match b == a + 1 {
            true => self.links[a].clone(),
            false => Link::new(&self.images[a], &self.images[b]),
        }
    }

    /// Whether two frames show parts of the same.
    pub fn connected(&self, a: usize, b: usize) -> bool {
        self.link(a, b).share >= self.min_link
            || likeness(&coarse(&self.images[a]), &coarse(&self.images[b])) >= MIN_LIKENESS
    }

    fn timeline(&self) -> Timeline {
        let mut out = BTreeMap::new();
        for index in self.blank() {
            out.insert(index, Reason::Blank);
        }
        let mut segments = self.segments(&mut out);
        segments = segments
            .into_iter()
            .flat_map(|segment| without_dissolves(self, segment, &mut out))
            .collect();
        let mut shots: Vec<Shot> = segments
            .into_iter()
            .map(|segment| self.shot(&segment, &mut out))
            .collect();
        let longest_s = shots.iter().map(Shot::seconds).fold(0.0, f64::max);
        shots.retain(|shot| {
            let long = shot.seconds() >= MIN_SHOT_S.min(longest_s);
            if !long {
                out.extend(shot.frames.iter().map(|f| (f.index, Reason::Short)));
            }
            long
        });
        let left_out = out
            .into_iter()
            .map(|(index, reason)| LeftOut { index, reason })
            .collect();
        Timeline { shots, left_out }
    }

    /// Frames that show nothing, with the fades beside them; none where all are alike.
    fn blank(&self) -> Vec<usize> {
        let n = self.detail.len();
        let reference = quantile(&self.detail, 0.75);
        if reference < MIN_DETAIL {
            return Vec::new();
        }
        let nothing = |i: usize| self.detail[i] < BLANK_DETAIL * reference;
        let mut blank: Vec<bool> = (0..n).map(nothing).collect();
        for i in (0..n).filter(|&i| nothing(i)) {
            if i + 1 < n && !nothing(i + 1) {
                self.fade(&mut blank, (i + 1..n).collect());
            }
            if i > 0 && !nothing(i - 1) {
                self.fade(&mut blank, (0..i).rev().collect());
            }
        }
        (0..n).filter(|&i| blank[i]).collect()
    }

    /// Marks the frames that come out of blank ones, from those outwards.
    fn fade(&self, blank: &mut [bool], outwards: Vec<usize>) {
        let Some(&start) = outwards.first() else {
            return;
        };
        let within = |i: usize, s: f64| (self.times_s[i] - self.times_s[start]).abs() <= s;
        let ahead: Vec<f32> = outwards
            .iter()
            .take_while(|&&i| within(i, 2.0 * MOST_FADE_S) && !blank[i])
            .map(|&i| self.detail[i])
            .collect();
        let full = quantile(&ahead, 0.75);
        for (k, &i) in outwards.iter().enumerate() {
            let rises = ahead.get(k + 1).is_some_and(|&next| next > ahead[k]);
            if !(within(i, MOST_FADE_S) && rises && self.detail[i] < FADED_DETAIL * full) {
                break;
            }
            blank[i] = true;
        }
    }

    /// Frames that hang together, without those that are left out.
    fn segments(&self, out: &mut BTreeMap<usize, Reason>) -> Vec<Vec<usize>> {
        let good: Vec<usize> = (0..self.images.len())
            .filter(|i| !out.contains_key(i))
            .collect();
        let mut segments: Vec<Vec<usize>> = Vec::new();
        let mut k = 0;
        while k < good.len() {
            let b = good[k];
            let Some(&a) = segments.last().and_then(|segment| segment.last()) else {
                segments.push(vec![b]);
                k += 1;
                continue;
            };
            let soon = |&&c: &&usize| self.times_s[c] - self.times_s[a] <= MOST_ODD_S;
            let odd = good[k..]
                .iter()
                .enumerate()
                .take_while(|(i, c)| *i < 2 || soon(c))
                .find(|(_, c)| self.connected(a, **c));
            match odd {
                Some((n, &c)) => {
                    for &i in &good[k..k + n] {
                        out.insert(i, Reason::Odd);
                    }
                    if let Some(segment) = segments.last_mut() {
                        segment.push(c);
                    }
                    k += n + 1;
                }
                None => {
                    segments.push(vec![b]);
                    k += 1;
                }
            }
        }
        if segments.is_empty() {
            segments.push((0..self.images.len()).collect());
        }
        segments
    }

    fn shot(&self, segment: &[usize], out: &mut BTreeMap<usize, Reason>) -> Shot {
        let links: Vec<Link> = segment
            .par_windows(2)
            .map(|pair| self.link(pair[0], pair[1]))
            .collect();
        let steps: Vec<Step> = segment
            .windows(2)
            .zip(&links)
            .map(|(pair, link)| Step {
                seconds: self.times_s[pair[1]] - self.times_s[pair[0]],
                neighbours: pair[1] == pair[0] + 1,
                difference: link.difference,
            })
            .collect();
        let repeats = repeats::of(&steps);
        let mut at = Shown {
            index: segment[0],
            time_s: self.times_s[segment[0]],
            log_gain: 0.0,
            place: [[0.0; 2]; 4],
        };
        let mut frames = vec![at];
        let followed = links.iter().zip(&steps).zip(&repeats.repeated);
        for (&index, ((link, step), &repeated)) in segment[1..].iter().zip(followed) {
            at.index = index;
            at.time_s = self.times_s[index];
            at.log_gain += link.log_gain;
            // Few points are found again across a gap, and not surely the right ones.
            if step.neighbours {
                for (place, motion) in at.place.iter_mut().zip(link.motion) {
                    *place = [place[0] + motion[0], place[1] + motion[1]];
                }
            }
            if repeated {
                out.insert(index, Reason::Repeated);
            } else {
                frames.push(at);
            }
        }
        if repeats.pattern && steps.iter().all(|step| step.neighbours) {
            repeats::even_out(&mut frames, self.times_s);
        }
        let moment = |k: usize| self.times_s[segment[k]];
        let frozen_s = repeats
            .frozen
            .iter()
            .map(|run| [moment(run.start), moment(run.end)])
            .collect();
        Shot { frames, frozen_s }
    }
}
