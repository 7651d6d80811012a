//! Captures in which one kind of estimate is replaced by the truth: which of them costs how much is
//! seen by warping or training each.

use super::depth::{covering, depth_error, usable};
use super::matching::pair;
use super::report::{GeometryError, median_of_sorted, training};
use super::trajectory::placement;
use m4_core::{Camera, Capture, CaptureFrame, CompactDepth, CompactMask, DepthMap, Plane};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Fewest pixels of an object in a frame whose median depth is replaced.
const LEAST_PIXELS: usize = 40;

/// What is true; everything else is as estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Substitution {
    /// Nothing.
    None,
    /// Masks of dynamic pixels.
    Masks,
    /// The median depth of each object in each frame; its relief is as estimated.
    Distance,
    /// The relief of each object; its median depth in each frame is as estimated.
    Relief,
    /// Depth of dynamic pixels of either mask.
    DynamicDepth,
    /// Depth of static pixels.
    StaticDepth,
    /// Poses and lens.
    Cameras,
    /// Masks, and depth of dynamic pixels of either mask: what is left is static geometry.
    Dynamic,
    /// Masks and all depth, with the estimated cameras.
    MasksAndDepth,
    /// Everything but the depth of static pixels.
    AllButStaticDepth,
    /// Everything.
    All,
}

impl Substitution {
    /// All of them in the order of reports, with names for tables and folders.
    pub const ALL: [(Self, &str); 11] = [
        (Self::None, "as estimated"),
        (Self::Masks, "true masks"),
        (Self::Distance, "true distance"),
        (Self::Relief, "true relief"),
        (Self::DynamicDepth, "true dynamic depth"),
        (Self::StaticDepth, "true static depth"),
        (Self::Cameras, "true cameras"),
        (Self::Dynamic, "true dynamic content"),
        (Self::MasksAndDepth, "true masks and depth"),
        (Self::AllButStaticDepth, "all but static depth"),
        (Self::All, "everything true"),
    ];
}

/// The training frames of an estimate in the world and unit of the truth, beside it.
pub struct Substitutes<'a> {
    pairs: Vec<(CaptureFrame, &'a CaptureFrame)>,
    /// Units of the truth per unit of the estimate, by depth of static pixels over that by cameras:
    /// for estimated depth with true cameras.
    depth_over_cameras: f64,
    time_frames: usize,
    duration_s: Option<f64>,
}

impl<'a> Substitutes<'a> {
    /// Places the estimate in the world of the truth by the similarity of their cameras.
    ///
    /// # Errors
    ///
    /// [`GeometryError`] if frames cannot be paired, depth or masks are missing, or the cameras do
    /// not determine the similarity.
    pub fn new(estimate: &Capture, truth: &'a Capture) -> Result<Self, GeometryError> {
        let (own, reference) = (training(estimate), training(truth));
        let (_, index) = pair(&own, &reference)?;
        let pairs: Vec<(&CaptureFrame, &CaptureFrame)> = index
            .iter()
            .map(|&(e, t)| (own.frames[e], reference.frames[t]))
            .collect();
        let complete = |f: &CaptureFrame| f.depth.is_some() && f.mask.is_some();
        if let Some((e, t)) = pairs.iter().find(|(e, t)| !complete(e) || !complete(t)) {
            return Err(GeometryError(format!(
                "frame {:?} of the estimate or {:?} of the ground truth has no depth or no mask; both sides need both to be substituted",
                e.name, t.name
            )));
        }
        let (cameras, true_cameras): (Vec<Camera>, Vec<Camera>) =
            pairs.iter().map(|(e, t)| (e.camera, t.camera)).unzip();
        let map = placement(&cameras, &true_cameras);
        let (Some(map), Some(depth)) = (map, depth_error(&pairs)) else {
            return Err(GeometryError(
                "the cameras of one side do not move, so the estimate cannot be placed in the true world".to_owned(),
            ));
        };
        let place = |frame: &CaptureFrame| CaptureFrame {
            camera: Camera {
                c2w: map.transform_pose(&frame.camera.c2w),
                ..frame.camera
            },
            depth: frame
                .depth
                .as_ref()
                .map(|d| d.to_map().map(|z| z * map.scale as f32).into()),
            ..frame.clone()
        };
        Ok(Self {
            pairs: pairs.iter().map(|(e, t)| (place(e), *t)).collect(),
            depth_over_cameras: depth.scale / map.scale,
            time_frames: estimate.time_frames,
            duration_s: estimate.duration_s,
        })
    }

