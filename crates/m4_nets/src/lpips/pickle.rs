//! Dictionaries of numpy's arrays, as Python's `pickle` writes them (protocols 2 and 3). Nothing is executed.
//!
//! A pickle is a program for a machine with a stack. This one knows what the arrays need and refuses all else: dictionaries
//! with texts for keys, tuples, numbers, bytes, and three names (`ndarray`, `dtype` and the function that makes an empty array), which
//! stand for themselves and call nothing. Objects lie in lists and refer to one another by number, so that nothing here recurses;
//! steps are counted, numbers stay where they are in the file, and a length is compared with what is left of it.

use std::collections::{BTreeMap, BTreeSet};

/// Most steps that a file may take; a network of 13 layers takes 948.
const MAX_STEPS: usize = 100_000;
/// Most sides of an array.
const MAX_RANK: usize = 8;

/// Why a file is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("byte {at}: {what}")]
pub struct Refused {
    /// Where the machine was.
    pub at: usize,
    /// What is wrong there.
    pub what: &'static str,
}

/// Numbers of 32 bits, little-endian, the last side next to one another.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Array<'a> {
    /// Its sides.
    pub shape: Vec<usize>,
    /// Four times as many bytes as the sides' product.
    pub bytes: &'a [u8],
}

/// What lies on the stack. Numbers are those of the lists of [`Machine`].
#[derive(Debug, Clone, Copy)]
enum Value<'a> {
    None,
    Bool(bool),
    Int(i64),
    Text(&'a str),
    Bytes(&'a [u8]),
    Tuple(usize),
    Dict(usize),
    Array(usize),
    Type(usize),
    Name(Name),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Name {
    Reconstruct,
    NdArray,
    DType,
}

impl Name {
    fn of(module: &str, name: &str) -> Option<Self> {
        match (module, name) {
            ("numpy.core.multiarray" | "numpy._core.multiarray", "_reconstruct") => Some(Self::Reconstruct),
            ("numpy", "ndarray") => Some(Self::NdArray),
            ("numpy", "dtype") => Some(Self::DType),
            _ => None,
        }
    }
}

/// What kind of numbers an array has.
#[derive(Debug, Clone, Copy)]
struct Type {
    is_f32: bool,
    is_little_endian: bool,
}

struct Machine<'a> {
    file: &'a [u8],
    at: usize,
    stack: Vec<Value<'a>>,
    /// How long the stack was where a mark was set.
    marks: Vec<usize>,
    memo: BTreeMap<u32, Value<'a>>,
    tuples: Vec<Vec<Value<'a>>>,
    dicts: Vec<Vec<(&'a str, Value<'a>)>>,
    /// Empty until their state is known.
    arrays: Vec<Option<Array<'a>>>,
    types: Vec<Type>,
}

/// The arrays of the pickled dictionary `file` by their keys from the outermost dictionary on, joined by `/`.
pub fn arrays(file: &[u8]) -> Result<BTreeMap<String, Array<'_>>, Refused> {
    let mut machine = Machine {
        file,
        at: 0,
        stack: Vec::new(),
        marks: Vec::new(),
        memo: BTreeMap::new(),
        tuples: Vec::new(),
        dicts: Vec::new(),
        arrays: Vec::new(),
        types: Vec::new(),
    };
    for _ in 0..MAX_STEPS {
        if machine.step()? {
            return machine.finish();
        }
    }
    Err(machine.refused("more steps than any checkpoint takes"))
}

impl<'a> Machine<'a> {
    fn refused(&self, what: &'static str) -> Refused {
        Refused { at: self.at, what }
    }

