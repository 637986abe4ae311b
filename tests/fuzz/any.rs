//! Any target of `tests/src/fuzz/mod.rs` under libFuzzer, named by `LDI_FUZZ_TARGET`. With
//! `LDI_FUZZ_SEEDS` its valid inputs are written to that folder first. `docs/testing.md` has the
//! commands.

#![no_main]

use ldi_tests::fuzz::Target;
use libfuzzer_sys::fuzz_target;
use std::{path::Path, sync::LazyLock};

static TARGET: LazyLock<&Target> = LazyLock::new(|| {
    let name = std::env::var("LDI_FUZZ_TARGET").expect("LDI_FUZZ_TARGET names a target");
    Target::named(&name)
});

fn write_seeds() {
    let Some(folder) = std::env::var_os("LDI_FUZZ_SEEDS") else { return };
    std::fs::create_dir_all(&folder).expect("writable");
    for (number, seed) in (TARGET.seeds)().iter().enumerate() {
        std::fs::write(Path::new(&folder).join(format!("seed-{number}")), seed).expect("writable");
    }
}

fuzz_target!(init: write_seeds(), |bytes: &[u8]| {
    (TARGET.run)(bytes);
});