    /// The capture with `what` replaced, in the world and unit of the truth.
    #[must_use]
    pub fn capture(&self, what: Substitution) -> Capture {
        let frames = self
            .pairs
            .iter()
            .map(|(own, truth)| self.frame(own, truth, what))
            .collect();
        Capture {
            frames,
            time_frames: self.time_frames,
            duration_s: self.duration_s,
            metric: true,
            tracks: None,
        }
    }

    fn frame(&self, own: &CaptureFrame, truth: &CaptureFrame, what: Substitution) -> CaptureFrame {
        use Substitution as S;
        let mut out = own.clone();
        let Some(both) = Both::new(own, truth) else {
            return out;
        };
        let depth = match what {
            S::None | S::Masks => None,
            S::Cameras => Some(both.own.map(|z| z * self.depth_over_cameras as f32)),
            S::Distance => Some(both.by_object(truth, |own, _, error| own * (-error).exp() as f32)),
            S::Relief => Some(both.by_object(truth, |_, truth, error| truth * error.exp() as f32)),
            S::DynamicDepth | S::Dynamic => {
                Some(both.choose(|own_mask, true_mask| own_mask || true_mask))
            }
            S::AllButStaticDepth => {
                let static_depth = both.own.map(|z| z * self.depth_over_cameras as f32);
                Some(
                    Both {
                        own: static_depth,
                        ..both
                    }
                    .choose(|own_mask, true_mask| own_mask || true_mask),
                )
            }
            S::StaticDepth => Some(both.choose(|own_mask, _| !own_mask)),
            S::MasksAndDepth | S::All => Some(both.choose(|_, _| true)),
        };
        if let Some(depth) = depth {
            out.depth = Some(depth.into());
        }
        if matches!(
            what,
            S::Masks | S::Dynamic | S::MasksAndDepth | S::AllButStaticDepth | S::All
        ) {
            (out.mask, out.instances) = (truth.mask.clone(), truth.instances.clone());
        }
        if matches!(what, S::Cameras | S::AllButStaticDepth | S::All) {
            out.camera = Camera {
                c2w: truth.camera.c2w,
                intrinsics: truth
                    .camera
                    .resized(own.rgb.width(), own.rgb.height())
                    .intrinsics,
            };
        }
        out
    }
}

/// The maps of a frame, all of the size of the estimated depth.
struct Both {
    own: DepthMap,
    truth: DepthMap,
    own_mask: CompactMask,
    true_mask: CompactMask,
}

impl Both {
    fn new(own: &CaptureFrame, truth: &CaptureFrame) -> Option<Self> {
        let (own_depth, true_depth): (_, &CompactDepth) =
            (own.depth.as_ref()?.to_map(), truth.depth.as_ref()?);
        let (w, h) = own_depth.size();
        let of = |x, y, to| covering((x, y), (w, h), to);
        let mask = |m: &CompactMask| {
            CompactMask::from_fn(w, h, |x, y| {
                of(x, y, m.size()).is_some_and(|(x, y)| m.at(x, y))
            })
        };
        Some(Self {
            truth: Plane::from_fn(w, h, |x, y| {
                of(x, y, true_depth.size()).map_or(0.0, |(x, y)| true_depth.at(x, y))
            }),
            own_mask: mask(own.mask.as_ref()?),
            true_mask: mask(truth.mask.as_ref()?),
            own: own_depth,
        })
    }

    /// The true depth, where there is one, of the pixels that `f(own mask, true mask)` chooses.
    fn choose(&self, f: impl Fn(bool, bool) -> bool) -> DepthMap {
        let (w, h) = self.own.size();
        Plane::from_fn(w, h, |x, y| {
            let chosen =
                f(self.own_mask.at(x, y), self.true_mask.at(x, y)) && usable(self.truth[(x, y)]);
            if chosen {
                self.truth[(x, y)]
            } else {
                self.own[(x, y)]
            }
        })
    }

