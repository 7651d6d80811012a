//! A room through a lens that bends straight lines.

use super::{HEIGHT, ROOM, WIDTH, errors, features};
use crate::classical::sparse::SparseConfig;
use crate::classical::sparse::lens::Bend;
use crate::classical::sparse::priors::Recovered;
use crate::classical::sparse::reconstruct::from_tracks;
use m4_core::Silent;

/// Cameras of [`ROOM`] through a lens with that coefficient.
fn through(coefficient: f64, config: &SparseConfig) -> Recovered {
    let bend = Bend {
        coefficient,
        radius_px: 0.5 * (WIDTH as f64).hypot(HEIGHT as f64),
    };
    let (mut tracks, _) = ROOM.tracks();
    for at in tracks.iter_mut().flat_map(|track| &mut track.seen) {
        *at = bend.distorted(*at).expect("the lens shows the whole image");
    }
    let features = features(tracks, ROOM.frames);
    from_tracks(features, None, config, &Silent).expect("a reconstruction")
}

#[test]
fn a_lens_that_bends_is_told_from_a_pinhole() {
    let config = SparseConfig::default();
    assert_eq!(through(0.0, &config).distortion, None);
    for coefficient in [-0.4, -0.15, 0.12] {
        let recovered = through(coefficient, &config);
        let lens = recovered.distortion.expect("the lens bends");
        assert!(
            (lens.coefficient - coefficient).abs() < 0.01,
            "{coefficient}: {lens:?}"
        );
        assert!(
            (lens.focal_px / ROOM.focal - 1.0).abs() < 0.01,
            "{coefficient}: {lens:?}"
        );
        assert!(recovered.sparse.residual_px < 0.3);
        let (error, _) = errors(&recovered.sparse, &ROOM);
        assert!(error < 0.002, "{coefficient}: {error}");
    }
    let pinhole = SparseConfig {
        pinhole: true,
        ..config
    };
    assert_eq!(through(-0.15, &pinhole).distortion, None);
}
