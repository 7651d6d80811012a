//! Planes of numbers within a budget: what was not used for longest goes to a file.

use half::f16;
use half::slice::HalfFloatSliceExt;
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::hash::Hash;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::PathBuf;

/// How numbers are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Storage {
    /// 16 bits, as upstream does: half the memory, three digits.
    #[default]
    F16,
    /// 32 bits.
    F32,
}

impl Storage {
    const fn bytes(self) -> usize {
        match self {
            Self::F16 => 2,
            Self::F32 => 4,
        }
    }

    fn encode(self, values: &[f32]) -> Vec<u8> {
        let mut out = Vec::with_capacity(values.len() * self.bytes());
        match self {
            Self::F32 => out.extend(values.iter().flat_map(|x| x.to_le_bytes())),
            Self::F16 => {
                let mut halves = [f16::ZERO; 256];
                for values in values.chunks(halves.len()) {
                    let halves = &mut halves[..values.len()];
                    halves.convert_from_f32_slice(values);
                    out.extend(halves.iter().flat_map(|x| x.to_le_bytes()));
                }
            }
        }
        out
    }

    fn decode(self, bytes: &[u8]) -> Vec<f32> {
        match self {
            Self::F32 => bytes.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect(),
            Self::F16 => {
                let mut out = vec![0.0; bytes.len() / 2];
                let mut halves = [f16::ZERO; 256];
                let words = bytes.as_chunks::<2>().0;
                for (words, out) in words.chunks(256).zip(out.chunks_mut(256)) {
                    let halves = &mut halves[..words.len()];
                    for (half, &word) in halves.iter_mut().zip(words) {
                        *half = f16::from_le_bytes(word);
                    }
                    halves.convert_to_f32_slice(out);
                }
                out
            }
        }
    }
}

/// Numbers by key. They are rounded to [`Storage`] whenever they are put in, so what comes out does not depend on where they
/// were meanwhile.
#[derive(Debug)]
pub struct Store<K> {
    storage: Storage,
    budget: usize,
    folder: PathBuf,
    entries: HashMap<K, Entry>,
    /// Keys of what lies in memory by when it was used last.
    order: BTreeMap<u64, K>,
    clock: u64,
    held: usize,
    most_held: usize,
    file: Option<File>,
    end: u64,
    /// Places of the file that nothing uses, by their size.
    free: HashMap<usize, Vec<u64>>,
}

#[derive(Debug)]
struct Entry {
    size: usize,
    /// The bytes and when they were used last, while they lie in memory.
    memory: Option<(Vec<u8>, u64)>,
    /// Where the file has a place for them.
    place: Option<u64>,
    /// Whether that place holds what is valid.
    written: bool,
}

impl<K: Copy + Eq + Hash> Store<K> {
    /// Holds at most `budget` bytes in memory, the rest in a nameless file in `folder` (made when it is needed).
    pub fn new(budget: usize, storage: Storage, folder: PathBuf) -> Self {
        Self {
            storage,
            budget,
            folder,
            entries: HashMap::new(),
            order: BTreeMap::new(),
            clock: 0,
            held: 0,
            most_held: 0,
            file: None,
            end: 0,
            free: HashMap::new(),
        }
    }

    /// Bytes in memory, now and at most so far.
    pub const fn held(&self) -> (usize, usize) {
        (self.held, self.most_held)
    }

    /// Bytes of the file.
    #[cfg(test)]
    pub const fn spilled(&self) -> u64 {
        self.end
    }

    pub fn folder(&self) -> &PathBuf {
        &self.folder
    }

    pub fn contains(&self, key: K) -> bool {
        self.entries.contains_key(&key)
    }

    /// Keeps `values` under `key`, instead of what was there.
    pub fn put(&mut self, key: K, values: &[f32]) -> io::Result<()> {
        let bytes = self.storage.encode(values);
        if self.entries.get(&key).is_some_and(|e| e.size != bytes.len()) {
            self.remove(key);
        }
        self.make_room(bytes.len())?;
        self.clock += 1;
        let entry =
            self.entries.entry(key).or_insert(Entry { size: bytes.len(), memory: None, place: None, written: false });
        entry.written = false;
        if bytes.len() > self.budget {
            return self.write(key, &bytes);
        }
        self.hold(key, bytes);
        Ok(())
    }

    /// What was put under `key`, rounded.
    pub fn get(&mut self, key: K) -> io::Result<Option<Vec<f32>>> {
        let Some(entry) = self.entries.get_mut(&key) else {
            return Ok(None);
        };
        if let Some((bytes, used)) = &mut entry.memory {
            let values = self.storage.decode(bytes);
            self.order.remove(used);
            self.clock += 1;
            *used = self.clock;
            self.order.insert(self.clock, key);
            return Ok(Some(values));
        }
        let (size, place) = (entry.size, entry.place);
        let (Some(place), Some(file)) = (place, &mut self.file) else {
            return Ok(None);
        };
        let mut bytes = vec![0; size];
        file.seek(SeekFrom::Start(place))?;
        file.read_exact(&mut bytes)?;
        let values = self.storage.decode(&bytes);
        if size <= self.budget {
            self.make_room(size)?;
            self.hold(key, bytes);
        }
        Ok(Some(values))
    }

    /// Forgets what is under `key`.
    pub fn remove(&mut self, key: K) {
        let Some(entry) = self.entries.remove(&key) else {
            return;
        };
        if let Some((bytes, used)) = entry.memory {
            self.order.remove(&used);
            self.held -= bytes.len();
        }
        if let Some(place) = entry.place {
            self.free.entry(entry.size).or_default().push(place);
        }
    }

    /// Puts `bytes`, for which there is room, in memory.
    fn hold(&mut self, key: K, bytes: Vec<u8>) {
        self.clock += 1;
        self.held += bytes.len();
        self.order.insert(self.clock, key);
        if let Some(entry) = self.entries.get_mut(&key)
            && let Some((old, used)) = entry.memory.replace((bytes, self.clock))
        {
            self.held -= old.len();
            self.order.remove(&used);
        }
        self.most_held = self.most_held.max(self.held);
    }

    /// Moves to the file what was not used for longest, until `size` more bytes are within the budget or nothing is left.
    fn make_room(&mut self, size: usize) -> io::Result<()> {
        while self.held + size > self.budget {
            let Some((_, key)) = self.order.pop_first() else {
                return Ok(());
            };
            let Some(entry) = self.entries.get_mut(&key) else {
                continue;
            };
            let written = entry.written;
            if let Some((bytes, _)) = entry.memory.take() {
                self.held -= bytes.len();
                if !written {
                    self.write(key, &bytes)?;
                }
            }
        }
        Ok(())
    }

    /// Writes `bytes` of `key` to the file.
    fn write(&mut self, key: K, bytes: &[u8]) -> io::Result<()> {
        let file = match &mut self.file {
            Some(file) => file,
            none => none.insert(tempfile::tempfile_in(&self.folder)?),
        };
        let Some(entry) = self.entries.get_mut(&key) else {
            return Ok(());
        };
        let place = match entry.place {
            Some(place) => place,
            None => match self.free.get_mut(&entry.size).and_then(Vec::pop) {
                Some(place) => place,
                None => {
                    let place = self.end;
                    self.end += entry.size as u64;
                    place
                }
            },
        };
        entry.place = Some(place);
        file.seek(SeekFrom::Start(place))?;
        file.write_all(bytes)?;
        entry.written = true;
        Ok(())
    }
}
