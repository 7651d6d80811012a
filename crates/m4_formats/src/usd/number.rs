//! Numbers as short text.

use std::io::{self, Write};

/// A number with at most `DIGITS` decimals (up to 9) and no zeros behind them.
pub fn decimals<const DIGITS: u32>(out: &mut impl Write, value: f64) -> io::Result<()> {
    let unit = 10u64.pow(DIGITS);
    let steps = (value.abs() * unit as f64).round() as u64;
    if steps == 0 {
        return out.write_all(b"0");
    }
    if value < 0.0 {
        out.write_all(b"-")?;
    }
    write!(out, "{}", steps / unit)?;
    let mut rest = steps % unit;
    if rest == 0 {
        return Ok(());
    }
    let mut digits = DIGITS as usize;
    while rest.is_multiple_of(10) {
        rest /= 10;
        digits -= 1;
    }
    write!(out, ".{rest:0digits$}")
}

/// A number with four significant digits.
pub fn significant(out: &mut impl Write, value: f64) -> io::Result<()> {
    write!(out, "{value:.3e}")
}

#[cfg(test)]
mod tests {
    use super::{decimals, significant};

    fn text(write: impl Fn(&mut Vec<u8>) -> std::io::Result<()>) -> String {
        let mut out = Vec::new();
        write(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn numbers_are_short_and_right() {
        let cases = [
            (0.0, "0"),
            (-0.0004, "0"),
            (0.0005, "0.001"),
            (1.0, "1"),
            (-12.5, "-12.5"),
            (0.0404, "0.04"),
            (0.9999, "1"),
            (3.0071, "3.007"),
        ];
        for (value, expected) in cases {
            assert_eq!(text(|out| decimals::<3>(out, value)), expected);
        }
        assert_eq!(text(|out| significant(out, 0.012_341)), "1.234e-2");
        for i in 0..2000 {
            let value = f64::from(i - 1000) * 0.737;
            let back: f64 = text(|out| decimals::<4>(out, value)).parse().unwrap();
            assert!((back - value).abs() <= 0.5e-4 + 1e-12);
            let back: f64 = text(|out| significant(out, value)).parse().unwrap();
            assert!((back - value).abs() <= 5e-4 * value.abs());
        }
    }
}
