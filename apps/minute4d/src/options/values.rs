//! Parsers that check the values of options.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};

/// Returns the parser of an option that has these values: each with its name, its line of help, and
/// what it stands for.
pub fn choice<T: Copy + Send + Sync + 'static, const N: usize>(
    values: [(&'static str, &'static str, T); N],
) -> impl TypedValueParser<Value = T> {
    let named = values.map(|(name, help, _)| PossibleValue::new(name).help(help));
    PossibleValuesParser::new(named).try_map(move |text| {
        let entry = values.iter().find(|(name, ..)| *name == text);
        entry
            .map(|&(.., value)| value)
            .ok_or("it is none of the possible values")
    })
}

/// Parses a size such as 480x360 of synthetic images, pixels.
pub fn image_size(text: &str) -> Result<(usize, usize), String> {
    size(text, 16, 8192)
}

/// Parses a size such as 480x360 of images to render, pixels.
pub fn render_size(text: &str) -> Result<(usize, usize), String> {
    size(text, 1, 16_384)
}

fn size(text: &str, least: usize, most: usize) -> Result<(usize, usize), String> {
    let sides = text
        .split_once('x')
        .and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    let fits = |side: &usize| (least..=most).contains(side);
    sides.filter(|(w, h)| fits(w) && fits(h)).ok_or_else(|| {
        format!("a size is WIDTHxHEIGHT, such as 480x360, each side {least} to {most}")
    })
}

/// Parses a number that has to pass a check; `reason` says what is allowed.
fn checked(text: &str, check: impl FnOnce(f64) -> bool, reason: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && check(value) => Ok(value),
        Ok(value) if value.is_finite() => Err(reason.to_owned()),
        _ => Err(format!("{text:?} is not a number")),
    }
}

/// Parses seconds, at least 0, with an optional suffix `s`.
pub fn seconds(text: &str) -> Result<f64, String> {
    checked(
        text.strip_suffix('s').unwrap_or(text),
        |value| value >= 0.0,
        "it must be at least 0",
    )
}

/// Parses a duration above 0, in seconds or with a suffix `s`, `m` or `h`: 90, 90s, 10m, 1.5h.
/// Returns seconds.
pub fn duration(text: &str) -> Result<f64, String> {
    let units = [("h", 3600.0), ("m", 60.0), ("s", 1.0)];
    let (digits, unit) = units
        .into_iter()
        .find_map(|(name, unit)| Some((text.strip_suffix(name)?, unit)))
        .unwrap_or((text, 1.0));
    let reason = format!("{text:?} is not a duration above 0; write 90, 90s, 10m or 1.5h");
    let value = checked(digits, |value| value > 0.0, "").map_err(|_| reason)?;
    Ok(value * unit)
}

pub fn degrees(text: &str) -> Result<f64, String> {
    let reason = "a field of view must lie between 5 and 170 degrees";
    checked(text, |value| (5.0..=170.0).contains(&value), reason)
}

/// Parses frames a second.
pub fn rate(text: &str) -> Result<f64, String> {
    checked(
        text,
        |value| (0.1..=240.0).contains(&value),
        "it must lie between 0.1 and 240",
    )
}
