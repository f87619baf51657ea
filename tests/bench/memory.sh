#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Usage: tests/bench/memory.sh [SPHERULE [DATA]]
# What server/work/memory.cpp estimates by: the peak memory of making models and of measuring them, less what the program
# takes at rest, by boundary point and by tetrahedron. SPHERULE is the built command, DATA the folder of test scans.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
command=${1:-build/release/clients/cli/spherule} data=${2:-../shared/data}

# figure NAME: a number of the report on standard input, without its commas.
figure() { sed -n "s/^  $1  *\([0-9.,]*\).*/\1/p" | tr -d , | head -n 1; }
rest=$("$command" points "$data/mr-small.mhd" "$data/mr-small.raw" --threshold 30 | figure 'peak memory')

printf 'at rest: %s MiB\n%-16s %10s %12s %8s %9s %13s\n' "$rest" scan points tetrahedra 'MiB' 'B/point' 'measured, B/t'
while read -r name threshold files; do
  paths=()
  for file in $files; do paths+=("$data/$file"); done
  model=$("$command" model "${paths[@]}" --threshold "$threshold")
  points=$(figure 'boundary points' <<<"$model") cells=$(figure tetrahedra <<<"$model") peak=$(figure 'peak memory' <<<"$model")
  measured=$("$command" measures "${paths[@]}" --threshold "$threshold" | figure 'peak memory')
  awk -v n="$name" -v p="$points" -v c="$cells" -v m="$peak" -v u="$measured" -v r="$rest" 'BEGIN {
    printf "%-16s %10d %12d %8.0f %9.0f %13.0f\n", n, p, c, m, (m - r) * 1048576 / p, (u - r) * 1048576 / c }'
done <<'SCANS'
ct-head 1000 ct-head.mhd ct-head.raw
abdomen-ct -300 abdomen-ct.nii.gz
engine 70 engine.nii.gz
SCANS
