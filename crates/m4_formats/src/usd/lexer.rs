//! The words, numbers and brackets of USD text, from a stream.

use std::io::{self, BufRead};
use std::str::FromStr;

/// Longest number and longest word or text, bytes.
const MAX_NUMBER: usize = 64;
const MAX_WORD: usize = 256;
/// Deepest nesting of brackets in a value that is passed over.
const MAX_NESTING: usize = 64;

/// What stops reading; the caller knows the file.
#[derive(Debug)]
pub enum Fault {
    /// The system refused.
    Io(io::Error),
    /// It is no USD text, or not whole.
    Bad(String),
    /// It is USD, of a kind that is not read.
    Foreign(String),
}

impl From<io::Error> for Fault {
    fn from(e: io::Error) -> Self {
        Self::Io(e)
    }
}

/// A stream of bytes with its place.
pub struct Lexer<R> {
    from: R,
    at: u64,
}

impl<R: BufRead> Lexer<R> {
    /// `at`: bytes before the first of the stream.
    pub fn new(from: R, at: u64) -> Self {
        Self { from, at }
    }

    /// Bytes read so far.
    pub fn at(&self) -> u64 {
        self.at
    }

    pub fn bad(&self, what: impl std::fmt::Display) -> Fault {
        Fault::Bad(format!("at byte {}: {what}", self.at))
    }

    /// The next byte, which stays; `None` at the end.
    pub fn peek(&mut self) -> Result<Option<u8>, Fault> {
        Ok(self.from.fill_buf()?.first().copied())
    }

    pub fn step(&mut self) {
        self.from.consume(1);
        self.at += 1;
    }

    /// Takes `byte`, if it is the next.
    pub fn take(&mut self, byte: u8) -> Result<bool, Fault> {
        let here = self.peek()? == Some(byte);
        if here {
            self.step();
        }
        Ok(here)
    }

    /// Takes `byte`, which must come next after blanks.
    pub fn expect(&mut self, byte: u8) -> Result<(), Fault> {
        self.blanks()?;
        if self.take(byte)? {
            return Ok(());
        }
        Err(self.unexpected(&format!("{:?}", char::from(byte)))?)
    }

    pub fn unexpected(&mut self, wanted: &str) -> Result<Fault, Fault> {
        Ok(match self.peek()? {
            Some(byte) => self.bad(format!("{:?} where {wanted} was expected", char::from(byte))),
            None => self.bad(format!("it ends where {wanted} was expected")),
        })
    }

    /// Passes over blanks within a line.
    pub fn spaces(&mut self) -> Result<(), Fault> {
        while matches!(self.peek()?, Some(b' ' | b'\t')) {
            self.step();
        }
        Ok(())
    }

    /// Passes over blanks, ends of lines and comments.
    pub fn blanks(&mut self) -> Result<(), Fault> {
        loop {
            match self.peek()? {
                Some(b' ' | b'\t' | b'\r' | b'\n') => self.step(),
                Some(b'#') => self.skip_line()?,
                _ => return Ok(()),
            }
        }
    }

    /// Passes over the rest of a line.
    pub fn skip_line(&mut self) -> Result<(), Fault> {
        self.at += self.from.skip_until(b'\n')? as u64;
        Ok(())
    }

    fn run(&mut self, belongs: impl Fn(u8) -> bool, most: usize, out: &mut Vec<u8>) -> Result<(), Fault> {
        while let Some(byte) = self.peek()?.filter(|&b| belongs(b)) {
            if out.len() == most {
                return Err(self.bad(format!("a word of more than {most} bytes")));
            }
            out.push(byte);
            self.step();
        }
        Ok(())
    }

