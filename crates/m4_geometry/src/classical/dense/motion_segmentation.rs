//! Separates dynamic from static regions: motion spoils depth and depth shows motion, so one is
//! found from the other in turn.

use super::background_model;
use super::fusion::{self, DepthMap};
use super::layers;
use super::mono::Mono;
use super::motion::{self, FrameDisparity, MotionCues};
use super::refine;
use super::segment;
use super::shot::{Shot, at_parallax, keyframes};
use super::sources::{DenseError, Sources};
use super::static_depth::{self, Measured};
use super::temporal;
use super::working::{each, try_each};
use crate::flow::FlowPair;
use crate::smooth::Smoother;
use m4_core::{Progress, RgbImage, dilated};

/// How often depth and motion are estimated in turn: the second round knows the masks of the first.
const ROUNDS: usize = 2;
/// Time in which evidence of motion counts e times less, seconds: an object in motion is dynamic a
/// little before and after, too.
const MEMORY_S: f64 = 0.4;
/// Colour difference that stops the edge-aware fill of depth, 0..255 (Min et al. 2014, sigma).
const FILL_SIGMA: f32 = 8.0;

/// One per frame, above 0 in dynamic regions.
pub(super) type Masks = Vec<Vec<u8>>;

/// A clip whose depth was swept. Lists are by frame, planes `[height][width]` at the working size.
pub(super) struct Segmentation<'a> {
    pub width: usize,
    pub height: usize,
    /// Whether depth can be measured at all.
    pub parallax: bool,
    /// At their own size.
    pub frames: &'a [&'a RgbImage],
    pub shots: &'a [Shot],
    pub flows: &'a [FlowPair],
    pub mono: &'a Mono,
    pub clues: &'a MotionCues,
    pub sources: &'a Sources<'a>,
    pub progress: &'a dyn Progress,
}

/// Dynamic masks, and depth as if everything were static.
pub(super) struct MotionSegmentation {
    pub dynamic: Masks,
    pub measured: Vec<Measured>,
    /// Disparity of static regions, also behind dynamic ones, which are placed by it.
    pub filled: Vec<Vec<f32>>,
    /// The same of static regions alone, also next to dynamic ones, more precise; none without
    /// parallax.
    pub refined: Vec<Vec<f32>>,
}

/// The mask of a frame, if there are any.
fn of(masks: Option<&[Vec<u8>]>, i: usize) -> Option<&[u8]> {
    masks.map(|masks| masks[i].as_slice())
}

