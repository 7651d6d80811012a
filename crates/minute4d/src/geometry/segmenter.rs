//! The segmentation method: none, or a network.

use crate::Error;
#[cfg(not(feature = "nets"))]
use crate::error::{NetworkError, NetworkMethod};
use m4_geometry::classical::dense;
use serde::{Deserialize, Serialize};

/// The segmentation method.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Segmenter {
    /// [`Self::Mobilesam`] where its weights are present, else [`Self::None`], and [`Self::Sam2`] after it where its are: see
    /// `docs/geometry.md`.
    #[default]
    Auto,
    /// Masks are what motion and colours say.
    None,
    /// MobileSAM, a pretrained network; needs its weights.
    Mobilesam,
    /// SAM 2.1, a pretrained network with a memory, which follows things through the clip; needs the weights of one of its sizes.
    Sam2,
}

impl Segmenter {
    /// As options and records name it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::None => "none",
            Self::Mobilesam => "mobilesam",
            Self::Sam2 => "sam2",
        }
    }
}

/// A segmenter that can be used: its weights were found.
pub(crate) struct Resolved {
    #[cfg(feature = "nets")]
    weights: Option<network::Weights>,
}

/// Finds what `asked` needs.
///
/// # Errors
///
/// [`Error::Network`] if weights are missing, [`Error::Read`] if they cannot be read.
#[cfg(feature = "nets")]
pub(crate) fn resolve(asked: Segmenter) -> Result<Resolved, Error> {
    let weights = match asked {
        // SAM 2 follows things through the clip afterwards
        Segmenter::None | Segmenter::Sam2 => None,
        Segmenter::Auto => network::Weights::present()?,
        Segmenter::Mobilesam => Some(network::Weights::find()?),
    };
    Ok(Resolved { weights })
}

/// Finds what `asked` needs.
///
/// # Errors
///
/// [`Error::Network`]: the build has no networks.
#[cfg(not(feature = "nets"))]
pub(crate) fn resolve(asked: Segmenter) -> Result<Resolved, Error> {
    match asked {
        Segmenter::None | Segmenter::Auto => Ok(Resolved {}),
        Segmenter::Mobilesam | Segmenter::Sam2 => {
            Err(NetworkError::NotBuilt { method: NetworkMethod::Segmenter(asked) }.into())
        }
    }
}

impl Resolved {
    /// Its name, never `auto`.
    pub(crate) fn name(&self) -> &'static str {
        if self.weights_hash().is_some() { Segmenter::Mobilesam.name() } else { Segmenter::None.name() }
    }

    /// BLAKE3 of its weights.
    pub(crate) fn weights_hash(&self) -> Option<&str> {
        #[cfg(feature = "nets")]
        return self.weights.as_ref().map(|w| w.hash.as_str());
        #[cfg(not(feature = "nets"))]
        None
    }

    /// The segmenter, loaded.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the weights cannot be used.
    pub(crate) fn load(&self) -> Result<Option<Box<dyn dense::Segmenter>>, Error> {
        #[cfg(feature = "nets")]
        if let Some(weights) = &self.weights {
            return Ok(Some(Box::new(weights.load()?)));
        }
        Ok(None)
    }
}

#[cfg(feature = "nets")]
mod network {
    //! MobileSAM as a segmenter.

    use super::Segmenter;
    use crate::error::{NetworkError, NetworkMethod};
    use crate::weights::{self, State, Store, WeightsError};
    use crate::{Error, hash};
    use m4_core::{Plane, RgbImage};
    use m4_geometry::classical::dense::{self, SegmentError, SegmentMask, SegmentPrompt};
    use m4_nets::{MobileSam, PointPrompt, Prompt};
    use std::path::PathBuf;

    /// The name of the weights.
    const ENTRY: &str = "mobile-sam";
    const METHOD: NetworkMethod = NetworkMethod::Segmenter(Segmenter::Mobilesam);

    /// Weights that are there.
    pub struct Weights {
        path: PathBuf,
        pub hash: String,
    }

    fn missing(source: WeightsError) -> Error {
        Error::from(NetworkError::Weights { method: METHOD, source })
    }

    impl Weights {
        /// Those of the user's store; an error that says how to get them without.
        pub fn find() -> Result<Self, Error> {
            let entry = weights::find(ENTRY).map_err(missing)?;
            Self::at(Store::of_user().and_then(|s| s.require(entry)).map_err(missing)?)
        }

        /// Those of the user's store, if there is one and they are in it.
        pub fn present() -> Result<Option<Self>, Error> {
            let entry = weights::find(ENTRY).map_err(missing)?;
            match Store::of_user().map(|store| store.state(entry)) {
                Ok(State::Stored(path) | State::InHub(path)) => Self::at(path).map(Some),
                Ok(State::Absent) | Err(_) => Ok(None),
            }
        }

        fn at(path: PathBuf) -> Result<Self, Error> {
            let hash = hash::of_path(&path)?;
            Ok(Self { path, hash })
        }

        pub fn load(&self) -> Result<MobileSamSegmenter, Error> {
            let net = MobileSam::load(&self.path, m4_nets::cpu())
                .map_err(|source| NetworkError::Load { method: METHOD, source: Box::new(source) })?;
            Ok(MobileSamSegmenter { net })
        }
    }

    /// The network; an image is encoded once for all of its prompts.
    pub struct MobileSamSegmenter {
        net: MobileSam,
    }

