#!/usr/bin/env bash
# All checks, as CI runs them: format, lints, unit and end-to-end tests, doc tests, architecture, a walk, the contract.
set -euo pipefail
cd "$(dirname "$0")/.."
bash deploy/setup.sh window
step() { printf '\n== %s (%ss)\n' "$1" "$SECONDS"; }

step "format"
cargo fmt --all -- --check
step "build"
cargo build --release --locked --all-targets
step "clippy"
cargo clippy --release --locked --all-targets -- -D warnings
step "tests"
if cargo nextest --version >/dev/null 2>&1; then
  cargo nextest run --release --locked --no-fail-fast
else
  echo "cargo-nextest is not installed: using cargo test"
  cargo test --release --locked --no-fail-fast --lib --bins --tests
fi
step "doc tests"
cargo test --release --locked --doc
step "documentation"
# Within the project private items are documented too; a link that leads nowhere is an error.
RUSTDOCFLAGS="-D rustdoc::broken_intra_doc_links" cargo doc --release --locked --no-deps --document-private-items --quiet
step "a walk from end to end"
target/release/ldi-demo --quick -o target/demo-quick
shared="${LDI_SHARED:-$PWD/../shared}"
if [ -d "$shared/scenes" ] && command -v python3 >/dev/null 2>&1; then
  step "contract"
  python3 "$shared/tools/check_contract.py" target/release "$shared/scenes/willow_garage.glb" "$shared/scenes/willow_garage.path.json" --budget 4000
else
  step "contract: SKIPPED, $shared/scenes or python3 is not there"
fi
step "done"
