//! Writes valid files and the findings of the corpus to `fuzz/corpus`, in the form that the fuzz
//! targets read: `cargo run --example seeds` in `fuzz/`.

use m4_fuzz_targets::files::corpus;
use m4_fuzz_targets::of_family;
use m4_fuzz_targets::table::families;
use std::error::Error;
use std::fs;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let to = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    for family in families() {
        let folder = to.join(family);
        fs::create_dir_all(&folder)?;
        let readers = of_family(family);
        for (i, reader) in readers.iter().enumerate() {
            // the first byte says which reader it is
            let write = |name: &str, bytes: &[u8]| {
                let input = [&[u8::try_from(i)?], bytes].concat();
                fs::write(folder.join(format!("{}-{name}", reader.name)), input)?;
                Ok::<_, Box<dyn Error>>(())
            };
            for (k, seed) in reader.stage()?.seeds().iter().enumerate() {
                write(&format!("valid-{k}"), seed)?;
            }
            for (name, bytes) in corpus(reader.name)? {
                write(&format!("found-{name}"), &bytes)?;
            }
        }
        println!("{family}: {} readers", readers.len());
    }
    Ok(())
}
