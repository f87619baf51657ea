#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""http.py [SPHERULED [REQUESTS [SEED]]]: hostile HTTP against a running server, best one with sanitizers.

    cmake --preset asan && cmake --build --preset asan --target spheruled
    tests/fuzz/http.py build/asan/server/spheruled 100000

Request number i is a function of SEED and i: an operation of the server's own contract with values that its schemas
allow, some of them spoilt; the bytes of such a request spoilt, framing included; or a scan, archive, table or form of
tests/fuzz/corpus, spoilt. What comes back must be HTTP; every error a problem document; no status 500 or above but 503
and 507 (a full queue or disk); and no answer may name a folder, a source file or a library, or the patient whom files
and forms name. In the end the server must still answer, stop with status 0, and have logged no fault, no sanitizer's
report and no patient. Prints what broke that, with its number; the status is 0 when nothing did.
Needs python3-yaml.
"""
import collections
import copy
import gzip
import io
import json
import random
import re
import socket
import sys
import tempfile
import threading
import time
import urllib.parse
import warnings
import zipfile

from hostile import BALL, SEEDS, Broken, Server, check_answer, read_answer, request_bytes

warnings.filterwarnings("ignore", "Duplicate name")  # which an archive may have

SERVER = sys.argv[1] if len(sys.argv) > 1 else "build/asan/server/spheruled"
REQUESTS = int(sys.argv[2]) if len(sys.argv) > 2 else 100000
SEED = sys.argv[3] if len(sys.argv) > 3 else "1"
THREADS = 3
REFRESH = 1000  # requests after which what was deleted is there again
FLAGS = ["--max-image-pixels", "20000", "--max-body-bytes", str(1 << 20), "--max-decompressed-bytes", str(1 << 22), "--max-voxels", str(1 << 20),
         "--queue-length", "100000", "--queue-per-client", "100000", "--max-wait-s", "2", "--keep-jobs", "10m", "--threads", "1"]

EVIL_JSON = [None, True, False, 0, -1, 1, 2**31, 2**53 + 1, 2**64, -(2**63), 1e308, -1e308, 5e-324, 0.1, "", "x", "x" * 5000, "\0", "\u202e",
             "\U0001f9b4", [], {}, [[]], [0] * 2000, {"": ""}, {"a": {"b": {"c": [1]}}}, "60.5", "vol_" + "0" * 32, "mdl_" + "f" * 32]
EVIL_TEXT = ["", "0", "-1", "1", "1e309", "-0", "nan", "inf", "99999999999999999999", "0x10", "1,2,3", "1,2", ",", ",,,", "a", "true", "%", "\0", "\xff",
             "a" * 3000, "\u202e", "..", "../..", "*", "'", "\"", ";", "1;2", "1e-320", "0.0000001", " 1", "1 ", "+1", "json", "png", "a,a", "0,0,0,0,0,0"]
EVIL_HEADERS = [("Range", v) for v in ("bytes=0-0", "bytes=-1", "bytes=5-1", "bytes=0-,1-,2-", "bytes=99999999999999999999-", "octets=0-1", "bytes=", "bytes=-0",
                                       "bytes=" + "0-0," * 300 + "1-1", "bytes=0-99,50-149", "bytes=1-1, 3-3,-2")]
EVIL_HEADERS += [("Accept", v) for v in ("*/*", "", "text/html", "application/json;q=0", "image/*", "a/b;q=2", ",;,", "*/*;q=0", "x" * 2000)]
EVIL_HEADERS += [("Accept-Encoding", v) for v in ("gzip", "zstd", "gzip;q=0", "*", "br", "gzip,zstd;q=0.5", ";q=", "identity;q=0")]
EVIL_HEADERS += [("Prefer", v) for v in ("wait=0", "wait=1", "wait=-1", "wait=x", "wait=99999999999999999999", "respond-async", "wait=1;a=b", "wait")]
EVIL_HEADERS += [("If-None-Match", v) for v in ("*", '"x"', 'W/"x"', "x", '"', ",")] + [("If-Match", v) for v in ("*", '"x"', "")]
EVIL_HEADERS += [("Content-Type", v) for v in ("application/json", "text/csv", "application/x-npy", "multipart/form-data", "multipart/form-data; boundary=",
                                               "multipart/form-data; boundary=\"a", "application/zip", "", "a", "application/offset+octet-stream")]
EVIL_HEADERS += [("Content-Encoding", v) for v in ("gzip", "zstd", "br", "gzip, gzip", "identity", "x")]
EVIL_HEADERS += [("Content-Length", v) for v in ("-1", "0", "5", "99999999999999999999", "x", "1 1")]
EVIL_HEADERS += [("Transfer-Encoding", v) for v in ("chunked", "gzip, chunked", "Chunked", "identity", "x")]
EVIL_HEADERS += [("Idempotency-Key", v) for v in ("a", "", "b c", "k" * 256, "k1", "k2")] + [("traceparent", v) for v in ("", "00-" + "a" * 32 + "-" + "b" * 16 + "-01", "x" * 55)]
EVIL_HEADERS += [("Expect", "100-continue"), ("Expect", "x"), ("Connection", "close"), ("Connection", "keep-alive, close"), ("Host", ""), ("Upgrade", "h2c"),
                 ("Tus-Resumable", "0.2"), ("Upload-Offset", "-1"), ("Upload-Offset", "3"), ("Upload-Length", "x"), ("Upload-Length", "99999999999999999999"),
                 ("Upload-Metadata", "filename"), ("Upload-Metadata", "filename !!"), ("Upload-Metadata", "filename RE9FXkpBTkU="), ("Last-Event-ID", "x"),
                 ("Last-Event-ID", "99999999999999999999"), ("Origin", "null"), ("X" * 300, "y"), ("Cookie", "a=b" * 1000), ("Authorization", "Bearer sph_0")]


class Generator:
    """Request number i: generate() gives its method, its bytes, and whether they are whole."""

    def __init__(self, server, i):
        self.server, self.ids, self.random = server, server.ids, random.Random("%s %d" % (SEED, i))
        self.contract = server.contract

    def chance(self, p):
        return self.random.random() < p

    def resolve(self, node):
        while isinstance(node, dict) and "$ref" in node:
            found = self.contract
            for part in node["$ref"][2:].split("/"):
                found = found[part]
            node = found
        return node

    def value(self, parameter):
        schema = self.resolve(parameter.get("schema", {}))
        name = parameter["name"]
        good = {"dims": "8,8,8", "dtype": self.random.choice(["uint8", "int8", "int16"]), "spacing": "1,1,2", "origin": "0,0,0", "upload": self.ids["upload"],
                "with": self.random.choice([self.ids["model"], self.ids["other"]]), "Upload-Length": "9", "Upload-Offset": "0", "width": str(self.random.randrange(1, 200)),
                "height": str(self.random.randrange(1, 200)), "samples": "1", "turntable": self.random.choice(["1", "2"]), "index": str(self.random.randrange(9)),
                "limit": str(self.random.randrange(1, 9)), "level": str(self.random.randrange(1, 5)), "voxel_mm": "1", "threshold": str(self.random.randrange(256))}
        if name in good and (name != "upload" or parameter.get("in") == "query"):
            return good[name]
        if "example" in parameter or "example" in schema:
            return str(parameter.get("example", schema.get("example")))
        for choices in (schema.get("enum"), [schema.get("const")] if "const" in schema else None):
            if choices:
                return str(self.random.choice(choices))
        kind = schema.get("type")
        if kind in ("integer", "number"):
            least = schema.get("minimum", schema.get("exclusiveMinimum", 0))
            most = min(schema.get("maximum", schema.get("exclusiveMaximum", least + 20)), least + 50)
            return str(self.random.randint(int(least), int(max(most, least)))) if kind == "integer" else "%.3f" % self.random.uniform(least, most)
        if kind == "boolean":
            return self.random.choice(["true", "false"])
        return self.random.choice(EVIL_TEXT)

    def spoil_json(self, document):
        document = copy.deepcopy(document)
        places = []

        def walk(node):
            for key in list(node.keys() if isinstance(node, dict) else range(len(node))):
                places.append((node, key))
                if isinstance(node[key], (dict, list)):
                    walk(node[key])

        if not isinstance(document, (dict, list)):
            return self.random.choice(EVIL_JSON)
        walk(document)
        for _ in range(self.random.randrange(1, 3)):
            if not places:
                break
            node, key = self.random.choice(places)
            way = self.random.randrange(4)
            if way == 0 and isinstance(node, dict):
                node.pop(key, None)
            elif way == 1 and isinstance(node, dict):
                node[self.random.choice(["x", "", "thresholds", "\0", "k" * 500, "__proto__"])] = self.random.choice(EVIL_JSON)
            elif isinstance(node, dict) or key < len(node):
                node[key] = self.random.choice(EVIL_JSON)
        return document

    def json_text(self, document):
        text = json.dumps(document, ensure_ascii=self.chance(0.5)).encode("utf-8", "surrogatepass")
        way = self.random.randrange(12)
        if way == 0:
            text = self.spoil(text)
        elif way == 1:
            text = self.random.choice([b"", b"{", b"[" * 3000, b"{\"a\":" * 1000, b"nul", b"\xef\xbb\xbf{}", b"1e999", b"\"\\ud800\"", b"{\"a\":1,\"a\":2}", b"{}{}", b"[1e400]",
                                       b"{\"threshold\":1e999}", b"\xff", b"{\"volume\":\"\\u0000\"}", text.replace(b"}", b",\"volume\":1}", 1)])
        return text

    def spoil(self, data):
        data = bytearray(data)
        for _ in range(self.random.choice([1, 1, 2, 4, 16])):
            at = self.random.randrange(len(data) + 1)
            way = self.random.randrange(7)
            if way == 0 and data:
                data[at % len(data)] = self.random.randrange(256)
            elif way == 1 and data:
                data[at % len(data)] ^= 1 << self.random.randrange(8)
            elif way == 2:
                data[at:at] = self.random.randbytes(self.random.choice([1, 2, 4, 40]))
            elif way == 3:
                del data[at:at + self.random.choice([1, 2, 8, 100])]
            elif way == 4:
                del data[at:]
            elif way == 5:
                data[at:at + 4] = self.random.choice([b"\0\0\0\0", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"\r\n\r\n", b"\0\0\x80\x7f"])
            else:
                other = self.random.randrange(len(data) + 1)
                data[at:at] = data[other:other + 64]
        return bytes(data)

    def scan(self):
        """A file that a reader takes, or what packs one: bytes, query, headers."""
        kinds = ["nifti", "nrrd", "metaimage", "openvdb", "raw", "csv", "npy", "zip", "form", "gzip", "tus"]
        kind = self.random.choice(kinds)
        headers, query, path = [], "", "/v1/volumes"
        if kind in ("nifti", "nrrd", "metaimage", "openvdb"):
            data = self.random.choice(SEEDS[kind])
        elif kind == "csv":
            data, path, headers = self.random.choice(SEEDS["spheres_csv"] + [b"x,y,z,r\n0,0,0,1\n"]), "/v1/models", [("Content-Type", "text/csv")]
        elif kind == "npy":
            data, path, headers = self.random.choice(SEEDS["spheres_npy"]), "/v1/models", [("Content-Type", "application/x-npy")]
        else:
            data = BALL
            query = "?format=raw&dims=8,8,8&dtype=uint8"
        if kind in ("zip", "form", "gzip") and self.chance(0.5):
            data, query = self.random.choice(SEEDS[self.random.choice(["nifti", "nrrd", "metaimage"])]), ""
        if self.chance(0.7):
            data = self.spoil(data)
        name = self.random.choice(["scan.raw", "DOE^JANE.nii", "a/../b", "../x", "", "x" * 300, "\u202e", "scan\0"])
        if kind == "zip":
            packed = io.BytesIO()
            with zipfile.ZipFile(packed, "w", self.random.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])) as files:
                for n in range(self.random.choice([1, 1, 2, 5])):
                    files.writestr(zipfile.ZipInfo(name + str(n or "")), data)
            data = packed.getvalue()
        elif kind == "form":
            parts = "".join("--cut\r\nContent-Disposition: form-data; name=\"file\"; filename=\"%s%s\"\r\n\r\n@@\r\n" % (name, n or "")
                            for n in range(self.random.choice([1, 1, 2, 5])))
            data = (parts + "--cut--\r\n").encode().replace(b"@@", data)
            headers = [("Content-Type", "multipart/form-data; boundary=cut")]
        elif kind == "gzip":
            data = gzip.compress(data)
            headers = self.random.choice([[], [("Content-Encoding", "gzip")], [("Content-Encoding", "zstd")]])
        elif kind == "tus":
            headers = [("Tus-Resumable", "1.0.0"), ("Upload-Offset", str(self.random.choice([0, 0, 5, 100]))), ("Content-Type", "application/offset+octet-stream")]
            data = data[:self.random.choice([0, 1, 100, 1000, 2000])]
            return "PATCH", "/v1/uploads/" + self.ids["upload"], headers, data
        if kind in ("zip", "form", "gzip") and self.chance(0.6):
            data = self.spoil(data)
        return "POST", path + query, headers, data

    def operation(self):
        """One of the contract's, filled in."""
        paths = self.contract["paths"]
        path = self.random.choice(list(paths))
        item = paths[path]
        method = self.random.choice([name for name in item if name in ("get", "post", "delete", "patch")])
        if method == "post" and path == "/v1/registrations" and not self.chance(0.1):
            method = "get"  # each takes as long as hundreds of others
        operation = item[method]
        if method == "delete" and not self.chance(0.05):
            method = "get"
            operation = item.get("get", operation)
        parameters = [self.resolve(p) for p in item.get("parameters", []) + operation.get("parameters", [])]
        query, headers = [], []
        for parameter in parameters:
            name = parameter["name"]
            if parameter["in"] == "path":
                good = {"model": self.random.choice([self.ids["model"], self.ids["other"], self.ids["simple"]])}.get(name, self.ids.get(name))
                value = good if good and self.chance(0.95) else self.value(parameter) if self.chance(0.9) else self.random.choice(EVIL_TEXT)
                path = path.replace("{%s}" % name, urllib.parse.quote(value, safe=",*'"))
            elif parameter["in"] == "query" and (parameter.get("required") or self.chance(0.25)):
                query.append([name, self.value(parameter)])
            elif parameter["in"] == "header" and (name == "Tus-Resumable" or self.chance(0.3)):
                headers.append((name, "1.0.0" if name == "Tus-Resumable" else self.value(parameter)))
        body = b""
        content = operation.get("requestBody", {}).get("content", {})
        if content:
            kind = self.random.choice(list(content))
            examples = [self.resolve(e).get("value") for e in content[kind].get("examples", {}).values()]
            if "example" in content[kind]:
                examples.append(content[kind]["example"])
            if kind == "application/json":
                wish = self.random.choice(examples or [{}])
                text = json.dumps(wish)
                for pattern, name in (("vol_[0-9a-f]{32}", "volume"), ("mdl_[0-9a-f]{32}", "model")):
                    text = re.sub(pattern, self.ids[name], text)
                wish = json.loads(text)
                body = self.json_text(self.spoil_json(wish) if self.chance(0.7) else wish)
            elif examples:
                body = str(examples[0]).encode()
            else:
                body = self.random.choice(SEEDS[self.random.choice(list(SEEDS))])
            if kind != "*/*" and not kind.startswith("multipart"):
                headers.append(("Content-Type", kind))
        for _ in range(self.random.choice([0, 0, 1, 1, 2])):
            way = self.random.randrange(5)
            if way == 0 and query:
                self.random.choice(query)[1] = self.random.choice(EVIL_TEXT)
            elif way == 1 and query:
                query.append(list(self.random.choice(query)))
            elif way == 2:
                query.append([self.random.choice(["x", "limit", "", "format", "\0", "k" * 200]), self.random.choice(EVIL_TEXT)])
            else:
                headers.append(self.random.choice(EVIL_HEADERS))
        if query:
            path += "?" + "&".join("%s=%s" % (urllib.parse.quote(n), urllib.parse.quote(v, safe=self.random.choice(["", ",", ",;"]))) for n, v in query)
        method = method.upper()
        if method == "GET" and self.chance(0.05):
            method = self.random.choice(["HEAD", "OPTIONS", "PUT", "PATCH", "TRACE", "get", "X" * 50])
        return method, path, headers, body

    def generate(self):
        way = self.random.random()
        method, target, headers, body = self.scan() if way < 0.3 else self.operation()
        if self.chance(0.1):
            headers = headers + [self.random.choice(EVIL_HEADERS)]
        if way < 0.85:
            return method, request_bytes(method, target, headers, body), not any(
                name.lower() in ("content-length", "transfer-encoding", "expect", "connection") for name, _ in headers)
        if self.chance(0.3):  # chunks, good and bad
            headers = [h for h in headers if h[0].lower() != "content-length"] + [("Transfer-Encoding", "chunked")]
            half = len(body) // 2
            pieces = b"".join(b"%x\r\n%s\r\n" % (len(p), p) for p in (body[:half], body[half:]) if p) + b"0\r\n\r\n"
            body = self.spoil(pieces) if self.chance(0.5) else pieces
        data = request_bytes(method, target, headers, body)
        head = data.find(b"\r\n\r\n") + 4
        return method, self.spoil(data[:head]) + data[head:] if self.chance(0.6) else self.spoil(data), False


