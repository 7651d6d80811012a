//! Dictionaries of numpy's arrays, as Python's `pickle` writes them (protocols 2 and 3). Nothing is
//! executed.
//!
//! A pickle is a program for a machine with a stack. This one knows what the arrays need and
//! refuses all else: dictionaries with texts for keys, tuples, numbers, bytes, and three names
//! (`ndarray`, `dtype` and the function that makes an empty array), which stand for themselves and
//! call nothing. Nothing recurses; steps are counted, numbers stay where they are in the file, and
//! a length is compared with what is left of it.

use std::collections::BTreeMap;
use std::rc::Rc;

/// Most steps that a file may take; a network of 13 layers takes 948.
const MAX_STEPS: usize = 100_000;
/// Most sides of an array.
const MAX_RANK: usize = 8;
/// Most dictionaries within one another.
const MAX_DEPTH: usize = 8;

/// Why a file is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("byte {at}: {what}")]
pub struct Refused {
    /// Where the machine was.
    at: usize,
    what: &'static str,
}

/// Numbers of 32 bits, little-endian, the last side next to one another.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Array<'a> {
    /// Its sides.
    pub shape: Vec<usize>,
    /// Four times as many bytes as the sides' product.
    pub bytes: &'a [u8],
}

/// Arrays by their keys from the outermost dictionary on, joined by `/`.
type Arrays<'a> = BTreeMap<String, Array<'a>>;

