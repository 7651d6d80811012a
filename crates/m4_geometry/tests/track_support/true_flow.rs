//! The flow of boxes, as it is.

use m4_core::{Flow, RgbImage};
use m4_geometry::classical::dense::{FlowError, FlowImage, FlowSource};
use m4_testkit::BoxScene;

/// True flow: images are known by their pixels.
pub struct TrueFlow<'a> {
    pub scene: &'a BoxScene,
    pub images: Vec<RgbImage>,
}

impl<'a> TrueFlow<'a> {
    pub fn new(scene: &'a BoxScene) -> Self {
        let images = (0..scene.frames()).map(|t| scene.rgb(t)).collect();
        Self { scene, images }
    }
}

impl FlowSource for TrueFlow<'_> {
    fn name(&self) -> &str {
        "true"
    }

    fn both(&self, a: &FlowImage<'_>, b: &FlowImage<'_>) -> Result<(Flow, Flow), FlowError> {
        let index = |p: &FlowImage<'_>| {
            let at = self.images.iter().position(|q| q.data() == p.rgb);
            at.ok_or_else(|| FlowError::Source {
                source_name: "true".to_owned(),
                reason: "an unknown image".into(),
            })
        };
        let (from, to) = (index(a)?, index(b)?);
        let flow = |from, to| {
            let (u, v) = self.scene.flow(from, to);
            Flow {
                width: a.width,
                height: a.height,
                u,
                v,
            }
        };
        Ok((flow(from, to), flow(to, from)))
    }
}
