# SPDX-License-Identifier: GPL-3.0-or-later
"""A server to be attacked, and what its answers must hold to: shared by http.py and attack.py. Needs python3-yaml."""
import atexit
import gzip
import json
import pathlib
import re
import socket
import subprocess

import yaml

PATIENT = b"DOE^JANE"
CORPUS = pathlib.Path(__file__).parent / "corpus"
SEEDS = {folder.name: [file.read_bytes() for file in sorted(folder.iterdir())] for folder in CORPUS.iterdir() if folder.is_dir()}

# What answers never say. Ours are "std::", types and sources; no generator writes one of them.
LEAKS = re.compile(rb"/(usr|home|root|proc|tmp|var|dev|work|core|server)/|\.cpp\b|\.h:\d|std::|spherule::|nlohmann|httplib|sqlite|SELECT |"
                   rb"json\.exception|basic_string|0x7f[0-9a-f]{6}|catalog\.sqlite|blobs/|" + PATIENT)
MAY_SAY_MORE = ("/content", "/docs", "/openapi.yaml")

BALL = bytes(max(0, int(200 - 100 * ((x - 3.6) ** 2 + (y - 3.4) ** 2 + (z - 3.5) ** 2) ** 0.5 / 2.4)) for z in range(8) for y in range(8) for x in range(8))


class Broken(Exception):
    """What an answer should not be."""


def read_answer(stream, method):
    """One answer of HTTP/1.1: status, headers (lower case), body, whether the connection stays."""
    while True:
        line = stream.readline(65536)
        if not line:
            raise EOFError
        if not re.fullmatch(rb"HTTP/1\.1 [1-5]\d\d [ -~]*\r\n", line):
            raise Broken("no status line: %r" % line[:80])
        status, headers = int(line[9:12]), {}
        while (line := stream.readline(65536)) not in (b"\r\n", b""):
            name, colon, value = line.partition(b":")
            if not colon or not line.endswith(b"\r\n"):
                raise Broken("no header: %r" % line[:80])
            headers[name.decode("latin-1").lower()] = value.strip().decode("latin-1")
        if status != 100:
            break
    stays = headers.get("connection", "").lower() != "close"
    if method == "HEAD" or status in (204, 304):
        return status, headers, b"", stays
    if headers.get("transfer-encoding") == "chunked":
        body = b""
        while size := int(stream.readline(100).split(b";")[0], 16):
            body += stream.read(size)
            stream.read(2)
        stream.readline(100)
        return status, headers, body, stays
    body = stream.read(int(headers.get("content-length", 0)))
    if len(body) < int(headers.get("content-length", 0)):
        raise Broken("a body that is cut")
    return status, headers, body, stays


def request_bytes(method, target, headers, body):
    names = {name.lower() for name, _ in headers}
    head = "%s %s HTTP/1.1\r\n" % (method, target)
    if "host" not in names:
        head += "Host: localhost\r\n"
    if (body or method in ("POST", "PATCH")) and not names & {"content-length", "transfer-encoding"}:
        head += "Content-Length: %d\r\n" % len(body)
    head += "".join("%s: %s\r\n" % header for header in headers)
    return (head + "\r\n").encode("utf-8", "surrogateescape") + body


