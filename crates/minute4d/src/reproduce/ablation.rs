//! Trains a scene again without each part of the method.

use super::scene::SceneResult;
use crate::ablate::{self, AblateOptions, AblationReport, Row};
use crate::{Error, Job};
use serde::Serialize;
use std::path::Path;

/// Pixels by which masks of dynamic regions are grown before they are scored.
const GROW_MASK: usize = 2;

/// What each part of the method is worth on a scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SceneAblation {
    /// The scene.
    pub scene: String,
    /// The rows; PSNR and SSIM are of whole images (clamped, 8 bits), whatever the protocol's headline is.
    pub report: AblationReport,
}

/// Makes the rows in the folder of the scene; finished ones are not made again.
pub(super) fn of(made: &SceneResult, program: &Path, job: &Job<'_>) -> Result<SceneAblation, Error> {
    let options = AblateOptions {
        program: program.to_path_buf(),
        rows: Row::ALL.to_vec(),
        data: Some(made.views.clone()),
        grow_mask: GROW_MASK,
    };
    let report = ablate::ablate(&made.capture, &made.folder.join("ablation"), &options, job)?;
    Ok(SceneAblation {
        scene: made.row.scene.clone(),
        report,
    })
}

/// A part of the page; empty where nothing was asked for.
pub(super) fn markdown(scenes: &[SceneAblation]) -> String {
    if scenes.is_empty() {
        return String::new();
    }
    let mut out = String::from(
        "\n### Without each part\n\nThe same steps for all rows; PSNR and SSIM of whole images in 8 bits. The paper loses 1.17 dB without segmentation and \
         tracking on its clips (table 3).\n",
    );
    for scene in scenes {
        out += &format!("\n#### {}\n\n{}", scene.scene, scene.report.to_markdown());
    }
    out
}
