//! Writes what of `fuzz/` follows from the table of readers: `cargo run -p m4_fuzz --example targets -- seeds` writes the sound
//! files and the findings of the corpus to `fuzz/corpus`, `-- sources` a target a reader and the list of them.
#![expect(clippy::print_stdout, reason = "a program that prints its results")]

use m4_fuzz::{corpus, readers};
use std::error::Error;
use std::path::Path;
use std::{env, fs};

fn main() -> Result<(), Box<dyn Error>> {
    let fuzz = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz");
    match env::args().nth(1).as_deref() {
        Some("seeds") => seeds(&fuzz),
        Some("sources") => sources(&fuzz),
        _ => Err("say seeds or sources".into()),
    }
}

fn seeds(fuzz: &Path) -> Result<(), Box<dyn Error>> {
    for reader in readers() {
        let folder = fuzz.join("corpus").join(reader.name);
        fs::create_dir_all(&folder)?;
        let stage = reader.stage()?;
        for (i, seed) in stage.seeds().iter().enumerate() {
            fs::write(folder.join(format!("sound-{i}")), seed)?;
        }
        for (name, bytes) in corpus(reader.name)? {
            fs::write(folder.join(format!("found-{name}")), bytes)?;
        }
        println!("{}", reader.name);
    }
    Ok(())
}

fn sources(fuzz: &Path) -> Result<(), Box<dyn Error>> {
    let manifest = fs::read_to_string(fuzz.join("Cargo.toml"))?;
    let mark = "# One a reader, written by `cargo run -p m4_fuzz --example targets -- sources`.\n";
    let head = manifest.split(mark).next().unwrap_or_default();
    let mut out = format!("{head}{mark}");
    let targets = fuzz.join("fuzz_targets");
    if targets.is_dir() {
        fs::remove_dir_all(&targets)?;
    }
    fs::create_dir_all(&targets)?;
    for reader in readers() {
        let name = reader.name;
        out.push_str(&format!(
            "\n[[bin]]\nname = \"{name}\"\npath = \"fuzz_targets/{name}.rs\"\ntest = false\ndoc = false\nbench = false\n"
        ));
        let source = format!("#![no_main]\nm4_fuzz_targets::target!(\"{name}\");\n");
        fs::write(targets.join(format!("{name}.rs")), source)?;
    }
    fs::write(fuzz.join("Cargo.toml"), out)?;
    Ok(())
}
