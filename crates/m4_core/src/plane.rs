//! A dense two-dimensional array, row by row, and the error of lengths that do not agree.

/// `height` rows of `width` values.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "Written<T>")]
pub struct Plane<T> {
    width: usize,
    height: usize,
    data: Vec<T>,
}

/// The pixel of a plane of size `to` that covers the centre of pixel `(x, y)` of one of size
/// `from`.
pub fn covering(
    (x, y): (usize, usize),
    from: (usize, usize),
    to: (usize, usize),
) -> (usize, usize) {
    (
        (2 * x + 1) * to.0 / (2 * from.0),
        (2 * y + 1) * to.1 / (2 * from.1),
    )
}

/// As it is written: its length is checked when it is read.
#[derive(serde::Deserialize)]
#[serde(rename = "Plane")]
struct Written<T> {
    width: usize,
    height: usize,
    data: Vec<T>,
}

impl<T> TryFrom<Written<T>> for Plane<T> {
    type Error = ShapeError;

    fn try_from(written: Written<T>) -> Result<Self, ShapeError> {
        ShapeError::check(
            "plane",
            written.width.saturating_mul(written.height),
            written.data.len(),
        )?;
        Self::from_vec(written.width, written.height, written.data)
    }
}

impl<T> Plane<T> {
    /// Takes `data`, `[height][width]`. Fails with [`ShapeError`] if `data` does not hold
    /// `width * height` values.
    pub fn from_vec(width: usize, height: usize, data: Vec<T>) -> Result<Self, ShapeError> {
        ShapeError::check("plane", width * height, data.len())?;
        Ok(Self {
            width,
            height,
            data,
        })
    }

    /// A plane whose value at column `x` of row `y` is `f(x, y)`.
    pub fn from_fn(width: usize, height: usize, mut f: impl FnMut(usize, usize) -> T) -> Self {
        let data = (0..width * height)
            .map(|i| f(i % width, i / width))
            .collect();
        Self {
            width,
            height,
            data,
        }
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// `(width, height)`.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// All values, row by row.
    pub fn data(&self) -> &[T] {
        &self.data
    }

    /// All values, row by row.
    pub fn data_mut(&mut self) -> &mut [T] {
        &mut self.data
    }

    /// Gives the values up, row by row.
    #[must_use]
    pub fn into_vec(self) -> Vec<T> {
        self.data
    }

    /// Row `y`.
    pub fn row(&self, y: usize) -> &[T] {
        &self.data[y * self.width..(y + 1) * self.width]
    }

    /// Row `y`.
    pub fn row_mut(&mut self, y: usize) -> &mut [T] {
        &mut self.data[y * self.width..(y + 1) * self.width]
    }

    /// The same shape with every value replaced by `f` of it.
    pub fn map<U>(&self, f: impl FnMut(&T) -> U) -> Plane<U> {
        Plane {
            width: self.width,
            height: self.height,
            data: self.data.iter().map(f).collect(),
        }
    }
}

impl<T: Clone> Plane<T> {
    /// A plane of one value.
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self {
            width,
            height,
            data: vec![value; width * height],
        }
    }
}

impl<T> std::ops::Index<(usize, usize)> for Plane<T> {
    type Output = T;

    /// The value at `(x, y)`: column first.
    fn index(&self, (x, y): (usize, usize)) -> &T {
        &self.data[y * self.width + x]
    }
}

impl<T> std::ops::IndexMut<(usize, usize)> for Plane<T> {
    fn index_mut(&mut self, (x, y): (usize, usize)) -> &mut T {
        &mut self.data[y * self.width + x]
    }
}

/// Two lengths that must agree do not.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{what} has {found} entries where {expected} were expected")]
pub struct ShapeError {
    /// The column or plane at fault.
    pub what: &'static str,
    /// The length that the rest of the data implies.
    pub expected: usize,
    /// The length that was found.
    pub found: usize,
}

impl ShapeError {
    /// Fails unless `found == expected`. Fails with [`ShapeError`] naming `what` when the lengths
    /// differ.
    pub fn check(what: &'static str, expected: usize, found: usize) -> Result<(), Self> {
        if found == expected {
            Ok(())
        } else {
            Err(Self {
                what,
                expected,
                found,
            })
        }
    }
}
