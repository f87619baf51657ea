#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
#
# format.sh ROOT: fails when a C++ file is not as clang-format would write it. To mend one: clang-format-14 -i FILE
set -euo pipefail
cd "$1"
find core api server clients tests \( -name '*.h' -o -name '*.cpp' \) -print0 | sort -z |
  xargs -0 -P "$(nproc)" -n 8 clang-format-14 --dry-run -Werror
