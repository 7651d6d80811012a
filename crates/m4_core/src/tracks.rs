//! Trajectories of points on dynamic objects through a clip: what a tracker hands to the
//! initialisation.

use crate::ShapeError;

/// Points followed through the frames of a [`Capture`](crate::Capture): frame `i` of the tracks is
/// frame `i` of the capture.
///
/// Places are world units, in the world of the cameras; one that is not known is NaN. A place can
/// be known where the point was not seen (behind something, or out of the image), never the other
/// way round in what [`Tracks::new`] accepts.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "Written")]
pub struct Tracks {
    frames: usize,
    count: usize,
    /// `[frames][count]`.
    #[serde(with = "crate::packed")]
    xyz: Vec<[f32; 3]>,
    /// `[frames][count]`.
    visible: Vec<bool>,
    /// `[count]`.
    rgb: Option<Vec<[u8; 3]>>,
    /// `[frames][count]`, in steps of 1/255.
    confidence: Option<Vec<u8>>,
}

/// As they are written: their lengths are checked when they are read.
#[derive(serde::Deserialize)]
#[serde(rename = "Tracks")]
struct Written {
    frames: usize,
    count: usize,
    #[serde(with = "crate::packed")]
    xyz: Vec<[f32; 3]>,
    visible: Vec<bool>,
    rgb: Option<Vec<[u8; 3]>>,
    confidence: Option<Vec<u8>>,
}

impl TryFrom<Written> for Tracks {
    type Error = ShapeError;

    fn try_from(written: Written) -> Result<Self, ShapeError> {
        let mut tracks = Self::new(written.frames, written.count, written.xyz, written.visible)?;
        if let Some(rgb) = written.rgb {
            tracks = tracks.with_colours(rgb)?;
        }
        match written.confidence {
            Some(steps) => tracks.with_confidence_steps(steps),
            None => Ok(tracks),
        }
    }
}

impl Tracks {
    /// `count` tracks over `frames` frames: places `[frames][count]` and whether the point was seen
    /// there, `[frames][count]`. Places that are not known, in whole or in part, count as not seen.
    /// Fails with [`ShapeError`] when a length is not `frames * count`.
    pub fn new(
        frames: usize,
        count: usize,
        xyz: Vec<[f32; 3]>,
        mut visible: Vec<bool>,
    ) -> Result<Self, ShapeError> {
        let expected = frames.saturating_mul(count);
        ShapeError::check("places of tracks", expected, xyz.len())?;
        ShapeError::check("visibility of tracks", expected, visible.len())?;
        for (visible, p) in visible.iter_mut().zip(&xyz) {
            *visible &= is_known(*p);
        }
        Ok(Self {
            frames,
            count,
            xyz,
            visible,
            rgb: None,
            confidence: None,
        })
    }

    /// The same with a colour per track, sRGB. Fails with [`ShapeError`] when there is not one per
    /// track.
    pub fn with_colours(self, rgb: Vec<[u8; 3]>) -> Result<Self, ShapeError> {
        ShapeError::check("colours of tracks", self.count, rgb.len())?;
        Ok(Self {
            rgb: Some(rgb),
            ..self
        })
    }

    /// The same with the confidence of each position, 0..1, `[frames][count]`, stored in steps of
    /// 1/255; NaN counts as 0. Fails with [`ShapeError`] when there is not one per place.
    pub fn with_confidence(self, confidence: &[f32]) -> Result<Self, ShapeError> {
        // a NaN becomes 0 in the cast
        self.with_confidence_steps(
            confidence
                .iter()
                .map(|c| (255.0 * c).round() as u8)
                .collect(),
        )
    }

