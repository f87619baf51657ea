#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Counts and times VTK's Flying Edges on one thread, as an independent peer of our boundary extraction.

It shares no reader with us: FILE holds the bare samples, x fastest, in the machine's byte order. Prints one line
of "name=value" pairs: points, triangles and the median wall time in seconds. Points are the crossed grid edges inside
the volume, so they compare with our crossings for `border: open`; a sample is inside where value >= THRESHOLD.

Example: flying_edges.py head.raw 60.5 --dims 181 217 181 --dtype uint8 --repeat 5
"""
import argparse
import os
import statistics
import time

os.environ["VTK_SMP_MAX_THREADS"] = "1"  # read when VTK loads

import numpy
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonCore import vtkSMPTools
from vtkmodules.vtkCommonDataModel import vtkImageData
from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float32", "float64")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file")
    parser.add_argument("threshold", type=float)
    parser.add_argument("--dims", type=int, nargs=3, required=True, metavar=("X", "Y", "Z"))
    parser.add_argument("--dtype", choices=TYPES, required=True)
    parser.add_argument("--spacing", type=float, nargs=3, default=(1.0, 1.0, 1.0), metavar=("X", "Y", "Z"))
    parser.add_argument("--repeat", type=int, default=5, help="runs, of which the median counts (5)")
    options = parser.parse_args()

    samples = numpy.fromfile(options.file, dtype=options.dtype)
    expected = options.dims[0] * options.dims[1] * options.dims[2]
    if samples.size != expected:
        parser.error(f"the file holds {samples.size} samples, --dims says {expected}")
    vtkSMPTools.Initialize(1)
    image = vtkImageData()
    image.SetDimensions(options.dims)
    image.SetSpacing(options.spacing)
    image.GetPointData().SetScalars(numpy_to_vtk(samples))

    seconds = []
    for _ in range(max(1, options.repeat)):
        surface = vtkFlyingEdges3D()  # a fresh filter has nothing cached and no memory to reuse
        surface.SetInputData(image)
        surface.SetValue(0, options.threshold)
        surface.ComputeNormalsOff()
        surface.ComputeGradientsOff()
        surface.ComputeScalarsOff()
        begin = time.perf_counter()
        surface.Update()
        seconds.append(time.perf_counter() - begin)
    mesh = surface.GetOutput()
    print(
        f"points={mesh.GetNumberOfPoints()} triangles={mesh.GetNumberOfPolys()} "
        f"seconds={statistics.median(seconds):.6f} runs={len(seconds)} threads={vtkSMPTools.GetEstimatedNumberOfThreads()}"
    )


main()