    /// A name or a type, such as `positions.timeSamples` and `float3[]`; empty where there is none.
    pub fn word(&mut self) -> Result<String, Fault> {
        let mut out = Vec::new();
        let belongs = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'_' | b':' | b'.' | b'[' | b']');
        self.run(belongs, MAX_WORD, &mut out)?;
        Ok(String::from_utf8_lossy(&out).into_owned())
    }

    /// A number that is finite.
    pub fn number<T: FromStr + Copy + Into<f64>>(&mut self) -> Result<T, Fault> {
        self.blanks()?;
        let mut out = [0; MAX_NUMBER];
        let mut n = 0;
        while let Some(byte) = self.peek()? {
            if !(byte.is_ascii_alphanumeric() || matches!(byte, b'+' | b'-' | b'.')) {
                break;
            }
            if n == MAX_NUMBER {
                return Err(self.bad(format!("a number of more than {MAX_NUMBER} bytes")));
            }
            out[n] = byte;
            n += 1;
            self.step();
        }
        if n == 0 {
            return Err(self.unexpected("a number")?);
        }
        let text = str::from_utf8(&out[..n]).unwrap_or_default();
        match text.parse::<T>() {
            Ok(value) if value.into().is_finite() => Ok(value),
            _ => Err(self.bad(format!("{text:?} is no number that is finite"))),
        }
    }

    /// A short text in quotes.
    pub fn quoted(&mut self) -> Result<String, Fault> {
        self.blanks()?;
        self.expect(b'"')?;
        let mut out = Vec::new();
        self.run(|b| b != b'"' && b != b'\n', MAX_WORD, &mut out)?;
        self.expect(b'"')?;
        Ok(String::from_utf8_lossy(&out).into_owned())
    }

    /// Passes over a text in one or three quotes of either kind.
    fn skip_quoted(&mut self, quote: u8) -> Result<(), Fault> {
        let mut opened = 0;
        while opened < 3 && self.take(quote)? {
            opened += 1;
        }
        if opened == 2 {
            return Ok(()); // nothing between them
        }
        let mut closed = 0;
        while closed < opened {
            match self.peek()? {
                Some(byte) => {
                    self.step();
                    closed = if byte == quote { closed + 1 } else { 0 };
                    if byte == b'\\' && self.peek()?.is_some() {
                        self.step();
                    }
                }
                None => return Err(self.bad("a text does not end")),
            }
        }
        Ok(())
    }

    /// Passes over a value: a number, a word, a text, a path, or anything in brackets.
    pub fn skip_value(&mut self) -> Result<(), Fault> {
        self.blanks()?;
        let mut open = Vec::new();
        loop {
            match self.peek()? {
                None => return Err(self.unexpected("a value")?),
                Some(quote @ (b'"' | b'\'')) => self.skip_quoted(quote)?,
                Some(mark @ (b'@' | b'<')) => {
                    let end = if mark == b'<' { b'>' } else { b'@' };
                    self.step();
                    self.at += self.from.skip_until(end)? as u64;
                }
                Some(bracket @ (b'(' | b'[' | b'{')) => {
                    if open.len() == MAX_NESTING {
                        return Err(self.bad(format!("brackets nested more than {MAX_NESTING} deep")));
                    }
                    open.push(match bracket {
                        b'(' => b')',
                        b'[' => b']',
                        _ => b'}',
                    });
                    self.step();
                }
                Some(bracket @ (b')' | b']' | b'}')) => {
                    if open.pop() != Some(bracket) {
                        return Err(self.unexpected("a value")?);
                    }
                    self.step();
                }
                Some(byte) if open.is_empty() => {
                    if !(byte.is_ascii_alphanumeric() || matches!(byte, b'+' | b'-' | b'.' | b'_')) {
                        return Err(self.unexpected("a value")?);
                    }
                    let belongs = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'+' | b'-' | b'.' | b'_' | b':');
                    self.run(belongs, MAX_WORD, &mut Vec::new())?;
                }
                Some(_) => self.step(),
            }
            if open.is_empty() {
                return Ok(());
            }
            self.blanks()?;
        }
    }

    /// The text of a list of numbers, brackets included, onto `out`.
    pub fn list_text(&mut self, out: &mut Vec<u8>) -> Result<(), Fault> {
        self.open_list()?;
        out.push(b'[');
        self.at += self.from.read_until(b']', out)? as u64;
        self.closed(out.last() == Some(&b']'))
    }

    /// Passes over a list of numbers.
    pub fn skip_list(&mut self) -> Result<(), Fault> {
        self.open_list()?;
        self.at += self.from.skip_until(b']')? as u64;
        // what comes after it says whether the file was cut
        self.blanks()?;
        let goes_on = self.peek()?.is_some();
        self.closed(goes_on)
    }

    fn closed(&self, whole: bool) -> Result<(), Fault> {
        if whole {
            return Ok(());
        }
        Err(self.bad("it ends within a list"))
    }

    fn open_list(&mut self) -> Result<(), Fault> {
        self.blanks()?;
        if self.take(b'[')? {
            return Ok(());
        }
        Err(self.unexpected("a list of numbers")?)
    }

    /// A list of numbers, or of tuples of `width` of them, onto `out`.
    pub fn list(&mut self, width: usize, out: &mut Vec<f32>) -> Result<(), Fault> {
        self.open_list()?;
        loop {
            self.blanks()?;
            if self.take(b']')? {
                return Ok(());
            }
            if width == 1 {
                out.push(self.number()?);
            } else {
                for k in 0..width {
                    self.expect(if k == 0 { b'(' } else { b',' })?;
                    out.push(self.number()?);
                }
                self.expect(b')')?;
            }
            self.blanks()?;
            if !self.take(b',')? && self.peek()? != Some(b']') {
                return Err(self.unexpected("',' or ']'")?);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Fault, Lexer};

    fn lexer(text: &str) -> Lexer<&[u8]> {
        Lexer::new(text.as_bytes(), 0)
    }

    #[test]
    fn lists_of_numbers_and_of_tuples() {
        let mut out = Vec::new();
        lexer("[1, -2.5,3e-1 ]").list(1, &mut out).unwrap();
        assert_eq!(out, [1.0, -2.5, 0.3]);
        out.clear();
        lexer(" [(1,2),\n (3 , 4),]").list(2, &mut out).unwrap();
        assert_eq!(out, [1.0, 2.0, 3.0, 4.0]);
        for text in ["[1 2]", "[1,", "(1)", "[(1,2)]", "[nan]", "[1e39]", "[,]"] {
            assert!(
                matches!(lexer(text).list(1, &mut Vec::new()), Err(Fault::Bad(_))),
                "{text}"
            );
        }
        for text in ["[(1,2,3)]", "[(1)]", "[1,2]"] {
            assert!(
                matches!(lexer(text).list(2, &mut Vec::new()), Err(Fault::Bad(_))),
                "{text}"
            );
        }
    }

    #[test]
    fn any_value_is_passed_over() {
        for value in [
            "-1.5e3",
            "true",
            r#""a \" ] b""#,
            "'''a 'b' c'''",
            "\"\"",
            "@a/b[].usd@",
            "</a/b>",
            r#"["a]", "b"]"#,
            "{ string a = \"}\" # }\n dictionary b = { } }",
            "((1, 0), (0, 1))",
        ] {
            let text = format!(" {value} rest");
            let mut lexer = lexer(&text);
            lexer.skip_value().unwrap();
            lexer.blanks().unwrap();
            assert_eq!(lexer.word().unwrap(), "rest", "{value}");
        }
        let deep = "[".repeat(1000);
        for value in ["", "[1", "(]", "\"a", "}", deep.as_str()] {
            assert!(matches!(lexer(value).skip_value(), Err(Fault::Bad(_))), "{value}");
        }
    }
}
