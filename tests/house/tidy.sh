#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
#
# tidy.sh ROOT BUILD FOLDER...: fails when clang-tidy finds something in a .cpp of the folders (or a header of ours that
# one includes), compiled as in the finished Ninja build BUILD. What passed is not looked at again until it changes.
set -euo pipefail
cd "$1"
build=$2
shift 2
passed=$build/tidy
mkdir -p "$passed"

# check SOURCE HEADER...: all that the verdict depends on is in the name of the file that records it.
check() {
  local key
  key=$(cat .clang-tidy CMakeLists.txt "$@" | sha256sum | cut -d ' ' -f 1)
  [ ! -e "$passed/$key" ] || return 0
  if clang-tidy-16 --quiet -p "$build" "$1" >"$passed/$key.log" 2>&1; then
    mv "$passed/$key.log" "$passed/$key"
  else
    # One write a file: several files are checked at a time.
    printf '%s\n' "$(grep -v ' warnings generated\.$' "$passed/$key.log")"
    rm "$passed/$key.log"
    return 1
  fi
}
export -f check
export build passed

# Ninja knows which headers each object was made from: the source first, then the headers; ours alone matter. They are
# named from the build folder or from the file system's root, as the compiler was called.
mapfile -t sources < <(ninja -C "$build" -t deps | awk -v near="$(realpath --relative-to="$build" .)/" -v far="$PWD/" \
  -v folders="$*" '
  function end() { if (files ~ "^(" folders ")/[^ ]*\\.cpp( |$)") print files; files = "" }
  function add(file) { files = files (files == "" ? "" : " ") file }
  BEGIN { gsub(/ /, "|", folders) }
  /^[^ ]/ { end() }
  /^ / && index($1, near) == 1 { add(substr($1, length(near) + 1)) }
  /^ / && index($1, far) == 1 { add(substr($1, length(far) + 1)) }
  END { end() }' | sort -u)
if [ ${#sources[@]} = 0 ]; then
  echo "tidy.sh finds no source of $* in $build; build first." >&2
  exit 1
fi
printf '%s\n' "${sources[@]}" | xargs -P "$(nproc)" -I {} bash -c 'check {}'
