//! The space that the network works in: the points of a window about their mean, in units of their spread.

use super::config::NormMode;

/// Mean and sum of squared distances from it, an axis each, of some points.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Moments {
    n: f64,
    mean: [f64; 3],
    squares: [f64; 3],
}

impl Moments {
    /// Of points from their sums and sums of squares about `about`.
    pub fn of_sums(n: usize, about: [f64; 3], sums: [f64; 3], squares: [f64; 3]) -> Self {
        let n = n as f64;
        if n == 0.0 {
            return Self::default();
        }
        Self {
            n,
            mean: [0, 1, 2].map(|i| about[i] + sums[i] / n),
            squares: [0, 1, 2].map(|i| (squares[i] - sums[i] * sums[i] / n).max(0.0)),
        }
    }

    /// Of these points and those of `other`.
    pub fn with(self, other: &Self) -> Self {
        let n = self.n + other.n;
        if n == 0.0 {
            return self;
        }
        let apart = [0, 1, 2].map(|i| other.mean[i] - self.mean[i]);
        Self {
            n,
            mean: [0, 1, 2].map(|i| self.mean[i] + apart[i] * other.n / n),
            squares: [0, 1, 2].map(|i| self.squares[i] + other.squares[i] + apart[i] * apart[i] * self.n * other.n / n),
        }
    }

    /// The space of these points; `None` if there are none, or all at one place.
    pub fn space(&self, mode: NormMode, scale: f32) -> Option<Space> {
        let Self { n, mean, squares } = *self;
        let spread = match mode {
            NormMode::None => {
                return Some(Space { mean: [0.0; 3], std: [1.0; 3], scale: 1.0 });
            }
            NormMode::Anisotropic => squares.map(|square| (square / n).sqrt()),
            NormMode::Isotropic => [(squares.iter().sum::<f64>() / (3.0 * n)).sqrt(); 3],
        };
        let space = Space { mean: mean.map(|x| x as f32), std: spread.map(|x| x as f32), scale };
        let usable = n > 0.0 && space.mean.iter().all(|x| x.is_finite());
        (usable && space.std.iter().all(|x| x.is_finite() && *x > 0.0)).then_some(space)
    }
}

/// A space: what is taken off, by what is divided, by what is multiplied.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Space {
    pub mean: [f32; 3],
    pub std: [f32; 3],
    scale: f32,
}

impl Space {
    /// A point of the world.
    pub fn enter(&self, p: [f32; 3]) -> [f32; 3] {
        [0, 1, 2].map(|i| (p[i] - self.mean[i]) / self.std[i] * self.scale)
    }

    /// A point of this space in the world.
    pub fn leave(&self, p: [f32; 3]) -> [f32; 3] {
        [0, 1, 2].map(|i| p[i] / self.scale * self.std[i] + self.mean[i])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_have_the_moments_of_the_whole() {
        let points: Vec<[f64; 3]> =
            (0..97).map(|i| [(i * i % 31) as f64 + 1e4, (i % 7) as f64 * 0.1, -(i as f64)]).collect();
        let of = |points: &[[f64; 3]]| {
            let about = points[0];
            let sums = [0, 1, 2].map(|a| points.iter().map(|p| p[a] - about[a]).sum());
            let squares = [0, 1, 2].map(|a| points.iter().map(|p| (p[a] - about[a]).powi(2)).sum());
            Moments::of_sums(points.len(), about, sums, squares)
        };
        let parts = of(&points[..40]).with(&of(&points[40..])).with(&Moments::default());
        let mean = [0, 1, 2].map(|a| points.iter().map(|p| p[a]).sum::<f64>() / 97.0);
        let variance = |a: usize| points.iter().map(|p| (p[a] - mean[a]).powi(2)).sum::<f64>() / 97.0;
        let space = parts.space(NormMode::Isotropic, 2.0).unwrap();
        let std = ((variance(0) + variance(1) + variance(2)) / 3.0).sqrt();
        let apart = parts.space(NormMode::Anisotropic, 2.0).unwrap();
        for a in 0..3 {
            assert!((f64::from(space.mean[a]) / mean[a] - 1.0).abs() < 1e-6);
            assert!((f64::from(space.std[a]) / std - 1.0).abs() < 1e-6);
            assert!((f64::from(apart.std[a]) / variance(a).sqrt() - 1.0).abs() < 1e-6);
        }
        let p = [1e4_f32, 3.0, -8.0];
        let back = space.leave(space.enter(p));
        assert!((0..3).all(|a| (back[a] - p[a]).abs() < 2e-3), "{back:?}");
        assert_eq!(Moments::default().space(NormMode::Isotropic, 1.0), None);
        assert_eq!(of(&points[..1]).space(NormMode::Isotropic, 1.0), None);
    }
}
