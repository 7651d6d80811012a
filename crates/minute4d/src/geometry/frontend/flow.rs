//! Sources of optical flow: the classical search, RAFT, and a cache of their results in the finished steps.

use super::Plan;
use crate::Error;
use crate::device::NetworkDevice;
use crate::steps::Steps;
use m4_core::Flow;
use m4_geometry::classical::dense::{FlowError, FlowImage, FlowSource, InverseSearch};

impl Plan {
    /// The source of flow; a recurrent network takes `iterations`. Fails if weights cannot be used.
    pub fn flow(&self, iterations: usize, device: &NetworkDevice) -> Result<Box<dyn FlowSource>, Error> {
        #[cfg(feature = "nets")]
        if let Some(network) = self.flow_network(iterations, device)? {
            return Ok(network);
        }
        let _ = (iterations, device);
        Ok(Box::new(InverseSearch))
    }
}

/// A source of flow whose results are cached. The same images are measured again after an interruption, and when depth is estimated
/// again with better cameras.
pub struct CachedFlow<'a> {
    pub source: Box<dyn FlowSource>,
    pub steps: &'a Steps<'a>,
}

impl FlowSource for CachedFlow<'_> {
    fn name(&self) -> &str {
        self.source.name()
    }

    fn both(&self, a: &FlowImage<'_>, b: &FlowImage<'_>) -> Result<(Flow, Flow), FlowError> {
        let name = self.name_of(a, b);
        let size = (a.width, a.height);
        if let Some(both) = self.steps.get(&name).and_then(|bytes| read(&bytes, size)) {
            return Ok(both);
        }
        let both = self.source.both(a, b)?;
        // The caller refuses flow of another size.
        if [&both.0, &both.1].iter().all(|flow| (flow.width, flow.height) == size) {
            self.steps.put(&name, &written(&both));
        }
        Ok(both)
    }
}

impl CachedFlow<'_> {
    fn name_of(&self, a: &FlowImage<'_>, b: &FlowImage<'_>) -> String {
        let mut hasher = blake3::Hasher::new();
        hasher.update(self.source.name().as_bytes());
        for image in [a, b] {
            hasher.update(&(image.width as u64).to_le_bytes());
            hasher.update(image.rgb.as_flattened());
            for luma in image.grey {
                hasher.update(&luma.to_le_bytes());
            }
        }
        format!("flow-{}", &hasher.finalize().to_hex()[..32])
    }
}

fn written(both: &(Flow, Flow)) -> Vec<u8> {
    let planes = [&both.0.u, &both.0.v, &both.1.u, &both.1.v];
    planes.iter().flat_map(|plane| plane.iter()).flat_map(|v| v.to_le_bytes()).collect()
}

fn read(bytes: &[u8], (width, height): (usize, usize)) -> Option<(Flow, Flow)> {
    let (numbers, rest) = bytes.as_chunks();
    let n = width * height;
    if numbers.len() != 4 * n || !rest.is_empty() {
        return None;
    }
    let plane = |k: usize| -> Vec<f32> {
        let of_plane = &numbers[k * n..(k + 1) * n];
        of_plane.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
    };
    let flow = |k: usize| Flow { width, height, u: plane(k), v: plane(k + 1) };
    Some((flow(0), flow(2)))
}

#[cfg(feature = "nets")]
mod raft {
    //! RAFT as a source of flow.

    use super::super::{Part, Plan, unusable};
    use super::{Error, Flow, FlowError, FlowImage, FlowSource, NetworkDevice};
    use crate::error::NetworkMethod;
    use m4_core::{Plane, RgbImage};
    use m4_geometry::megasam::cvd::pairs::FramePair;
    use m4_geometry::megasam::{PairFlow, PairFlowError};
    use m4_nets::Raft;
    use std::collections::HashMap;

    impl Plan {
        fn raft(&self, device: &NetworkDevice) -> Result<Option<Raft>, Error> {
            let load = |path| Raft::load(path, &device.device).map_err(unusable(NetworkMethod::FrontEnd(Part::Raft)));
            self.file(Part::Raft).map(load).transpose()
        }

        pub(super) fn flow_network(
            &self,
            iterations: usize,
            device: &NetworkDevice,
        ) -> Result<Option<Box<dyn FlowSource>>, Error> {
            let raft = self.raft(device)?;
            Ok(raft.map(|net| Box::new(RaftSource { net, iterations }) as Box<dyn FlowSource>))
        }

        /// RAFT along a clip; `None` if another method measures flow. Fails if its weights cannot be used.
        pub fn raft_pairs(
            &self,
            iterations: usize,
            device: &NetworkDevice,
        ) -> Result<Option<Box<dyn PairFlow>>, Error> {
            let (there, back) = (HashMap::new(), HashMap::new());
            let raft = self.raft(device)?;
            Ok(raft.map(|net| Box::new(RaftPairs { net, iterations, there, back }) as Box<dyn PairFlow>))
        }
    }

