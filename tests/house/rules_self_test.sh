#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
#
# rules_self_test.sh ROOT: shows that rules.sh can fail. A copy of the repository passes; each seeded breach is named.
set -euo pipefail
rules=$(dirname "$(realpath "${BASH_SOURCE[0]}")")/rules.sh
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
copy=$scratch/copy
mkdir "$copy"
(cd "$1" && tar -c --exclude=./.git --exclude=./build --exclude=./spherule-data .) | tar -x -C "$copy"
"$rules" "$copy" || { echo "The repository itself breaks the rules above." && exit 1; }

# seed FILE TEXT RULE: puts TEXT at the end of FILE. rules.sh must name RULE, FILE and one of these lines.
seeds=()
seed() {
  local file=$copy/$1 before
  mkdir -p "$(dirname "$file")"
  [ -e "$file" ] || printf '// SPDX-License-Identifier: GPL-3.0-or-later\n#pragma once\n' >"$file"
  before=$(wc -l <"$file")
  printf '%s\n' "$2" >>"$file"
  seeds+=("$3"$'\t'"$1"$'\t'$((before + 1))$'\t'"$(wc -l <"$file")")
}
# A file without what every file must have.
bare() {
  mkdir -p "$(dirname "$copy/$1")"
  echo '// int f();' >"$copy/$1"
  seeds+=("$2"$'\t'"$1"$'\t\t')
}

seed core/volume.h '#include <httplib.h>' 'cpp-httplib belongs elsewhere'
seed core/volume.cpp '#include "nlohmann/json.hpp"' 'nlohmann-json belongs elsewhere'
seed core/volume.cpp '  #  include <sqlite3.h>' 'SQLite belongs elsewhere'
seed core/spheres.cpp '#include <CGAL/Delaunay_triangulation_3.h>' 'CGAL belongs elsewhere'
seed core/spheres.h '#include <embree3/rtcore.h>' 'Embree belongs elsewhere'
seed core/render/render.h '#include <OpenImageIO/imageio.h>' 'OpenImageIO belongs elsewhere'
seed core/volume.cpp '#include <itkImageFileReader.h>' 'ITK belongs elsewhere'
seed core/volume.cpp '#include <nifti/nifti2_io.h>' 'nifti belongs elsewhere'
seed core/read/read.h '#include <openvdb/openvdb.h>' 'OpenVDB belongs elsewhere'
seed clients/cli/main.cpp '#include <CLI/CLI.hpp>' 'CLI11 belongs elsewhere'
seed core/volume.cpp '#include <openssl/evp.h>' 'OpenSSL belongs elsewhere'
seed api/seeded.cpp '#include <sys/socket.h>' 'api opens no sockets'
seed api/seeded.cpp '#include <httplib.h>' 'cpp-httplib belongs elsewhere'
seed api/seeded.cpp '#include <sqlite3.h>' 'SQLite belongs elsewhere'
seed core/volume.cpp '#include "api/seeded.h"' 'core knows nobody else'
seed core/volume.cpp '#include "server/seeded.h"' 'core knows nobody else'
seed core/volume.cpp '#include "core/measure/union.h"' 'the root of core knows only base'
seed core/read/raw.cpp '#include "core/spheres.h"' 'core/read knows of the root only the volume'
seed core/measure/mass.cpp '#include "core/render/render.h"' 'core/measure knows only base, trees, compare'
seed api/seeded.cpp '#include "server/seeded.h"' 'api knows only core'
seed server/seeded.cpp '#include "clients/seeded.h"' 'server knows only api and core'
seed server/base/clock.h '#include "server/bytes/staging.h"' 'server/base knows only base'
seed server/records/store.cpp '#include "server/work/jobs.h"' 'server/records knows only base, bytes'
seed server/work/jobs.h '#include "server/pipeline.h"' 'server/work knows only base, bytes, records'
seed clients/cli/seeded.cpp '#include "server/seeded.h"' 'the command line knows only core'
seed core/volume.cpp 'void f() { std::printf("x"); }' 'core neither prints nor exits'
seed core/volume.cpp 'void f() { std::cerr << 1; }' 'core neither prints nor exits'
seed core/volume.cpp 'void f() { std::exit(1); }' 'core neither prints nor exits'
seed core/volume.cpp 'double f(double x) { return std::sin(x); }' 'elementary functions of core are those of base/elementary.h'
seed core/volume.cpp '#include <sleef.h>' 'SLEEF belongs elsewhere'
place=/home
seed README.md "See $place/somebody/notes." 'names a folder of one machine'
seed tests/seeded.cpp "const char* path = \"$place/somebody/scan.nii\";" 'names a folder of one machine'

long=$(printf 'int seeded(int x) {\n%s}\n' "$(printf '  x = x * 3 + 1;\n%.0s' {1..61})"$'\n')
seed core/volume.cpp "$long" 'a function is too long'
seed core/volume.h $'struct Seeded {\n  int seeds() {\n    return [] {\n'"$(printf '      ;\n%.0s' {1..60})"$'\n    }();\n  }\n};' \
  'a function is too long'
seed core/volume.h $'\nint seeded(int x);' 'a declaration has no comment'
seed core/volume.h $'\nstruct Seeded {\n  int x = 0;\n};' 'a declaration has no comment'
seed core/volume.cpp $'// This line was cut by a reflow in the middle of its\n// sentence, and nobody saw it.' 'a comment is broken'
seed core/volume.h $'/// What does this describe?\n\nstruct Seeded;' 'a comment is cut from its declaration'
seed core/base/geometry.h '#include "core/volume.h"' 'includes go in a circle'

for name in core/bare.h server/bare.cpp tests/bare.sh tests/bare.pl; do bare $name 'no SPDX line'; done
bare core/bare.h 'no #pragma once'

if output=$("$rules" "$copy"); then echo "None of ${#seeds[@]} seeded breaches was noticed." && exit 1; fi
# Whether a line of the output names the rule, the file and, unless FIRST is empty, a line from FIRST to LAST.
named() {
  awk -v start="$1: $2" -v first="$3" -v last="$4" '
    index($0, start) != 1 { next }
    { split(substr($0, length(start) + 1), rest, ":") }
    first == "" || first + 0 <= rest[2] + 0 && rest[2] + 0 <= last + 0 { found = 1 }
    END { exit !found }' <<<"$output"
}
for planted in "${seeds[@]}"; do
  IFS=$'\t' read -r rule file first last <<<"$planted"
  named "$rule" "$file" "$first" "$last" && continue
  printf '%s\n' "$output" "Not noticed in the lines above: $rule: $file:$first"
  exit 1
done
echo "${#seeds[@]} seeded breaches noticed"
