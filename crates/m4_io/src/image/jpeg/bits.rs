//! Huffman codes, and the bits of a scan.

/// Longest code, bits.
const LONGEST: u32 = 16;

/// A Huffman table: length and symbol of the code that 16 bits begin with; length 0 where there is
/// none.
pub(super) struct Codes(Vec<(u8, u8)>);

impl Codes {
    /// Of the numbers of codes of 1 to 16 bits and their symbols in order (annex C).
    pub(super) fn new(counts: &[u8; 16], symbols: &[u8]) -> Result<Self, String> {
        let mut table = vec![(0, 0); 1 << LONGEST];
        let (mut next, mut symbols) = (0, symbols.iter());
        for (length, &n) in (1..).zip(counts) {
            let span = 1 << (LONGEST - u32::from(length));
            for &symbol in symbols.by_ref().take(usize::from(n)) {
                let codes = table
                    .get_mut(next..next + span)
                    .ok_or("a Huffman table has too many codes")?;
                codes.fill((length, symbol));
                next += span;
            }
        }
        Ok(Self(table))
    }
}

/// Reads the entropy-coded data of a scan, from a marker to the next.
pub(super) struct Bits<'a> {
    file: &'a [u8],
    at: usize,
    /// The next bits, uppermost first.
    held: u64,
    count: u32,
}

impl<'a> Bits<'a> {
    pub(super) fn new(file: &'a [u8]) -> Self {
        Self {
            file,
            at: 0,
            held: 0,
            count: 0,
        }
    }

    /// Holds at least 32 bits unless a marker or the end of the file comes before.
    fn fill(&mut self) {
        while self.count <= 56 {
            let byte = match self.file.get(self.at..) {
                // a zero behind a byte of ones says that it is none of a marker
                Some([0xff, 0, ..]) => {
                    self.at += 2;
                    0xff
                }
                Some([0xff, ..] | []) | None => return,
                Some([byte, ..]) => {
                    self.at += 1;
                    *byte
                }
            };
            self.held |= u64::from(byte) << (56 - self.count);
            self.count += 8;
        }
    }

    /// The next `n` bits, 16 at most.
    pub(super) fn take(&mut self, n: u32) -> Result<u32, String> {
        if n == 0 {
            return Ok(0);
        }
        if self.count < n {
            self.fill();
        }
        if self.count < n || n > LONGEST {
            return Err(self.short());
        }
        let bits = self.held >> (64 - n);
        self.held <<= n;
        self.count -= n;
        Ok(bits as u32)
    }

    /// Passes over `n` bits.
    pub(super) fn skip(&mut self, mut n: u32) -> Result<(), String> {
        while n > 0 {
            let part = n.min(LONGEST);
            self.take(part)?;
            n -= part;
        }
        Ok(())
    }

    /// The next symbol.
    pub(super) fn symbol(&mut self, codes: &Codes) -> Result<u8, String> {
        if self.count < LONGEST {
            self.fill();
        }
        let (length, symbol) = codes.0[(self.held >> (64 - LONGEST)) as usize];
        if u32::from(length) > self.count {
            return Err(self.short());
        }
        if length == 0 {
            return Err("its data hold a code that is in no table".to_owned());
        }
        self.held <<= length;
        self.count -= u32::from(length);
        Ok(symbol)
    }

    fn short(&self) -> String {
        "its data end before its last block".to_owned()
    }

    /// Ends at a marker: no more than the rest of a byte is left. Returns how many bytes were read.
    pub(super) fn end(&mut self) -> Result<usize, String> {
        if self.count < 8 {
            self.fill();
        }
        if self.count >= 8 {
            return Err("its data go on behind its last block".to_owned());
        }
        (self.held, self.count) = (0, 0);
        Ok(self.at)
    }

    /// Passes over the restart marker of number `n` (0 to 7).
    pub(super) fn restart(&mut self, n: usize) -> Result<(), String> {
        self.end()?;
        while self
            .file
            .get(self.at..)
            .is_some_and(|rest| rest.starts_with(&[0xff, 0xff]))
        {
            self.at += 1;
        }
        if self.file.get(self.at..self.at + 2) != Some(&[0xff, 0xd0 + n as u8]) {
            return Err("a restart marker is missing".to_owned());
        }
        self.at += 2;
        Ok(())
    }
}
