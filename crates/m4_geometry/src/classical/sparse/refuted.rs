//! Given poses against those that the clip itself suggests.

use super::limits::Limits;
use super::priors::Lenses;
use super::reconstruct::Clip;
use super::{SparseConfig, SparseError};
use crate::classical::reconstruction::CameraMotion;
use m4_core::{Camera, Sim3, log_so3, nalgebra::Vector3};

/// How many times as many tracks must agree with other poses.
const TIMES: usize = 2;
/// Poses as near as this to the given ones, as a share of the way and in radians, are the same.
const SAME_WAY: f64 = 0.05;
const SAME_RAD: f64 = 0.035;

impl Clip<'_> {
    /// Fails where poses found from the clip alone, with the given focal length (working pixels), explain far more tracks than
    /// the `points` that the given ones do, and are others.
    pub(super) fn refute(
        &self,
        cameras: &[Camera],
        focal: f64,
        points: usize,
        judged: usize,
    ) -> Result<(), SparseError> {
        let config = SparseConfig {
            fov_deg: None,
            focal_px: Some(focal / self.size.scale),
            intrinsics: None,
            static_camera: false,
            ..self.config.clone()
        };
        let mut free = Clip {
            // They were moved already to where a lens of that focal length has them.
            tracks: self.tracks.clone(),
            masked: Vec::new(),
            lenses: Lenses::Centred,
            frames: self.frames,
            size: self.size,
            width: self.width,
            height: self.height,
            limits: Limits::default(),
            config: &config,
            progress: self.progress,
            warnings: Vec::new(),
            quiet: true,
        };
        let found = match free.solve() {
            Ok(found) if found.sparse.camera_motion == CameraMotion::Parallax => found.sparse,
            Err(SparseError::Cancelled) => return Err(SparseError::Cancelled),
            // The clip suggests nothing.
            _ => return Ok(()),
        };
        let better = found.tracks.iter().filter(|t| t.point.is_some()).count();
        let (way, turn_rad) = apart(&found.cameras, cameras);
        if better >= TIMES * points && (way > SAME_WAY || turn_rad > SAME_RAD) {
            return Err(SparseError::PosesRefuted {
                points,
                tracks: judged,
                better,
                turn_deg: turn_rad.to_degrees(),
            });
        }
        Ok(())
    }
}

/// How far `a` is from `b` once its world is laid over that of `b`: root mean square distance over the length of the way, and
/// the greatest turn between two cameras of a frame, radians.
fn apart(a: &[Camera], b: &[Camera]) -> (f64, f64) {
    let centres = |cameras: &[Camera]| cameras.iter().map(Camera::centre).collect::<Vec<Vector3<f64>>>();
    let (from, to) = (centres(a), centres(b));
    // Turns are compared with those since the first frame: a straight way leaves the turn about it open.
    let turn = |(x, y): (&Camera, &Camera)| {
        let since = |c: &Camera, first: &Camera| first.c2w.rotation.tr_mul(&c.c2w.rotation);
        log_so3(&since(x, &a[0]).tr_mul(&since(y, &b[0]))).norm()
    };
    let turn_rad = a.iter().zip(b).map(turn).fold(0.0, f64::max);
    let way: f64 = to.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
    let Some(fit) = Sim3::umeyama(&from, &to).filter(|_| way > 0.0) else {
        return (f64::INFINITY, turn_rad);
    };
    let squared: f64 = from
        .iter()
        .zip(&to)
        .map(|(p, q)| (fit.transform(p) - q).norm_squared())
        .sum();
    ((squared / to.len() as f64).sqrt() / way, turn_rad)
}
