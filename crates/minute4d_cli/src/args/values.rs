//! Parsers that check the values of options.

/// Parses a size such as 480x360, pixels.
pub fn image_size(text: &str) -> Result<(u16, u16), String> {
    let sides = text
        .split_once('x')
        .and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    match sides {
        Some((w, h)) if (16..=8192).contains(&w) && (16..=8192).contains(&h) => Ok((w, h)),
        _ => Err("a size is WIDTHxHEIGHT, such as 480x360, each side 16 to 8192".to_owned()),
    }
}

/// Parses a finite number.
pub fn number(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(format!("{text:?} is not a number")),
    }
}

/// Parses seconds, at least 0, with an optional suffix `s`.
pub fn seconds(text: &str) -> Result<f64, String> {
    let value = number(text.strip_suffix('s').unwrap_or(text))?;
    if value >= 0.0 {
        Ok(value)
    } else {
        Err("it must be at least 0".to_owned())
    }
}

/// Parses a duration above 0, in seconds or with a suffix `s`, `m` or `h`: 90, 90s, 10m, 1.5h. Returns seconds.
pub fn duration(text: &str) -> Result<f64, String> {
    let units = [("h", 3600.0), ("m", 60.0), ("s", 1.0)];
    let (digits, unit) = units
        .into_iter()
        .find_map(|(name, unit)| Some((text.strip_suffix(name)?, unit)))
        .unwrap_or((text, 1.0));
    match positive(digits) {
        Ok(value) => Ok(value * unit),
        Err(_) => Err(format!(
            "{text:?} is not a duration above 0; write 90, 90s, 10m or 1.5h"
        )),
    }
}

/// Parses a field of view in degrees.
pub fn degrees(text: &str) -> Result<f64, String> {
    let value = number(text)?;
    if (5.0..=170.0).contains(&value) {
        Ok(value)
    } else {
        Err("a field of view must lie between 5 and 170 degrees".to_owned())
    }
}

/// Parses frames per second.
pub fn rate(text: &str) -> Result<f64, String> {
    let value = number(text)?;
    if (0.1..=240.0).contains(&value) {
        Ok(value)
    } else {
        Err("it must lie between 0.1 and 240".to_owned())
    }
}

/// Parses a finite number above 0.
pub fn positive(text: &str) -> Result<f64, String> {
    let value = number(text)?;
    if value > 0.0 {
        Ok(value)
    } else {
        Err("it must be above 0".to_owned())
    }
}

/// Parses a fraction from 0 to 1.
pub fn share(text: &str) -> Result<f64, String> {
    let value = number(text)?;
    if (0.0..=1.0).contains(&value) {
        Ok(value)
    } else {
        Err("it must lie between 0 and 1".to_owned())
    }
}

/// Parses a size such as 480x360 of images to render, pixels.
pub fn render_size(text: &str) -> Result<(usize, usize), String> {
    let sides = text
        .split_once('x')
        .and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    match sides {
        Some((w, h)) if (1..=16_384).contains(&w) && (1..=16_384).contains(&h) => Ok((w, h)),
        _ => Err("a size is WIDTHxHEIGHT, such as 480x360, each side 1 to 16384".to_owned()),
    }
}
