//! Who measures flow: a search without weights, or a network.

use crate::Error;
use m4_slam::dense::{FlowConfig, FlowSource, InverseSearch};
use serde::{Deserialize, Serialize};

/// Who measures flow between frames.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Frontend {
    /// The best that pays on a processor: see `docs/geometry.md`.
    #[default]
    Auto,
    /// Inverse search with variational refinement; needs nothing.
    Classical,
    /// GMFlow, a pretrained network; needs its weights.
    Gmflow,
}

/// What [`Frontend::Auto`] stands for, by measurement (docs/geometry.md, "Front ends").
pub const AUTO: Frontend = Frontend::Classical;

impl Frontend {
    /// As options and records name it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Classical => "classical",
            Self::Gmflow => "gmflow",
        }
    }
}

/// A front end that can be used: its weights were found.
pub(super) struct Resolved {
    frontend: Frontend,
    #[cfg(feature = "nets")]
    weights: Option<network::Weights>,
}

/// Finds what `asked` needs.
///
/// # Errors
///
/// [`Error::FrontEndWeights`] if weights are missing, [`Error::NoNetworks`] if the build has no networks.
pub(super) fn resolve(asked: Frontend) -> Result<Resolved, Error> {
    match if asked == Frontend::Auto { AUTO } else { asked } {
        #[cfg(feature = "nets")]
        Frontend::Gmflow => Ok(Resolved {
            frontend: Frontend::Gmflow,
            weights: Some(network::Weights::find(Frontend::Gmflow.name())?),
        }),
        #[cfg(not(feature = "nets"))]
        Frontend::Gmflow => Err(Error::NoNetworks {
            frontend: Frontend::Gmflow.name(),
        }),
        Frontend::Auto | Frontend::Classical => Ok(Resolved {
            frontend: Frontend::Classical,
            #[cfg(feature = "nets")]
            weights: None,
        }),
    }
}

impl Resolved {
    /// Its name, never `auto`.
    pub(super) fn name(&self) -> &'static str {
        self.frontend.name()
    }

    /// BLAKE3 of its weights.
    pub(super) fn weights_hash(&self) -> Option<&str> {
        #[cfg(feature = "nets")]
        return self.weights.as_ref().map(|w| w.hash.as_str());
        #[cfg(not(feature = "nets"))]
        None
    }

    /// The source of flow, loaded.
    ///
    /// # Errors
    ///
    /// [`Error::FrontEndLoad`] if the weights cannot be used.
    pub(super) fn load(&self, config: &FlowConfig) -> Result<Box<dyn FlowSource>, Error> {
        #[cfg(feature = "nets")]
        if let Some(weights) = &self.weights {
            return Ok(Box::new(weights.load()?));
        }
        Ok(Box::new(InverseSearch { config: config.clone() }))
    }
}

#[cfg(feature = "nets")]
mod network {
    //! GMFlow as a source of flow.

    use super::Frontend;
    use crate::weights::{self, Store};
    use crate::{Error, hash};
    use m4_nets::GmFlow;
    use m4_scene::{Plane, RgbImage};
    use m4_slam::dense::{Flow, FlowError, FlowPicture, FlowSource};
    use std::path::PathBuf;

    /// Weights that are there.
    pub struct Weights {
        path: PathBuf,
        pub hash: String,
    }

    impl Weights {
        /// Those of `frontend`, from the user's store.
        pub fn find(frontend: &'static str) -> Result<Self, Error> {
            let missing = |source| Error::FrontEndWeights { frontend, source };
            let entry = weights::find(frontend).map_err(missing)?;
            let path = Store::of_user().and_then(|s| s.require(entry)).map_err(missing)?;
            let hash = hash::of_path(&path)?;
            Ok(Self { path, hash })
        }

        pub fn load(&self) -> Result<GmFlowSource, Error> {
            let net = GmFlow::load(&self.path, &m4_nets::cpu()).map_err(|source| Error::FrontEndLoad {
                frontend: Frontend::Gmflow.name(),
                source: Box::new(source),
            })?;
            Ok(GmFlowSource { net })
        }
    }

    /// The network; features are made once a pair, for both directions.
    pub struct GmFlowSource {
        net: GmFlow,
    }

    fn image(picture: &FlowPicture<'_>) -> RgbImage {
        Plane::from_fn(picture.width, picture.height, |x, y| picture.rgb[y * picture.width + x])
    }

    fn ours(flow: m4_nets::Flow) -> Flow {
        Flow {
            width: flow.width,
            height: flow.height,
            u: flow.u,
            v: flow.v,
        }
    }

    impl FlowSource for GmFlowSource {
        fn name(&self) -> &str {
            Frontend::Gmflow.name()
        }

        fn both(&self, a: &FlowPicture<'_>, b: &FlowPicture<'_>) -> Result<(Flow, Flow), FlowError> {
            let failed = |error: m4_nets::FlowError| FlowError::Source {
                source_name: Frontend::Gmflow.name().to_owned(),
                reason: Box::new(error),
            };
            let encode = |p: &FlowPicture<'_>| self.net.encode(&image(p)).map_err(failed);
            let (there, back) = self.net.flow_both(&encode(a)?, &encode(b)?).map_err(failed)?;
            Ok((ours(there), ours(back)))
        }
    }
}