impl Segmentation<'_> {
    /// Segments dynamic regions by the disparities that were `swept`, or takes the masks of the
    /// user.
    pub fn segment_motion(
        &self,
        swept: Vec<Vec<f32>>,
        input_masks: Option<Masks>,
    ) -> Result<MotionSegmentation, DenseError> {
        let given_masks = input_masks.is_some();
        let mut dynamic = match input_masks {
            Some(masks) => masks,
            None => self.dynamic_masks(&swept)?,
        };
        let mut measured = self.measured(&swept, Some(&dynamic))?;
        // a clip's planes are its memory: each goes as soon as nothing needs it
        drop(swept);
        let filled = self.filled(&measured, Some(&dynamic))?;
        let refined = if self.parallax {
            self.refined(&measured, &filled, &dynamic)?
        } else {
            Vec::new()
        };
        if !given_masks {
            if self.parallax {
                dynamic = self.sharpened(&dynamic, &self.grown(&dynamic)?, &refined)?;
            }
            dynamic = self.segmented(dynamic)?;
            for (measured, dynamic) in measured.iter_mut().zip(&dynamic) {
                distrust(measured, dynamic);
            }
        }
        Ok(MotionSegmentation {
            dynamic,
            measured,
            filled,
            refined,
        })
    }

    /// The static depth `filled` by what frames far apart show: refined on brightness, merged over
    /// the frames and filled once more.
    fn refined(
        &self,
        measured: &[Measured],
        filled: &[Vec<f32>],
        dynamic: &[Vec<u8>],
    ) -> Result<Vec<Vec<f32>>, DenseError> {
        let cameras = &self.clues.cameras;
        let all: Vec<usize> = (0..cameras.len()).collect();
        let keys = keyframes(cameras, self.shots, refine::KEYFRAME_PX);
        let at = |frames: &[usize], i: usize, targets: &[f64], least: usize| {
            at_parallax(cameras, frames, i, self.shots[i].median, targets, least)
        };
        // the fill smears edges: it is the start only where nothing was measured
        let start = self.each("refining depth", |i| {
            let pixels = measured[i]
                .disparity
                .iter()
                .zip(&measured[i].confidence)
                .zip(&filled[i]);
            pixels
                .map(|((measured, confidence), filled)| {
                    if *confidence > 0.0 {
                        *measured
                    } else {
                        *filled
                    }
                })
                .collect()
        })?;
        let clip = refine::Estimates {
            shots: self.shots,
            cameras,
            disparity: &start,
            dynamic,
        };
        let refined = self.each("refining depth", |i| {
            if keys.binary_search(&i).is_err() {
                // what it shows is taken from the keyframes around it
                return start[i].iter().map(|d| (*d, 0.0)).collect::<DepthMap>();
            }
            let rounds: Vec<Vec<usize>> = refine::PARALLAX_PX
                .iter()
                .map(|targets| at(&all, i, targets, refine::FRAMES))
                .collect();
            let mut out = Measured {
                disparity: clip.refined(&rounds, i),
                confidence: measured[i].confidence.clone(),
            };
            self.mono.impose(i, &mut out, Some(&dynamic[i]));
            out.disparity
                .into_iter()
                .zip(out.confidence)
                .collect::<DepthMap>()
        })?;
        drop(start);
        self.each("merging depth", |i| {
            let others = at(&keys, i, &fusion::PARALLAX_PX, 0);
            let mut fused = fusion::fuse(self.shots, cameras, &refined, &others, i);
            self.mono.impose(i, &mut fused, Some(&dynamic[i]));
            let fused = self.mono.with_prior(i, &fused, Some(&dynamic[i]));
            static_depth::fill_planes(&self.shots[i], self.smoother(i), &fused, Some(&dynamic[i]))
        })
    }

    /// For every frame in parallel, with progress.
    fn each<T: Send>(
        &self,
        phase: &'static str,
        f: impl Fn(usize) -> T + Sync,
    ) -> Result<Vec<T>, DenseError> {
        each(self.frames.len(), phase, self.progress, f)
    }

    /// Made anew where needed: cheaper than keeping them.
    pub fn smoother(&self, i: usize) -> Smoother {
        Smoother::new(
            self.width,
            self.height,
            &self.shots[i].frame.rgb,
            FILL_SIGMA,
        )
    }

    /// Masks of dynamic regions, with the outlines of the images as far as depth of this precision
    /// shows what is behind them.
    fn dynamic_masks(&self, swept: &[Vec<f32>]) -> Result<Masks, DenseError> {
        let (mut last, mut measured) = self.round(swept, None)?;
        for _ in 1..ROUNDS {
            drop(measured);
            (last, measured) = self.round(swept, Some(&last))?;
        }
        let near = self.grown(&last)?;
        let background = if self.parallax {
            self.each("filling depth", |i| {
                let mut measured = self.mono.with_prior(i, &measured[i], Some(&near[i]));
                distrust(&mut measured, &near[i]);
                self.fill(i, &measured, Some(&near[i]))
            })?
        } else {
            // the place of a background pixel in other frames does not depend on its depth
            self.filled(&[], None)?
        };
        drop(measured);
        self.sharpened(&last, &near, &background)
    }

    /// `dynamic` with the outlines that the segmenter finds, if there is one.
    fn segmented(&self, dynamic: Masks) -> Result<Masks, DenseError> {
        let Some(segmenter) = self.sources.segmenter else {
            return Ok(dynamic);
        };
        try_each(
            self.frames.len(),
            "segmenting dynamic objects",
            self.progress,
            |i| {
                segment::sharpen(
                    segmenter,
                    self.frames[i],
                    (self.width, self.height),
                    &dynamic[i],
                )
                .map_err(|source| DenseError::Segment { frame: i, source })
            },
        )
    }

    /// Masks, given those of the round before, and the disparities that were measured with those.
    fn round(
        &self,
        swept: &[Vec<f32>],
        before: Option<&[Vec<u8>]>,
    ) -> Result<(Masks, Vec<Measured>), DenseError> {
        let (w, h) = (self.width, self.height);
        let measured = self.measured(swept, before)?;
        let filled = self.filled(&measured, before)?;
        let evidence = self.each("finding motion", |i| {
            let frame_disparity = FrameDisparity {
                frame: &self.shots[i].frame,
                disparity: &filled[i],
                confidence: &measured[i].confidence,
            };
            let smoother = self.smoother(i);
            motion::evidence(
                self.clues,
                self.shots,
                self.flows,
                i,
                &frame_disparity,
                &smoother,
            )
        })?;
        drop(filled);
        let memory = self.clues.rate.exact(MEMORY_S).max(1.0) as f32;
        let evidence = temporal::mean(w, &evidence, self.flows, memory, motion::trust);
        Ok((
            self.each("cutting masks", |i| motion::mask(w, h, &evidence[i]))?,
            measured,
        ))
    }

    /// The `swept` disparities that the neighbours confirm; dynamic pixels (above 0) confirm
    /// nothing.
    fn measured(
        &self,
        swept: &[Vec<f32>],
        dynamic: Option<&[Vec<u8>]>,
    ) -> Result<Vec<Measured>, DenseError> {
        self.each("comparing depth", |i| {
            let mut measured = static_depth::measure(self.shots, swept, dynamic, i);
            self.mono.impose(i, &mut measured, of(dynamic, i));
            measured
        })
    }

    /// The same everywhere, carried on into what was not measured or moves.
    fn filled(
        &self,
        measured: &[Measured],
        dynamic: Option<&[Vec<u8>]>,
    ) -> Result<Vec<Vec<f32>>, DenseError> {
        self.each("filling depth", |i| {
            if self.parallax {
                let measured = self.mono.with_prior(i, &measured[i], of(dynamic, i));
                self.fill(i, &measured, of(dynamic, i))
            } else {
                self.mono
                    .without_parallax(i, layers::sphere(&self.clues.cameras[i]))
            }
        })
    }

    fn fill(&self, i: usize, measured: &Measured, dynamic: Option<&[u8]>) -> Vec<f32> {
        static_depth::fill(&self.shots[i], &self.smoother(i), measured, dynamic)
    }

    /// Everything that may be dynamic, given masks that may be a little too narrow.
    fn grown(&self, dynamic: &[Vec<u8>]) -> Result<Masks, DenseError> {
        self.each("growing masks", |i| {
            dilated(
                &dynamic[i],
                self.width,
                self.height,
                background_model::GUARD_PX,
            )
        })
    }

    /// `dynamic` with the outlines of the images, by what the other frames show behind it:
    /// `background` is the static disparity, `near` what may be dynamic.
    fn sharpened(
        &self,
        dynamic: &[Vec<u8>],
        near: &[Vec<u8>],
        background: &[Vec<f32>],
    ) -> Result<Masks, DenseError> {
        let scene = background_model::BackgroundInputs {
            width: self.width,
            height: self.height,
            parallax: self.parallax,
            rate: self.clues.rate,
            cameras: &self.clues.cameras,
            shots: self.shots,
            background,
            near,
        };
        self.each("sharpening masks", |i| {
            background_model::sharpen(&scene, i, &dynamic[i], &self.smoother(i))
        })
    }
}

/// Nothing is measured in `dynamic` (above 0).
fn distrust(measured: &mut Measured, dynamic: &[u8]) {
    for (c, _) in measured
        .confidence
        .iter_mut()
        .zip(dynamic)
        .filter(|(_, dynamic)| **dynamic > 0)
    {
        *c = 0.0;
    }
}