    fn take(&mut self, n: usize) -> Result<&'a [u8], Refused> {
        let end = self.at.checked_add(n).filter(|&end| end <= self.file.len());
        let Some(end) = end else {
            return Err(self.refused("the file ends too early"));
        };
        let bytes = &self.file[self.at..end];
        self.at = end;
        Ok(bytes)
    }

    fn fixed<const N: usize>(&mut self) -> Result<[u8; N], Refused> {
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N)?);
        Ok(bytes)
    }

    fn byte(&mut self) -> Result<u8, Refused> {
        self.fixed::<1>().map(|[byte]| byte)
    }

    fn word(&mut self) -> Result<u32, Refused> {
        self.fixed().map(u32::from_le_bytes)
    }

    /// A length, then as many bytes.
    fn counted(&mut self) -> Result<&'a [u8], Refused> {
        let n = self.word()?;
        self.take(usize::try_from(n).unwrap_or(usize::MAX))
    }

    fn text(&self, bytes: &'a [u8]) -> Result<&'a str, Refused> {
        std::str::from_utf8(bytes).map_err(|_| self.refused("a text is not UTF-8"))
    }

    fn line(&mut self) -> Result<&'a str, Refused> {
        let rest = &self.file[self.at..];
        let n = rest.iter().take(256).position(|&b| b == b'\n');
        let n = n.ok_or_else(|| self.refused("a name has no end"))?;
        let bytes = self.take(n + 1)?;
        self.text(&bytes[..n])
    }

    fn pop(&mut self) -> Result<Value<'a>, Refused> {
        let floor = self.marks.last().copied().unwrap_or(0);
        if self.stack.len() <= floor {
            return Err(self.refused("the stack is empty"));
        }
        self.stack.pop().ok_or_else(|| self.refused("the stack is empty"))
    }

    /// What lies above the last mark, which is taken away.
    fn above_mark(&mut self) -> Result<Vec<Value<'a>>, Refused> {
        let mark = self.marks.pop().ok_or_else(|| self.refused("no mark was set"))?;
        Ok(self.stack.split_off(mark))
    }

    fn push_tuple(&mut self, values: Vec<Value<'a>>) {
        self.tuples.push(values);
        self.stack.push(Value::Tuple(self.tuples.len() - 1));
    }

    fn tuple_of(&mut self, n: usize) -> Result<(), Refused> {
        let mut values = (0..n).map(|_| self.pop()).collect::<Result<Vec<_>, _>>()?;
        values.reverse();
        self.push_tuple(values);
        Ok(())
    }

    /// One step; true at the end of the program.
    fn step(&mut self) -> Result<bool, Refused> {
        let step = self.byte()?;
        let value = match step {
            b'N' => Value::None,
            b'\x88' | b'\x89' => Value::Bool(step == b'\x88'),
            b'K' => Value::Int(i64::from(self.byte()?)),
            b'M' => Value::Int(i64::from(u16::from_le_bytes(self.fixed()?))),
            b'J' => Value::Int(i64::from(i32::from_le_bytes(self.fixed()?))),
            b'X' => {
                let bytes = self.counted()?;
                Value::Text(self.text(bytes)?)
            }
            b'B' => Value::Bytes(self.counted()?),
            b'C' => {
                let n = self.byte()?;
                Value::Bytes(self.take(usize::from(n))?)
            }
            _ => return self.operation(step),
        };
        self.stack.push(value);
        Ok(false)
    }

    /// A step that does not just push a value; true at the end of the program.
    fn operation(&mut self, step: u8) -> Result<bool, Refused> {
        match step {
            b'\x80' => {
                if !(2..=3).contains(&self.byte()?) {
                    return Err(self.refused("a pickle of another protocol than 2 or 3"));
                }
            }
            b'.' => return Ok(true),
            b'(' => self.marks.push(self.stack.len()),
            b'}' => {
                self.dicts.push(Vec::new());
                self.stack.push(Value::Dict(self.dicts.len() - 1));
            }
            b')' => self.push_tuple(Vec::new()),
            b'\x85' => self.tuple_of(1)?,
            b'\x86' => self.tuple_of(2)?,
            b'\x87' => self.tuple_of(3)?,
            b't' => {
                let values = self.above_mark()?;
                self.push_tuple(values);
            }
            b'c' => {
                let (module, name) = (self.line()?, self.line()?);
                let name = Name::of(module, name);
                let name = name.ok_or_else(|| self.refused("something of Python that is not an array"))?;
                self.stack.push(Value::Name(name));
            }
            b'q' => {
                let key = self.byte()?;
                self.remember(u32::from(key))?;
            }
            b'r' => {
                let key = self.word()?;
                self.remember(key)?;
            }
            b'h' => {
                let key = self.byte()?;
                self.recall(u32::from(key))?;
            }
            b'j' => {
                let key = self.word()?;
                self.recall(key)?;
            }
            b's' => {
                let (value, key) = (self.pop()?, self.pop()?);
                self.insert(&[key, value])?;
            }
            b'u' => {
                let pairs = self.above_mark()?;
                self.insert(&pairs)?;
            }
            b'R' => self.call()?,
            b'b' => self.set_state()?,
            _ => return Err(self.refused("a step that arrays do not need")),
        }
        Ok(false)
    }

    fn remember(&mut self, key: u32) -> Result<(), Refused> {
        let value = self.pop()?;
        self.memo.insert(key, value);
        self.stack.push(value);
        Ok(())
    }

    fn recall(&mut self, key: u32) -> Result<(), Refused> {
        let value = self.memo.get(&key).copied();
        let value = value.ok_or_else(|| self.refused("nothing was kept under this number"))?;
        self.stack.push(value);
        Ok(())
    }

    /// Puts keys and values, one after the other, into the dictionary on the stack.
    fn insert(&mut self, pairs: &[Value<'a>]) -> Result<(), Refused> {
        let Some(&Value::Dict(dict)) = self.stack.last() else {
            return Err(self.refused("this is not a dictionary"));
        };
        let (pairs, rest) = pairs.as_chunks::<2>();
        if !rest.is_empty() {
            return Err(self.refused("a key has no value"));
        }
        for &[key, value] in pairs {
            let Value::Text(key) = key else {
                return Err(self.refused("a key is not text"));
            };
            self.dicts[dict].push((key, value));
        }
        Ok(())
    }

    /// An empty array, or a type, instead of a name and its arguments.
    fn call(&mut self) -> Result<(), Refused> {
        let (args, name) = (self.pop()?, self.pop()?);
        let (Value::Tuple(args), Value::Name(name)) = (args, name) else {
            return Err(self.refused("a call of what cannot be called"));
        };
        let made = match (name, &self.tuples[args][..]) {
            (Name::Reconstruct, [Value::Name(Name::NdArray), Value::Tuple(_), Value::Bytes(_)]) => {
                self.arrays.push(None);
                Value::Array(self.arrays.len() - 1)
            }
            (Name::DType, [Value::Text(name), ..]) => {
                self.types.push(Type { is_f32: *name == "f4", is_little_endian: false });
                Value::Type(self.types.len() - 1)
            }
            _ => return Err(self.refused("a call that arrays do not need")),
        };
        self.stack.push(made);
        Ok(())
    }

    /// Gives an array or a type, which stays on the stack, its state.
    fn set_state(&mut self) -> Result<(), Refused> {
        let (state, object) = (self.pop()?, self.pop()?);
        let Value::Tuple(state) = state else {
            return Err(self.refused("a state is not a tuple"));
        };
        match (object, &self.tuples[state][..]) {
            (Value::Type(of), [Value::Int(_), Value::Text(order), ..]) => {
                self.types[of].is_little_endian = *order == "<"
            }
            (
                Value::Array(array),
                &[Value::Int(_), Value::Tuple(shape), Value::Type(of), Value::Bool(by_columns), Value::Bytes(bytes)],
            ) => {
                let numbers = self.types[of];
                if by_columns || !numbers.is_f32 || !numbers.is_little_endian {
                    return Err(self.refused("an array is not of little-endian 32-bit numbers, row by row"));
                }
                let shape = self.shape(&self.tuples[shape])?;
                let fits = shape.iter().try_fold(4usize, |n, &side| n.checked_mul(side)) == Some(bytes.len());
                if !fits {
                    return Err(self.refused("an array has another number of bytes than its shape says"));
                }
                self.arrays[array] = Some(Array { shape, bytes });
            }
            _ => return Err(self.refused("a state that arrays do not have")),
        }
        self.stack.push(object);
        Ok(())
    }

    fn shape(&self, sides: &[Value<'a>]) -> Result<Vec<usize>, Refused> {
        if sides.len() > MAX_RANK {
            return Err(self.refused("an array of too many sides"));
        }
        let side = |side: &Value<'a>| match side {
            Value::Int(n) => usize::try_from(*n).ok(),
            _ => None,
        };
        let sides = sides.iter().map(side).collect::<Option<_>>();
        sides.ok_or_else(|| self.refused("a shape is not of whole numbers"))
    }
}

