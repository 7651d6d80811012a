//! Named arrays: the form in which a stage hands its state to the writer of checkpoints.

use crate::ShapeError;
use std::borrow::Cow;
use std::collections::BTreeMap;

/// An array of numbers with a shape, row-major; the product of `shape` is the length of `data`. The
/// numbers may be borrowed, so that a state can be written without a copy of it.
///
/// Integers of 64 bits (counters, seeds) are stored as two entries of [`StateTensor::U32`], low
/// half first; bits survive a round trip, NaN included.
#[derive(Debug, Clone, PartialEq)]
pub enum StateTensor<'a> {
    /// 32-bit floats.
    F32 {
        /// Extent of each axis, outermost first.
        shape: Vec<usize>,
        /// The values.
        data: Cow<'a, [f32]>,
    },
    /// 32-bit unsigned integers.
    U32 {
        /// Extent of each axis, outermost first.
        shape: Vec<usize>,
        /// The values.
        data: Cow<'a, [u32]>,
    },
    /// 16-bit unsigned integers.
    U16 {
        /// Extent of each axis, outermost first.
        shape: Vec<usize>,
        /// The values.
        data: Cow<'a, [u16]>,
    },
    /// Bytes: flags, or UTF-8 text.
    U8 {
        /// Extent of each axis, outermost first.
        shape: Vec<usize>,
        /// The values.
        data: Cow<'a, [u8]>,
    },
    /// 64-bit floats.
    F64 {
        /// Extent of each axis, outermost first.
        shape: Vec<usize>,
        /// The values.
        data: Cow<'a, [f64]>,
    },
}

/// State by name, in the order of the names.
pub type TrainState<'a> = BTreeMap<String, StateTensor<'a>>;

impl<'a> StateTensor<'a> {
    /// A vector of 32-bit floats.
    pub fn f32(data: impl Into<Cow<'a, [f32]>>) -> Self {
        let data = data.into();
        Self::F32 {
            shape: vec![data.len()],
            data,
        }
    }

    /// A vector of 32-bit unsigned integers.
    pub fn u32(data: impl Into<Cow<'a, [u32]>>) -> Self {
        let data = data.into();
        Self::U32 {
            shape: vec![data.len()],
            data,
        }
    }

    /// A vector of bytes.
    pub fn u8(data: impl Into<Cow<'a, [u8]>>) -> Self {
        let data = data.into();
        Self::U8 {
            shape: vec![data.len()],
            data,
        }
    }

    /// A vector of 64-bit floats.
    pub fn f64(data: impl Into<Cow<'a, [f64]>>) -> Self {
        let data = data.into();
        Self::F64 {
            shape: vec![data.len()],
            data,
        }
    }

    /// The same array, borrowed from this one.
    pub fn view(&self) -> StateTensor<'_> {
        let shape = self.shape().to_vec();
        match self {
            Self::F32 { data, .. } => StateTensor::F32 {
                shape,
                data: Cow::Borrowed(data),
            },
            Self::U32 { data, .. } => StateTensor::U32 {
                shape,
                data: Cow::Borrowed(data),
            },
            Self::U16 { data, .. } => StateTensor::U16 {
                shape,
                data: Cow::Borrowed(data),
            },
            Self::U8 { data, .. } => StateTensor::U8 {
                shape,
                data: Cow::Borrowed(data),
            },
            Self::F64 { data, .. } => StateTensor::F64 {
                shape,
                data: Cow::Borrowed(data),
            },
        }
    }

    /// Extent of each axis, outermost first.
    pub fn shape(&self) -> &[usize] {
        match self {
            Self::F32 { shape, .. }
            | Self::U32 { shape, .. }
            | Self::U16 { shape, .. }
            | Self::U8 { shape, .. }
            | Self::F64 { shape, .. } => shape,
        }
    }

    /// Number of values.
    pub fn len(&self) -> usize {
        match self {
            Self::F32 { data, .. } => data.len(),
            Self::U32 { data, .. } => data.len(),
            Self::U16 { data, .. } => data.len(),
            Self::U8 { data, .. } => data.len(),
            Self::F64 { data, .. } => data.len(),
        }
    }

    /// True when it holds none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Fails unless the shape and the number of values agree.
    /// Fails with [`ShapeError`] when they do not, or when the product of the shape overflows.
    pub fn check(&self) -> Result<(), ShapeError> {
        let expected = self
            .shape()
            .iter()
            .try_fold(1usize, |n, &extent| n.checked_mul(extent));
        ShapeError::check("state tensor", expected.unwrap_or(usize::MAX), self.len())
    }
}

#[cfg(test)]
mod tests {
    use super::StateTensor;

    #[test]
    fn a_shape_must_fit_its_values() {
        assert!(StateTensor::f32(vec![1.0, 2.0]).check().is_ok());
        let (shape, data) = (vec![2, 3], vec![0; 5].into());
        assert_eq!(
            StateTensor::U32 { shape, data }
                .check()
                .unwrap_err()
                .expected,
            6
        );
        let (shape, data) = (vec![usize::MAX, 2], vec![0; 5].into());
        assert!(StateTensor::U8 { shape, data }.check().is_err());
    }
}
