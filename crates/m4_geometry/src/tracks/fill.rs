//! Tracks carried on where their points are hidden, and taken up again where they come back.
//!
//! A point that is lost goes on with the rigid motion that most of its neighbours follow: those
//! that were seen with it last, from that frame on, so that nothing adds up; where none of them is
//! left, those around it, frame by frame. As soon as the camera sees something that moves where the
//! point should be, at its depth, and its surface has not turned away, a chain starts there: if
//! that goes where the neighbours go, it is the point again.

use super::flow_tracker::{Chain, Lifted, around, is_inside, lift, one_way};
use super::predict::{Guess, Lost, Step, lose};
use super::tracker::nearest;
use super::{Strip, TrackError};
use m4_core::nalgebra::Vector3;
use m4_core::{DepthMap, Progress};
use rayon::prelude::*;

/// Most frames that a point is carried on from the last in which it was seen.
const MOST_FRAMES: usize = 60;
/// A point is visible again where the visible surface lies at its depth, to within this share ...
const JOIN_DEPTH: f32 = 0.03;
/// ... and where, some frames later, it is still within this many pixels of the prediction of its
/// neighbours.
const JOIN_PX: f32 = 3.0;
/// A hidden point in front of the visible surface by more than this share of the depth is wrong
/// (docs/spec/optimiser.md 2.6: 5 %).
const FREE_SPACE: f32 = 0.05;
/// Frames in which something farther was seen in its place, after which a track is given up.
const MOST_VIOLATIONS: usize = 2;
/// Frames after which a track that came back is compared with its neighbours.
const PROOF: usize = 8;

/// The clip that tracks are carried through.
pub(crate) struct TrackInputs<'a> {
    pub strip: &'a Strip,
    /// z-depth of all that a frame sees; 0 or not a number where unknown.
    pub surface: &'a (dyn Fn(usize) -> Result<DepthMap, TrackError> + Sync),
}

/// What became of a lost point in one frame.
struct Outcome {
    guess: Guess,
    violated: bool,
    back: Option<Lifted>,
}

/// Carries every track of `board` on to both ends of the clip, as far as its places can be told.
pub(crate) fn fill(
    scene: &TrackInputs<'_>,
    board: &mut Board,
    progress: &dyn Progress,
) -> Result<(), TrackError> {
    sweep(scene, board, true, progress)?;
    sweep(scene, board, false, progress)
}

fn sweep(
    scene: &TrackInputs<'_>,
    board: &mut Board,
    forward: bool,
    progress: &dyn Progress,
) -> Result<(), TrackError> {
    const PHASE: &str = "carrying hidden points";
    let n = board.frames;
    let frame = |s: usize| if forward { s } else { n - 1 - s };
    let mut lost: Vec<Option<Lost>> = vec![None; board.count];
    for s in 1..n {
        if progress.cancelled() {
            return Err(TrackError::Cancelled { phase: PHASE });
        }
        let done = if forward { s } else { n + s };
        progress.update(PHASE, done, 2 * n - 1, "");
        let (before, now) = (frame(s - 1), frame(s));
        let unknown = |board: &Board, k: usize| board.state[board.at(now, k)] == State::Unknown;
        let new: Vec<usize> = board
            .seen_in(before)
            .filter(|&k| unknown(board, k))
            .collect();
        let memories = lose(board, &scene.strip.cameras[before], before, &new);
        for (&k, memory) in new.iter().zip(memories) {
            lost[k] = Some(memory);
        }
        let is_known = |k: usize| board.state[board.at(before, k)] != State::Unknown;
        let open = |k: &usize| is_known(*k) && unknown(board, *k);
        let open: Vec<(usize, &Lost)> = (0..board.count)
            .filter(open)
            .filter_map(|k| lost[k].as_ref().map(|l| (k, l)))
            .filter(|(_, l)| now.abs_diff(l.since) <= MOST_FRAMES)
            .collect();
        if open.is_empty() {
            continue;
        }
        let surface = (scene.surface)(now)?;
        let step = Step::new(board, before, now);
        let earlier = (s >= 2).then(|| frame(s - 2));
        let outcome = |&(k, memory): &(usize, &Lost)| {
            let guess = memory.guess(board, k, &step, earlier)?;
            let outcome = look(scene, board, (k, memory), guess, now, forward, &surface);
            Some((k, outcome))
        };
        let outcomes: Vec<Option<(usize, Outcome)>> = open.par_iter().map(outcome).collect();
        for (k, outcome) in outcomes.into_iter().flatten() {
            let Some(memory) = &mut lost[k] else { continue };
            memory.learn(&outcome.guess);
            memory.violations += usize::from(outcome.violated);
            if memory.violations > MOST_VIOLATIONS {
                lost[k] = None;
                continue;
            }
            let confidence = if outcome.violated {
                0.0
            } else {
                outcome.guess.confidence
            };
            let p = outcome.guess.place;
            board.set(
                now,
                k,
                [p.x as f32, p.y as f32, p.z as f32],
                outcome.guess.state,
                confidence,
            );
            if let Some(piece) = outcome.back {
                board.put(k, &piece);
            }
        }
    }
    board.forget_blind((0..n).map(frame));
    Ok(())
}

