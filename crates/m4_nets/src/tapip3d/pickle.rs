//! What a pickle of Python holds, as JSON: an interpreter of pickles that executes nothing.
//!
//! Dictionaries, lists, text and numbers are what they are. An object of any class keeps its state
//! and its items, and no class is looked up. Objects refer to one another, also in circles: they
//! are indices into one list.

use serde_json::{Map, Value};
use std::collections::HashMap;

/// Most objects of a pickle, and of the JSON that is made of it.
const MOST_OBJECTS: usize = 1 << 20;
/// Deepest JSON that is made.
const MOST_DEPTH: usize = 64;

type Id = usize;

#[derive(Debug, Clone)]
enum Object {
    Value(Value),
    List(Vec<Id>),
    /// A dictionary.
    Dict(Vec<(Id, Id)>),
    /// An object of a class, by its state and its items, or a class or a stored tensor.
    Other {
        state: Option<Id>,
        items: Vec<(Id, Id)>,
    },
}

impl Object {
    fn other() -> Self {
        Self::Other {
            state: None,
            items: Vec::new(),
        }
    }
}

/// The objects of a pickle.
pub struct Pickle {
    objects: Vec<Object>,
    root: Id,
}

impl Pickle {
    /// Reads the pickle `bytes`, of protocols 2 to 5.
    ///
    /// # Errors
    ///
    /// The reason, if it is cut off, or has an operation that no checkpoint has.
    pub fn read(bytes: &[u8]) -> Result<Self, String> {
        let mut machine = Machine {
            bytes,
            objects: Vec::new(),
            stack: Vec::new(),
            marks: Vec::new(),
            memo: HashMap::new(),
        };
        loop {
            if let Some(root) = machine.step()? {
                return Ok(Self {
                    objects: machine.objects,
                    root,
                });
            }
        }
    }

    /// The entry `key` of the dictionary as JSON. The containers and the nodes of OmegaConf are
    /// what they hold.
    ///
    /// # Errors
    ///
    /// The reason, if it is missing, or something in it has no counterpart in JSON.
    pub fn entry(&self, key: &str) -> Result<Value, String> {
        let id = match &self.objects[self.root] {
            Object::Dict(items) | Object::Other { items, .. } => self.get(items, key),
            _ => None,
        };
        let id = id.ok_or_else(|| format!("it has no `{key}`"))?;
        self.json(id, 0, &mut 0)
    }

    fn get(&self, items: &[(Id, Id)], key: &str) -> Option<Id> {
        // the last of several, as in Python
        let entry = items
            .iter()
            .rev()
            .find(|(name, _)| self.text(*name) == Some(key));
        entry.map(|(_, value)| *value)
    }

    fn text(&self, id: Id) -> Option<&str> {
        match &self.objects[id] {
            Object::Value(Value::String(text)) => Some(text),
            _ => None,
        }
    }

    fn json(&self, id: Id, depth: usize, count: &mut usize) -> Result<Value, String> {
        *count += 1;
        if depth > MOST_DEPTH || *count > MOST_OBJECTS {
            return Err("its objects are nested too deeply".to_owned());
        }
        match &self.objects[id] {
            Object::Value(value) => Ok(value.clone()),
            Object::List(items) => {
                let items = items.iter().map(|&item| self.json(item, depth + 1, count));
                items.collect::<Result<Vec<_>, _>>().map(Value::Array)
            }
            Object::Dict(items) => {
                let mut map = Map::new();
                for &(key, value) in items {
                    let key = self.text(key).ok_or("a key in it is no text")?;
                    map.insert(key.to_owned(), self.json(value, depth + 1, count)?);
                }
                Ok(Value::Object(map))
            }
            Object::Other { state, .. } => {
                let state = state.map(|state| &self.objects[state]);
                let Some(Object::Dict(state)) = state else {
                    return Err("an object in it is of no class that is known here".to_owned());
                };
                let content = self.get(state, "_content").or(self.get(state, "_val"));
                let content = content.ok_or("an object in it has no content")?;
                self.json(content, depth + 1, count)
            }
        }
    }
}

struct Machine<'a> {
    bytes: &'a [u8],
    objects: Vec<Object>,
    stack: Vec<Id>,
    /// Heights of the stack.
    marks: Vec<usize>,
    memo: HashMap<u32, Id>,
}

fn cut() -> String {
    "it is cut off".to_owned()
}

