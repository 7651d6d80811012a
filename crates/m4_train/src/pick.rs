//! Which frame an iteration looks at: a function of seed, iteration and the losses so far.

use crate::config::FrameChoice;
use m4_math::CounterRng;

/// Purposes of random numbers in this crate: streams never overlap.
pub(crate) mod purpose {
    pub const SHUFFLE: u64 = 0x5455_0001;
    pub const DRAW: u64 = 0x5455_0002;
    pub const DENSIFY_FRAMES: u64 = 0x5455_0003;
    pub const PRUNE_FRAMES: u64 = 0x5455_0004;
    /// Plus the iteration shifted by 8 bits.
    pub const SPLIT: u64 = 0x5455_0005;
}

/// How much of a frame's old loss is kept when it is seen again.
const MEMORY: f32 = 0.5;

/// The losses seen so far, and this epoch's order.
#[derive(Debug, Clone)]
pub(crate) struct Picker {
    seed: u64,
    choice: FrameChoice,
    /// Smoothed loss a frame; negative before the first visit.
    pub loss: Vec<f32>,
    order: Vec<usize>,
    epoch: Option<usize>,
}

impl Picker {
    pub fn new(seed: u64, choice: FrameChoice, frames: usize) -> Self {
        Self {
            seed,
            choice,
            loss: vec![-1.0; frames],
            order: Vec::new(),
            epoch: None,
        }
    }

    /// The frame of `iteration`.
    pub fn pick(&mut self, iteration: usize) -> usize {
        let n = self.loss.len();
        let epoch = iteration / n;
        if let FrameChoice::ErrorDriven { uniform } = self.choice
            && epoch > 0
        {
            let mut rng = CounterRng::new(self.seed, purpose::DRAW, iteration as u64);
            if rng.uniform() >= f64::from(uniform) {
                let weight = |l: &f32| f64::from(l.max(0.0));
                let mut left = rng.uniform() * self.loss.iter().map(weight).sum::<f64>();
                for (i, l) in self.loss.iter().enumerate() {
                    left -= weight(l);
                    if left < 0.0 {
                        return i;
                    }
                }
            }
        }
        if self.epoch != Some(epoch) {
            self.order = CounterRng::new(self.seed, purpose::SHUFFLE, epoch as u64).sample(n, n);
            self.epoch = Some(epoch);
        }
        self.order[iteration % n]
    }

    /// Remembers the loss of a frame.
    pub fn seen(&mut self, frame: usize, loss: f32) {
        let old = self.loss[frame];
        self.loss[frame] = if old < 0.0 {
            loss
        } else {
            MEMORY * old + (1.0 - MEMORY) * loss
        };
    }
}

#[cfg(test)]
mod tests {
    use super::Picker;
    use crate::config::FrameChoice;

    #[test]
    fn an_epoch_sees_every_frame_once() {
        let mut picker = Picker::new(3, FrameChoice::Shuffled, 7);
        for epoch in 0..4 {
            let mut seen: Vec<usize> = (0..7).map(|i| picker.pick(7 * epoch + i)).collect();
            seen.sort_unstable();
            assert!(seen.iter().copied().eq(0..7));
        }
        // the order is that of the iteration, not of the calls
        let mut fresh = Picker::new(3, FrameChoice::Shuffled, 7);
        assert_eq!(fresh.pick(25), picker.pick(25));
        assert_eq!(fresh.pick(8), picker.pick(8));
    }

    #[test]
    fn frames_that_look_wrong_come_more_often() {
        let mut picker = Picker::new(1, FrameChoice::ErrorDriven { uniform: 0.25 }, 4);
        for (i, loss) in [0.1, 0.1, 0.7, 0.1].into_iter().enumerate() {
            picker.seen(i, loss);
        }
        let hits = (4..4004).filter(|&i| picker.pick(i) == 2).count();
        // a quarter of 0.25 and 0.7 of 0.75
        assert!((2200..2500).contains(&hits), "{hits} of 4000");
    }
}
