#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""soak.py [SPHERULED [MINUTES [BUSY]]]: mixed load for an hour, and whether memory stays flat.

Four clients upload (whole, packed, as a form, as an archive, in pieces, broken off), model, measure, simplify, register,
draw, export, read, ask wrongly, cancel and delete, and rest so that the server keeps BUSY processors busy (0.35). What is
stored keeps its size: the oldest volumes go, with all that was made of them. Every 30 s a line tells the server's
resident memory, open files, threads and requests so far.

Flat means: after the first quarter of the time, in which caches fill, the median of the last third of the samples of
resident memory is at most 5 % above that of the first third, and there are never more than 320 files open: the server
keeps up to 256 blobs open, and the rest are connections, the catalogue and logs. The growth an hour by least squares is
told beside it. The status is 0 when both hold and no answer had a status of 500 or more.
"""
import gzip
import http.client
import io
import json
import os
import random
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import zipfile

SERVER = sys.argv[1] if len(sys.argv) > 1 else "build/release/server/spheruled"
MINUTES = float(sys.argv[2]) if len(sys.argv) > 2 else 60
BUSY = float(sys.argv[3]) if len(sys.argv) > 3 else 0.35
CLIENTS, VOLUMES_KEPT, SAMPLE_S, MOST_FILES = 4, 5, 30, 320
EXPORTS = ["npy", "csv", "ply", "vtp", "xyz", "pqr", "gltf", "urdf"]
TICKS = os.sysconf("SC_CLK_TCK")


class Served:
    """The server in a folder of its own."""

    def __init__(self, folder):
        flags = ["--port", "0", "--data", folder + "/data", "--model-cache-bytes", str(16 << 20), "--keep-jobs", "120s"]
        self.log = open(folder + "/log", "wb")
        self.process = subprocess.Popen([SERVER, *flags], stdout=subprocess.PIPE, stderr=self.log)
        self.port = int(self.process.stdout.readline().rsplit(b":", 1)[1])
        self.folder = "/proc/%d/" % self.process.pid

    def status(self, name):
        with open(self.folder + "status") as lines:
            return next(int(line.split()[1]) for line in lines if line.startswith(name + ":"))

    def open_files(self):
        return len(os.listdir(self.folder + "fd"))

    def seconds(self):
        with open(self.folder + "stat") as line:
            fields = line.read().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / TICKS


def ball(size, centre, radius):
    """A ball in a cube of bytes: 200 at its centre, 100 at its surface."""
    rows = []
    for z in range(size):
        for y in range(size):
            plane = (z - centre[2]) ** 2 + (y - centre[1]) ** 2
            rows.append(bytes(max(0, int(200 - 100 * ((x - centre[0]) ** 2 + plane) ** 0.5 / radius)) for x in range(size)))
    return b"".join(rows)


class Client(threading.Thread):
    def __init__(self, server, seed, stop, tally):
        super().__init__(daemon=True)
        self.server, self.random, self.stopping, self.tally = server, random.Random(seed), stop, tally
        self.connection = None
        self.models = []

    def ask(self, method, path, body=None, **headers):
        """Status, headers and body; a connection serves several requests, as clients' do."""
        headers = {name.replace("_", "-"): value for name, value in headers.items()}
        for attempt in range(2):
            if self.connection is None:
                self.connection = http.client.HTTPConnection("127.0.0.1", self.server.port, timeout=300)
            try:
                self.connection.request(method, path, body, headers)
                answer = self.connection.getresponse()
                data = answer.read()
                break
            except (http.client.HTTPException, ConnectionError):
                self.connection.close()
                self.connection = None
                if attempt == 1:
                    raise
        self.tally[answer.status] = self.tally.get(answer.status, 0) + 1
        return answer.status, answer.headers, data

    def made(self, path, wish, **headers):
        """The document of what a POST makes, having waited for it; nothing when it makes none."""
        status, _, data = self.ask("POST", path, json.dumps(wish), Content_Type="application/json", Prefer="wait=60", **headers)
        return json.loads(data) if status in (200, 201) else None

    def upload(self):
        size = self.random.randrange(20, 36)
        centre = [size / 2 + self.random.uniform(-2, 2) for _ in range(3)]
        scan = ball(size, centre, self.random.uniform(0.2, 0.35) * size)
        query = "?format=raw&dims=%d,%d,%d&dtype=uint8&spacing=%.4f,1,1" % (size, size, size, self.random.uniform(0.8, 1.2))
        way = self.random.randrange(6)
        if way == 0:
            answer = self.ask("POST", "/v1/volumes" + query, scan)
        elif way == 1:
            answer = self.ask("POST", "/v1/volumes" + query, gzip.compress(scan), Content_Encoding="gzip")
        elif way == 2:
            form = b'--cut\r\nContent-Disposition: form-data; name="file"; filename="scan.raw"\r\n\r\n' + scan + b"\r\n--cut--\r\n"
            answer = self.ask("POST", "/v1/volumes" + query, form, Content_Type="multipart/form-data; boundary=cut")
        elif way == 3:
            archive = io.BytesIO()
            with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as files:
                files.writestr("scan.raw", scan)
            answer = self.ask("POST", "/v1/volumes" + query, archive.getvalue(), Content_Type="application/zip")
        else:
            tus = {"Tus_Resumable": "1.0.0"}
            _, headers, _ = self.ask("POST", "/v1/uploads", Upload_Length=str(len(scan)), **tus)
            place = headers["Location"]
            for begin in range(0, len(scan), 10000):
                self.ask("PATCH", place, scan[begin:begin + 10000], Content_Type="application/offset+octet-stream",
                         Upload_Offset=str(begin), **tus)
                if way == 5 and self.random.random() < 0.1:  # never finished
                    self.ask("DELETE", place, **tus)
                    return None
            answer = self.ask("POST", "/v1/volumes" + query + "&upload=" + place.rsplit("/", 1)[1])
        return json.loads(answer[2])["id"] if answer[0] in (200, 201) else None

    def break_off(self):
        """A body that ends before it is complete."""
        broken = http.client.HTTPConnection("127.0.0.1", self.server.port, timeout=60)
        broken.putrequest("POST", "/v1/volumes")
        broken.putheader("Content-Length", "1000000")
        broken.endheaders(b"n" * self.random.randrange(100, 10000))
        broken.close()

    def ask_wrongly(self):
        for method, path, body in [("GET", "/v1/models/mdl_0", None), ("POST", "/v1/models", "{"), ("PUT", "/v1/models", None),
                                   ("POST", "/v1/volumes", b"no scan"), ("GET", "/v1/models?limit=x", None)]:
            self.ask(method, path, body)

    def use(self, model):
        """Everything that can be asked of a model."""
        path = "/v1/models/" + model
        _, headers, _ = self.ask("GET", path)
        self.ask("GET", path, If_None_Match=headers["ETag"])
        for part in ["measures", "checks", "histogram?buckets=%d" % self.random.randrange(5, 50),
                     "render?width=160&height=120&view=" + self.random.choice("aprlhf"),
                     "spheres?limit=%d" % self.random.randrange(1, 1000), "exports/" + self.random.choice(EXPORTS)]:
            self.ask("GET", path + "/" + part, Prefer="wait=60", Accept_Encoding=self.random.choice(["gzip", "zstd", ""]))
        self.ask("GET", path + "/exports/npy", Prefer="wait=60", Range="bytes=0-99")

    def watch(self):
        """A job's events to the end, or a job cancelled."""
        status, _, data = self.ask("POST", "/v1/models", json.dumps({"volume": self.volume, "threshold": self.random.uniform(90, 150)}),
                                   Content_Type="application/json")
        if status != 202:
            return
        job = "/v1/jobs/" + json.loads(data)["id"]
        if self.random.random() < 0.5:
            self.ask("POST", job + "/cancel")
        else:
            self.ask("GET", job + "/events")
        self.ask("GET", job)

    def cycle(self):
        self.volume = self.upload()
        if self.volume is None:
            return
        self.mine.append(self.volume)
        self.ask("GET", "/v1/volumes/%s/slices/k/8?threshold=100" % self.volume, Prefer="wait=60")
        self.ask("GET", "/v1/volumes/%s/histogram" % self.volume)
        self.ask("GET", "/v1/volumes/%s/content" % self.volume)
        model = self.made("/v1/models", {"volume": self.volume, "threshold": round(self.random.uniform(90, 150), 3)},
                          Idempotency_Key=str(self.random.getrandbits(64)))
        if model is None:
            return
        self.models.append(model["id"])
        for _ in range(3):
            self.use(self.random.choice(self.models[-3:]))
        self.made("/v1/models/%s/simplifications" % model["id"], {"method": "best", "k": 20})
        if len(self.models) > 1:
            registration = self.made("/v1/registrations", {"fixed": self.models[-1], "moving": self.models[-2]})
            if registration is not None:
                self.ask("GET", "/v1/registrations/%s?format=itk" % registration["id"])
        self.watch()
        for path in ["/v1/volumes", "/v1/models", "/v1/jobs?limit=20", "/v1/registrations", "/metrics", "/readyz", "/version", "/docs"]:
            self.ask("GET", path)
        if self.random.random() < 0.3:
            self.break_off()
            self.ask_wrongly()
        if len(self.mine) > VOLUMES_KEPT:
            self.ask("DELETE", "/v1/volumes/" + self.mine.pop(0))
            self.models.pop(0)

    def run(self):
        self.mine = []
        begun = time.monotonic()
        while not self.stopping.is_set():
            self.cycle()
            while not self.stopping.wait(0.5) and self.server.seconds() > BUSY * (time.monotonic() - begun):
                pass