impl<'a> Machine<'a> {
    fn take(&mut self, n: usize) -> Result<&'a [u8], String> {
        let (first, rest) = self.bytes.split_at_checked(n).ok_or_else(cut)?;
        self.bytes = rest;
        Ok(first)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        self.take(N)?.try_into().map_err(|_| cut())
    }

    fn line(&mut self) -> Result<(), String> {
        let end = self
            .bytes
            .iter()
            .position(|&b| b == b'\n')
            .ok_or_else(cut)?;
        self.take(end + 1).map(drop)
    }

    fn length(&mut self) -> Result<usize, String> {
        Ok(u32::from_le_bytes(self.array()?) as usize)
    }

    fn text(&mut self, n: usize) -> Result<(), String> {
        let text = String::from_utf8_lossy(self.take(n)?).into_owned();
        self.push(Object::Value(Value::String(text)))
    }

    fn push(&mut self, object: Object) -> Result<(), String> {
        if self.objects.len() >= MOST_OBJECTS {
            return Err("it has too many objects".to_owned());
        }
        self.stack.push(self.objects.len());
        self.objects.push(object);
        Ok(())
    }

    fn pop(&mut self) -> Result<Id, String> {
        self.stack
            .pop()
            .ok_or_else(|| "its stack is empty".to_owned())
    }

    fn top(&mut self) -> Result<&mut Object, String> {
        let &id = self.stack.last().ok_or("its stack is empty")?;
        Ok(&mut self.objects[id])
    }

    /// Everything above the last mark.
    fn marked(&mut self) -> Result<Vec<Id>, String> {
        let height = self
            .marks
            .pop()
            .filter(|&height| height <= self.stack.len());
        let height = height.ok_or("a mark is missing")?;
        Ok(self.stack.split_off(height))
    }

    fn tuple(&mut self, n: usize) -> Result<(), String> {
        let start = self
            .stack
            .len()
            .checked_sub(n)
            .ok_or("its stack is empty")?;
        let items = self.stack.split_off(start);
        self.push(Object::List(items))
    }

    fn set(&mut self, items: &[Id]) -> Result<(), String> {
        let pairs = items.chunks_exact(2).map(|pair| (pair[0], pair[1]));
        match self.top()? {
            Object::Dict(all) | Object::Other { items: all, .. } => all.extend(pairs),
            _ => return Err("what has entries is no dictionary".to_owned()),
        }
        Ok(())
    }

    fn append(&mut self, items: &[Id]) -> Result<(), String> {
        match self.top()? {
            Object::List(all) => all.extend(items),
            // a sequence of another class
            Object::Other { .. } => {}
            _ => return Err("what has items is no list".to_owned()),
        }
        Ok(())
    }

    fn remember(&mut self, key: u32) -> Result<(), String> {
        let &id = self.stack.last().ok_or("its stack is empty")?;
        self.memo.insert(key, id);
        Ok(())
    }

    fn recall(&mut self, key: u32) -> Result<(), String> {
        let &id = self.memo.get(&key).ok_or("it refers to nothing")?;
        self.stack.push(id);
        Ok(())
    }

    /// Takes one operation; returns the root after the last one.
    fn step(&mut self) -> Result<Option<Id>, String> {
        let [operation] = self.array()?;
        match operation {
            // the protocol, and the length of a frame
            0x80 => drop(self.take(1)?),
            0x95 => drop(self.take(8)?),
            b'.' => return self.pop().map(Some),
            b'(' => self.marks.push(self.stack.len()),
            b'0' => drop(self.pop()?),
            b'1' => drop(self.marked()?),
            b'2' => {
                let &id = self.stack.last().ok_or("its stack is empty")?;
                self.stack.push(id);
            }
            b'N' => self.push(Object::Value(Value::Null))?,
            0x88 => self.push(Object::Value(true.into()))?,
            0x89 => self.push(Object::Value(false.into()))?,
            b'K' => {
                let [n] = self.array()?;
                self.push(Object::Value(n.into()))?;
            }
            b'M' => {
                let n = u16::from_le_bytes(self.array()?);
                self.push(Object::Value(n.into()))?;
            }
            b'J' => {
                let n = i32::from_le_bytes(self.array()?);
                self.push(Object::Value(n.into()))?;
            }
            // a whole number of any length
            0x8a => {
                let [n] = self.array()?;
                let bytes = self.take(usize::from(n))?;
                let fill = bytes
                    .last()
                    .map_or(0, |&b| if b & 0x80 == 0 { 0 } else { 0xff });
                let mut all = [fill; 8];
                let object = match all.get_mut(..bytes.len()) {
                    Some(low) => {
                        low.copy_from_slice(bytes);
                        Object::Value(i64::from_le_bytes(all).into())
                    }
                    None => Object::other(),
                };
                self.push(object)?;
            }
            b'G' => {
                let number = f64::from_be_bytes(self.array()?);
                self.push(Object::Value(number.into()))?;
            }
            b'X' | b'T' => {
                let n = self.length()?;
                self.text(n)?;
            }
            0x8c | b'U' => {
                let [n] = self.array()?;
                self.text(usize::from(n))?;
            }
            b'B' => {
                let n = self.length()?;
                self.take(n)?;
                self.push(Object::other())?;
            }
            b'C' => {
                let [n] = self.array()?;
                self.take(usize::from(n))?;
                self.push(Object::other())?;
            }
            b'}' => self.push(Object::Dict(Vec::new()))?,
            b']' | b')' => self.push(Object::List(Vec::new()))?,
            b't' => {
                let items = self.marked()?;
                self.push(Object::List(items))?;
            }
            0x85..=0x87 => self.tuple(usize::from(operation - 0x84))?,
            b's' => {
                let value = self.pop()?;
                let key = self.pop()?;
                self.set(&[key, value])?;
            }
            b'u' => {
                let items = self.marked()?;
                self.set(&items)?;
            }
            b'a' => {
                let item = self.pop()?;
                self.append(&[item])?;
            }
            b'e' => {
                let items = self.marked()?;
                self.append(&items)?;
            }
            // a class, by two lines or two texts
            b'c' => {
                self.line()?;
                self.line()?;
                self.push(Object::other())?;
            }
            0x93 => {
                self.pop()?;
                self.pop()?;
                self.push(Object::other())?;
            }
            // an object of a class and its arguments
            b'R' | 0x81 => {
                self.pop()?;
                self.pop()?;
                self.push(Object::other())?;
            }
            b'b' => {
                let built = self.pop()?;
                if let Object::Other { state, .. } = self.top()? {
                    *state = Some(built);
                }
            }
            // a tensor's numbers, which are in another file
            b'Q' => {
                self.pop()?;
                self.push(Object::other())?;
            }
            b'q' => {
                let [key] = self.array()?;
                self.remember(u32::from(key))?;
            }
            b'r' => {
                let key = u32::from_le_bytes(self.array()?);
                self.remember(key)?;
            }
            0x94 => self.remember(self.memo.len() as u32)?,
            b'h' => {
                let [key] = self.array()?;
                self.recall(u32::from(key))?;
            }
            b'j' => {
                let key = u32::from_le_bytes(self.array()?);
                self.recall(key)?;
            }
            other => return Err(format!("the operation {other:#x} in it is not known here")),
        }
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use super::Pickle;
    use m4_core::CounterRng;
    use serde_json::json;

    /// By Python: `pickle.dumps({"a": [1, -2, 300, 1 << 40, 0.5, None, True], "b": (3, "x")},
    /// protocol)`.
    const SECOND: &[u8] =
        b"\x80\x02}q\x00(X\x01\x00\x00\x00aq\x01]q\x02(K\x01J\xfe\xff\xff\xffM,\x01\
        \x8a\x06\x00\x00\x00\x00\x00\x01G?\xe0\x00\x00\x00\x00\x00\x00N\x88eX\x01\x00\x00\x00bq\x03\
        K\x03X\x01\x00\x00\x00xq\x04\x86q\x05u.";
    const FOURTH: &[u8] =
        b"\x80\x04\x956\x00\x00\x00\x00\x00\x00\x00}\x94(\x8c\x01a\x94]\x94(K\x01\
        J\xfe\xff\xff\xffM,\x01\x8a\x06\x00\x00\x00\x00\x00\x01G?\xe0\x00\x00\x00\x00\x00\x00N\x88e\
        \x8c\x01b\x94K\x03\x8c\x01x\x94\x86\x94u.";

    #[test]
    fn values_are_what_python_pickled() {
        for bytes in [SECOND, FOURTH] {
            let pickle = Pickle::read(bytes).unwrap();
            let first = json!([1, -2, 300, 1_u64 << 40, 0.5, null, true]);
            assert_eq!(pickle.entry("a").unwrap(), first);
            assert_eq!(pickle.entry("b").unwrap(), json!([3, "x"]));
            assert!(pickle.entry("c").unwrap_err().contains("`c`"));
            for n in 0..bytes.len() {
                assert!(Pickle::read(&bytes[..n]).is_err(), "cut at {n}");
            }
        }
    }

    #[test]
    fn lists_in_circles_and_wide_ones_end() {
        // a = []; a.append(a); {"a": a}
        let circle = b"\x80\x02}X\x01\x00\x00\x00a]q\x00h\x00as.";
        assert!(Pickle::read(circle).unwrap().entry("a").is_err());
        // each list holds the one before twice
        let mut wide = b"\x80\x02}X\x01\x00\x00\x00a]q\x00".to_vec();
        for _ in 0..50 {
            wide.extend(b"0](h\x00h\x00eq\x00");
        }
        wide.extend(b"s.");
        assert!(Pickle::read(&wide).unwrap().entry("a").is_err());
    }

    #[test]
    fn no_bytes_panic() {
        let mut rng = CounterRng::new(7, 0, 0);
        for _ in 0..2000 {
            let mut bytes = SECOND.to_vec();
            m4_testkit::mutate(&mut bytes, &mut rng);
            if let Ok(pickle) = Pickle::read(&bytes) {
                let _ = (pickle.entry("a"), pickle.entry("b"));
            }
        }
    }
}
