#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""attack.py [SPHERULED [MINUTES [SEED]]]: an attacker's hour against a running server, best one with sanitizers.

    cmake --preset asan && cmake --build --preset asan --target spheruled
    tests/fuzz/attack.py build/asan/server/spheruled 60

Where http.py sends single spoilt requests, this one means harm. Attackers of eight kinds work side by side: cameras and
options at the ends of the number line; sets of balls and volumes made to cost time or memory; headers of scans whose
geometry is out of this world; heads and chunks that hide a second request; connections that hold what they got; uploads
in pieces that stop, overlap and vanish; work that is cancelled, deleted and asked for again while it runs; requests in
the name of foreign pages. Meanwhile an honest client asks every second: /livez must answer within PATIENCE seconds and
a small model must be made. Answers must be what http.py's must be; in the end the server must stop with status 0, fsck must
find nothing, and the log must have no fault, no sanitizer's report and no patient. From time to time the server is killed
and started again. Prints what broke that; the status is 0 when nothing did. Needs python3-yaml.
"""
import collections
import json
import math
import random
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import urllib.parse

from hostile import BALL, SEEDS, Broken, Server, check_answer, read_answer, request_bytes

SERVER = sys.argv[1] if len(sys.argv) > 1 else "build/asan/server/spheruled"
MINUTES = float(sys.argv[2]) if len(sys.argv) > 2 else 60
SEED = sys.argv[3] if len(sys.argv) > 3 else "1"
PATIENCE = 20  # seconds; a server with sanitizers on a busy machine is slow
ROUND = 300  # seconds after which the server is killed and started again
FLAGS = ["--max-image-pixels", "65536", "--max-body-bytes", str(4 << 20), "--max-decompressed-bytes", str(1 << 24), "--max-voxels", str(1 << 21),
         "--max-boundary-points", "200000", "--job-memory-bytes", str(2 << 30), "--max-wait-s", "5", "--keep-jobs", "10m", "--threads", "2"]

EXTREMES = [0, -0.0, 1, -1, 0.5, 1e-9, -1e-9, 1e-20, 1e-150, 1e-170, 1e-300, 5e-324, 1e3, 1e6, -1e6, 1e9, 1e15, 1e30, -1e30, 1e38, 3.5e38, 1e150, 1e300, 1.7e308, -1.7e308,
            255, 256, 2**31 - 1, 2**31, 2**32, 2**53, 2**63, 2**64]


def text_of(number):
    return repr(number) if isinstance(number, float) else str(number)


class Attacker(threading.Thread):
    """One kind of harm, until `until`. Each exchange that must be answered is held against check_answer()."""

    def __init__(self, server, until, tally, findings, number):
        super().__init__(daemon=True)
        self.server, self.until, self.tally, self.findings = server, until, tally, findings
        self.random = random.Random("%s %s %d %f" % (SEED, type(self).__name__, number, until))
        self.what = ""

    def run(self):
        while time.monotonic() < self.until and self.server.process.poll() is None:
            try:
                self.harm()
            except (EOFError, OSError):
                self.tally["closed"] += 1
            except Exception as problem:  # whatever it is, it is a finding
                if self.server.process.poll() is None:
                    self.findings.append("%s: %s\n  %.600s" % (type(self).__name__, problem, self.what))

    def exchange(self, method, target, body=b"", **headers):
        """An answer that must come and be one."""
        self.what = "%s %s %r" % (method, target, body[:300])
        for _ in range(3):
            try:
                answer = self.server.ask(method, target, body, **headers)
                break
            except (EOFError, ConnectionError):  # too many connections at once is no crime
                time.sleep(0.05)
        else:
            self.tally["closed"] += 1
            return 0, {}, b"", False
        check_answer(method, "%s %s" % (method, target), answer, self.server.folder)
        self.tally[answer[0]] += 1
        return answer

    def make(self, target, body, wait="2", **headers):
        """The id of what was made, or nothing."""
        status, _, data, _ = self.exchange("POST", target, body, Prefer="wait=" + wait, **headers)
        return json.loads(data)["id"] if status in (200, 201, 202) else None

    def number(self):
        n = self.random.choice(EXTREMES)
        if self.random.random() < 0.3:
            n = n * self.random.uniform(-2, 2)
        return n if math.isfinite(n) else 1e308

    def spheres(self):
        """A set of balls that costs more than it weighs."""
        r, n = self.random, self.random.choice([1, 2, 3, 10, 100, 1000, 2000])
        way = r.randrange(9)
        if way == 0:
            rows = [(1.5, 2.5, 3.5, 1.0)] * n
        elif way == 1:
            rows = [(0.0, 0.0, 0.0, 1.0 + i / 7) for i in range(n)]
        elif way == 2:
            rows = [(float(i), 0.0, 0.0, r.choice([0.3, 0.5, 0.6, 40.0])) for i in range(n)]
        elif way == 3:
            rows = [(r.uniform(-1, 1), r.uniform(-1, 1), r.uniform(-1, 1), r.choice([1e-170, 1e-20, 1e-3, 1.0, 1e3])) for _ in range(n)]
        elif way == 4:
            rows = [tuple(self.number() for _ in range(3)) + (abs(self.number()),) for _ in range(min(n, 10))]
        elif way == 5:  # touching, on a lattice
            k = max(1, round(n ** (1 / 3)))
            rows = [(float(x), float(y), float(z), 0.5) for x in range(k) for y in range(k) for z in range(k)]
        elif way == 6:  # two skew lines
            k = min(n, 300) // 2 + 1
            rows = [(i / k, 0.0, 0.0, 0.9) for i in range(k)] + [(0.0, i / k, 1.0, 0.9) for i in range(k)]
        elif way == 7:  # on a sphere
            rows = []
            for _ in range(min(n, 500)):
                a, b = r.uniform(0, 2 * math.pi), math.acos(r.uniform(-1, 1))
                rows.append((math.cos(a) * math.sin(b), math.sin(a) * math.sin(b), math.cos(b), 1.0))
        else:
            far = r.choice([1e5, 1e6, 1e8])
            rows = [(far + r.uniform(0, 1), far, -far, 0.01) for _ in range(min(n, 100))]
        return ("x,y,z,r\n" + "".join("%r,%r,%r,%r\n" % row for row in rows)).encode()

    def own_model(self):
        return self.make("/v1/models", self.spheres(), Content_Type="text/csv")

    def some_model(self):
        ids = self.server.ids
        return self.random.choice([ids["model"], ids["other"], ids["simple"]])


class Cameras(Attacker):
    """Every number of every picture and file at the ends of the number line."""

    def harm(self):
        paths = [p for p in self.server.contract["paths"] if p.endswith(("/render", "/exports/{format}", "/slices/{axis}/{index}", "/histogram", "/histograms/radii", "/tree"))]
        path = self.random.choice(paths + ["/v1/models/{model}/render"] * 5)
        item = self.server.contract["paths"][path]
        target = path
        query = []
        for parameter in item.get("parameters", []) + item["get"].get("parameters", []):
            parameter = self.resolve(parameter)
            schema, name = self.resolve(parameter.get("schema", {})), parameter["name"]
            choices = schema.get("enum")
            if parameter["in"] == "path":
                value = self.server.ids.get(name) or (self.random.choice(choices) if choices else str(self.random.randrange(-1, 9)))
                if name == "model":
                    value = self.some_model()
                target = target.replace("{%s}" % name, urllib.parse.quote(value))
            elif parameter["in"] == "query" and name not in ("width", "height") and self.random.random() < 0.2:
                if choices:
                    value = self.random.choice(choices)
                elif schema.get("type") in ("integer", "number") and self.random.random() < 0.5:
                    value = text_of(self.random.choice([schema.get("minimum", 0), schema.get("maximum", 1)]))
                else:
                    value = ",".join(text_of(self.number()) for _ in range(self.random.choice([1, 1, 2, 3, 3, 6])))
                query.append((name, value))
        if path.endswith("render"):
            query += [("width", "24"), ("height", "24")]
        if self.random.random() < 0.2 and "{model}" in path:
            if model := self.own_model():
                target = path.replace("{model}", model)
        if "{" not in target:
            self.exchange("GET", target + "?" + urllib.parse.urlencode(query, safe=","), Prefer="wait=3")

    def resolve(self, node):
        while isinstance(node, dict) and "$ref" in node:
            found = self.server.contract
            for part in node["$ref"][2:].split("/"):
                found = found[part]
            node = found
        return node


class Sets(Attacker):
    """Balls and options that cost, and all that can be asked of them."""

    def harm(self):
        model = self.own_model()
        if model is None:
            return
        for _ in range(self.random.randrange(1, 4)):
            way = self.random.randrange(6)
            if way == 0:
                self.exchange("GET", "/v1/models/%s/measures" % model, Prefer="wait=3")
            elif way == 1:
                self.exchange("GET", "/v1/models/%s/exports/%s" % (model, self.random.choice(["vdb", "nifti", "ply", "vtp", "npy", "csv", "urdf", "glb", "yade", "liggghts"])),
                              Prefer="wait=3")
            elif way == 2:
                style = self.random.choice(["spheres", "blobs", "centres"])
                self.exchange("GET", "/v1/models/%s/render?width=32&height=32&style=%s" % (model, style), Prefer="wait=3")
            elif way == 3:
                body = {"method": self.random.choice(["best", "average", "median", "prune", "sphericity"]), "k": self.random.choice([1, 2, 5, 64, 1000, 2**31])}
                self.make("/v1/models/%s/simplifications" % model, json.dumps(body).encode(), Content_Type="application/json")
            elif way == 4:
                body = {"fixed": model, "moving": self.some_model(), "transform": self.random.choice(["rigid", "similarity"]),
                        "scale_bounds": [self.number(), self.number()]}
                if self.random.random() < 0.5:
                    del body["scale_bounds"]
                self.make("/v1/registrations", json.dumps(body).encode(), Content_Type="application/json")
            else:
                self.exchange("GET", "/v1/models/%s/spheres?limit=%s&columns=rank,share" % (model, text_of(self.number())), Prefer="wait=3")
        if self.random.random() < 0.7:
            self.exchange("DELETE", "/v1/models/" + model)


class Scans(Attacker):
    """Volumes whose surface, shape or geometry is out of this world, and spoilt files of every format."""

    def volume(self):
        r = self.random
        way = r.randrange(7)
        if way == 0:  # checkerboard
            n = r.choice([8, 20, 40])
            data, dims = bytes(255 * ((x + y + z) & 1) for z in range(n) for y in range(n) for x in range(n)), (n, n, n)
        elif way == 1:  # a row
            n = r.choice([1, 2, 1000, 80000])
            data, dims = bytes(r.choice([0, 200]) for _ in range(n)), r.choice([(1, 1, n), (n, 1, 1), (1, n, 1)])
        elif way == 2:
            n = r.choice([2, 10, 30])
            data, dims = r.randbytes(n * n * n), (n, n, n)
        elif way == 3:
            n = r.choice([1, 2, 16])
            data, dims = bytes([r.choice([0, 255])]) * (n * n * n), (n, n, n)
        else:
            data, dims = BALL, (8, 8, 8)
        query = {"format": "raw", "dims": "%d,%d,%d" % dims, "dtype": "uint8"}
        if way > 3:
            query[r.choice(["spacing", "origin", "slope", "intercept", "direction"])] = ",".join(text_of(self.number()) for _ in range(r.choice([1, 3, 3, 9])))
        return "/v1/volumes?" + urllib.parse.urlencode(query, safe=","), data

    def spoilt(self):
        kind = self.random.choice(["nifti", "nrrd", "metaimage", "openvdb", "archive"])
        data = bytearray(self.random.choice(SEEDS[kind]))
        for _ in range(self.random.choice([1, 1, 2, 4])):
            at = self.random.randrange(len(data) + 1)
            way = self.random.randrange(4)
            if way == 0:
                data[at:at + 4] = struct.pack("<f", self.random.choice([1e38, -1e38, math.nan, math.inf, 1e-45, 0.0]))
            elif way == 1:
                data[at:at + 2] = self.random.choice([b"\xff\xff", b"\0\0", b"\xff\x7f", b"\0\x80"])
            elif way == 2:
                data[at:at + 8] = self.random.choice([b"1e110", b"-1e309 ", b"99999999", b"nan", b"\0" * 8])
            else:
                del data[at:at + self.random.choice([1, 4, 64])]
        return "/v1/volumes", bytes(data)

    def harm(self):
        target, data = self.volume() if self.random.random() < 0.5 else self.spoilt()
        volume = self.make(target, data)
        if volume is None or not volume.startswith("vol_"):
            return
        self.exchange("GET", "/v1/volumes/" + volume)
        self.exchange("GET", "/v1/volumes?limit=5")
        self.exchange("GET", "/v1/models?limit=5")
        rule = self.random.choice([{"threshold": self.number()}, {"threshold": 100}, {"range": [self.number(), self.number()]}, {"labels": [self.random.choice([0, 1, 255, 2**63 + 5, "9223372036854775813"])]}])
        model = self.make("/v1/models", json.dumps({"volume": volume, **rule}).encode(), Content_Type="application/json")
        if model and model.startswith("mdl_"):
            self.exchange("GET", "/v1/models/%s/%s" % (model, self.random.choice(["measures", "checks", "exports/vdb", "exports/nifti", "render?width=24&height=24&style=surface"])),
                          Prefer="wait=3")
        if self.random.random() < 0.8:
            self.exchange("DELETE", "/v1/volumes/" + volume)


class Heads(Attacker):
    """Framing that two readers would see two ways, and heads without an end. A second request must never be answered."""

    def harm(self):
        r = self.random
        hidden = b"DELETE /v1/volumes/vol_" + b"0" * 32 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n"
        base = b"POST /v1/volumes HTTP/1.1\r\nHost: localhost\r\n"
        endless = None
        shapes = [base + b"Content-Length : 5\r\n\r\nhello" + hidden, base + b"Content-Length: 5\r\n Content-Length: 0\r\n\r\nhello" + hidden,
                  base + b"Content-Length: 5\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n" + hidden, base + b"X: a\rContent-Length: 5\r\n\r\nhello" + hidden,
                  base + b"X: a\0b\r\nContent-Length: 0\r\n\r\n" + hidden, base + b"Transfer-Encoding: chunked\r\n\r\n5\r\nhelloXX0\r\n\r\n" + hidden,
                  base + b"Transfer-Encoding: chunked\r\n\r\n5;a=b\nhello\r\n0\r\n\r\n" + hidden, base + b"Transfer-Encoding: chunked\r\nContent-Length: 3\r\n\r\n0\r\n\r\n" + hidden,
                  base + b"Transfer-Encoding: \x0bchunked\r\n\r\n0\r\n\r\n" + hidden, base + b"Content-Length: +5\r\n\r\nhello" + hidden, base + b"Content-Length: 5, 5\r\n\r\nhello" + hidden,
                  base + b"Host: evil\r\nContent-Length: 0\r\n\r\n", b"GET /v1/volumes HTTP/1.1\r\n\r\n", b"GET http://evil/v1/volumes HTTP/1.1\r\nHost: localhost\r\n\r\n",
                  b"GET  /v1/volumes HTTP/1.1\r\nHost: localhost\r\n\r\n", base + b"Transfer-Encoding: chunked\r\n\r\nfffffffffffffffff\r\n", base + b"Transfer-Encoding: chunked\r\n\r\n-5\r\nhello\r\n"]
        data = r.choice(shapes)
        way = r.randrange(5)
        if way == 0:
            endless, data = b"A:b\r\n", base[:-2] + b"\n"
        elif way == 1:
            endless, data = b"a" * 1000, b"GET /" if r.random() < 0.5 else base + b"Transfer-Encoding: chunked\r\n\r\n5;"
        elif way == 2:
            data = bytearray(data)
            for _ in range(r.randrange(1, 5)):
                data.insert(r.randrange(len(data)), r.choice(b"\r\n\0 :;,\t\x80"))
        self.what = repr(bytes(data))
        with self.server.connect(30) as link:
            try:
                link.sendall(data)
                for _ in range(4000 if endless else 0):
                    link.sendall(endless * 10)
                link.shutdown(socket.SHUT_WR)
            except OSError:
                pass
            stream = link.makefile("rb")
            answers = 0
            try:
                while answers < 3:
                    answer = read_answer(stream, data.split(b" ", 1)[0].decode("latin-1"))
                    answers += 1
                    self.tally[answer[0]] += 1
                    if answers == 2 and answer[0] == 404 and hidden in data and way > 2:
                        raise Broken("a hidden request was answered")
                    if not answer[3]:
                        break
            except ValueError as problem:
                raise Broken("an answer that is none: %s" % problem) from problem


class Holders(Attacker):
    """Connections that do nothing, or little, for as long as they may."""

    def harm(self):
        r = self.random
        starts = [b"", b"G", b"GET /livez HTTP/1.1\r\nHost: localhost\r\n", b"POST /v1/volumes HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n",
                  b"POST /v1/volumes HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000\r\n\r\n", b"POST /v1/volumes HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\nExpect: 100-continue\r\n\r\n",
                  b"GET /openapi.yaml HTTP/1.1\r\nHost: localhost\r\n\r\n" * 20, b"GET /v1/jobs/%s/events HTTP/1.1\r\nHost: localhost\r\n\r\n" % self.server.ids["job"].encode()]
        links = []
        self.what = "connections that are held"
        try:
            for _ in range(r.choice([10, 100, 200])):
                link = self.server.connect(5)
                link.sendall(r.choice(starts))
                links.append(link)
            end = min(self.until, time.monotonic() + r.choice([1, 5, 20]))
            while time.monotonic() < end:
                for link in links:
                    try:
                        link.send(b"5" if r.random() < 0.5 else b"\r")
                    except OSError:
                        pass
                time.sleep(1)
            self.tally["held"] += len(links)
        finally:
            for link in links:
                link.close()


class Pieces(Attacker):
    """Uploads in pieces that stop, overlap, are read, finished and deleted by several at once."""

    mine = collections.deque(maxlen=50)

    def harm(self):
        r = self.random
        way = r.randrange(5)
        if way == 0 or not self.mine:
            length = r.choice([0, 1, 512, 1000, 1 << 20, 1 << 40, 2**63, 2**64])
            status, headers, _, _ = self.exchange("POST", "/v1/uploads", Tus_Resumable="1.0.0", Upload_Length=str(length))
            if status == 201:
                self.mine.append((headers["location"], length))
            return
        target, length = r.choice(list(self.mine))
        if way == 1:
            self.exchange("HEAD", target, Tus_Resumable="1.0.0")
        elif way == 2:
            self.exchange("DELETE", target, Tus_Resumable="1.0.0")
        elif way == 3:
            self.make("/v1/volumes?format=raw&dims=8,8,8&dtype=uint8&upload=" + target.rsplit("/", 1)[1], b"")
        else:
            offset = r.choice([0, 0, 1, 512, length, 2**63])
            data = r.randbytes(r.choice([0, 1, 512, 100000]))
            self.exchange("PATCH", target, data, Tus_Resumable="1.0.0", Upload_Offset=str(offset), Content_Type="application/offset+octet-stream")


class Undoers(Attacker):
    """Work that is asked for, cancelled, deleted and asked for again while it runs."""

    def harm(self):
        r = self.random
        n = r.choice([16, 24])
        data = r.randbytes(n * n * n)
        volume = self.make("/v1/volumes?format=raw&dims=%d,%d,%d&dtype=uint8" % (n, n, n), data)
        if not volume:
            return
        wish = json.dumps({"volume": volume, "threshold": r.randrange(1, 255)}).encode()
        key = {"Idempotency_Key": "k%d" % r.randrange(4)} if r.random() < 0.3 else {}
        status, headers, body, _ = self.exchange("POST", "/v1/models", wish, Content_Type="application/json", **key)
        job = headers.get("location", "") if status == 202 else ""
        for _ in range(r.randrange(1, 5)):
            way = r.randrange(5)
            if way == 0 and job.startswith("/v1/jobs/"):
                self.exchange("DELETE", job)
            elif way == 1:
                self.exchange("POST", "/v1/models", wish, Content_Type="application/json")
            elif way == 2 and job:
                self.exchange("GET", job)
            elif way == 3:
                self.exchange("GET", "/v1/jobs?limit=20")
            else:
                self.exchange("DELETE", "/v1/volumes/" + volume)
        self.exchange("DELETE", "/v1/volumes/" + volume)


class Pages(Attacker):
    """Requests in the name of foreign pages, which must change and read nothing."""

    def harm(self):
        r = self.random
        method = r.choice(["GET", "POST", "DELETE"])
        target = {"GET": "/v1/volumes", "POST": "/v1/models", "DELETE": "/v1/models/" + self.server.ids["other"]}[method]
        headers = r.choice([{"Host": "evil.example"}, {"Host": "127.0.0.1.evil.example:80"}, {"Sec_Fetch_Site": "cross-site"}, {"Origin": "http://evil.example"}, {"Origin": "null"}])
        if method == "GET":
            headers = {"Host": r.choice(["evil.example", "localhost.evil", "0.0.0.0.nip.io", "[::2]", "169.254.1.1"])}
        status = self.exchange(method, target, b"x,y,z,r\n9,9,9,9\n" if method == "POST" else b"", Content_Type="text/plain", **headers)[0]
        if status not in (0, 400, 403, 415, 421, 429, 503):
            raise Broken("answered %d to a foreign page %r" % (status, headers))
        time.sleep(0.05)


class Honest(Attacker):
    """Somebody who just uses it."""

    def harm(self):
        begun = time.monotonic()
        self.what = "GET /livez"
        answer = self.server.ask("GET", "/livez", timeout=PATIENCE)
        if answer[0] != 200 or time.monotonic() - begun > PATIENCE:
            raise Broken("/livez: %d after %.1f s" % (answer[0], time.monotonic() - begun))
        self.tally["alive"] += 1
        for target in ("/v1/volumes?limit=3", "/v1/models?limit=3", "/v1/jobs?limit=3", "/v1/registrations?limit=3", "/metrics"):
            answer = self.exchange("GET", target)
            if answer[0] not in (0, 200, 429, 503):
                raise Broken("%s: %d" % (target, answer[0]))
        time.sleep(1)

    def run(self):
        while time.monotonic() < self.until and self.server.process.poll() is None:
            try:
                self.harm()
            except Exception as problem:
                if self.server.process.poll() is None:
                    self.findings.append("Honest: %s (%s)" % (problem, self.what))


def resident(process):
    with open("/proc/%d/status" % process.pid) as status:
        return sum(int(line.split()[1]) for line in status if line.startswith("VmRSS:")) // 1024


def attack(server, seconds, tally, findings):
    until = time.monotonic() + seconds
    kinds = [Cameras, Cameras, Sets, Sets, Scans, Scans, Heads, Holders, Pieces, Pieces, Undoers, Undoers, Pages, Honest]
    threads = [kind(server, until, tally, findings, n) for n, kind in enumerate(kinds)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(seconds + 300)
        if thread.is_alive():
            findings.append("%s was never answered: %.600s" % (type(thread).__name__, thread.what))


def main():
    with tempfile.TemporaryDirectory() as folder:
        tally, findings, begun, rounds = collections.Counter(), [], time.monotonic(), 0
        server = Server(SERVER, folder, FLAGS)
        while (left := MINUTES * 60 - (time.monotonic() - begun)) > 1 and len(findings) < 50:
            attack(server, min(left, ROUND), tally, findings)
            rounds += 1
            if server.process.poll() is not None:
                findings.append("the server ended with %d" % server.process.poll())
                server.start()
            print("%5.0f s, resident %d MiB, %d findings, answers: %s" % (time.monotonic() - begun, resident(server.process), len(findings), dict(sorted(tally.items(), key=str))), flush=True)
            if rounds % 3 == 0:
                server.process.kill()
                server.process.wait()
                server.start()
            server.refresh()
        ended = server.stop()
        if ended != 0:
            findings.append("an orderly stop ended with %d" % ended)
        checked = subprocess.run([SERVER, "fsck", "--data", folder + "/data"], capture_output=True, text=True)
        if checked.returncode != 0:
            findings.append("fsck: " + checked.stdout[-2000:] + checked.stderr[-2000:])
        findings += ["The log has: " + fault for fault in server.faults()]
        for finding in findings[:50]:
            print(finding)
        print("answers:", dict(sorted(tally.items(), key=str)), "- findings:", len(findings))
        sys.exit(1 if findings else 0)


main()
