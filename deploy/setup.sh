#!/usr/bin/env bash
# What the build needs beyond Rust and gcc on a bare Debian 12: a C++ compiler, for meshoptimizer and NVIDIA's FLIP metric.
#   deploy/setup.sh window    also what the tests of the window need: a display without a screen, a software driver, keys and mouse
# Installs only what is missing; says what to do where it may not install.
set -euo pipefail

command -v cargo >/dev/null 2>&1 || { echo "setup: cargo is not on the PATH; install Rust 1.95 or newer from https://rustup.rs" >&2; exit 42; }

# install PACKAGE...: returns 1 where that is not allowed.
install() {
  local sudo=""
  [ "$(id -u)" = 0 ] || sudo="sudo"
  if ! command -v apt-get >/dev/null 2>&1 || { [ -n "$sudo" ] && ! command -v sudo >/dev/null 2>&1; }; then
    echo "setup: please install: $*" >&2
    return 1
  fi
  echo "setup: installing $*" >&2
  $sudo apt-get -qq update >&2
  DEBIAN_FRONTEND=noninteractive $sudo apt-get -qq install -y --no-install-recommends "$@" >&2
}

if ! command -v c++ >/dev/null 2>&1 && ! command -v g++ >/dev/null 2>&1; then
  install g++ || exit 42
fi

if [ "${1:-}" = window ]; then
  need=()
  for package in xvfb xdotool mesa-vulkan-drivers libvulkan1 libxkbcommon-x11-0 libxcursor1 libxi6 libxrandr2 libx11-xcb1; do
    # Where there is no dpkg the tests themselves find out and say what is absent.
    if command -v dpkg-query >/dev/null 2>&1 && ! dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q "ok installed"; then
      need+=("$package")
    fi
  done
  if [ "${#need[@]}" -gt 0 ]; then
    install "${need[@]}" || echo "setup: the tests of the window will be skipped" >&2
  fi
fi