    /// A prompt of an image of `size` as one of `image`.
    fn ours(prompt: &SegmentPrompt, belief: Plane<f32>, image: &RgbImage, size: (usize, usize)) -> Prompt {
        let (sx, sy) = (image.width() as f32 / size.0 as f32, image.height() as f32 / size.1 as f32);
        let point = |&[x, y]: &[f32; 2], on_object: bool| PointPrompt { at_px: [x * sx, y * sy], on_object };
        let on = prompt.points_px.iter().map(|p| point(p, true));
        let off = prompt.off_points_px.iter().map(|p| point(p, false));
        let [x0, y0, x1, y1] = prompt.box_px;
        Prompt {
            points: on.chain(off).collect(),
            box_px: Some([x0 * sx, y0 * sy, x1 * sx, y1 * sy]),
            mask_logits: Some(belief),
        }
    }

    impl MobileSamSegmenter {
        fn answer(
            &self,
            image: &RgbImage,
            size: (usize, usize),
            prompts: &[SegmentPrompt],
        ) -> Result<Vec<SegmentMask>, Box<dyn std::error::Error + Send + Sync>> {
            let embedding = self.net.encode(image)?;
            let one = |prompt: &SegmentPrompt| {
                let belief = Plane::from_vec(size.0, size.1, prompt.belief.clone())?;
                let belief = embedding.mask_logits(&belief);
                let masks = self.net.masks(&embedding, &ours(prompt, belief, image, size))?;
                // The first: box, points and belief leave no doubt which thing is meant.
                let mask = masks.first().ok_or("the network gave no mask")?;
                Ok(SegmentMask { logits: mask.logits_at(size).data().to_vec(), quality: mask.iou })
            };
            prompts.iter().map(one).collect()
        }
    }

    impl dense::Segmenter for MobileSamSegmenter {
        fn name(&self) -> &str {
            Segmenter::Mobilesam.name()
        }

        fn masks(
            &self,
            image: &RgbImage,
            size: (usize, usize),
            prompts: &[SegmentPrompt],
        ) -> Result<Vec<SegmentMask>, SegmentError> {
            self.answer(image, size, prompts).map_err(|error| SegmentError::Source {
                segmenter: Segmenter::Mobilesam.name().to_owned(),
                reason: error,
            })
        }
    }
}

#[cfg(all(test, feature = "nets"))]
mod tests {
    use super::network::Weights;
    use m4_core::{Plane, RgbImage};
    use m4_geometry::classical::dense::{SegmentPrompt, Segmenter};

    const FULL: (usize, usize) = (480, 270);
    const SMALL: (usize, usize) = (240, 135);

    /// A disc on waves; in shares of the width.
    fn on_disc(x: f32, y: f32) -> bool {
        (x - 0.45).hypot(y - 0.3) < 0.13
    }

    fn colour_image() -> RgbImage {
        Plane::from_fn(FULL.0, FULL.1, |x, y| {
            let (x, y) = ((x as f32 + 0.5) / FULL.0 as f32, (y as f32 + 0.5) / FULL.0 as f32);
            if on_disc(x, y) {
                return [220, 60, 40];
            }
            [60.0, 33.0, 14.0].map(|f: f32| (127.0 + 50.0 * (x * f).sin() * (y * f).cos()) as u8)
        })
    }

    #[test]
    fn a_coarse_disc_becomes_the_disc() {
        let Some(weights) = Weights::present().unwrap() else {
            m4_testkit::skip(m4_testkit::Need::Weights, "mobile-sam is not here");
            return;
        };
        let at = |p: usize| {
            let (x, y) = ((p % SMALL.0) as f32 + 0.5, (p / SMALL.0) as f32 + 0.5);
            (x / SMALL.0 as f32, y / SMALL.0 as f32)
        };
        let pixels = 0..SMALL.0 * SMALL.1;
        let truth: Vec<bool> = pixels.clone().map(at).map(|(x, y)| on_disc(x, y)).collect();
        // A box of another shape, larger and beside it.
        let edges = [0.33f32, 0.15, 0.63, 0.45];
        let inside = |(x, y): (f32, f32)| x > edges[0] && y > edges[1] && x < edges[2] && y < edges[3];
        let coarse: Vec<bool> = pixels.map(|p| inside(at(p))).collect();
        let prompt = SegmentPrompt {
            points_px: vec![[0.48 * SMALL.0 as f32, 0.3 * SMALL.0 as f32]],
            off_points_px: Vec::new(),
            box_px: edges.map(|v| v * SMALL.0 as f32),
            belief: coarse.iter().map(|&c| if c { 2.0 } else { -2.0 }).collect(),
        };
        let found = weights.load().unwrap().masks(&colour_image(), SMALL, &[prompt]).unwrap();
        let found: Vec<bool> = found[0].logits.iter().map(|&logit| logit > 0.0).collect();
        let overlap = |mask: &[bool]| {
            let count = |f: &dyn Fn(bool, bool) -> bool| mask.iter().zip(&truth).filter(|(a, b)| f(**a, **b)).count();
            count(&|a, b| a && b) as f64 / count(&|a, b| a || b) as f64
        };
        let (before, after) = (overlap(&coarse), overlap(&found));
        assert!(before < 0.7 && after > 0.93, "{before} {after}");
    }
}