/// What the camera says of a place where a point should be.
fn look(
    scene: &TrackInputs<'_>,
    board: &Board,
    (track, memory): (usize, &Lost),
    guess: Guess,
    now: usize,
    forward: bool,
    surface: &DepthMap,
) -> Outcome {
    let strip = scene.strip;
    let camera = &strip.cameras[now];
    let ([u, v], z) = camera.project(&guess.place);
    let at = [u as f32, v as f32];
    let mut out = Outcome {
        guess,
        violated: false,
        back: None,
    };
    if !(z > 0.0 && is_inside(strip, at)) {
        return out;
    }
    out.violated = z < f64::from(least(surface, at)) * (1.0 - f64::from(FREE_SPACE));
    if memory.faces(&guess, &camera.centre()) {
        out.back = again(scene, board, (track, memory), (now, at, z), forward);
    }
    out
}

/// The least depth that is known of 3x3 pixels; 0 where none is.
fn least(surface: &DepthMap, at: [f32; 2]) -> f32 {
    let (w, h) = surface.size();
    let (x, y) = nearest(at);
    let rows = y.saturating_sub(1)..(y + 2).min(h);
    let pixels = rows.flat_map(|y| (x.saturating_sub(1)..(x + 2).min(w)).map(move |x| (x, y)));
    let depths = pixels
        .map(|p| surface[p])
        .filter(|z| z.is_finite() && *z > 0.0);
    depths.min_by(f32::total_cmp).unwrap_or(0.0)
}

/// The piece of a track that begins where the point should be, if what is seen there may be it.
fn again(
    scene: &TrackInputs<'_>,
    board: &Board,
    (track, memory): (usize, &Lost),
    (now, at, z): (usize, [f32; 2], f64),
    forward: bool,
) -> Option<Lifted> {
    let strip = scene.strip;
    let (x, y) = nearest(at);
    strip.dynamic[now].get(x, y)?;
    let same_depth = |z: f64, surface: f64| (z / surface - 1.0).abs() <= f64::from(JOIN_DEPTH);
    if !same_depth(z, 1.0 / f64::from(around(strip, now, at))) {
        return None;
    }
    let mut positions = one_way(strip, now, at, forward);
    let first = if forward { now } else { now - positions.len() };
    positions.insert(0, at);
    if !forward {
        positions.reverse();
    }
    let pieces = lift(strip, &Chain { first, positions });
    let piece = pieces
        .into_iter()
        .find(|p| (p.first..p.first + p.places.len()).contains(&now))?;
    // A little later it must still be where its neighbours say.
    let reach = (piece.places.len() - 1).min(PROOF - 1);
    let then = if forward { now + reach } else { now - reach };
    if let (Some(want), Some(actual)) = (
        memory.check(board, track, then),
        then.checked_sub(piece.first)
            .and_then(|i| piece.places.get(i)),
    ) {
        let actual = Vector3::from(actual.map(f64::from));
        let (a, b) = (
            strip.cameras[then].project(&want),
            strip.cameras[then].project(&actual),
        );
        let off = (a.0[0] - b.0[0]).hypot(a.0[1] - b.0[1]);
        if !(off <= f64::from(JOIN_PX) && same_depth(a.1, b.1)) {
            return None;
        }
    }
    Some(piece)
}