    const RAFT: &str = "raft";

    /// RAFT; features are made once a pair, for both directions.
    struct RaftSource {
        net: Raft,
        iterations: usize,
    }

    impl RaftSource {
        fn measure(&self, a: &RgbImage, b: &RgbImage) -> Result<(Flow, Flow), m4_nets::NetError> {
            let (a, b) = (self.net.encode(a)?, self.net.encode(b)?);
            let [there, back] = self.net.flow_both(&a, &b, self.iterations, None)?;
            Ok((there.flow, back.flow))
        }
    }

    impl FlowSource for RaftSource {
        fn name(&self) -> &'static str {
            RAFT
        }

        fn both(&self, a: &FlowImage<'_>, b: &FlowImage<'_>) -> Result<(Flow, Flow), FlowError> {
            let image = |of: &FlowImage<'_>| Plane::from_fn(of.width, of.height, |x, y| of.rgb[y * of.width + x]);
            self.measure(&image(a), &image(b))
                .map_err(|error| FlowError::Source { source_name: RAFT.to_owned(), reason: Box::new(error) })
        }
    }

    /// RAFT along a clip: a longer step begins with the flow that the shorter one before it found at the same ends.
    struct RaftPairs {
        net: Raft,
        iterations: usize,
        /// By the frame that it starts in.
        there: HashMap<usize, Flow>,
        /// By the frame that it starts in, which is the later one.
        back: HashMap<usize, Flow>,
    }

    impl RaftPairs {
        fn measure(&mut self, pair: FramePair, a: &RgbImage, b: &RgbImage) -> Result<[Flow; 2], m4_nets::NetError> {
            let begin = match (self.there.get(&pair.source), self.back.get(&pair.target)) {
                (Some(there), Some(back)) if pair.target > pair.source + 1 => Some([there, back]),
                _ => None,
            };
            let (a, b) = (self.net.encode(a)?, self.net.encode(b)?);
            let [there, back] = self.net.flow_both(&a, &b, self.iterations, begin)?;
            self.there.insert(pair.source, there.low);
            self.back.insert(pair.target, back.low);
            Ok([there.flow, back.flow])
        }
    }

    impl PairFlow for RaftPairs {
        fn name(&self) -> &'static str {
            RAFT
        }

        fn both(&mut self, pair: FramePair, a: &RgbImage, b: &RgbImage) -> Result<[Flow; 2], PairFlowError> {
            self.measure(pair, a, b).map_err(|error| PairFlowError {
                source_frame: pair.source,
                target_frame: pair.target,
                reason: Box::new(error),
            })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::CachedFlow;
    use crate::Silent;
    use crate::steps::Steps;
    use m4_core::Flow;
    use m4_geometry::classical::dense::{FlowError, FlowImage, FlowSource, InverseSearch};
    use std::sync::atomic::{AtomicUsize, Ordering};

    static MEASURED: AtomicUsize = AtomicUsize::new(0);

    struct Counting;

    impl FlowSource for Counting {
        fn name(&self) -> &'static str {
            "counting"
        }

        fn both(&self, a: &FlowImage<'_>, b: &FlowImage<'_>) -> Result<(Flow, Flow), FlowError> {
            MEASURED.fetch_add(1, Ordering::Relaxed);
            InverseSearch.both(a, b)
        }
    }

    #[test]
    fn the_same_images_are_measured_once() {
        let (w, h) = (48, 40);
        let pixels = |shift: usize| -> (Vec<[u8; 3]>, Vec<f32>) {
            let value = |i: usize| ((i % w + shift) * 37 % 211) as u8;
            (0..w * h).map(|i| ([value(i); 3], f32::from(value(i)))).unzip()
        };
        let pixels = [pixels(0), pixels(1)];
        let [a, b] = pixels.each_ref().map(|(rgb, grey)| FlowImage { width: w, height: h, rgb, grey });
        let dir = tempfile::tempdir().unwrap();
        let steps = Steps::open(dir.path(), "key", &Silent);
        let cached = CachedFlow { source: Box::new(Counting), steps: &steps };
        let plain = InverseSearch.both(&a, &b).unwrap();
        assert_eq!(cached.both(&a, &b).unwrap(), plain);
        assert_eq!(cached.both(&a, &b).unwrap(), plain, "from the cache");
        assert_eq!(MEASURED.load(Ordering::Relaxed), 1);
        assert_ne!(cached.both(&b, &a).unwrap(), plain, "the other way round is another pair");
        assert_eq!(MEASURED.load(Ordering::Relaxed), 2);
    }
}
