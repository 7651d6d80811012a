//! The ranges of the numbers that files may hold. Every number is compared with its range once,
//! where its file is read; the message names the file, the field and the range.
//!
//! The computations have 32 bits: a length may be squared twice without an overflow (1e7 to the
//! power of 4 is 1e28, the largest number 3e38), and so may its inverse. Within these ranges
//! nothing in the program becomes NaN or infinite.

pub(crate) mod bound;

use crate::Fault;
use bound::of_bindings;
use m4_core::nalgebra::Vector3;
use m4_core::{Column, Intrinsics, SourceFrame, Splats};
use std::ops::RangeInclusive;

/// A range of numbers.
pub type Range = RangeInclusive<f64>;

/// Coordinates of cameras, tracks and camera paths, scene units.
pub const COORDINATE: Range = -1e7..=1e7;
/// z-depth that counts as known, scene units: what lies outside is unknown, as 0 is.
pub const DEPTH: Range = 1e-9..=1e7;
/// Scene units per step of a depth map of whole numbers: its 65535 steps stay within [`DEPTH`].
pub const DEPTH_UNIT: Range = 1e-9..=152.0;
/// What a file says that its coordinates were multiplied by.
pub const SCALE: Range = 1e-9..=1e9;
/// Focal lengths, in longer sides of the image: fields of view from 0.06 to 179 degrees.
pub const FOCAL: Range = 0.01..=1000.0;
/// Principal points, in sides of the image from its corner.
pub const CENTRE: Range = -1.0..=2.0;
/// Sides of an image, pixels.
pub const SIDE_PX: RangeInclusive<usize> = 1..=1 << 16;
/// Frames per second: from a frame in twelve days to cameras of a microsecond.
pub const FPS: Range = 1e-6..=1e6;
/// Frames of a clip: nine hours at 30 frames per second. What goes through them frame by frame has
/// to end.
pub const FRAMES: RangeInclusive<usize> = 0..=1_000_000;
/// Moments of a clip, seconds: 31 years.
pub const SECONDS: Range = -1e9..=1e9;
/// Relative standard deviation of a distance.
pub const DISTANCE_SIGMA: Range = 1e-9..=1e3;
/// Near plane, scene units.
pub const NEAR: Range = 0.0..=1e7;
/// Colours of a background, and entries of a colour correction.
pub const COLOUR: Range = -1e6..=1e6;

/// The range of a parameter of splats; scenes reach farther than the cameras that saw them.
#[must_use]
pub fn of_column(column: Column) -> Range {
    match column {
        Column::Mean | Column::Velocity => -1e9..=1e9,
        // the standard deviation is as far as a mean at most; what is smaller than 1e-38 is a point
        Column::LogScale => -200.0..=20.8,
        Column::Quat => -1e6..=1e6,
        Column::Opacity => -1e4..=1e4,
        Column::Trend | Column::Colour => COLOUR,
        Column::TimeMean => -2e6..=2e6,
        Column::LogTimeSd => -40.0..=40.0,
    }
}

/// What is wrong with a number: the field, the value and the range.
pub(crate) fn of_number(field: &str, value: f64, range: &Range, unit: &str) -> Option<String> {
    let fits = range.contains(&value);
    (!fits).then(|| {
        format!(
            "{field} is {}; {} was expected",
            short(value),
            words(range, unit)
        )
    })
}

/// Fails with the field and the range unless `value` is in it.
pub(crate) fn check(
    field: &str,
    value: f64,
    range: &Range,
    unit: &str,
    hint: &str,
) -> Result<(), Fault> {
    of_number(field, value, range, unit).map_or(Ok(()), |what| Err(Fault::bad(what, hint)))
}

/// `1e-6 to 1e6 frames per second`.
pub(crate) fn words(range: &Range, unit: &str) -> String {
    let space = if unit.is_empty() { "" } else { " " };
    format!(
        "{} to {}{space}{unit}",
        short(*range.start()),
        short(*range.end())
    )
}

/// A number of few letters: `1e39` in place of forty digits.
pub(crate) fn short(value: f64) -> String {
    let plain = value == 0.0 || !value.is_finite() || (1e-4..1e7).contains(&value.abs());
    if plain {
        value.to_string()
    } else {
        format!("{value:e}")
    }
}

/// What is wrong with a place, world units.
pub(crate) fn of_place(field: &str, place: &Vector3<f64>) -> Option<String> {
    let value = place.iter().find(|v| !COORDINATE.contains(v))?;
    Some(format!(
        "{field} holds {}; {} was expected",
        short(*value),
        words(&COORDINATE, "scene units")
    ))
}

