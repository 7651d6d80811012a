//! The most memory that each reader takes for hostile files: `cargo run -p m4_fuzz --example reader_memory -- [READER...]`.
#![expect(clippy::print_stdout, reason = "a program that prints its results")]

use m4_fuzz::{Meter, Stage, hostile, reader, readers, watch, work};
use peak_alloc::PeakAlloc;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// Argument of the process that reads.
const CHILD: &str = "--read";
/// Hostile relatives of each sound file: as good as all.
const HOSTILE: usize = 2000;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    if let [mark, name, folder, from] = arguments.as_slice()
        && mark == CHILD
    {
        return read(name, &PathBuf::from(folder), from.parse()?);
    }
    let mut names = arguments;
    if names.is_empty() {
        names = readers().iter().map(|r| r.name.to_owned()).collect();
    }
    let folder = PathBuf::from("target/harm");
    fs::create_dir_all(&folder)?;
    let mut rows = Vec::new();
    for name in names {
        let again = |from: usize| {
            let mut command = Command::new(env::current_exe().unwrap_or_default());
            command.arg(CHILD).arg(&name).arg(&folder).arg(from.to_string());
            command
        };
        let report = watch(&name, &folder, again)?;
        for f in &report.findings {
            println!("{name}: {}: {} ({})", f.input, f.why, f.saved.display());
        }
        rows.push((report.peak_bytes, name, report));
    }
    rows.sort_by_key(|row| std::cmp::Reverse(row.0));
    println!("| reader | files | most memory, MiB | of |\n|---|---|---|---|");
    for (bytes, name, report) in rows {
        let mib = bytes as f64 / f64::from(1 << 20);
        println!("| {name} | {} | {mib:.1} | {} |", report.executions, report.peak_input);
    }
    Ok(())
}

fn read(name: &str, folder: &Path, from: usize) -> Result<(), Box<dyn Error>> {
    let reader = reader(name).ok_or_else(|| format!("there is no reader {name}"))?;
    let meter = Meter {
        reset: || MEMORY.reset_peak_usage(),
        peak: || MEMORY.peak_usage(),
        now: || MEMORY.current_usage(),
    };
    let inputs = |stage: &Stage<'_>| -> Box<dyn Iterator<Item = (String, Vec<u8>)>> {
        let seeds = stage.seeds().to_vec();
        Box::new(seeds.into_iter().flat_map(|seed| hostile(seed, HOSTILE)))
    };
    Ok(work(&reader, folder, from, inputs, meter)?)
}