def check_answer(method, target, answer, folder):
    """Throws Broken when an answer is none that may be given; `folder` is where the server keeps its data."""
    status, headers, body, _ = answer
    packing = headers.get("content-encoding")
    if packing == "gzip":
        body = gzip.decompress(body)
    elif packing == "zstd":  # which Python does not unpack
        body = b'{"status": %d, "type": "?", "detail": "?."}' % status
    if status >= 500 and status not in (503, 507):
        raise Broken("status %d" % status)
    if status in (429, 503) and "retry-after" not in headers:
        raise Broken("status %d without Retry-After" % status)
    if status >= 400 and method != "HEAD" and not target.startswith("HEAD"):
        if headers.get("content-type") != "application/problem+json":
            raise Broken("status %d without a problem document" % status)
        problem = json.loads(body)
        if problem["status"] != status or not problem["type"] or not problem["detail"].endswith("."):
            raise Broken("a problem document that is not one")
        if len(body) > 65536:
            raise Broken("a problem document of %d bytes" % len(body))
    said = "\r\n".join("%s: %s" % h for h in headers.items()).encode("latin-1")
    if not any(part in target for part in MAY_SAY_MORE):
        said += body
    if leak := LEAKS.search(said):
        raise Broken("says %r in %r" % (leak.group(), said[max(0, leak.start() - 60):leak.end() + 60]))
    if folder.encode() in said:
        raise Broken("names its folder")


class Server:
    """spheruled in a folder of its own, on a free port. `ids` are of things that are there after refresh()."""

    def __init__(self, program, folder, flags):
        self.folder = folder
        self.log_file = folder + "/log"
        self.command = [program, "--port", "0", "--data", folder + "/data", *flags]
        atexit.register(lambda: self.process.kill())  # whatever ends this
        self.start()
        self.contract = yaml.safe_load(self.ask("GET", "/openapi.yaml")[2])
        self.refresh()

    def start(self):
        self.process = subprocess.Popen(self.command, stdout=subprocess.PIPE, stderr=open(self.log_file, "ab"))
        self.port = int(self.process.stdout.readline().rsplit(b":", 1)[1])

    def stop(self):
        """The exit status of an orderly stop."""
        self.process.terminate()
        return self.process.wait(180)

    def faults(self):
        """What the log should not have: pieces of it around each."""
        log = open(self.log_file, "rb").read()
        found = []
        for sign in (b'"event":"fault"', b"Sanitizer", b"runtime error", PATIENT):
            at = log.find(sign)
            if at >= 0:
                found.append(log[max(0, at - 200):at + 3000].decode("utf-8", "replace"))
        return found

    def connect(self, timeout=120):
        link = socket.create_connection(("127.0.0.1", self.port), timeout=timeout)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return link

    def ask(self, method, target, body=b"", timeout=120, **headers):
        with self.connect(timeout) as link:
            link.sendall(request_bytes(method, target, [(name.replace("_", "-"), value) for name, value in headers.items()], body))
            return read_answer(link.makefile("rb"), method)

    def make(self, target, body, **headers):
        for _ in range(600):
            status, _, data, _ = self.ask("POST", target, body, Prefer="wait=2", **headers)
            if status in (200, 201):
                return json.loads(data)["id"]
            if status != 202:
                raise Broken("no %s: %d %r" % (target, status, data[:300]))
        raise Broken("no %s in time" % target)

    def refresh(self):
        """What requests are about; the same ids each time, but those of the job and the upload."""
        ids = {}
        ids["volume"] = self.make("/v1/volumes?format=raw&dims=8,8,8&dtype=uint8", BALL)
        wish = lambda **fields: json.dumps(fields).encode()
        ids["model"] = self.make("/v1/models", wish(volume=ids["volume"], threshold=100), Content_Type="application/json")
        ids["other"] = self.make("/v1/models", b"x,y,z,r\n0,0,0,2\n3,0,0,2\n0,3,0,1\n", Content_Type="text/csv")
        ids["simple"] = self.make("/v1/models/%s/simplifications" % ids["model"], wish(method="best", k=5), Content_Type="application/json")
        ids["registration"] = self.make("/v1/registrations", wish(fixed=ids["model"], moving=ids["simple"], transform="similarity"),
                                        Content_Type="application/json")
        job = self.ask("GET", "/v1/jobs?limit=1")[2]
        ids["job"] = json.loads(job)["jobs"][0]["id"]
        ids["upload"] = json.loads(self.ask("POST", "/v1/uploads", Tus_Resumable="1.0.0", Upload_Length="1000")[2])["id"]
        self.ids = ids
