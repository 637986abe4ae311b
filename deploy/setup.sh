#!/usr/bin/env bash
# What the build needs beyond Rust and gcc on a bare Debian 12: a C++ compiler, for NVIDIA's FLIP metric.
# Installs only what is missing; says what to do where it may not install.
set -euo pipefail

need=()
command -v c++ >/dev/null 2>&1 || command -v g++ >/dev/null 2>&1 || need+=(g++)
command -v cargo >/dev/null 2>&1 || { echo "setup: cargo is not on the PATH; install Rust 1.95 or newer from https://rustup.rs" >&2; exit 42; }
if [ "${#need[@]}" -gt 0 ]; then
  sudo=""
  [ "$(id -u)" = 0 ] || sudo="sudo"
  if ! command -v apt-get >/dev/null 2>&1 || { [ -n "$sudo" ] && ! command -v sudo >/dev/null 2>&1; }; then
    echo "setup: please install: ${need[*]}" >&2
    exit 42
  fi
  echo "setup: installing ${need[*]}" >&2
  $sudo apt-get -qq update >&2
  DEBIAN_FRONTEND=noninteractive $sudo apt-get -qq install -y --no-install-recommends "${need[@]}" >&2
fi
