//! The segmentation method: none, or a network.

use crate::Error;
#[cfg(not(feature = "nets"))]
use crate::error::NetworkError;
use crate::error::NetworkMethod;
use crate::settings::Segmenter;
use m4_geometry::classical::dense;
use std::path::PathBuf;

/// A segmenter that can be used: its weights were found.
#[derive(Debug)]
pub(crate) struct Resolved {
    weights: Option<(super::UsedNetwork, PathBuf)>,
}

const METHOD: NetworkMethod = NetworkMethod::Segmenter(Segmenter::Mobilesam);

/// Finds the weights of `segmenter`; fails if they are missing or cannot be read, or the build has
/// no networks.
pub(crate) fn resolve(segmenter: Segmenter) -> Result<Resolved, Error> {
    let weights = match segmenter {
        #[cfg(not(feature = "nets"))]
        Segmenter::Sam2 => {
            let method = NetworkMethod::Segmenter(segmenter);
            return Err(NetworkError::NotBuilt { method }.into());
        }
        // SAM 2 follows objects through the clip afterwards
        #[cfg(feature = "nets")]
        Segmenter::Sam2 => None,
        Segmenter::None => None,
        Segmenter::Auto => super::network(&["mobile-sam"], false, METHOD)?,
        Segmenter::Mobilesam => super::network(&["mobile-sam"], true, METHOD)?,
    };
    Ok(Resolved { weights })
}

impl Resolved {
    /// Its name, never `auto`.
    pub(crate) fn name(&self) -> &'static str {
        if self.weights_hash().is_some() {
            Segmenter::Mobilesam.name()
        } else {
            Segmenter::None.name()
        }
    }

    /// BLAKE3 of its weights.
    pub(crate) fn weights_hash(&self) -> Option<&str> {
        let weights = self.weights.as_ref();
        weights.map(|(network, _)| network.blake3.as_str())
    }

    /// The segmenter, loaded; fails if the weights cannot be used.
    pub(crate) fn load(&self) -> Result<Option<Box<dense::Segmenter<'static>>>, Error> {
        #[cfg(feature = "nets")]
        if let Some((_, path)) = &self.weights {
            let net =
                m4_nets::MobileSam::load(path, m4_nets::cpu()).map_err(super::unusable(METHOD))?;
            return Ok(Some(Box::new(move |image, size, prompts| {
                network::masks(&net, image, size, prompts)
            })));
        }
        Ok(None)
    }
}

#[cfg(feature = "nets")]
mod network {
    //! MobileSAM as a segmenter.

    use m4_core::{Plane, RgbImage};
    use m4_geometry::classical::dense::{SegmentMask, SegmentPrompt, SourceError};
    use m4_nets::{MobileSam, PointPrompt, Prompt};

    /// A prompt of an image of `size` as one of `image`.
    fn converted(
        prompt: &SegmentPrompt,
        belief: Plane<f32>,
        image: &RgbImage,
        size: (usize, usize),
    ) -> Prompt {
        let (sx, sy) = (
            image.width() as f32 / size.0 as f32,
            image.height() as f32 / size.1 as f32,
        );
        let point = |&[x, y]: &[f32; 2], on_object: bool| PointPrompt {
            at_px: [x * sx, y * sy],
            on_object,
        };
        let on = prompt.points_px.iter().map(|p| point(p, true));
        let off = prompt.off_points_px.iter().map(|p| point(p, false));
        let [x0, y0, x1, y1] = prompt.box_px;
        Prompt {
            points: on.chain(off).collect(),
            box_px: Some([x0 * sx, y0 * sy, x1 * sx, y1 * sy]),
            mask_logits: Some(belief),
        }
    }

    /// The masks of `prompts`; an image is encoded once for all of them.
    pub fn masks(
        net: &MobileSam,
        image: &RgbImage,
        size: (usize, usize),
        prompts: &[SegmentPrompt],
    ) -> Result<Vec<SegmentMask>, SourceError> {
        let embedding = net.encode(image)?;
        let one = |prompt: &SegmentPrompt| {
            let belief = Plane::from_vec(size.0, size.1, prompt.belief.clone())?;
            let belief = embedding.mask_logits(&belief);
            let masks = net.masks(&embedding, &converted(prompt, belief, image, size))?;
            // The first: box, points and belief leave no doubt which thing is meant.
            let mask = masks.first().ok_or("the network gave no mask")?;
            Ok(SegmentMask {
                logits: mask.logits_at(size).data().to_vec(),
                quality: mask.iou,
            })
        };
        prompts.iter().map(one).collect()
    }
}

#[cfg(all(test, feature = "nets"))]
mod tests {
    use super::resolve;
    use crate::settings::Segmenter;
    use m4_core::{Plane, RgbImage};
    use m4_geometry::classical::dense::SegmentPrompt;

    const FULL: (usize, usize) = (480, 270);
    const SMALL: (usize, usize) = (240, 135);

    /// A disc on waves; in shares of the width.
    fn on_disc(x: f32, y: f32) -> bool {
        (x - 0.45).hypot(y - 0.3) < 0.13
    }

    fn colour_image() -> RgbImage {
        Plane::from_fn(FULL.0, FULL.1, |x, y| {
            let (x, y) = (
                (x as f32 + 0.5) / FULL.0 as f32,
                (y as f32 + 0.5) / FULL.0 as f32,
            );
            if on_disc(x, y) {
                return [220, 60, 40];
            }
            [60.0, 33.0, 14.0].map(|f: f32| (127.0 + 50.0 * (x * f).sin() * (y * f).cos()) as u8)
        })
    }

    #[test]
    fn a_coarse_disc_becomes_the_disc() {
        let Some(segmenter) = resolve(Segmenter::Auto).unwrap().load().unwrap() else {
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
        let inside =
            |(x, y): (f32, f32)| x > edges[0] && y > edges[1] && x < edges[2] && y < edges[3];
        let coarse: Vec<bool> = pixels.map(|p| inside(at(p))).collect();
        let prompt = SegmentPrompt {
            points_px: vec![[0.48 * SMALL.0 as f32, 0.3 * SMALL.0 as f32]],
            off_points_px: Vec::new(),
            box_px: edges.map(|v| v * SMALL.0 as f32),
            belief: coarse.iter().map(|&c| if c { 2.0 } else { -2.0 }).collect(),
        };
        let objects = segmenter(&colour_image(), SMALL, &[prompt]).unwrap();
        let fine: Vec<bool> = objects[0].logits.iter().map(|&logit| logit > 0.0).collect();
        let overlap = |mask: &[bool]| {
            let count = |f: &dyn Fn(bool, bool) -> bool| {
                mask.iter().zip(&truth).filter(|(a, b)| f(**a, **b)).count()
            };
            count(&|a, b| a && b) as f64 / count(&|a, b| a || b) as f64
        };
        let (before, after) = (overlap(&coarse), overlap(&fine));
        assert!(before < 0.7 && after > 0.93, "{before} {after}");
    }
}
