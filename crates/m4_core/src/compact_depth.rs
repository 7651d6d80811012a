//! Depth maps as a capture holds them.

use crate::{DepthMap, Plane};

/// A depth map that takes as little memory as where it came from: two bytes per pixel for one of 16-bit steps, four
/// for floats. Both come back bit by bit.
#[derive(Debug, Clone)]
pub struct CompactDepth(Values);

#[derive(Debug, Clone)]
enum Values {
    Floats(DepthMap),
    Steps { steps: Plane<u16>, unit: f64 },
}

impl CompactDepth {
    /// A map whose depth is `steps` times `unit`, scene units per step; 0 steps = depth unknown.
    #[must_use]
    pub fn from_steps(steps: Plane<u16>, unit: f64) -> Self {
        Self(Values::Steps { steps, unit })
    }

    /// `(width, height)`.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        match &self.0 {
            Values::Floats(map) => map.size(),
            Values::Steps { steps, .. } => steps.size(),
        }
    }

    /// z-depth at column `x` of row `y`.
    #[must_use]
    pub fn at(&self, x: usize, y: usize) -> f32 {
        match &self.0 {
            Values::Floats(map) => map[(x, y)],
            Values::Steps { steps, unit } => depth(steps[(x, y)], *unit),
        }
    }

    /// z-depth of every `stride`-th pixel (at least 1), row by row from the first.
    pub fn every(&self, stride: usize) -> impl Iterator<Item = f32> + '_ {
        let (floats, steps): (&[f32], (&[u16], f64)) = match &self.0 {
            Values::Floats(map) => (map.data(), (&[], 1.0)),
            Values::Steps { steps, unit } => (&[], (steps.data(), *unit)),
        };
        let (steps, unit) = steps;
        let decoded = steps.iter().step_by(stride).map(move |&v| depth(v, unit));
        floats.iter().step_by(stride).copied().chain(decoded)
    }

    /// The map as floats, four bytes per pixel.
    #[must_use]
    pub fn to_map(&self) -> DepthMap {
        match &self.0 {
            Values::Floats(map) => map.clone(),
            Values::Steps { steps, unit } => steps.map(|&v| depth(v, *unit)),
        }
    }

    /// Size in memory, bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        match &self.0 {
            Values::Floats(map) => size_of_val(map.data()),
            Values::Steps { steps, .. } => size_of_val(steps.data()),
        }
    }
}

impl From<DepthMap> for CompactDepth {
    fn from(map: DepthMap) -> Self {
        Self(Values::Floats(map))
    }
}

impl PartialEq for CompactDepth {
    /// By size and depth, however they are held; depth that is not a number is equal to nothing.
    fn eq(&self, other: &Self) -> bool {
        self.size() == other.size() && self.every(1).eq(other.every(1))
    }
}

fn depth(steps: u16, unit: f64) -> f32 {
    (f64::from(steps) * unit) as f32
}

#[cfg(test)]
mod tests {
    use super::CompactDepth;
    use crate::{DepthMap, Plane};

    const UNIT: f64 = 0.001_234_567;

    fn both() -> (CompactDepth, CompactDepth) {
        let steps = Plane::from_fn(7, 5, |x, y| (x * 9001 + y * 301) as u16);
        let floats: DepthMap = steps.map(|&v| (f64::from(v) * UNIT) as f32);
        (CompactDepth::from_steps(steps, UNIT), floats.into())
    }

    #[test]
    fn steps_and_floats_are_the_same_bits_and_half_the_bytes() {
        let (steps, floats) = both();
        assert_eq!(steps, floats);
        assert_eq!(steps.to_map(), floats.to_map());
        assert_eq!((steps.bytes(), floats.bytes()), (70, 140));
        let map = floats.to_map();
        for held in [&steps, &floats] {
            assert_eq!(held.size(), (7, 5));
            assert_eq!(held.at(0, 0), 0.0, "unknown stays unknown");
            for y in 0..5 {
                assert!((0..7).all(|x| held.at(x, y) == map[(x, y)]));
            }
            let thirds: Vec<f32> = held.every(3).collect();
            assert_eq!(thirds, map.data().iter().step_by(3).copied().collect::<Vec<_>>());
        }
    }

    #[test]
    fn unquantisable_depth_is_stored_as_floats() {
        let map = Plane::from_vec(2, 1, vec![f32::NAN, -1.5e-20]).unwrap();
        let held = CompactDepth::from(map);
        assert!(held.at(0, 0).is_nan() && held.to_map()[(1, 0)] == -1.5e-20);
        assert_ne!(held, held.clone(), "not a number is equal to nothing");
        let (steps, _) = both();
        let other = CompactDepth::from_steps(Plane::filled(5, 7, 0), UNIT);
        assert_ne!(steps, other, "sizes count");
        assert_eq!(CompactDepth::from_steps(Plane::filled(0, 0, 0), UNIT).every(1).count(), 0);
    }
}