#[derive(Debug, Clone)]
enum Value<'a> {
    /// What lies above it is one tuple, or goes into one dictionary.
    Mark,
    None,
    Bool(bool),
    Int(i64),
    Text(&'a str),
    Bytes(&'a [u8]),
    Tuple(Rc<[Self]>),
    /// The function that makes an empty array.
    Reconstruct,
    NdArray,
    DType,
    /// The type of little-endian numbers of 32 bits.
    F32,
    Dict(Arrays<'a>),
    /// An array whose state is not known yet.
    Empty,
    Array(Array<'a>),
}

struct Machine<'a> {
    file: &'a [u8],
    at: usize,
    stack: Vec<Value<'a>>,
    memo: BTreeMap<u32, Value<'a>>,
}

/// The arrays of the pickled dictionary `file`.
pub fn arrays(file: &[u8]) -> Result<Arrays<'_>, Refused> {
    let mut machine = Machine {
        file,
        at: 0,
        stack: Vec::new(),
        memo: BTreeMap::new(),
    };
    for _ in 0..MAX_STEPS {
        if machine.step()? {
            if machine.at != file.len() {
                return machine.refuse("something comes after the end");
            }
            return match (machine.pop()?, machine.stack.is_empty()) {
                (Value::Dict(arrays), true) => Ok(arrays),
                _ => machine.refuse("what was pickled is not a dictionary"),
            };
        }
    }
    machine.refuse("more steps than any checkpoint takes")
}

impl<'a> Machine<'a> {
    fn refuse<T>(&self, what: &'static str) -> Result<T, Refused> {
        Err(Refused { at: self.at, what })
    }

    fn take(&mut self, n: usize) -> Result<&'a [u8], Refused> {
        let Some(bytes) = self.file[self.at..].get(..n) else {
            return self.refuse("the file ends too early");
        };
        self.at += n;
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

    fn line(&mut self) -> Result<&'a [u8], Refused> {
        match self.file[self.at..]
            .iter()
            .take(256)
            .position(|&b| b == b'\n')
        {
            Some(n) => self.take(n + 1).map(|line| &line[..n]),
            None => self.refuse("a name has no end"),
        }
    }

    fn pop(&mut self) -> Result<Value<'a>, Refused> {
        match self.stack.pop() {
            None | Some(Value::Mark) => self.refuse("the stack is empty"),
            Some(value) => Ok(value),
        }
    }

    /// What lies above the last mark, which is taken away.
    fn above_mark(&mut self) -> Result<Vec<Value<'a>>, Refused> {
        let Some(mark) = self
            .stack
            .iter()
            .rposition(|value| matches!(value, Value::Mark))
        else {
            return self.refuse("no mark was set");
        };
        let values = self.stack.split_off(mark + 1);
        self.stack.pop();
        Ok(values)
    }

    fn tuple(&self, values: Vec<Value<'a>>) -> Result<Value<'a>, Refused> {
        let is_tuple = |value: &Value<'a>| matches!(value, Value::Tuple(_));
        let deep =
            |value: &Value<'a>| matches!(value, Value::Tuple(inner) if inner.iter().any(is_tuple));
        if values.iter().any(deep) {
            return self.refuse("tuples lie in one another too deep");
        }
        Ok(Value::Tuple(values.into()))
    }

    fn tuple_of(&mut self, n: usize) -> Result<Value<'a>, Refused> {
        let mut values = (0..n).map(|_| self.pop()).collect::<Result<Vec<_>, _>>()?;
        values.reverse();
        self.tuple(values)
    }

    /// One step; true at the end of the program.
    fn step(&mut self) -> Result<bool, Refused> {
        let step = self.byte()?;
        let value = match step {
            b'\x80' => {
                if !(2..=3).contains(&self.byte()?) {
                    return self.refuse("a pickle of another protocol than 2 or 3");
                }
                return Ok(false);
            }
            b'.' => return Ok(true),
            b'(' => Value::Mark,
            b'N' => Value::None,
            b'\x88' | b'\x89' => Value::Bool(step == b'\x88'),
            b'K' => Value::Int(i64::from(self.byte()?)),
            b'M' => Value::Int(i64::from(u16::from_le_bytes(self.fixed()?))),
            b'J' => Value::Int(i64::from(i32::from_le_bytes(self.fixed()?))),
            b'X' => match std::str::from_utf8(self.counted()?) {
                Ok(text) => Value::Text(text),
                Err(_) => return self.refuse("a text is not UTF-8"),
            },
            b'B' => Value::Bytes(self.counted()?),
            b'C' => {
                let n = self.byte()?;
                Value::Bytes(self.take(usize::from(n))?)
            }
            b'}' => Value::Dict(BTreeMap::new()),
            b')' => Value::Tuple(Rc::new([])),
            b'\x85' => self.tuple_of(1)?,
            b'\x86' => self.tuple_of(2)?,
            b'\x87' => self.tuple_of(3)?,
            b't' => {
                let values = self.above_mark()?;
                self.tuple(values)?
            }
            b'c' => match (self.line()?, self.line()?) {
                (b"numpy.core.multiarray" | b"numpy._core.multiarray", b"_reconstruct") => {
                    Value::Reconstruct
                }
                (b"numpy", b"ndarray") => Value::NdArray,
                (b"numpy", b"dtype") => Value::DType,
                _ => return self.refuse("something of Python that is not an array"),
            },
            b'q' | b'r' => {
                let key = if step == b'q' {
                    u32::from(self.byte()?)
                } else {
                    self.word()?
                };
                let value = self.pop()?;
                let memo_value = match &value {
                    // these may be in one place alone
                    Value::Dict(_) | Value::Empty | Value::Array(_) => Value::Mark,
                    other => other.clone(),
                };
                self.memo.insert(key, memo_value);
                value
            }
            b'h' | b'j' => {
                let key = if step == b'h' {
                    u32::from(self.byte()?)
                } else {
                    self.word()?
                };
                match self.memo.get(&key) {
                    None => return self.refuse("nothing was kept under this number"),
                    Some(Value::Mark) => {
                        return self.refuse("a dictionary or an array is in two places");
                    }
                    Some(memo_value) => memo_value.clone(),
                }
            }
            b's' => {
                let (value, key) = (self.pop()?, self.pop()?);
                self.inserted(vec![key, value])?
            }
            b'u' => {
                let pairs = self.above_mark()?;
                self.inserted(pairs)?
            }
            b'R' => self.called()?,
            b'b' => self.built()?,
            _ => return self.refuse("a step that arrays do not need"),
        };
        self.stack.push(value);
        Ok(false)
    }

    /// The dictionary on the stack with keys and values, one after the other.
    fn inserted(&mut self, pairs: Vec<Value<'a>>) -> Result<Value<'a>, Refused> {
        let Value::Dict(mut dict) = self.pop()? else {
            return self.refuse("this is not a dictionary");
        };
        let mut pairs = pairs.into_iter();
        while let Some(key) = pairs.next() {
            let Value::Text(key) = key else {
                return self.refuse("a key is not text");
            };
            let arrays: Arrays<'a> = match pairs.next() {
                None => return self.refuse("a key has no value"),
                Some(Value::Array(array)) => [(key.to_owned(), array)].into(),
                Some(Value::Dict(inner)) => inner
                    .into_iter()
                    .map(|(name, array)| (format!("{key}/{name}"), array))
                    .collect(),
                Some(_) => return self.refuse("a dictionary holds something that is not an array"),
            };
            for (name, array) in arrays {
                if name.matches('/').count() >= MAX_DEPTH {
                    return self.refuse("dictionaries lie in one another too deep");
                }
                if dict.insert(name, array).is_some() {
                    return self.refuse("a key is there twice");
                }
            }
        }
        Ok(Value::Dict(dict))
    }

    /// An empty array, or a type, instead of a name and its arguments.
    fn called(&mut self) -> Result<Value<'a>, Refused> {
        let (args, name) = (self.pop()?, self.pop()?);
        let Value::Tuple(args) = args else {
            return self.refuse("a call without arguments");
        };
        match (name, &args[..]) {
            (Value::Reconstruct, [Value::NdArray, Value::Tuple(_), Value::Bytes(_)]) => {
                Ok(Value::Empty)
            }
            (Value::DType, [Value::Text("f4"), ..]) => Ok(Value::F32),
            (Value::DType, _) => self.refuse(OTHER_NUMBERS),
            _ => self.refuse("a call that arrays do not need"),
        }
    }

    /// An array, or a type, with its state.
    fn built(&mut self) -> Result<Value<'a>, Refused> {
        let (state, object) = (self.pop()?, self.pop()?);
        let Value::Tuple(state) = state else {
            return self.refuse("a state is not a tuple");
        };
        match (object, &state[..]) {
            (Value::F32, [Value::Int(_), Value::Text("<"), ..]) => Ok(Value::F32),
            (Value::F32, _) => self.refuse(OTHER_NUMBERS),
            (
                Value::Empty,
                [
                    Value::Int(_),
                    Value::Tuple(sides),
                    Value::F32,
                    Value::Bool(by_columns),
                    Value::Bytes(bytes),
                ],
            ) => {
                if *by_columns {
                    return self.refuse(OTHER_NUMBERS);
                }
                let side = |side: &Value<'a>| match side {
                    Value::Int(n) => usize::try_from(*n).ok(),
                    _ => None,
                };
                let shape: Option<Vec<usize>> = sides.iter().map(side).collect();
                let Some(shape) = shape.filter(|shape| shape.len() <= MAX_RANK) else {
                    return self.refuse("a shape is not of a few whole numbers");
                };
                if shape
                    .iter()
                    .try_fold(4usize, |n, &side| n.checked_mul(side))
                    != Some(bytes.len())
                {
                    return self.refuse("an array has another number of bytes than its shape says");
                }
                Ok(Value::Array(Array { shape, bytes }))
            }
            _ => self.refuse("a state that arrays do not have"),
        }
    }
}

const OTHER_NUMBERS: &str = "an array is not of little-endian 32-bit numbers, row by row";
