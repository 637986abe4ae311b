#!/usr/bin/env bash
# The main job in small: builds a dataset, serves it on loopback, walks through it over QUIC and leaves a page to look at.
#   deploy/demo.sh                        the built-in town
#   deploy/demo.sh --open                 the same, and a window on it at the end
#   deploy/demo.sh SCENE.glb PATH.json    your own scene along your own path
# More options: deploy/demo.sh --help
set -euo pipefail
cd "$(dirname "$0")/.."
bash deploy/setup.sh
cargo build --release --locked --bins
exec target/release/ldi-demo "$@"
