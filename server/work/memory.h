// SPDX-License-Identifier: GPL-3.0-or-later
//
// How much memory a job will need at its peak: what admission goes by. One function a kind of job, from the sizes of
// what it works on. Coefficients come from measured peaks of the stages, rounded up to those of the worst object of its
// size; they are estimates, not bounds. All in bytes, all constant time. What a process takes once, whatever it works
// on, is not counted: some 24 MiB.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

#include "api/service.h"
#include "core/volume.h"
#include "server/bytes/model_blob.h"

namespace spherule::server {

/// Of a volume, decoded.
struct ScanSize {
  std::uint64_t samples = 0, bytes = 0;
};
ScanSize size_of(const api::VolumeInfo& volume);

/// Samples about a model, of its volume's grid, or as many as are made of spheres without one: in its box, and in the
/// box of the ball around that, as far as a simplified model may reach.
struct SampledBox {
  std::uint64_t samples = 0, around = 0;
};
SampledBox sampled_box(const Box& box, const std::optional<Grid>& grid);

/// Of a model.
struct ModelSize {
  std::uint64_t spheres = 0;
  std::uint64_t cells = 0, inside_cells = 0, points = 0;  ///< of a raw model; 0 for any other
  std::uint64_t stored = 0;                               ///< bytes of its blob
  std::optional<ScanSize> scan{};                         ///< of the volume that its chain of sources began with
  SampledBox sampled{};

  bool raw() const { return cells > 0; }
  std::uint64_t loaded() const { return bytes_to_load(stored, spheres); }
};

/// Of reading a volume and counting the boundary points of an object: what making a model begins with.
std::uint64_t memory_to_count(const ScanSize& scan);
/// Of making a model, once the boundary points are known.
std::uint64_t memory_to_model(const ScanSize& scan, std::size_t boundary_points);

/// Of the measures of a model, and of the parts of its spheres alone.
std::uint64_t memory_to_measure(const ModelSize& model);
std::uint64_t memory_to_measure_parts(const ModelSize& model);
std::uint64_t memory_to_check(const ModelSize& model);

/// Of a picture of these models.
std::uint64_t memory_to_draw(const RenderOptions& options, std::span<const ModelSize> models);

/// Of a listing of spheres as a file; `source` is what the model was simplified from, where there is one.
std::uint64_t memory_to_list(const api::ExportRequest& wanted, const ModelSize& model,
                             const std::optional<ModelSize>& source);
std::uint64_t memory_to_show_tree(const ModelSize& model);

/// Of writing so many spheres within a box as a file for one other program, beside the model and the measures of its
/// parts; `scan` is the grid of a mask without a voxel size of its own.
std::uint64_t memory_to_write(const api::FileRequest& file, std::uint64_t spheres, const Box& box,
                              const std::optional<Grid>& scan);

/// Of simplifying a model; `root` is the model that its chain of sources began with, itself where there is none.
std::uint64_t memory_to_simplify(const SimplifyMethod& method, const ModelSize& model, const ModelSize& root);

/// Of a slice: the whole volume is read.
std::uint64_t memory_to_slice(const api::SliceRequest& wanted, const api::VolumeInfo& volume);

/// Of a histogram of its values.
constexpr std::uint64_t memory_to_count_values(const ScanSize& scan) { return scan.bytes; }

/// Of registering two models.
std::uint64_t memory_to_register(const ModelSize& fixed, const ModelSize& moving);
/// Of the moving model or its volume on the grid of the fixed one's.
std::uint64_t memory_to_apply(api::Applied what, const ModelSize& fixed, const ModelSize& moving);

/// Of reading spheres that a user brings from a file of so many bytes, of which so many are lines' ends.
std::uint64_t memory_to_import(api::SphereFormat format, std::uint64_t bytes, std::uint64_t lines);

}  // namespace spherule::server