class Asker(threading.Thread):
    def __init__(self, server, numbers, tally, findings):
        super().__init__()
        self.server, self.numbers, self.tally, self.findings = server, numbers, tally, findings
        self.link = self.stream = None

    def close(self):
        if self.link is not None:
            self.stream.close()
            self.link.close()
        self.link = self.stream = None

    def exchange(self, method, data, whole):
        """The answer, or nothing when the server closes without one, as it may when the bytes are no request."""
        if not whole:
            self.close()
        for fresh in (self.link is None, True):
            if self.link is None:
                self.link = self.server.connect()
                self.stream = self.link.makefile("rb")
            try:
                try:
                    self.link.sendall(data)
                    if not whole:
                        self.link.shutdown(socket.SHUT_WR)  # the rest will not come
                except OSError:
                    pass  # the answer may be there all the same
                answer = read_answer(self.stream, method)
                if not whole or not answer[3]:
                    self.close()
                return answer
            except (EOFError, ConnectionError):
                self.close()
                if not whole:
                    return None
                if fresh:
                    raise Broken("no answer to a whole request")
        return None

    def run(self):
        for i in self.numbers:
            method, data, whole = Generator(self.server, i).generate()
            try:
                answer = self.exchange(method, data, whole)
                if answer is not None:
                    check_answer(method, data.split(b"\r\n", 1)[0].decode("latin-1"), answer, self.server.folder)
                self.tally[answer[0] if answer else "closed"] += 1
            except Exception as problem:  # whatever it is, it is a finding
                self.close()
                self.findings.append("request %d: %s\n  %r" % (i, problem, data[:400]))
                if self.server.process.poll() is not None:
                    return
        self.close()


def main():
    with tempfile.TemporaryDirectory() as folder:
        server = Server(SERVER, folder, FLAGS)
        tally, findings, begun = collections.Counter(), [], time.monotonic()
        for first in range(0, REQUESTS, REFRESH):
            last = min(first + REFRESH, REQUESTS)
            askers = [Asker(server, range(first + t, last, THREADS), tally, findings) for t in range(THREADS)]
            for asker in askers:
                asker.start()
            for asker in askers:
                asker.join()
            if server.process.poll() is not None or len(findings) > 50:
                break
            server.refresh()
            if last % 10000 == 0:
                print("%6d requests in %5.0f s, %d findings" % (last, time.monotonic() - begun, len(findings)), flush=True)
        ended = server.stop()
        findings += ["The log has: " + fault for fault in server.faults()]
        for finding in findings[:50]:
            print(finding)
        print("answers:", dict(sorted(tally.items(), key=str)), "- ended with", ended, "- findings:", len(findings))
        sys.exit(1 if findings or ended != 0 else 0)


main()