/// Most dictionaries within one another.
const MAX_DEPTH: usize = 8;

impl<'a> Machine<'a> {
    /// What the dictionary on the stack holds.
    pub(super) fn finish(mut self) -> Result<BTreeMap<String, Array<'a>>, Refused> {
        if self.at != self.file.len() {
            return Err(self.refused("something comes after the end"));
        }
        let root = self.pop()?;
        let (Value::Dict(root), true) = (root, self.stack.is_empty()) else {
            return Err(self.refused("what was pickled is not a dictionary"));
        };
        let mut found = BTreeMap::new();
        let mut seen = BTreeSet::from([root]);
        let mut open = vec![(root, String::new(), 1)];
        while let Some((dict, prefix, depth)) = open.pop() {
            let entries = std::mem::take(&mut self.dicts[dict]);
            let mut keys = BTreeSet::new();
            for (key, value) in entries {
                if !keys.insert(key) {
                    return Err(self.refused("a key is there twice"));
                }
                let name = format!("{prefix}{key}");
                match value {
                    Value::Dict(inner) if depth < MAX_DEPTH && seen.insert(inner) => {
                        open.push((inner, name + "/", depth + 1));
                    }
                    Value::Dict(_) => {
                        return Err(self.refused("dictionaries lie in one another too deep, or in two places"));
                    }
                    Value::Array(array) => {
                        let array = self.arrays[array].take();
                        let array = array.ok_or_else(|| self.refused("an array is empty or in two places"))?;
                        if found.insert(name, array).is_some() {
                            return Err(self.refused("a name is there twice"));
                        }
                    }
                    _ => return Err(self.refused("a dictionary holds something that is not an array")),
                }
            }
        }
        Ok(found)
    }
}
