#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
#
# load.sh [SPHERULED [SECONDS [ROUNDS]]]: cached answers under load (wrk), beside nginx serving the same bytes as files
# in the same run, and cached reads and polls of a job while 64 clients submit jobs. Loopback only. Prints medians over
# the rounds, in which the two take turns. Needs the packages of purpose "bench".
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
server=${1:-build/bench/server/spheruled} seconds=${2:-5} rounds=${3:-3}
folder=$(mktemp -d)
chmod 755 "$folder" # nginx serves as nobody when root starts it
pids=()
# shellcheck disable=SC2317 # by the trap
finish() {
  for pid in "${pids[@]}"; do
    if kill "$pid" 2>/dev/null; then wait "$pid" || true; fi
  done
  rm -rf "$folder"
}
trap finish EXIT
median() { sort -g | awk '{ v[NR] = $1 } END { print NR % 2 ? v[(NR + 1) / 2] : (v[NR / 2] + v[NR / 2 + 1]) / 2 }'; }
ms() { awk "BEGIN { print 1000 * $1 }"; }

: >"$folder/out"
"$server" --port 0 --data "$folder/data" --queue-length 200000 --queue-per-client 200000 >"$folder/out" 2>"$folder/log" &
pids+=($!)
for ((i = 0; i < 100; ++i)); do
  ours=$(sed -n 's/^Spherule listens on //p' "$folder/out")
  [ -z "$ours" ] || break
  sleep 0.1
done
[ -n "$ours" ] || { cat "$folder/log" >&2 && exit 1; }

# 65,530 spheres: 1,048,608 bytes of NPY; and a picture of about a megabyte.
awk 'BEGIN { srand(1); print "x,y,z,r"
  for (i = 0; i < 65530; ++i) printf "%.4f,%.4f,%.4f,%.3f\n", 200 * rand(), 200 * rand(), 200 * rand(), .5 + 2.5 * rand() }' >"$folder/spheres.csv"
model=$(curl -fsS -H 'Content-Type: text/csv' --data-binary "@$folder/spheres.csv" "$ours/v1/models" | grep -om1 'mdl_[0-9a-f]*')
mkdir "$folder/www"
meta=/v1/models/$model npy=/v1/models/$model/exports/npy png="/v1/models/$model/render?width=1800&height=1800"
fetch() {
  local status=202
  while [ "$status" = 202 ]; do status=$(curl -fsS -o "$folder/www/$1" -w '%{http_code}' "$ours$2"); done
}
fetch meta.json "$meta"
fetch spheres.npy "$npy"
fetch picture.png "$png"
port=$(shuf -i 20000-40000 -n 1)
cat >"$folder/nginx.conf" <<END
worker_processes 2; daemon off; pid $folder/nginx.pid; error_log stderr crit;
events { worker_connections 1024; }
http { access_log off; sendfile on; tcp_nopush on; tcp_nodelay on; keepalive_requests 10000;
  client_body_temp_path $folder/t1; proxy_temp_path $folder/t2; fastcgi_temp_path $folder/t3; uwsgi_temp_path $folder/t4; scgi_temp_path $folder/t5;
  open_file_cache max=100; server { listen 127.0.0.1:$port; root $folder/www; } }
END
/usr/sbin/nginx -e stderr -p "$folder" -c "$folder/nginx.conf" 2>"$folder/nginx.log" &
pids+=($!)
theirs=http://127.0.0.1:$port
for ((i = 0; i < 50; ++i)); do
  ! curl -fs -o "$folder/check" "$theirs/spheres.npy" || break
  sleep 0.1
done

cmp "$folder/check" "$folder/www/spheres.npy"

# measure NAME URL: one line "requests/s p50 p99" (seconds for the times).
measure() {
  wrk -t1 -c16 -d"$seconds"s --latency "$2" |
    awk 'function s(t) { return t ~ /us$/ ? t / 1e6 : t ~ /ms$/ ? t / 1e3 : t + 0 }
      $1 == "50%" { p50 = s($2) } $1 == "99%" { p99 = s($2) } /^Requests\/sec/ { r = $2 }
      /Non-2xx|Socket errors/ { print "ERRORS " $0 > "/dev/stderr" }
      END { print r, p50, p99 }' >>"$folder/$1"
}
printf '%-14s %9s %10s %9s %9s %8s\n' what bytes requests/s p50_ms p99_ms ratio
for what in meta.json spheres.npy picture.png; do
  case $what in meta.json) path=$meta ;; spheres.npy) path=$npy ;; *) path=$png ;; esac
  measure warm "$ours$path"
  for ((round = 0; round < rounds; ++round)); do
    measure "ours.$what" "$ours$path"
    measure "nginx.$what" "$theirs/$what"
  done
  for who in nginx ours; do
    for column in 1 2 3; do eval "c$column=$(awk -v c=$column '{ print $c }' "$folder/$who.$what" | median)"; done
    # shellcheck disable=SC2154 # set by eval
    printf '%-14s %9d %10.0f %9.2f %9.2f' "$who" "$(stat -c %s "$folder/www/$what")" "$c1" "$(ms "$c2")" "$(ms "$c3")"
    if [ $who = nginx ]; then base=$c1 && printf '\n'; else printf ' %8.2f  %s\n' "$(awk "BEGIN { print $c1 / $base }")" "$what"; fi
  done
done

# 64 clients submit jobs of a small volume, each at another threshold, while one reads what is cached and polls a job.
head -c 13824 /dev/urandom >"$folder/noise"
volume=$(curl -fsS --data-binary "@$folder/noise" "$ours/v1/volumes?format=raw&dims=24,24,24&dtype=uint8" | grep -om1 'vol_[0-9a-f]*')
cat >"$folder/submit.lua" <<END
local thread = 0
function setup(t) t:set("id", thread); thread = thread + 1 end
local n = 0
function request()
  n = n + 1
  return wrk.format("POST", "/v1/models", {["Content-Type"] = "application/json"},
    string.format('{"volume": "$volume", "threshold": %.6f}', 1 + (n * 2 + id) / 1000))
end
END
job=$(curl -fsS -H 'Content-Type: application/json' -d "{\"volume\": \"$volume\", \"threshold\": 0.5}" "$ours/v1/models" |
  grep -om1 'job_[0-9a-f]*')
wrk -t2 -c64 -d"$((2 * seconds + 3))"s -s "$folder/submit.lua" "$ours" >"$folder/submitted" 2>&1 &
submitter=$!
sleep 1
wrk -t1 -c4 -d"$seconds"s --latency "$ours$meta" >"$folder/meta.under"
wrk -t1 -c4 -d"$seconds"s --latency "$ours/v1/jobs/$job" >"$folder/job.under"
wait $submitter
for what in meta job; do
  printf "%s while 64 clients submit: " "$what"
  awk '$1 == "50%" || $1 == "99%" { printf "%s %s  ", $1, $2 } /^Requests\/sec/ { print $2, "requests/s" }' "$folder/$what.under"
done
printf 'submitted: '
awk '/^Requests\/sec/ { print $2, "requests/s" } /Non-2xx/ { print; refused = 1 } END { exit refused }' "$folder/submitted"
awk '/^VmHWM|^Threads/ { print $1, $2, $3 }' "/proc/${pids[0]}/status"
