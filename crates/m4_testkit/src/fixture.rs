//! Loads `fixtures/`: numbers computed by the programs in `oracles/`, never by this program.

use serde::Deserialize;
use std::{fs, path::PathBuf};

/// A camera as the gradient oracle writes it.
#[derive(Debug, Clone, Deserialize)]
pub struct FixtureCamera {
    /// World to camera, row by row.
    #[serde(rename = "R")]
    pub rotation: [[f64; 3]; 3],
    /// World to camera.
    #[serde(rename = "T")]
    pub translation: [f64; 3],
    /// `fx, fy, cx, cy`; the half pixel is already taken off the principal point.
    pub f: [f64; 4],
    /// Tangents of half the field of view.
    pub tan: [f64; 2],
}

/// A splat, or a gradient with respect to one. Which of the optional fields are there depends on
/// the model: `ql` and `qr` (rotor), `q` and `v` (velocity), none (isotropic).
#[derive(Debug, Clone, Deserialize)]
pub struct FixtureSplat {
    /// Mean.
    pub mu: [f64; 3],
    /// Mean in time.
    pub mt: [f64; 1],
    /// Log scales: three, or one for the isotropic model.
    pub ls: Vec<f64>,
    /// Log scale in time.
    pub lst: [f64; 1],
    /// Logit of the opacity.
    pub o: [f64; 1],
    /// Colour coefficients, temporal index major.
    pub sh: Vec<[f64; 3]>,
    /// Left rotor.
    pub ql: Option<[f64; 4]>,
    /// Right rotor.
    pub qr: Option<[f64; 4]>,
    /// Quaternion.
    pub q: Option<[f64; 4]>,
    /// Velocity.
    pub v: Option<[f64; 3]>,
}

/// One scene with its loss and every gradient of it.
#[derive(Debug, Clone, Deserialize)]
pub struct GradientCase {
    /// `rotor`, `velocity` or `isotropic`.
    pub model: String,
    /// Mip filter.
    pub mip: bool,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The instant that is rendered.
    pub time: f64,
    /// Of the first temporal harmonic.
    pub period: f64,
    /// Colour behind everything.
    pub background: [f64; 3],
    /// The image to compare with, `[height][width]`.
    pub gt: Vec<Vec<[f64; 3]>>,
    /// The depth to compare with, `[height][width]`.
    pub gt_depth: Vec<Vec<f64>>,
    /// Lens and pose.
    pub camera: FixtureCamera,
    /// `[M | b]` row by row.
    pub exposure: [[f64; 4]; 3],
    /// The scene.
    pub splats: Vec<FixtureSplat>,
    /// 0.8 L1 + 0.2 (1 - SSIM) + depth term.
    pub loss: f64,
    /// One per splat.
    pub grad_splats: Vec<FixtureSplat>,
    /// Left twist, translation part.
    pub grad_translation: [f64; 3],
    /// Left twist, rotation part.
    pub grad_rotation: [f64; 3],
    /// `fx, fy, cx, cy`.
    pub grad_intrinsics: [f64; 4],
    /// As `exposure`.
    pub grad_exposure: [[f64; 4]; 3],
    /// With respect to the background.
    pub grad_background: [f64; 3],
    /// With respect to the projected centres, pixels.
    pub grad_means2d: Vec<[f64; 2]>,
}

impl GradientCase {
    /// For messages.
    pub fn name(&self) -> String {
        format!(
            "{}{}",
            self.model,
            if self.mip { " with Mip filter" } else { "" }
        )
    }
}

/// `fixtures/gradients/4dgs_gradients.json`.
#[derive(Debug, Clone, Deserialize)]
pub struct GradientFixtures {
    /// Added to the image covariance.
    pub low_pass: f64,
    /// Of the Jacobian, times the tangent of half the field of view.
    pub jacobian_clamp: f64,
    /// Largest alpha.
    pub alpha_max: f64,
    /// Smallest alpha.
    pub alpha_min: f64,
    /// Smallest transmittance.
    pub t_min: f64,
    /// Share of SSIM in the loss.
    pub lambda_ssim: f64,
    /// Factor of the mean square of `sum of w (z - z_gt)`.
    pub depth_weight: f64,
    /// The scenes.
    pub cases: Vec<GradientCase>,
}

/// Loads the gradient fixtures.
pub fn gradient_fixtures() -> GradientFixtures {
    let path = PathBuf::from(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../fixtures/gradients/4dgs_gradients.json"
    ));
    let text =
        fs::read_to_string(&path).unwrap_or_else(|e| panic!("cannot read {}: {e}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{} is broken: {e}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::gradient_fixtures;

    #[test]
    fn gradient_fixtures_match_the_readme() {
        let fixtures = gradient_fixtures();
        assert_eq!(fixtures.cases.len(), 6);
        for case in &fixtures.cases {
            assert_eq!(
                (
                    case.splats.len(),
                    case.grad_splats.len(),
                    case.grad_means2d.len()
                ),
                (9, 9, 9)
            );
            assert_eq!((case.gt.len(), case.gt[0].len()), (18, 22));
            assert!(case.splats.iter().all(|s| s.sh.len() == 48));
        }
    }
}
