//! The arrays of the binary chunk, in the order in which they are written.

use super::{EXTENSION, FLOAT, UNSIGNED_BYTE, harmonic_names};
use crate::scene::C0;
use crate::scene::row::{sigmoid, unit};
use m4_core::{Column, Splats};
use std::io::{self, Write};

/// What an array holds of each splat.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Content {
    Position,
    Rotation,
    Scale,
    Opacity,
    /// Index of a spatial harmonic.
    Harmonic(usize),
    Fallback,
}

/// One attribute of the points.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Section {
    pub name: String,
    content: Content,
}

impl Section {
    /// Those of splats of a degree.
    pub fn all(sh_degree: usize) -> Vec<Self> {
        let named = |name: &str, content| Self {
            name: name.to_owned(),
            content,
        };
        let own = |name: &str, content| named(&format!("{EXTENSION}:{name}"), content);
        let mut sections = vec![
            named("POSITION", Content::Position),
            own("ROTATION", Content::Rotation),
            own("SCALE", Content::Scale),
            own("OPACITY", Content::Opacity),
        ];
        let harmonics = harmonic_names(sh_degree).enumerate();
        sections.extend(harmonics.map(|(term, name)| named(&name, Content::Harmonic(term))));
        sections.push(named("COLOR_0", Content::Fallback));
        sections
    }

    /// glTF's name of the element.
    pub fn kind(&self) -> &'static str {
        match self.content {
            Content::Rotation | Content::Fallback => "VEC4",
            Content::Position | Content::Scale | Content::Harmonic(_) => "VEC3",
            Content::Opacity => "SCALAR",
        }
    }

    /// glTF's number of the type of a component.
    pub fn component_type(&self) -> u32 {
        match self.content {
            Content::Fallback => UNSIGNED_BYTE,
            _ => FLOAT,
        }
    }

    /// Bytes per splat: a multiple of 4, so that every array is aligned.
    pub fn width(&self) -> u64 {
        match self.content {
            Content::Rotation => 16,
            Content::Position | Content::Scale | Content::Harmonic(_) => 12,
            Content::Opacity | Content::Fallback => 4,
        }
    }

    /// Writes the array of static splats with three scales.
    pub fn write(&self, splats: &Splats, out: &mut impl Write) -> io::Result<()> {
        let at = |column, k, i: usize| splats.column(column, k)[i];
        for i in 0..splats.n() {
            match self.content {
                Content::Position => floats(out, [0, 1, 2].map(|k| at(Column::Mean, k, i)))?,
                Content::Rotation => {
                    let [w, x, y, z] = unit([0, 1, 2, 3].map(|k| at(Column::Quat, k, i)));
                    floats(out, [x, y, z, w])?;
                }
                Content::Scale => floats(out, [0, 1, 2].map(|k| at(Column::LogScale, k, i).exp()))?,
                Content::Opacity => floats(out, [sigmoid(at(Column::Opacity, 0, i)) as f32])?,
                Content::Harmonic(term) => {
                    floats(out, [0, 1, 2].map(|k| at(Column::Colour, 3 * term + k, i)))?;
                }
                Content::Fallback => {
                    // a cast to u8 clips
                    let [r, g, b] = [0, 1, 2].map(|k| 0.5 + C0 * f64::from(at(Column::Colour, k, i)));
                    let point = [r, g, b, sigmoid(at(Column::Opacity, 0, i))];
                    out.write_all(&point.map(|v| (v * 255.0).round() as u8))?;
                }
            }
        }
        Ok(())
    }
}

fn floats<const N: usize>(out: &mut impl Write, values: [f32; N]) -> io::Result<()> {
    values.iter().try_for_each(|v| out.write_all(&v.to_le_bytes()))
}
