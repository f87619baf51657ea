#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
#
# rules_self_test.sh ROOT: shows that rules.sh can fail. A copy of the repository passes; each seeded breach is named.
set -euo pipefail
rules=$(dirname "$(realpath "${BASH_SOURCE[0]}")")/rules.sh
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
copy=$scratch/copy kept=$scratch/kept
mkdir "$copy"
(cd "$1" && tar -c --exclude=./.git --exclude=./build --exclude=./spherule-data .) | tar -x -C "$copy"
"$rules" "$copy" || { echo "The repository itself breaks the rules above." && exit 1; }

seeds=0
# seed FILE LINE RULE: with LINE at the end of FILE, rules.sh must fail and name RULE and FILE.
seed() {
  local file=$copy/$1 output
  mkdir -p "$(dirname "$file")"
  if [ -e "$file" ]; then
    cp "$file" "$kept"
  else
    printf '// SPDX-License-Identifier: GPL-3.0-or-later\n#pragma once\n' >"$file"
  fi
  printf '%s\n' "$2" >>"$file"
  if output=$("$rules" "$copy"); then echo "Not noticed in $1: $2" && exit 1; fi
  grep -qF "$3: $1" <<<"$output" || { printf 'Noticed in other words (%s: %s): %s\n' "$3" "$1" "$output" && exit 1; }
  if [ -e "$kept" ]; then mv "$kept" "$file"; else rm "$file"; fi
  seeds=$((seeds + 1))
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

# Rules about what a file must have.
for name in core/bare.h server/bare.cpp tests/bare.sh; do
  echo 'int f();' >"$copy/$name"
  if output=$("$rules" "$copy"); then echo "A bare $name was not noticed." && exit 1; fi
  grep -qF "no SPDX line: $name" <<<"$output"
  [[ $name != *.h ]] || grep -qF "no #pragma once: $name" <<<"$output"
  rm "$copy/$name"
  seeds=$((seeds + 1))
done
"$rules" "$copy"
echo "$seeds seeded breaches noticed"
