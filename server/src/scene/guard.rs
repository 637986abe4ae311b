//! Decoders of other projects, kept from taking the program with them.

use std::panic::{AssertUnwindSafe, catch_unwind};

use super::error::Fault;

/// What a decoder gives. One that panics found a file that it was not made for; what it held is
/// dropped.
pub(super) fn guarded<T>(place: &str, decode: impl FnOnce() -> Result<T, Fault>) -> Result<T, Fault> {
    catch_unwind(AssertUnwindSafe(decode)).unwrap_or_else(|_| {
        Err(Fault::invalid(place, "its decoder fails on it", "write it again, with another program if need be"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decoder_that_panics_is_a_fault_of_the_file() {
        let broken = guarded("image 3", || -> Result<(), Fault> { panic!("on purpose") });
        assert!(broken.unwrap_err().in_short().contains("image 3"));
        assert_eq!(guarded("image 3", || Ok(5)).ok(), Some(5));
    }
}
