//! Numbers written as one run of bytes, as they lie in memory: many times faster than one by one in
//! formats that take a call for each. For files that stay on the machine: the order of the bytes is
//! its own.

use bytemuck::Pod;
use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::marker::PhantomData;

/// Some numbers, as they are written.
struct Packed<'a, T>(&'a [T]);

impl<T: Pod> Serialize for Packed<'_, T> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_bytes(bytemuck::cast_slice(self.0))
    }
}

/// Some numbers, as they are read.
struct Unpacked<T>(Vec<T>);

impl<'de, T: Pod> Deserialize<'de> for Unpacked<T> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Bytes<T>(PhantomData<T>);
        impl<T: Pod> Visitor<'_> for Bytes<T> {
            type Value = Vec<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("the bytes of whole numbers of values")
            }

            fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<Vec<T>, E> {
                if !bytes.len().is_multiple_of(size_of::<T>()) {
                    return Err(E::invalid_length(bytes.len(), &self));
                }
                Ok(bytes
                    .chunks_exact(size_of::<T>())
                    .map(bytemuck::pod_read_unaligned)
                    .collect())
            }
        }
        from.deserialize_bytes(Bytes(PhantomData)).map(Self)
    }
}

/// Writes values as bytes: `#[serde(with = "m4_core::packed")]`.
///
/// # Errors
///
/// Those of the format.
pub fn serialize<T: Pod, S: Serializer>(values: &[T], to: S) -> Result<S::Ok, S::Error> {
    Packed(values).serialize(to)
}

/// Reads values that were written by [`serialize`].
///
/// # Errors
///
/// Those of the format; bytes of no whole number of values.
pub fn deserialize<'de, T: Pod, D: Deserializer<'de>>(from: D) -> Result<Vec<T>, D::Error> {
    Ok(Unpacked::deserialize(from)?.0)
}

/// The same for a list of lists: `#[serde(with = "m4_core::packed::lists")]`.
pub mod lists {
    use super::{Packed, Unpacked};
    use bytemuck::Pod;
    use serde::{Deserialize, Deserializer, Serializer};

    /// Writes each list as bytes.
    ///
    /// # Errors
    ///
    /// Those of the format.
    pub fn serialize<T: Pod, S: Serializer>(lists: &[Vec<T>], to: S) -> Result<S::Ok, S::Error> {
        to.collect_seq(lists.iter().map(|list| Packed(list)))
    }

    /// Reads lists that were written by [`serialize`].
    ///
    /// # Errors
    ///
    /// Those of the format; bytes of no whole number of values.
    pub fn deserialize<'de, T: Pod, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Vec<Vec<T>>, D::Error> {
        let lists = Vec::<Unpacked<T>>::deserialize(from)?;
        Ok(lists.into_iter().map(|list| list.0).collect())
    }
}
