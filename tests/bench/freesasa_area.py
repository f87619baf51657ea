#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Areas of a union of balls by freesasa: lines "x y z r" on stdin; prints seconds and the area (Lee and Richards)."""
import sys
import time

import freesasa

balls = [tuple(map(float, line.split())) for line in sys.stdin]
coordinates = [value for ball in balls for value in ball[:3]]
radii = [ball[3] for ball in balls]
parameters = freesasa.Parameters({"algorithm": freesasa.LeeRichards, "probe-radius": 0.0, "n-threads": 1})
begin = time.perf_counter()
area = freesasa.calcCoord(coordinates, radii, parameters).totalArea()
print(f"seconds={time.perf_counter() - begin:.6f} area={area:.9g}")
