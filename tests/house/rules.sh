#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
#
# rules.sh ROOT: fails when the sources under ROOT break a rule of the house, naming rule, file and line.
set -euo pipefail
here=$(dirname "$(realpath "${BASH_SOURCE[0]}")")
cd "$1"

mapfile -t files < <(find . \( -name .git -o -path ./build -o -path ./spherule-data \) -prune -o -type f -printf '%P\n' | sort)
broken=no
breach() {
  printf '%s\n' "$@"
  broken=yes
}

# forbid RULE FILES PATTERN [EXCEPT]: in files whose name matches FILES, but not EXCEPT, no line may match PATTERN.
forbid() {
  local where line
  mapfile -t where < <(printf '%s\n' "${files[@]}" | grep -P -- "$2" | grep -vP -- "${4:-^$}")
  [ ${#where[@]} -gt 0 ] || return 0
  while read -r line; do breach "$1: $line"; done < <(grep -HnIP -- "$3" "${where[@]}")
}

cpp='\.(h|cpp)$'

# A heavy or foreign library is included in the one place that knows it. Tests may use one as an independent model.
# only_in LIBRARY HEADER FILES
only_in() { forbid "$1 belongs elsewhere" "$cpp" "^\s*#\s*include\s*[<\"]$2" "$3"; }
only_in cpp-httplib 'httplib\.h' '^tests/e2e/'
only_in libarchive 'archive(_entry)?\.h' '^server/intake/archive\.cpp$'
only_in zstd 'zstd\.h' '^server/http/encoding\.cpp$|^tests/e2e/'
only_in nlohmann-json 'nlohmann/' '^api/|^tests/'
only_in SQLite 'sqlite3\.h' '^server/records/sqlite\.cpp$|^tests/server/'
only_in CGAL 'CGAL/' '^core/(delaunay|slice/plane_delaunay|measure/(enclosing|power))\.cpp$|^tests/core/(\w+/)?\w+\.cpp$|^tests/bench/\w+\.cpp$'
only_in Embree 'embree' '^core/render/\w+\.cpp$'
only_in OpenImageIO 'OpenImageIO/' '^core/render/\w+\.cpp$|^tests/core/.*\.cpp$'
only_in ITK 'itk[A-Z]\w+\.h' '^core/read/\w+\.cpp$|^tests/core/register/itk_test\.cpp$'
only_in nifti 'nifti' '^core/(read|write)/\w+\.cpp$'
only_in OpenVDB 'openvdb/' '^core/(read|write)/\w+\.cpp$|^tests/(read|write)/\w+\.cpp$'
only_in SLEEF 'sleef\.h' '^core/base/elementary\.cpp$'
only_in CLI11 'CLI/' '^clients/cli/options\.cpp$'
only_in OpenSSL 'openssl/' '^server/(access|base|http)/\w+\.cpp$|^core/render/drawing\.cpp$|^tests/'
only_in toml++ 'toml' '^server/config\.cpp$'
forbid 'api opens no sockets' "^api/.*$cpp" '^\s*#\s*include\s*<(sys/socket|netinet/|arpa/|netdb|poll)'

# Code depends one way: core knows nobody, api knows core, server knows both, clients/cli only core.
forbid 'core knows nobody else' "^core/.*$cpp" '^\s*#\s*include\s*"(?!core/)'
# And so do its rooms: each knows base/, the values of the root, and the rooms named here.
room() {
  local name=$1 known=$2
  forbid "core/$name knows only ${known//|/, }" "^core/$name/.*$cpp" "^\\s*#\\s*include\\s*\"core/(?!($name|$known)/)\\w+/"
}
forbid 'the root of core knows only base' "^core/\\w+$cpp" '^\s*#\s*include\s*"core/(?!base/)\w+/'
forbid 'core/read knows of the root only the volume' "^core/read/.*$cpp" '^\s*#\s*include\s*"core/(?!volume\.h)\w+\.h'
room base base
room trees base
room read base
room compare base
room sampled base
room slice base
room measure 'base|trees|compare'
room simplify 'base|trees|measure|sampled'
room write 'base|measure|sampled'
room render 'base|trees|measure|compare|slice'
room register 'base|trees|measure|simplify|render'
forbid 'api knows only core' "^api/.*$cpp" '^\s*#\s*include\s*"(?!(api|core)/)'
# So do the server's; of its root they may know the configuration.
server_room() {
  local name=$1 known=$2
  forbid "server/$name knows only ${known//|/, }" "^server/$name/.*$cpp" \
    "^\\s*#\\s*include\\s*\"server/(?!($name|$known)/|config\\.h\")"
}
server_room base base
server_room http base
server_room bytes base
server_room access 'base|http'
server_room records 'base|bytes'
server_room intake 'base|bytes'
server_room work 'base|bytes|records'
forbid 'server knows only api and core' "^server/.*$cpp" '^\s*#\s*include\s*"(?!(server|api|core)/)'
forbid 'the command line knows only core' "^clients/cli/.*$cpp" '^\s*#\s*include\s*"(?!(clients/cli|core)/)'

forbid 'core neither prints nor exits' "^core/.*$cpp" 'std::(cout|cerr|clog)\b|\b(f|std::)?(printf|puts)\(|\b(exit|abort)\('

# The C library's differ between processors.
forbid 'elementary functions of core are those of base/elementary.h' "^core/.*$cpp" \
  '\bstd::(sin|cos|tan|asin|acos|atan2?|sinh|cosh|tanh|exp|exp2|expm1|log|log2|log10|log1p|pow|cbrt|hypot|erf|tgamma|lgamma|fma)\('

# Where people keep their checkouts and scratch files is nobody else's business.
forbid 'names a folder of one machine' '.' '(^|[^\w.~-])/(home|root|tmp|mnt|Users|work|workspace|scratch)/' '^LICENSE$'

# every RULE FILES LINE: each file whose name matches FILES holds LINE.
every() {
  local where file
  mapfile -t where < <(printf '%s\n' "${files[@]}" | grep -P -- "$2")
  while read -r file; do breach "$1: $file"; done < <(grep -LP -- "$3" "${where[@]}")
}
every 'no SPDX line' '\.(h|cpp|sh|py|pl)$|(^|/)CMakeLists\.txt$|^(run|test|\.ci/run)$|^docker/' \
  '^(//|#) SPDX-License-Identifier: GPL-3\.0-or-later$'
every 'no #pragma once' '\.h$' '^#pragma once$'

# Long functions, declarations without a comment, broken comments, circles of includes.
mapfile -t sources < <(printf '%s\n' "${files[@]}" | grep -P '^(core|api|server|clients)/.*\.(h|cpp)$')
shapes=$("$here/shape.pl" "${sources[@]}") || breach 'shape.pl cannot read the sources'
[ -z "$shapes" ] || breach "$shapes"

[ $broken = no ]
