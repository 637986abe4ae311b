//! Path files: what `ldi-client walk`, `ldi-server render` and `plan` walk along.
