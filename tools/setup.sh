# shellcheck shell=bash
# SPDX-License-Identifier: GPL-3.0-or-later
#
# Sourced by run and test, in the repository's root: what stands between a bare Debian 12 machine and a build.

say() { printf '\n== %s\n' "$*"; }
fail() {
  printf '%s: %s\n' "${0##*/}" "$*" >&2
  exit 1
}

# Prints the packages that packages.txt lists for the given purposes, one a line.
packages_for() { awk -v purposes=" $* " '/^[a-z]/ && index(purposes, " " $1 " ") { print $2 }' packages.txt; }

# Installs what packages.txt lists for the given purposes and the machine lacks. Touches the network only then.
install_packages() {
  local missing as_root=()
  command -v apt-get >/dev/null || fail "needs Debian 12 (apt-get); elsewhere install what packages.txt lists and use CMake."
  mapfile -t missing < <(comm -23 <(packages_for "$@" | sort -u) \
    <(dpkg-query -W -f '${db:Status-Status} ${Package}\n' | sed -n 's/^installed //p' | sort -u))
  [ ${#missing[@]} -gt 0 ] || return 0
  if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null || fail "run it as root, or install these packages first: ${missing[*]}"
    as_root=(sudo)
  fi
  say "Installing ${#missing[@]} packages and what they need: ${missing[*]}"
  "${as_root[@]}" apt-get update -q
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "${missing[@]}" </dev/null
}

# One compiler a core, but no more than the memory holds at 2 GiB each. CMAKE_BUILD_PARALLEL_LEVEL overrides.
parallel_jobs() {
  local by_memory
  by_memory=$(awk '/^MemAvailable:/ { print int($2 / 2097152) }' /proc/meminfo)
  local jobs=$(($(nproc) < by_memory ? $(nproc) : by_memory))
  echo "${CMAKE_BUILD_PARALLEL_LEVEL:-$((jobs > 1 ? jobs : 1))}"
}

# build PRESET [TARGET...]: configures and builds, with the count of steps as progress.
build() {
  local preset=$1
  shift
  say "Building ($preset)"
  cmake --preset "$preset" --log-level=WARNING || return
  NINJA_STATUS='[%f/%t, %e s] ' cmake --build --preset "$preset" -j "$(parallel_jobs)" ${1:+--target "$@"} -- -k 0
}
