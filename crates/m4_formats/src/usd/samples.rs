//! The value of an attribute at a moment, as USD has it.

use super::lexer::{Fault, Lexer};
use std::io::BufRead;

/// Lists of numbers: one without time, and those around the moment that is asked for.
#[derive(Debug, Default)]
pub struct Attribute {
    still: Option<Vec<f32>>,
    lower: Option<Sample>,
    upper: Option<Sample>,
}

/// A list that is not yet read: nearer ones may follow.
#[derive(Debug)]
struct Sample {
    t: f64,
    text: Vec<u8>,
    /// Where it began.
    at: u64,
}

impl Attribute {
    /// Reads the value without time.
    pub fn read_still<R: BufRead>(&mut self, lexer: &mut Lexer<R>, width: usize) -> Result<(), Fault> {
        let mut values = Vec::new();
        lexer.list(width, &mut values)?;
        self.still = Some(values);
        Ok(())
    }

    /// Reads `{ t: [...], ... }`, of which it keeps the last sample up to `t` and the first from there on.
    pub fn read_samples<R: BufRead>(&mut self, lexer: &mut Lexer<R>, t: f64) -> Result<(), Fault> {
        lexer.expect(b'{')?;
        loop {
            lexer.blanks()?;
            if lexer.take(b'}')? {
                return Ok(());
            }
            let time: f64 = lexer.number()?;
            lexer.expect(b':')?;
            let lower = time <= t && self.lower.as_ref().is_none_or(|s| s.t <= time);
            let upper = time > t && self.upper.as_ref().is_none_or(|s| s.t >= time);
            let slot = match (lower, upper) {
                (true, _) => &mut self.lower,
                (_, true) => &mut self.upper,
                _ => {
                    lexer.skip_list()?;
                    lexer.take(b',')?;
                    continue;
                }
            };
            let mut text = slot.take().map(|s| s.text).unwrap_or_default();
            text.clear();
            let at = lexer.at();
            lexer.list_text(&mut text)?;
            *slot = Some(Sample { t: time, text, at });
            lexer.blanks()?;
            if !lexer.take(b',')? && lexer.peek()? != Some(b'}') {
                return Err(lexer.unexpected("',' or '}'")?);
            }
        }
    }

    /// The value at `t`: between two samples linear, before the first and after the last as there. Lists of
    /// different lengths are not mixed: the earlier one holds. `None` where there is neither sample nor value.
    pub fn at(self, t: f64, width: usize) -> Result<Option<Vec<f32>>, Fault> {
        let read = |sample: Sample| -> Result<(f64, Vec<f32>), Fault> {
            let mut values = Vec::new();
            Lexer::new(&sample.text[..], sample.at).list(width, &mut values)?;
            Ok((sample.t, values))
        };
        match (self.lower, self.upper) {
            (None, None) => Ok(self.still),
            (Some(one), None) | (None, Some(one)) => read(one).map(|(_, values)| Some(values)),
            (Some(lower), Some(_)) if lower.t == t => read(lower).map(|(_, values)| Some(values)),
            (Some(lower), Some(upper)) => {
                let ((from, mut values), (to, next)) = (read(lower)?, read(upper)?);
                if values.len() == next.len() {
                    let share = (t - from) / (to - from);
                    for (v, next) in values.iter_mut().zip(next) {
                        *v = (f64::from(*v) * (1.0 - share) + f64::from(next) * share) as f32;
                    }
                }
                Ok(Some(values))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Attribute;
    use crate::usd::lexer::Lexer;

    fn at(samples: &str, t: f64) -> Vec<f32> {
        let mut attribute = Attribute::default();
        attribute.read_still(&mut Lexer::new(&b"[7]"[..], 0), 1).unwrap();
        attribute
            .read_samples(&mut Lexer::new(samples.as_bytes(), 0), t)
            .unwrap();
        attribute.at(t, 1).unwrap().unwrap()
    }

    #[test]
    fn values_between_samples_are_linear_and_outside_held() {
        // in any order
        let samples = "{ 4: [1, 3], 0: [0, 1], 8: [5, 5], 10: [9], }";
        assert_eq!(at(samples, -3.0), [0.0, 1.0]);
        assert_eq!(at(samples, 0.0), [0.0, 1.0]);
        assert_eq!(at(samples, 1.0), [0.25, 1.5]);
        assert_eq!(at(samples, 4.0), [1.0, 3.0]);
        assert_eq!(at(samples, 6.0), [3.0, 4.0]);
        assert_eq!(at(samples, 9.0), [5.0, 5.0], "of another length");
        assert_eq!(at(samples, 11.0), [9.0]);
        assert_eq!(at("{}", 1.0), [7.0]);
    }
}
