//! Caches optical flow between two images in the finished steps.

use m4_core::Cache;
use m4_geometry::dense::{Flow, FlowError, FlowImage, FlowSource};

/// A source of flow and where its results are kept. A clip may ask for the same images again: after an interruption, and
/// when depth is found again with better cameras.
pub(super) struct KeptFlow<'a> {
    pub source: &'a dyn FlowSource,
    pub cache: &'a dyn Cache,
}

impl FlowSource for KeptFlow<'_> {
    fn name(&self) -> &str {
        self.source.name()
    }

    fn both(&self, a: &FlowImage<'_>, b: &FlowImage<'_>) -> Result<(Flow, Flow), FlowError> {
        let name = self.name_of(a, b);
        let size = (a.width, a.height);
        if let Some(both) = self.cache.get(&name).and_then(|bytes| read(&bytes, size)) {
            return Ok(both);
        }
        let both = self.source.both(a, b)?;
        // The caller refuses flow of another size.
        if [&both.0, &both.1].iter().all(|flow| (flow.width, flow.height) == size) {
            self.cache.put(&name, &written(&both));
        }
        Ok(both)
    }
}

impl KeptFlow<'_> {
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
    planes
        .iter()
        .flat_map(|plane| plane.iter())
        .flat_map(|v| v.to_le_bytes())
        .collect()
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
    let flow = |k: usize| Flow {
        width,
        height,
        u: plane(k),
        v: plane(k + 1),
    };
    Some((flow(0), flow(2)))
}

#[cfg(test)]
mod tests {
    use super::KeptFlow;
    use m4_core::Cache;
    use m4_geometry::dense::{FlowImage, FlowSource, InverseSearch};
    use std::collections::HashMap;
    use std::sync::Mutex;

    #[derive(Default)]
    struct Memory(Mutex<HashMap<String, Vec<u8>>>);

    impl Cache for Memory {
        fn get(&self, name: &str) -> Option<Vec<u8>> {
            self.0.lock().unwrap().get(name).cloned()
        }

        fn put(&self, name: &str, bytes: &[u8]) {
            let old = self.0.lock().unwrap().insert(name.to_owned(), bytes.to_vec());
            assert!(old.is_none(), "{name} was measured twice");
        }
    }

    #[test]
    fn flow_of_equal_images_is_computed_once() {
        let (w, h) = (48, 40);
        let pixels = |shift: usize| -> (Vec<[u8; 3]>, Vec<f32>) {
            let value = |i: usize| ((i % w + shift) * 37 % 211) as u8;
            (0..w * h).map(|i| ([value(i); 3], f32::from(value(i)))).unzip()
        };
        let pixels = [pixels(0), pixels(1)];
        let [a, b] = pixels.each_ref().map(|(rgb, grey)| FlowImage {
            width: w,
            height: h,
            rgb,
            grey,
        });
        let (search, memory) = (InverseSearch, Memory::default());
        let kept = KeptFlow {
            source: &search,
            cache: &memory,
        };
        let plain = search.both(&a, &b).unwrap();
        assert_eq!(kept.both(&a, &b).unwrap(), plain);
        assert_eq!(kept.both(&a, &b).unwrap(), plain, "from the cache");
        assert_ne!(kept.both(&b, &a).unwrap(), plain, "the other way round is another pair");
        assert_eq!(memory.0.lock().unwrap().len(), 2);
    }
}
