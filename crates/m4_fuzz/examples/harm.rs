//! Blind fuzzing on stable Rust: `cargo run -p m4_fuzz --example harm -- [EXECUTIONS [SEED [READER...]]]`.
//!
//! Sound files are changed at random and read, each reader in a process whose memory is limited. What does harm is saved in
//! `target/harm`.
#![expect(clippy::print_stdout, reason = "a program that prints its results")]

use m4_fuzz::{Meter, Stage, harmed, reader, readers, watch, work};
use peak_alloc::PeakAlloc;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// Argument of the process that reads.
const CHILD: &str = "--read";

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    if let [mark, name, folder, from, each, seed] = arguments.as_slice()
        && mark == CHILD
    {
        return read(
            name,
            &PathBuf::from(folder),
            from.parse()?,
            each.parse()?,
            seed.parse()?,
        );
    }
    let number = |i: usize, default: u64| arguments.get(i).map_or(Ok(default), |a| a.parse());
    let (executions, seed) = (number(0, 30_000)?, number(1, 1)?);
    let mut names: Vec<String> = arguments.iter().skip(2).cloned().collect();
    if names.is_empty() {
        names = readers().iter().map(|r| r.name.to_owned()).collect();
    }
    let each = executions.div_ceil(names.len() as u64);
    let folder = PathBuf::from("target/harm");
    fs::create_dir_all(&folder)?;
    let (mut all, mut found) = (0, 0);
    println!(
        "{:<34} {:>8} {:>8} {:>8} {:>9}",
        "reader", "files", "refused", "MiB", "findings"
    );
    for name in &names {
        let again = |from: usize| {
            let mut command = Command::new(env::current_exe().unwrap_or_default());
            command.arg(CHILD).arg(name).arg(&folder);
            command.args([from.to_string(), each.to_string(), seed.to_string()]);
            command
        };
        let report = watch(name, &folder, again)?;
        let (n, findings) = (report.executions, report.findings.len());
        println!(
            "{name:<34} {n:>8} {:>8} {:>8} {findings:>9}",
            report.refused,
            report.peak_bytes >> 20
        );
        for f in &report.findings {
            println!("    {}: {} ({})", f.input, f.why, f.saved.display());
        }
        all += n;
        found += findings;
    }
    println!("{all} files, {found} findings");
    if found == 0 {
        Ok(())
    } else {
        Err(format!("{found} findings").into())
    }
}

fn read(name: &str, folder: &Path, from: usize, each: u64, seed: u64) -> Result<(), Box<dyn Error>> {
    let reader = reader(name).ok_or_else(|| format!("there is no reader {name}"))?;
    let meter = Meter {
        reset: || MEMORY.reset_peak_usage(),
        peak: || MEMORY.peak_usage(),
        now: || MEMORY.current_usage(),
    };
    let inputs = |stage: &Stage<'_>| -> Box<dyn Iterator<Item = (String, Vec<u8>)>> {
        let seeds = stage.seeds().to_vec();
        Box::new((0..each).map(move |i| {
            let sound = &seeds[i as usize % seeds.len()];
            let (bytes, what) = harmed(sound, seed, i);
            (format!("{i}: {what}"), bytes)
        }))
    };
    Ok(work(&reader, folder, from, inputs, meter)?)
}
