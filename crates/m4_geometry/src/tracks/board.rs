//! Who is where: every track in every frame.

use super::Lifted;

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

    /// The place of a track that is seen; `None` where it is not.
    pub fn seen(&self, frame: usize, track: usize) -> Option<[f32; 3]> {
        let i = self.at(frame, track);
        (self.state[i] == State::Seen).then(|| self.places[i])
    }

    /// Tracks that are seen in a frame.
    pub fn seen_in(&self, frame: usize) -> impl Iterator<Item = usize> + '_ {
        (0..self.count).filter(move |&k| self.state[self.at(frame, k)] == State::Seen)
    }

    pub fn set(&mut self, frame: usize, track: usize, place: [f32; 3], state: State, confidence: f32) {
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

    /// What was guessed blindly is forgotten where the track did not come back: `frames` in the order of the guessing.
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
    use super::{Board, State};
    use crate::tracks::Lifted;

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
        assert_eq!(board.seen(5, 1), Some([3.0; 3]));
        assert_eq!(board.seen_in(1).collect::<Vec<_>>(), [0, 1]);
    }
}