    /// `f(own, true, median of ln(own / true))` of the pixels of each object that both masks hold:
    /// objects are the instances of the truth, or all dynamic pixels as one.
    fn by_object(&self, truth: &CaptureFrame, f: impl Fn(f32, f32, f64) -> f32) -> DepthMap {
        let mut out = self.own.clone();
        let (w, h) = self.own.size();
        let id = |x, y| {
            let ids = truth.instances.as_ref()?;
            covering((x, y), (w, h), ids.size()).map(|(x, y)| ids.at(x, y))
        };
        let mut objects: BTreeMap<u16, Vec<(usize, usize)>> = BTreeMap::new();
        for (x, y) in self
            .own_mask
            .set_pixels()
            .filter(|&(x, y)| self.true_mask.at(x, y))
        {
            if usable(self.own[(x, y)]) && usable(self.truth[(x, y)]) {
                objects
                    .entry(id(x, y).unwrap_or(0))
                    .or_default()
                    .push((x, y));
            }
        }

        for pixels in objects
            .into_values()
            .filter(|pixels| pixels.len() >= LEAST_PIXELS)
        {
            let mut errors: Vec<f64> = pixels
                .iter()
                .map(|&p| (f64::from(self.own[p]) / f64::from(self.truth[p])).ln())
                .collect();
            errors.sort_by(f64::total_cmp);
            let error = median_of_sorted(&errors);
            for p in pixels {
                out[p] = f(self.own[p], self.truth[p], error);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::super::report::tests::capture;
    use super::{Substitutes, Substitution};
    use m4_core::nalgebra::Vector3;
    use m4_core::{Camera, Capture, CompactMask, Plane, Sim3};

    /// The truth in another world and unit; dynamic depth 10 % too far with a relief of 2 %, static
    /// depth 1 % too far, masks one column short.
    fn estimate(truth: &Capture) -> Capture {
        let map = Sim3 {
            scale: 0.5,
            translation: Vector3::new(3.0, 1.0, -2.0),
            ..Sim3::identity()
        };
        let mut own = truth.clone();
        for frame in &mut own.frames {
            frame.camera = Camera {
                c2w: map.transform_pose(&frame.camera.c2w),
                ..frame.camera
            };
            let wrong = |x: usize, y: usize| match (x < 8, y % 2) {
                (true, 0) => 4.0 * 1.12,
                (true, _) => 4.0 * 1.08,
                _ => 2.0 * 1.01,
            };
            frame.depth = Some(Plane::from_fn(16, 12, |x, y| 0.5 * wrong(x, y)).into());
            frame.mask = Some(CompactMask::from_fn(16, 12, |x, _| x < 7));
        }
        own
    }

    #[test]
    fn each_substitution_replaces_what_it_names() {
        let truth = capture(5);
        let own = estimate(&truth);
        let all = Substitutes::new(&own, &truth).unwrap();
        let of = |what| all.capture(what).frames.swap_remove(2);
        let depth = |what, at: (usize, usize)| of(what).depth.unwrap().at(at.0, at.1);
        let close = |actual: f32, expected: f32| {
            assert!(
                (actual - expected).abs() < 2e-3,
                "{actual} instead of {expected}"
            )
        };
        // as estimated, in the true unit; rows 0 and 1 of a dynamic column, the missed column, a
        // static one
        for (at, z) in [
            ((2, 0), 4.48),
            ((2, 1), 4.32),
            ((7, 0), 4.48),
            ((12, 0), 2.02),
        ] {
            close(depth(Substitution::None, at), z);
        }
        let middle = (4.0f32 * 1.12 * 4.0 * 1.08).sqrt() / 4.0;
        close(depth(Substitution::Distance, (2, 0)), 4.48 / middle);
        close(depth(Substitution::Relief, (2, 0)), 4.0 * middle);
        close(depth(Substitution::Relief, (2, 1)), 4.0 * middle);
        for at in [(2, 0), (7, 0)] {
            close(depth(Substitution::DynamicDepth, at), 4.0);
        }
        close(depth(Substitution::StaticDepth, (12, 0)), 2.0);
        close(depth(Substitution::StaticDepth, (2, 0)), 4.48);
        close(depth(Substitution::Cameras, (12, 0)), 2.0);
        let set = |what| of(what).mask.unwrap().count();
        assert_eq!(
            (
                set(Substitution::None),
                set(Substitution::Masks),
                set(Substitution::All)
            ),
            (7 * 12, 8 * 12, 8 * 12)
        );
        let only_static = |what| (depth(what, (2, 0)), depth(what, (7, 1)), set(what));
        assert_eq!(only_static(Substitution::Dynamic), (4.0, 4.0, 8 * 12));
        assert_eq!(
            only_static(Substitution::AllButStaticDepth),
            (4.0, 4.0, 8 * 12)
        );
        close(depth(Substitution::Dynamic, (12, 0)), 2.02);
        close(depth(Substitution::AllButStaticDepth, (12, 0)), 2.0);
        let pose = |what| of(what).camera.centre() - truth.frames[2].camera.centre();
        assert!(
            pose(Substitution::None).norm() < 1e-9 && pose(Substitution::Cameras).norm() < 1e-12
        );
        close(depth(Substitution::All, (7, 1)), 4.0);
    }

    #[test]
    fn a_side_without_depth_is_refused_by_name() {
        let truth = capture(3);
        let mut own = capture(3);
        own.frames[1].depth = None;
        let error = Substitutes::new(&own, &truth).err().unwrap().to_string();
        assert!(
            error.contains("00001") && error.contains("no depth"),
            "{error}"
        );
    }
}
