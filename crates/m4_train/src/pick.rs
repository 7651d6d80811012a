//! Chooses the frame of an iteration, as a function of seed and iteration.

use m4_core::CounterRng;

/// Purposes of random numbers in this crate: streams never overlap.
pub(crate) mod purpose {
    pub const SHUFFLE: u64 = 0x5455_0001;
    pub const DENSIFY_FRAMES: u64 = 0x5455_0003;
    /// Plus the iteration shifted by 8 bits.
    pub const SPLIT: u64 = 0x5455_0005;
}

/// Every frame once an epoch, in an order drawn again for each.
#[derive(Debug, Clone)]
pub(crate) struct Picker {
    seed: u64,
    frames: usize,
    order: Vec<usize>,
    epoch: Option<usize>,
}

impl Picker {
    pub fn new(seed: u64, frames: usize) -> Self {
        Self { seed, frames, order: Vec::new(), epoch: None }
    }

    /// The frame of `iteration`.
    pub fn pick(&mut self, iteration: usize) -> usize {
        let n = self.frames;
        let epoch = iteration / n;
        if self.epoch != Some(epoch) {
            self.order = CounterRng::new(self.seed, purpose::SHUFFLE, epoch as u64).sample(n, n);
            self.epoch = Some(epoch);
        }
        self.order[iteration % n]
    }
}

#[cfg(test)]
mod tests {
    use super::Picker;

    #[test]
    fn an_epoch_sees_every_frame_once() {
        let mut picker = Picker::new(3, 7);
        for epoch in 0..4 {
            let mut seen: Vec<usize> = (0..7).map(|i| picker.pick(7 * epoch + i)).collect();
            seen.sort_unstable();
            assert!(seen.iter().copied().eq(0..7));
        }
        // the order is that of the iteration, not of the calls
        let mut fresh = Picker::new(3, 7);
        assert_eq!(fresh.pick(25), picker.pick(25));
        assert_eq!(fresh.pick(8), picker.pick(8));
    }
}