/// What is known of a track in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum State {
    /// Nothing.
    Unknown,
    /// As it moved last, without any neighbour to go by: kept if it comes back.
    Blind,
    /// Where its neighbours went.
    Predicted,
    /// Where it was seen.
    Seen,
}

/// Every track in every frame, `[frames][count]`.
pub(crate) struct Board {
    pub frames: usize,
    pub count: usize,
    pub places: Vec<[f32; 3]>,
    pub state: Vec<State>,
    /// 0..1.
    pub confidence: Vec<f32>,
}

impl Board {
    pub fn new(frames: usize, count: usize) -> Self {
        Self {
            frames,
            count,
            places: vec![[f32::NAN; 3]; frames * count],
            state: vec![State::Unknown; frames * count],
            confidence: vec![0.0; frames * count],
        }
    }

    pub fn at(&self, frame: usize, track: usize) -> usize {
        frame * self.count + track
    }

    /// The place of a track in a frame where it is visible; `None` elsewhere.
    pub fn visible_place(&self, frame: usize, track: usize) -> Option<[f32; 3]> {
        let i = self.at(frame, track);
        (self.state[i] == State::Seen).then(|| self.places[i])
    }

    /// Tracks that are seen in a frame.
    pub fn seen_in(&self, frame: usize) -> impl Iterator<Item = usize> + '_ {
        (0..self.count).filter(move |&k| self.state[self.at(frame, k)] == State::Seen)
    }

    pub fn set(
        &mut self,
        frame: usize,
        track: usize,
        place: [f32; 3],
        state: State,
        confidence: f32,
    ) {
        let i = self.at(frame, track);
        (self.places[i], self.state[i], self.confidence[i]) = (place, state, confidence);
    }

    pub fn clear(&mut self, frame: usize, track: usize) {
        self.set(frame, track, [f32::NAN; 3], State::Unknown, 0.0);
    }

    /// A piece that was seen, where nothing is known of the track yet or only what was predicted.
    pub fn put(&mut self, track: usize, piece: &Lifted) {
        for (frame, place) in (piece.first..self.frames).zip(&piece.places) {
            if self.state[self.at(frame, track)] != State::Seen {
                self.set(frame, track, *place, State::Seen, 1.0);
            }
        }
    }

    /// What was guessed blindly is forgotten where the track did not come back: `frames` in the
    /// order of the guessing.
    pub fn forget_blind(&mut self, frames: impl Iterator<Item = usize> + Clone) {
        for track in 0..self.count {
            let mut run: Vec<usize> = Vec::new();
            for frame in frames.clone() {
                let i = self.at(frame, track);
                match self.state[i] {
                    State::Blind => run.push(frame),
                    State::Unknown => {}
                    State::Predicted | State::Seen => {
                        for &t in &run {
                            let i = self.at(t, track);
                            self.state[i] = State::Predicted;
                        }
                        run.clear();
                    }
                }
            }
            run.iter().for_each(|&t| self.clear(t, track));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Lifted;
    use super::{Board, State};

    #[test]
    fn blind_guesses_stay_where_the_track_comes_back() {
        let mut board = Board::new(6, 2);
        for k in 0..2 {
            board.put(
                k,
                &Lifted {
                    first: 0,
                    places: vec![[1.0; 3]; 2],
                },
            );
            board.set(2, k, [2.0; 3], State::Blind, 0.2);
            board.set(3, k, [2.0; 3], State::Blind, 0.2);
        }
        board.put(
            1,
            &Lifted {
                first: 4,
                places: vec![[3.0; 3]; 9],
            },
        );
        board.forget_blind(0..6);
        assert_eq!(board.state[board.at(2, 0)], State::Unknown);
        assert!(board.places[board.at(3, 0)][0].is_nan());
        assert_eq!(board.state[board.at(2, 1)], State::Predicted);
        assert_eq!(board.visible_place(5, 1), Some([3.0; 3]));
        assert_eq!(board.seen_in(1).collect::<Vec<_>>(), [0, 1]);
    }
}
