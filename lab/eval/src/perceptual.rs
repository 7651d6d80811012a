//! LPIPS as a protocol defines it, with the networks whose weights are installed, and the reason
//! for missing ones.

use super::protocol::LpipsRule;
use crate::error::Error;
use m4_core::Mask;
use m4_eval::image::{ImageReport, PlanarImage};
use minute4d::device::DeviceChoice;
use serde::Serialize;

/// State of one network.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LpipsChoice {
    /// The network whose features are compared.
    pub net: LpipsRule,
    /// The release of the metric, and how colours enter it.
    pub definition: &'static str,
    /// The name of its score in `images.frames[].others`; absent where nothing was scored.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub score: Option<&'static str>,
    /// Why nothing was scored, and what changes that.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub absent: Option<String>,
}

const DEFINITION: &str = "LPIPS 0.1; sRGB values from 0 to 1 enter as 2 x - 1, less the shift of the scaling layer, over its scale";

impl LpipsRule {
    /// Names of its score over the whole image, and inside a mask.
    fn scores(self) -> [&'static str; 2] {
        match self {
            Self::Alex => ["lpips_alex", "lpips_alex_masked"],
            Self::Vgg => ["lpips_vgg", "lpips_vgg_masked"],
        }
    }
}

fn choice(net: LpipsRule, masked: bool, absent: Option<String>) -> LpipsChoice {
    LpipsChoice {
        net,
        definition: DEFINITION,
        score: absent
            .is_none()
            .then_some(net.scores()[usize::from(masked)]),
        absent,
    }
}

/// The networks of a protocol that can be used.
pub(super) struct Perceptual {
    #[cfg(feature = "nets")]
    nets: Vec<(LpipsRule, m4_nets::lpips::Lpips)>,
    pub choices: Vec<LpipsChoice>,
}

#[cfg(feature = "nets")]
mod with_nets {
    use super::{
        DeviceChoice, Error, ImageReport, LpipsRule, Mask, Perceptual, PlanarImage, choice,
    };
    use m4_nets::lpips::{Lpips, LpipsImage, LpipsNet};
    use minute4d::weights::{Store, find};
    use minute4d::{Category, Refusal};

    impl LpipsRule {
        fn net(self) -> LpipsNet {
            match self {
                Self::Alex => LpipsNet::Alex,
                Self::Vgg => LpipsNet::Vgg,
            }
        }

        fn weights(self) -> &'static str {
            match self {
                Self::Alex => "lpips-alex",
                Self::Vgg => "lpips-vgg",
            }
        }
    }

    impl Perceptual {
        /// Loads what is here of `wanted`, for images whose shorter side is `least_px`.
        pub fn load(
            wanted: &[LpipsRule],
            masked: bool,
            least_px: usize,
            device: DeviceChoice,
        ) -> Result<Self, Error> {
            let mut out = Self {
                nets: Vec::new(),
                choices: Vec::new(),
            };
            if wanted.is_empty() {
                return Ok(out);
            }
            let store = Store::of_user();
            let device = device.for_networks()?;
            for &rule in wanted {
                let net = rule.net();
                let absent = if least_px < net.min_side_px() {
                    Some(format!(
                        "{} needs images of {} pixels per side at least, these have {least_px}",
                        net.title(),
                        net.min_side_px()
                    ))
                } else {
                    let entry = find(rule.weights())?;
                    let store = store.as_ref().map_err(ToString::to_string);
                    match store
                        .and_then(|store| store.require(entry).map_err(|absent| absent.to_string()))
                    {
                        Err(absent) => Some(absent),
                        Ok(path) => {
                            let loaded = Lpips::load(net, &path, &device.device).map_err(|e| {
                                let hint = "`minute4d weights verify` says more";
                                Refusal::bad_input(format!(
                                    "the weights of LPIPS cannot be used: {e}; {hint}"
                                ))
                            })?;
                            out.nets.push((rule, loaded));
                            None
                        }
                    }
                };
                out.choices.push(choice(rule, masked, absent));
            }
            Ok(out)
        }

        /// Scores the view that was added to `report` last; inside `mask` as DyCheck does where
        /// there is one.
        pub fn score(
            &self,
            report: &mut ImageReport,
            name: &str,
            image: &PlanarImage,
            reference: &PlanarImage,
            mask: Option<&Mask>,
        ) -> Result<(), Error> {
            let failed = |e: m4_nets::NetError| {
                Refusal::new(
                    Category::NoDevice,
                    format!("LPIPS of the view {name} failed: {e}"),
                )
            };
            if self.nets.is_empty() {
                return Ok(());
            }
            let of = |planar: &PlanarImage| {
                let planes = planar.planes().each_ref().map(Vec::as_slice);
                LpipsImage::from_planes(planar.size().0, planar.size().1, planes).map_err(failed)
            };
            let (image, reference) = (of(image)?, of(reference)?);
            for (rule, net) in &self.nets {
                let title = rule.net().title();
                match mask {
                    None => {
                        let score = net.compare(&image, &reference).map_err(failed)?;
                        report.add_other(rule.scores()[0], title, score.distance);
                    }
                    Some(mask) => {
                        if let Some(score) = net
                            .compare_inside(&image, &reference, mask)
                            .map_err(failed)?
                        {
                            let title = format!(
                                "{title}, both images black outside a mask, the map averaged over it (DyCheck)"
                            );
                            report.add_other(rule.scores()[1], &title, score);
                        }
                    }
                }
            }
            Ok(())
        }
    }
}

#[cfg(not(feature = "nets"))]
impl Perceptual {
    pub fn load(
        wanted: &[LpipsRule],
        masked: bool,
        _: usize,
        _: DeviceChoice,
    ) -> Result<Self, Error> {
        let why = "this program was built without networks (the feature nets)".to_owned();
        let choices = wanted
            .iter()
            .map(|&net| choice(net, masked, Some(why.clone())));
        Ok(Self {
            choices: choices.collect(),
        })
    }

    pub fn score(
        &self,
        _: &mut ImageReport,
        _: &str,
        _: &PlanarImage,
        _: &PlanarImage,
        _: Option<&Mask>,
    ) -> Result<(), Error> {
        Ok(())
    }
}
