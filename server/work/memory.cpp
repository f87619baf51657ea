// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/work/memory.h"

#include <algorithm>
#include <cmath>
#include <variant>

#include "core/write/export_grids.h"

namespace spherule::server {

namespace {

// CGAL's triangulation is most of it. Measured: 480 to 667 bytes (ct-head, abdomen-ct, engine, ch2).
constexpr std::uint64_t kAPoint = 700;
// Of a union's parts with what they are made from: of inside cells (core/measure/union.h: 140, and the part), of other
// balls (300, and the part).
constexpr std::uint64_t kAPartOfCells = 190, kAPart = 340;
// While all is measured: of inside cells by thickness and components, of other balls by their power diagram, CGAL's
// again, of about 7 cells a ball.
constexpr std::uint64_t kAMeasuredCell = 300, kAMeasuredBall = 1600;
// Of pictures: of raw models a patch a facet, of other balls as many as they show apart (core/render/patches.h;
// measured: 130 side by side, 540 at random, 1,500 where all touch one sphere from inside); and of their pixels: the
// picture, the same as it is packed, and packed.
constexpr std::uint64_t kADrawnCell = 280, kADrawnBall = 1500, kAPixel = 12;
// Of blobs more (core/render/blob_cells.h): cells, which few balls may have many of where they all end in one place.
// Measured: 1.2 kB (3.2 million of a head, of which 2 million blend), 3.1 (39,000 at random), 3.8 (40,000 in each
// other); 23 (1,800 within a mm).
constexpr std::uint64_t kABlob = 4000, kARawBlob = 2000, kAFewBlob = 24 << 10, kMostOfFewBlobs = 64 << 20;
// A number in text, as it grows by doubling.
constexpr std::uint64_t kADecimal = 40;
// Bits that say on which side samples are.
constexpr std::uint64_t bits_of(const ScanSize& scan) { return scan.samples / 4; }

// Cubes of an edge in a box, and a layer around; at most `most`.
std::uint64_t cubes_in(const Box& box, double edge, std::uint64_t most) {
  double cubes = 1;
  for (int a = 0; a < 3; ++a) cubes *= std::floor((box.max[a] - box.min[a]) / edge) + 3;
  return cubes < static_cast<double>(most) ? static_cast<std::uint64_t>(cubes) : most;
}

// Of the measures of a union's parts, beside the model.
std::uint64_t parts_of(const ModelSize& model) {
  return model.raw() ? model.inside_cells * kAPartOfCells : model.spheres * kAPart;
}

// Of the volume of a raw model and of its sides.
std::uint64_t scanned(const ModelSize& model) {
  return model.raw() && model.scan ? model.scan->bytes + bits_of(*model.scan) : 0;
}

}  // namespace

ScanSize size_of(const api::VolumeInfo& volume) {
  const std::uint64_t samples = volume.grid.sample_count();
  return {.samples = samples, .bytes = samples * bytes_per_voxel(volume.type)};
}

std::uint64_t memory_to_count(const ScanSize& scan) { return scan.bytes + bits_of(scan); }

std::uint64_t memory_to_model(const ScanSize& scan, std::size_t boundary_points) {
  return memory_to_count(scan) + boundary_points * kAPoint;
}

std::uint64_t memory_to_measure(const ModelSize& model) {
  return model.loaded() + scanned(model) +
         (model.raw() ? model.inside_cells * kAMeasuredCell : model.spheres * kAMeasuredBall);
}

std::uint64_t memory_to_measure_parts(const ModelSize& model) { return model.loaded() + parts_of(model); }

std::uint64_t memory_to_check(const ModelSize& model) {
  constexpr std::uint64_t a_ball = 100;
  return model.loaded() + scanned(model) + model.spheres * a_ball;
}

std::uint64_t memory_to_draw(const RenderOptions& options, std::span<const ModelSize> models) {
  // Of a surface: its corner, two triangles with their box and node.
  constexpr std::uint64_t a_corner = 320;
  std::uint64_t bytes = pixels_of(options, models.size()) * kAPixel;
  for (const ModelSize& model : models) {
    bytes += model.loaded() + model.spheres * (model.raw() ? kADrawnCell : kADrawnBall);
    if (options.style == Style::blobs)
      bytes +=
          model.spheres * (model.raw() ? kARawBlob : kABlob) + std::min(model.spheres * kAFewBlob, kMostOfFewBlobs);
    if (options.style == Style::surface) bytes += scanned(model) + model.points * a_corner;
    if (options.colour_by == ColourBy::contribution) bytes += parts_of(model);
  }
  return bytes;
}

std::uint64_t memory_to_list(const api::ExportRequest& wanted, const ModelSize& model,
                             const std::optional<ModelSize>& source) {
  const api::SphereListing& listing = wanted.listing;
  const std::uint64_t rows = listing.rows == api::SphereRows::members && source ? source->spheres : model.spheres;
  const std::uint64_t numbers = 4 + listing.columns.size();
  const std::uint64_t a_number =
      sizeof(double) + (wanted.format == api::SphereFormat::csv ? kADecimal : 4 * sizeof(double));
  std::uint64_t bytes = model.loaded() + rows * numbers * a_number;
  if (source) bytes += source->loaded();
  if (listing.needs_contributions()) bytes += parts_of(model);
  return bytes;
}

std::uint64_t memory_to_show_tree(const ModelSize& model) {
  // The document's values, and its text.
  constexpr std::uint64_t a_byte = 12;
  return model.loaded() + model.stored * a_byte;
}

std::uint64_t memory_to_write(const api::FileRequest& file, std::uint64_t spheres, const Box& box,
                              const std::optional<Grid>& scan) {
  // Text that grows by doubling; corners and triangles of meshes likewise; a block of a level set as it is made, in the
  // library's tree and in the file; a mask as bits and packed.
  constexpr std::uint64_t bytes_a_line = 400, bytes_a_triangle = 90, bytes_a_block = 8192, bytes_a_node = 36864,
                          bytes_a_sample = 1, most_samples = std::uint64_t{1} << 29;
  switch (file.format) {
    case FileFormat::glb: {
      if (file.options.glb.style == GlbOptions::Style::instanced) return spheres * bytes_a_line;
      const std::uint64_t triangles = spheres * (std::uint64_t{20} << (2 * file.options.glb.detail));
      return std::min<std::uint64_t>(triangles, max_glb_triangles) * bytes_a_triangle;
    }
    case FileFormat::vdb: {
      const Vec3 size = box.max - box.min;
      const double voxel = file.options.voxel_mm.value_or(std::max({size.x, size.y, size.z, 1e-6}) / 256);
      // Blocks far apart have nodes of 128³ voxels to themselves; no more of those than fit into a quarter as much.
      const std::uint64_t most_nodes = max_level_set_blocks * bytes_a_block / 4 / bytes_a_node;
      return cubes_in(box, 8 * voxel, max_level_set_blocks) * bytes_a_block +
             cubes_in(box, 128 * voxel, most_nodes) * bytes_a_node;
    }
    case FileFormat::nifti: {
      const auto& voxel = file.options.voxel_mm;
      return (voxel || !scan ? cubes_in(box, voxel.value_or(1), most_samples) : scan->sample_count()) * bytes_a_sample;
    }
    default: return spheres * bytes_a_line;
  }
}

SampledBox sampled_box(const Box& box, const std::optional<Grid>& grid) {
  if (box.empty()) return {};
  constexpr double of_a_union = 0x1p22, most_around = 0x1p27;  // core/sampled/object.h, evaluate.cpp
  const Vec3 extent = box.max - box.min;
  const double diagonal = norm(extent);
  if (!grid) {
    const double volume = extent.x * extent.y * extent.z;
    const double around = volume > 0 ? of_a_union * diagonal * diagonal * diagonal / volume : most_around;
    return {static_cast<std::uint64_t>(of_a_union), static_cast<std::uint64_t>(std::min(around, most_around))};
  }
  double samples = 1, around = 1;
  for (int a = 0; a < 3; ++a) {
    double along = 0;  // of the box, on the grid's axis
    for (int b = 0; b < 3; ++b) along += std::abs(grid->direction.rows[static_cast<std::size_t>(b)][a]) * extent[b];
    samples *= std::min(along / grid->spacing[a] + 3, static_cast<double>(grid->dims[static_cast<std::size_t>(a)]));
    around *= diagonal / grid->spacing[a] + 3;
  }
  return {static_cast<std::uint64_t>(samples), static_cast<std::uint64_t>(std::min(around, most_around))};
}

std::uint64_t memory_to_simplify(const SimplifyMethod& method, const ModelSize& model, const ModelSize& root) {
  // Of the object's samples: 5 for distances and what they are made from, as far as the result may reach; where balls
  // are refined also how often each is covered, and by what. Of a raw model 120 bytes a ball for its clusters; of any
  // other what overlaps.
  constexpr std::uint64_t a_sample = 9, a_refined_sample = 30, a_ball = 160;
  const auto* sphericity = std::get_if<SphericityOptions>(&method);
  const auto* splitting = std::get_if<SplittingOptions>(&method);
  const bool reaches = (sphericity != nullptr && sphericity->representative == Representative::enclosing) ||
                       (splitting != nullptr && splitting->representative == Representative::enclosing);
  const bool refines = std::holds_alternative<BestOptions>(method);
  std::uint64_t object = root.sampled.samples * (refines ? a_refined_sample : a_sample);
  if (reaches) object = std::max(object, root.sampled.around * a_sample);
  if (root.scan) object = std::max(object, root.scan->bytes) + bits_of(*root.scan);
  const std::uint64_t reference = root.raw() ? 0 : root.spheres * kAMeasuredBall;
  return object + root.loaded() + model.loaded() + model.spheres * a_ball + std::max(reference, parts_of(model));
}

std::uint64_t memory_to_slice(const api::SliceRequest& wanted, const api::VolumeInfo& volume) {
  // Of the plane: a sample of it as a number and as text, and where an object is asked for its points and triangles.
  constexpr std::uint64_t a_sample = 40, an_objects_sample = 400;
  const std::uint64_t samples =
      volume.grid.sample_count() / static_cast<std::uint64_t>(volume.grid.dims[static_cast<std::size_t>(wanted.axis)]);
  const ScanSize scan = size_of(volume);
  return scan.bytes + samples * (a_sample + (wanted.object ? an_objects_sample : 0));
}

std::uint64_t memory_to_register(const ModelSize& fixed, const ModelSize& moving) {
  constexpr std::uint64_t a_ball = 300;
  return fixed.loaded() + moving.loaded() + (fixed.spheres + moving.spheres) * a_ball;
}

std::uint64_t memory_to_apply(api::Applied what, const ModelSize& fixed, const ModelSize& moving) {
  // Of the result: its samples, and the file that holds them.
  const std::uint64_t samples = fixed.scan ? fixed.scan->samples : 0;
  if (what == api::Applied::model) return moving.loaded() + moving.spheres * kAPart + 3 * samples;
  return (moving.scan ? moving.scan->bytes : 0) + 8 * samples;
}

std::uint64_t memory_to_import(api::SphereFormat format, std::uint64_t bytes, std::uint64_t lines) {
  // The file as it is mapped, and the spheres: where their number is not known before, as they grow by doubling.
  return bytes + (format == api::SphereFormat::csv ? 3 * lines * sizeof(Sphere) : 2 * bytes);
}

}  // namespace spherule::server
