//! Planes of numbers, all of one size, within a budget of memory: those that it has no room for lie
//! in a file.

use half::f16;
use half::slice::HalfFloatSliceExt;
use std::collections::{BTreeSet, HashMap};
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
    fn encode(self, values: &[f32]) -> Vec<u8> {
        match self {
            Self::F32 => values.iter().flat_map(|x| x.to_le_bytes()).collect(),
            Self::F16 => {
                let mut halves = vec![f16::ZERO; values.len()];
                halves.convert_from_f32_slice(values);
                halves.iter().flat_map(|x| x.to_le_bytes()).collect()
            }
        }
    }

    fn decode(self, bytes: &[u8]) -> Vec<f32> {
        match self {
            Self::F32 => bytes
                .as_chunks()
                .0
                .iter()
                .map(|&b| f32::from_le_bytes(b))
                .collect(),
            Self::F16 => {
                let halves: Vec<f16> = bytes
                    .as_chunks()
                    .0
                    .iter()
                    .map(|&b| f16::from_le_bytes(b))
                    .collect();
                halves.to_f32_vec()
            }
        }
    }
}

/// Planes by key, each in a slot: the first slots are in memory, as many as the budget has room
/// for, the others in the file. Numbers are rounded to [`Storage`] whenever they are put in, so
/// what comes out does not depend on where they were.
#[derive(Debug)]
pub struct Store<K> {
    storage: Storage,
    budget: usize,
    folder: PathBuf,
    /// Bytes of a plane, once one was put in.
    plane: Option<usize>,
    slots: HashMap<K, usize>,
    /// Slots that were used before.
    free: BTreeSet<usize>,
    held: Vec<Vec<u8>>,
    file: Option<File>,
}

impl<K: Copy + Eq + Hash> Store<K> {
    /// Holds at most `budget` bytes in memory, the rest in a nameless file in `folder` (made when
    /// it is needed).
    pub fn new(budget: usize, storage: Storage, folder: PathBuf) -> Self {
        Self {
            storage,
            budget,
            folder,
            plane: None,
            slots: HashMap::new(),
            free: BTreeSet::new(),
            held: Vec::new(),
            file: None,
        }
    }

    /// How many planes may lie in memory.
    fn room(&self) -> usize {
        self.budget / self.plane.unwrap_or(0).max(1)
    }

    /// Planes that the file has a place for.
    #[cfg(test)]
    pub fn spilled(&self) -> usize {
        (self.slots.len() + self.free.len()).saturating_sub(self.room())
    }

    pub fn folder(&self) -> &PathBuf {
        &self.folder
    }

    pub fn contains(&self, key: K) -> bool {
        self.slots.contains_key(&key)
    }

    /// Keeps `values`, as many as in every other plane, under `key`, instead of what was there.
    pub fn put(&mut self, key: K, values: &[f32]) -> io::Result<()> {
        let bytes = self.storage.encode(values);
        assert_eq!(
            *self.plane.get_or_insert(bytes.len()),
            bytes.len(),
            "planes of one size"
        );
        let old_slot = self.slots.get(&key).or_else(|| self.free.first());
        let slot = old_slot.copied().unwrap_or(self.slots.len());
        if slot < self.room() {
            self.held.resize(self.held.len().max(slot + 1), Vec::new());
            self.held[slot] = bytes;
        } else {
            self.at(slot)?.write_all(&bytes)?;
        }
        self.free.remove(&slot);
        self.slots.insert(key, slot);
        Ok(())
    }

    /// What was put under `key`, rounded.
    pub fn get(&mut self, key: K) -> io::Result<Option<Vec<f32>>> {
        let Some(&slot) = self.slots.get(&key) else {
            return Ok(None);
        };
        if let Some(bytes) = self.held.get(slot) {
            return Ok(Some(self.storage.decode(bytes)));
        }
        let mut bytes = vec![0; self.plane.unwrap_or(0)];
        self.at(slot)?.read_exact(&mut bytes)?;
        Ok(Some(self.storage.decode(&bytes)))
    }

    /// Forgets what is under `key`.
    pub fn remove(&mut self, key: K) {
        if let Some(slot) = self.slots.remove(&key) {
            self.free.insert(slot);
            if let Some(bytes) = self.held.get_mut(slot) {
                *bytes = Vec::new();
            }
        }
    }

    /// The file, at the place of `slot`.
    fn at(&mut self, slot: usize) -> io::Result<&File> {
        let place = (slot - self.room()) as u64 * self.plane.unwrap_or(0) as u64;
        let file = match &mut self.file {
            Some(file) => file,
            none => none.insert(tempfile::tempfile_in(&self.folder)?),
        };
        file.seek(SeekFrom::Start(place))?;
        Ok(file)
    }
}