    /// The same with the confidence of each position, `[frames][count]`, 0 to 255.
    /// Fails with [`ShapeError`] when there is not one per place.
    pub fn with_confidence_steps(self, steps: Vec<u8>) -> Result<Self, ShapeError> {
        ShapeError::check("confidence of tracks", self.xyz.len(), steps.len())?;
        Ok(Self {
            confidence: Some(steps),
            ..self
        })
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Number of tracks.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Places `[frames][count]`, world units; NaN where unknown.
    pub fn xyz(&self) -> &[[f32; 3]] {
        &self.xyz
    }

    /// `[frames][count]`: whether the point was seen.
    pub fn visible(&self) -> &[bool] {
        &self.visible
    }

    /// One sRGB colour per track, where the tracker gave colours.
    pub fn colours(&self) -> Option<&[[u8; 3]]> {
        self.rgb.as_deref()
    }

    /// Confidence of the position of a track in a frame, 0..1; without confidence from the tracker,
    /// 1 where the point was visible and else 0.
    pub fn confidence(&self, frame: usize, track: usize) -> f32 {
        if frame >= self.frames || track >= self.count {
            return 0.0;
        }
        let i = frame * self.count + track;
        match &self.confidence {
            Some(steps) => f32::from(steps[i]) / 255.0,
            None => f32::from(u8::from(self.visible[i])),
        }
    }

    /// Confidence of each position, `[frames][count]`, 0 to 255, if the tracker gave it.
    pub fn confidence_steps(&self) -> Option<&[u8]> {
        self.confidence.as_deref()
    }

    /// Position of a track in a frame; `None` where it is unknown, or beyond the last frame or
    /// track.
    pub fn place(&self, frame: usize, track: usize) -> Option<[f32; 3]> {
        if frame >= self.frames || track >= self.count {
            return None;
        }
        Some(self.xyz[frame * self.count + track]).filter(|p| is_known(*p))
    }

    /// The same tracks with all lengths times `by`.
    #[must_use]
    pub fn scaled(mut self, by: f32) -> Self {
        for v in self.xyz.as_flattened_mut() {
            *v *= by;
        }
        self
    }

    /// The same tracks over frames in another order: frame `i` of the result is frame `order[i]` of
    /// these. Fails with [`ShapeError`] when `order` names a frame that is missing.
    pub fn in_order(&self, order: &[usize]) -> Result<Self, ShapeError> {
        if let Some(&frame) = order.iter().find(|&&i| i >= self.frames) {
            return Err(ShapeError {
                what: "frames of tracks",
                expected: self.frames,
                found: frame + 1,
            });
        }
        let row = |i: usize| i * self.count..(i + 1) * self.count;
        Ok(Self {
            frames: order.len(),
            count: self.count,
            xyz: order
                .iter()
                .flat_map(|&i| self.xyz[row(i)].iter().copied())
                .collect(),
            visible: order
                .iter()
                .flat_map(|&i| self.visible[row(i)].iter().copied())
                .collect(),
            rgb: self.rgb.clone(),
            confidence: self.confidence.as_ref().map(|c| {
                order
                    .iter()
                    .flat_map(|&i| c[row(i)].iter().copied())
                    .collect()
            }),
        })
    }
}

fn is_known(p: [f32; 3]) -> bool {
    p.iter().all(|v| v.is_finite())
}

#[cfg(test)]
mod tests {
    use super::Tracks;

    const GAP: [f32; 3] = [f32::NAN, 0.0, 0.0];

    fn made() -> Tracks {
        let xyz = vec![[1.0, 2.0, 3.0], GAP, [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]];
        Tracks::new(2, 2, xyz, vec![true, true, false, true]).unwrap()
    }

    #[test]
    fn unknown_positions_are_not_visible() {
        let tracks = made();
        assert_eq!(tracks.visible(), [true, false, false, true]);
        assert_eq!(tracks.place(0, 0), Some([1.0, 2.0, 3.0]));
        assert_eq!(tracks.place(0, 1), None);
        assert_eq!(
            tracks.place(1, 0),
            Some([4.0, 5.0, 6.0]),
            "known though not seen"
        );
        assert_eq!(tracks.place(2, 0), None);
        assert_eq!(tracks.place(0, 2), None);
    }

    #[test]
    fn lengths_are_checked() {
        assert!(Tracks::new(2, 2, vec![[0.0; 3]; 3], vec![true; 4]).is_err());
        assert!(Tracks::new(2, 2, vec![[0.0; 3]; 4], vec![true; 5]).is_err());
        assert!(Tracks::new(usize::MAX, 2, Vec::new(), Vec::new()).is_err());
        assert!(made().with_colours(vec![[0; 3]]).is_err());
    }

    #[test]
    fn confidence_defaults_to_visibility() {
        let tracks = made();
        assert_eq!(
            [tracks.confidence(0, 0), tracks.confidence(1, 0)],
            [1.0, 0.0]
        );
        let told = tracks.with_confidence(&[0.8, f32::NAN, 0.4, 7.0]).unwrap();
        let turned = told.in_order(&[1, 0]).unwrap();
        assert_eq!(
            [turned.confidence(0, 0), turned.confidence(0, 1)],
            [0.4, 1.0]
        );
        assert_eq!(
            [turned.confidence(1, 1), turned.confidence(2, 0)],
            [0.0, 0.0]
        );
        assert!(made().with_confidence(&[1.0; 3]).is_err());
    }

    #[test]
    fn frames_change_places_and_lengths_their_unit() {
        let tracks = made().with_colours(vec![[1; 3], [2; 3]]).unwrap();
        let turned = tracks.in_order(&[1, 0]).unwrap();
        assert_eq!(turned.place(0, 1), Some([7.0, 8.0, 9.0]));
        assert_eq!(turned.place(1, 1), None);
        assert_eq!(turned.colours(), tracks.colours());
        assert!(tracks.in_order(&[0, 2]).is_err());
        assert_eq!(tracks.scaled(2.0).place(1, 0), Some([8.0, 10.0, 12.0]));
    }
}
