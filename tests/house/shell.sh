#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
#
# shell.sh ROOT: fails when shellcheck finds a mistake in a script.
set -euo pipefail
cd "$1"
mapfile -t scripts < <(find . \( -name .git -o -path ./build \) -prune -o -type f -print0 | xargs -0 grep -lE '^#!.*\b(ba)?sh$|^# shellcheck shell=')
[ ${#scripts[@]} -gt 0 ]
shellcheck -x "${scripts[@]}"