/// What is wrong with the size, the focal lengths or the principal point of a lens.
#[must_use]
pub fn of_lens(k: &Intrinsics) -> Option<String> {
    if !(SIDE_PX.contains(&k.width) && SIDE_PX.contains(&k.height)) {
        return Some(format!(
            "images of {} x {} pixels; sides of 1 to {} were expected",
            k.width,
            k.height,
            SIDE_PX.end()
        ));
    }
    let longer = k.width.max(k.height);
    let fields = [
        ("the focal length fx", k.fx, FOCAL, longer),
        ("the focal length fy", k.fy, FOCAL, longer),
        ("the principal point cx", k.cx, CENTRE, k.width),
        ("the principal point cy", k.cy, CENTRE, k.height),
    ];
    fields
        .into_iter()
        .find_map(|(field, value, range, side)| of_pixels(field, value, &range, side))
}

/// What is wrong with a number whose range is that of a side of the image, pixels.
pub(crate) fn of_pixels(field: &str, value: f64, range: &Range, side: usize) -> Option<String> {
    let range = range.start() * side as f64..=range.end() * side as f64;
    of_number(
        field,
        value,
        &range,
        &format!("pixels (its image has {side})"),
    )
}

/// The first parameter of a splat, of what it is bound to or of a window that is out of its range.
#[must_use]
pub fn of_splats(splats: &Splats) -> Option<String> {
    use Column::{Colour, LogScale, LogTimeSd, Mean, Opacity, Quat, TimeMean, Velocity};
    let layout = splats.layout();
    let columns = [
        (Mean, "mean"),
        (LogScale, "log_scale"),
        (Quat, "quat"),
        (Opacity, "opacity"),
        (Colour, "colour"),
        (TimeMean, "time_mean"),
        (LogTimeSd, "log_time_sd"),
        (Velocity, "velocity"),
    ];
    let of_column = |(column, name)| {
        let range = of_column(column);
        (0..layout.range(column).len()).find_map(|k| {
            let values = splats.column(column, k);
            let at = values
                .iter()
                .position(|v| !range.contains(&f64::from(*v)))?;
            let splat = if values.len() < splats.n() {
                splats.n_static() + at
            } else {
                at
            };
            let value = short(values[at].into());
            Some(format!(
                "{name} of splat {splat} is {value}; {} was expected",
                words(&range, "")
            ))
        })
    };
    columns
        .into_iter()
        .find_map(of_column)
        .or_else(|| of_bindings(splats))
}

/// What is wrong with the time, the deviation or the colour correction of a frame of a scene.
#[must_use]
pub fn of_source(frame: &SourceFrame) -> Option<String> {
    let frames = *FRAMES.end() as f64;
    if !(-frames..=frames).contains(&frame.t) {
        return Some(format!(
            "the time {}; frames up to {frames} were expected",
            short(frame.t)
        ));
    }
    let sigma = frame.distance_sigma.map(f64::from);
    if let Some(what) = sigma.and_then(|s| of_number("the distance_sigma", s, &DISTANCE_SIGMA, ""))
    {
        return Some(what);
    }
    let exposure = &frame.exposure;
    let mut numbers = exposure
        .matrix
        .as_flattened()
        .iter()
        .chain(&exposure.offset);
    let value = numbers.find(|v| !COLOUR.contains(&f64::from(**v)))?;
    Some(format!(
        "{} in its exposure; {} was expected",
        short(f64::from(*value)),
        words(&COLOUR, "")
    ))
}

#[cfg(test)]
mod tests {
    use super::{COORDINATE, check, of_lens, of_splats};
    use m4_core::{Column, Intrinsics, SplatLayout, Splats};

    #[test]
    fn messages_name_the_field_the_value_and_the_range() {
        let message = check("fl_x", 1e39, &COORDINATE, "pixels", "correct it")
            .unwrap_err()
            .to_string();
        assert_eq!(
            message,
            "fl_x is 1e39; -1e7 to 1e7 pixels was expected; correct it"
        );
        for focal in [1e-30, 0.0, -5.0, f64::NAN, f64::INFINITY, 1e30] {
            let lens = Intrinsics {
                fx: focal,
                ..Intrinsics::centred(640, 480, 500.0)
            };
            let said = of_lens(&lens).unwrap();
            assert!(
                said.starts_with("the focal length fx is")
                    && said.contains("6.4 to 640000 pixels (its image has 640)"),
                "{said}"
            );
        }
        assert_eq!(of_lens(&Intrinsics::centred(640, 480, 500.0)), None);
    }

    #[test]
    fn splats_out_of_range_are_named() {
        let layout = SplatLayout {
            isotropic: false,
            sh_degree: 0,
            time_degree: 0,
        };
        let mut splats = Splats::zeros(layout, 2, 3);
        assert_eq!(of_splats(&splats), None);
        splats.column_mut(Column::Velocity, 1)[2] = 1e30;
        let said = of_splats(&splats).unwrap();
        assert!(
            said.starts_with("velocity of splat 4 is 1")
                && said.ends_with("-1e9 to 1e9 was expected"),
            "{said}"
        );
        splats.column_mut(Column::Velocity, 1)[2] = f32::NAN;
        assert!(of_splats(&splats).unwrap().contains("NaN"));
    }
}