def growth(samples):
    """Least squares: units a second."""
    return statistics.linear_regression(*zip(*samples)).slope if len(samples) > 1 else 0


def main():
    with tempfile.TemporaryDirectory() as folder:
        server = Served(folder)
        stop, tally, begun = threading.Event(), {}, time.monotonic()
        clients = [Client(server, seed, stop, tally) for seed in range(CLIENTS)]
        for client in clients:
            client.start()
        memory, files = [], []
        print("%8s %9s %6s %8s %9s %8s" % ("s", "rss_MiB", "files", "threads", "requests", "cpu_s"), flush=True)
        while (now := time.monotonic() - begun) < 60 * MINUTES:
            if not all(client.is_alive() for client in clients) or server.process.poll() is not None:
                sys.exit("A client or the server has ended early.")
            rss, held = server.status("VmRSS") / 1024, server.open_files()
            memory.append((now, rss))
            files.append((now, held))
            print("%8.0f %9.1f %6d %8d %9d %8.0f" % (now, rss, held, server.status("Threads"), sum(tally.values()), server.seconds()), flush=True)
            time.sleep(SAMPLE_S)
        stop.set()
        for client in clients:
            client.join(300)
        server.process.terminate()
        ended = server.process.wait(60)
        print("answers by status:", dict(sorted(tally.items())), "- ended with", ended)
        warm = memory[len(memory) // 4:]
        third = max(1, len(warm) // 3)
        first, last = (statistics.median(value for _, value in part) for part in (warm[:third], warm[-third:]))
        most = max(value for _, value in files)
        flat = last <= 1.05 * first and most <= MOST_FILES
        print("resident memory: %.1f MiB, %.1f at the end, %+.2f an hour by least squares; at most %d open files: %s" %
              (first, last, 3600 * growth(warm), most, "flat" if flat else "GROWS"))
        faults = sum(count for status, count in tally.items() if status >= 500)
        sys.exit(0 if flat and faults == 0 and ended == 0 else 1)


main()
